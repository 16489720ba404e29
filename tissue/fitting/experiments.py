"""What to measure next: the information that a log of other cuts or presses would add, before it is measured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.forward import Forward
from tissue.fitting.noise import innovations, place_information
from tissue.fitting.posterior import Posterior
from tissue.fitting.target import BIAS_SHARE, OFFSET_S

__all__ = ["Gain", "expected_information"]


@dataclass(frozen=True)
class Gain:
    """What a candidate log is expected to add.

    Attributes
    ----------
    label
        What would be measured.
    nats
        Expected gain of information about all constants.
    widest
        The constant with the widest interval now.
    shrinks_to
        Its interval after the candidate log, as a share of that now.
    """

    label: str
    nats: float
    widest: str
    shrinks_to: float


def expected_information(
    posterior: Posterior, candidates: Sequence[tuple[str, Forward]], *, among: Sequence[int] = ()
) -> list[Gain]:
    """Expected information of candidate logs with the noise of the measured one, greatest first.

    Half the logarithm of the determinant of I + C M: C is the covariance of z now, and M the Fisher information of the
    candidate, its bias unknown (Chaloner and Verdinelli 1995, linearised at the maximum).

    Parameters
    ----------
    posterior
        Of the log that was measured.
    candidates
        Name and forward model of each, with the same constants.
    among
        Places of the constants of which the widest is looked for; all of them by default.
    """
    now = posterior.covariance_z
    places = list(among) or list(range(len(now)))
    at = places[int(np.argmax(np.diag(now)[places]))]
    values, vectors = np.linalg.eigh(now)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    gains = []
    for label, forward in candidates:
        grown, axes = np.linalg.eigh(np.eye(len(now)) + root.T @ _information(posterior, forward) @ root)
        grown = np.maximum(grown, 1.0)
        nats, after = 0.5 * float(np.log(grown).sum()), float(np.sum((root[at] @ axes) ** 2 / grown))
        gains.append(Gain(label, nats, posterior.names[at], float(np.sqrt(after / now[at, at]))))
    return sorted(gains, key=lambda each: -each.nats)


def _information(posterior: Posterior, forward: Forward) -> Array:
    """Fisher information of a log about z, its biases and its clock's offset left free, shape (p, p).

    A log at another rate than the measured one would have other noise: the candidate is taken at the measured rate.
    """
    target, noise = posterior.target, posterior.nuisances
    rate_s = float(np.median(np.diff(target.log.times_s)))
    every = max(round(rate_s / float(np.median(np.diff(forward.times_s)))), 1)
    places = [forward.channels.index(name) for name in target.log.channels]
    slopes = target.slopes(posterior.mean_z)
    x = target.x(posterior.mean_z)
    moved = forward.jacobian(x)[::every][:, places] * slopes
    by_offset = -OFFSET_S * np.gradient(forward.loads(x)[:, places], forward.times_s, axis=0)[::every, :, None]
    biases = np.broadcast_to(np.diag(BIAS_SHARE * target.log.sizes()), (len(moved), len(places), len(places)))
    columns = innovations(np.concatenate([moved, biases, by_offset], axis=2), noise.correlation)
    columns *= (np.sqrt(place_information(noise.freedom)) / noise.scale)[:, None]
    rows = columns.reshape(-1, columns.shape[2])
    p = len(slopes)
    whole = rows.T @ rows + np.diag([0.0] * p + [1.0] * (len(places) + 1))
    return np.asarray(whole[:p, :p] - whole[:p, p:] @ np.linalg.solve(whole[p:, p:], whole[p:, :p]))
