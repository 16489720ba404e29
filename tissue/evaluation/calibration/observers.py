"""Simulated people who compare two forces, and the effect of a force mapping on the result.

A mapping scales the force before the person feels it. The force scatters from trial to trial,
because of tissue, hand and device. The mapping scales this scatter together with the force. The
perceptual noise of the person is not scaled, because it is added after the mapping. A mapping
therefore changes discrimination only relative to the perceptual noise. An exponent or a gain above
1 improves discrimination: the differences between forces increase, or the forces exceed the
low-force term of the threshold. An exponent or a gain below 1 impairs discrimination. Calibration
gives every person the exponent of the reference observer. Discrimination improves for people with a
lower exponent, and becomes worse for people with a higher exponent. The mean over a population may
increase or decrease.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from meshes.base.arrays import Array, Flags
from meshes.base.hints import suggests_arguments
from tissue.evaluation.statistics.hypothesis_test import Effect
from tissue.haptics.device.device import device_parameters
from tissue.haptics.loop.filters import ForceRange
from tissue.materials.constants import constants
from tissue.perception.adaptive import MAGNITUDE_FORCES_N, fit_magnitudes
from tissue.perception.laws import D_PRIME_75, ForceMap, Intensity, intensity_of
from tissue.perception.observer import population, reference_observer

RESAMPLES = 2000
"""Number of bootstrap resamples of the people from which a 95 % interval is computed.

With this number, the tail probability of 2.5 % has a standard error of 0.35 %.
"""
TOUCH = ForceRange(limit_N=device_parameters("touch").force_limit_N)
"""Range of forces that the haptic device Touch can apply."""
Command = Callable[[Array], Array]
"""Function that maps an array of forces [N] to the forces [N] that the device shall apply."""


@suggests_arguments
@dataclass(frozen=True, kw_only=True)
class SimulatedObservers:
    """Simulated observers with known parameters, as arrays of shape (n,).

    The threshold of discrimination at the force F is kappa (F + offset). If two forces differ by
    the threshold, the felt intensities differ by 0.954 standard deviations of the noise. The noise
    of each felt intensity has unit variance; 75 % of the answers at the threshold are then right. A
    person rates a force F with the number alpha (F / 1 N)^beta, with noise in the logarithm of the
    number.

    Attributes
    ----------
    alpha, beta
        Stevens' factor and exponent.
    kappa, offset_N
        Weber fraction, and offset [N] that increases the threshold at low forces.
    lapse
        Fraction of wrong answers if the difference of the forces is large (lapse rate).
    sigma
        Standard deviation of the logarithm of a rated number.
    """

    alpha: Array
    beta: Array
    kappa: Array
    offset_N: Array
    lapse: Array
    sigma: Array

    def __len__(self) -> int:
        return len(self.kappa)

    def correct(self, base_N: ArrayLike, step_N: ArrayLike, rng: np.random.Generator) -> Flags:
        """Return True for each observer who names the larger of two forces, shape (n,).

        The forces are `base_N` and `base_N + step_N` [N]. If the step is 0, there is no larger
        force, and the results are random.

        Parameters
        ----------
        base_N, step_N
            The smaller force, and the difference between the two forces [N]. Each is a single
            value, or one value for each observer, shape (n,).
        rng
            Random generator of the noise. The noise depends only on the state of the generator, not
            on the forces.
        """
        threshold = self.kappa * (np.asarray(base_N) + self.offset_N)
        return self.discriminate(D_PRIME_75 * np.asarray(step_N) / threshold, rng)

    def discriminate(self, distance: ArrayLike, rng: np.random.Generator) -> Flags:
        """Return True for each observer who answers correctly, shape (n,).

        ``distance`` is the felt difference between two forces, divided by the standard deviation of
        the noise of one felt force.
        """
        first, second = rng.standard_normal((2, len(self)))
        blind, guess = rng.random((2, len(self)))
        return np.where(
            # half of the blind answers are right
            blind < 2.0 * self.lapse,
            guess < 0.5,
            np.asarray(distance) + second > first,
        )

    def number(self, force_N: ArrayLike, rng: np.random.Generator) -> Array:
        """Return the number with which each observer rates a force, shape (n,)."""
        noise = self.sigma * rng.standard_normal(len(self))
        return self.alpha * np.asarray(force_N) ** self.beta * np.exp(noise)


def draw_observers(group: str, count: int, rng: np.random.Generator) -> SimulatedObservers:
    """Return random observers of a group (novice, intermediate or expert).

    The distributions of the observers' parameters are from ``observers.toml`` and
    ``perception.toml``.
    """
    people = replace(population(), kappa=constants("observers", group)["kappa"].value)
    drawn: dict[str, Any] = people.draw(count, rng)
    return SimulatedObservers(**drawn)


@dataclass(frozen=True)
class Stimulus:
    """Force that scatters between trials: its mean and its standard deviation [N]."""

    level_N: float
    scatter_N: float = 0.0


def calibrated_commands(
    people: SimulatedObservers, rng: np.random.Generator, *, numbers: int = 24
) -> list[Command]:
    """Calibrate people; return the force mapping of each person.

    In the calibration, each person rates forces with numbers. The mapped force feels as strong to
    the person as the unchanged force feels to the reference observer.

    Parameters
    ----------
    people
        People to calibrate.
    rng
        Random generator of the scatter of the ratings.
    numbers
        Number of forces that each person rates. With 0, there are no ratings, and the true Stevens
        exponent and factor of each person are used.
    """
    knee_N = TOUCH.knee_N
    wanted = intensity_of(reference_observer())
    forces = np.resize(MAGNITUDE_FORCES_N, numbers)
    given = np.array([people.number(force, rng) for force in forces])
    commands: list[Command] = []
    for who in range(len(people)):
        if numbers:
            fit = fit_magnitudes(forces, given[:, who])
            (alpha, both), (_, beta) = fit.covariance.tolist()
            felt = Intensity(
                log_alpha=float(fit.mean[0]), beta=float(fit.mean[1]), variances=(alpha, both, beta)
            )
        else:
            felt = Intensity(
                log_alpha=float(np.log(people.alpha[who])), beta=float(people.beta[who])
            )
        # the command is a straight line below the low-force term, where Weber's law does not hold;
        # the line must end below the knee
        lowest_N = min(float(people.offset_N[who]), 0.5 * knee_N)
        commands.append(ForceMap(wanted, felt, lowest_N=lowest_N, knee_N=knee_N).command_N)
    return commands


def share_right(
    people: SimulatedObservers,
    first: Stimulus,
    second: Stimulus,
    *,
    seed: int,
    trials: int = 100,
    commands: Sequence[Command] | None = None,
    limits: ForceRange = TOUCH,
) -> Array:
    """Return the fraction of right answers of each person, shape (n,).

    An answer is right if it names the stimulus with the larger mean as the stronger one. Calls with
    the same seed use the same random numbers even if `commands` differs, so their results are
    paired.

    Parameters
    ----------
    people
        Observers.
    first, second
        The two stimuli. If their means are equal, half of the answers count as right.
    seed
        Seed of the scatter of the forces and of the perceptual noise.
    trials
        Number of trials for each person.
    commands
        Force mapping of each person. None for unchanged forces.
    limits
        Range of forces of the device. Forces near or above the upper end are compressed into the
        range.
    """
    if first.level_N > second.level_N:
        first, second = second, first
    scatter, noise = (np.random.default_rng([seed, stream]) for stream in (0, 1))
    shape = (trials, len(people))
    felt = []
    for each in (first, second):
        force = np.maximum(each.level_N + each.scatter_N * scatter.standard_normal(shape), 0.0)
        if commands is not None:
            force = np.column_stack(
                [command(force[:, who]) for who, command in enumerate(commands)]
            )
        felt.append(_played(force, limits))
    less, more = felt
    threshold = people.kappa * (np.minimum(less, more) + people.offset_N)
    distance = D_PRIME_75 * (more - less) / threshold
    return np.mean([people.discriminate(distance[trial], noise) for trial in range(trials)], axis=0)


def sensitivity(people: SimulatedObservers, first: Stimulus, second: Stimulus) -> Array:
    """Return the sensitivity d' of each person for two forces at the skin, shape (n,).

    The scatter of the forces between trials is included. Let kappa be the person's Weber fraction,
    and let t = kappa (F + offset) be the threshold at the weaker force F. Let m and s be the mean
    and the standard deviation of the difference between the two forces. Measured in units of d',
    the felt difference has mean 0.954 m / t and standard deviation 0.954 s / t; d' is 0.954 at the
    threshold. In addition, each force is felt with noise of unit variance. d' is the distance
    between two forces without scatter that gives the same fraction of right answers.
    """
    weaker = min(first.level_N, second.level_N)
    per_newton = D_PRIME_75 / (people.kappa * (weaker + people.offset_N))
    scatter = per_newton * np.hypot(first.scatter_N, second.scatter_N)
    # The noise of two intervals has variance 2: a scatter s of the difference adds s**2 / 2 to 1.
    return per_newton * abs(second.level_N - first.level_N) / np.sqrt(1.0 + 0.5 * scatter**2)


def chance_right(people: SimulatedObservers, first: Stimulus, second: Stimulus) -> Array:
    """Return the probability that each person names the stronger of two forces, shape (n,).

    `first` and `second` are forces at the skin. The scatter of the forces and the perceptual noise
    have normal distributions.
    """
    # in two intervals P = Phi(d' / sqrt(2))
    right = ndtr(sensitivity(people, first, second) / 2.0**0.5)
    return people.lapse + (1.0 - 2.0 * people.lapse) * right


def _played(force_N: Array, device: ForceRange) -> Array:
    """Return the force magnitudes [N] that a device applies for requested magnitudes [N].

    The function applies the compression of `ForceRange.play` to arrays.
    """
    knee = device.knee_N
    above = device.limit_N - knee
    return np.where(
        force_N <= knee, force_N, knee - above * np.expm1(-np.maximum(force_N - knee, 0.0) / above)
    )


def gain_of(before: Array, after: Array, rng: np.random.Generator) -> Effect:
    """Return the relative change [%] of the mean fraction of right answers.

    `before` and `after` are the fractions for the same n people, each of shape (n,). The 95 %
    interval is computed by resampling the people (bootstrap).
    """
    drawn = rng.integers(len(before), size=(RESAMPLES, len(before)))
    changes = 100.0 * (after[drawn].mean(axis=1) / before[drawn].mean(axis=1) - 1.0)
    value = 100.0 * float(after.mean() / before.mean() - 1.0)
    # 2.5 to 97.5 %: the 95 % interval
    return Effect(
        "change of right answers in percent", value, *np.quantile(changes, [0.025, 0.975]).tolist()
    )
