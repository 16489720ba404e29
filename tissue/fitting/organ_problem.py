"""Loads of a probe on an organ as a function of the organ's constants.

If all moduli change by one factor, the loads change by this factor. A polynomial of second order
in the other constants approximates the loads.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from tissue.fitting.log import MeasuredLog
from tissue.fitting.organ_runs import KEYS, OrganRuns, Poses, organ_parameters
from tissue.fitting.posterior import Posterior, maximum_posterior, require_signs
from tissue.fitting.problem import MeasuredLoads, Parameter, Problem
from tissue.models.tissue_model import TICK_S
from tissue.scene.load import changed
from tissue.scene.organ import LiverFile, SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe


@dataclass(frozen=True, eq=False)
class OrganForward:
    """Approximation of the loads for constants near the constants of one run.

    If all moduli of an organ are multiplied by one factor and all other constants stay the same,
    the force on a given path is multiplied by the same factor. Each run therefore uses the cited
    value of the first modulus, and the other moduli are scaled in proportion.

    Attributes
    ----------
    parameters, channels, times_s
        See `tissue.fitting.problem.Forward`.
    moduli
        Indices of the moduli to which the loads are jointly proportional. Empty if the loads are
        not proportional to the moduli, see `tissue.fitting.organ_runs.organ_parameters`.
    constants
        Constants of the run, shape (p,).
    run_loads
        Loads of the run, shape (n, channels).
    slopes
        Coefficients, shape (n, channels, p), that multiply the difference between each constant and
        its value in `constants`. They are zero for the first modulus. For a relaxation time, the
        difference of the logarithms is used.
    curved
        Coefficients, shape (n, channels, p, p), that multiply the squares and products of the
        differences. The matrix is symmetric: entries (i, j) and (j, i) each hold half of the
        coefficient of a product.
    """

    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    times_s: Array
    moduli: tuple[int, ...]
    constants: Array
    run_loads: Array
    slopes: Array
    curved: Array

    def reduced(self, x: Array) -> tuple[float, Array]:
        """Return the load ratio between `x` and a run with scaled moduli, and that run's constants.

        All moduli in `x` are scaled by one factor. In the scaled run, the first modulus is equal to
        the first modulus in `constants`. If `moduli` is empty, the results are 1 and `x`.
        """
        x = np.asarray(x, dtype=float)
        # the loads are not proportional to moduli: a run with x itself is needed
        if not self.moduli:
            return 1.0, x
        first = self.moduli[0]
        others = list(self.moduli)
        scale = float(x[first] / self.constants[first])
        same = x.copy()
        same[others] = x[others] / scale
        same[first] = self.constants[first]
        return scale, same

    def loads(self, x: Array) -> Array:
        """Return the loads, see `tissue.fitting.problem.Forward`."""
        scale, same = self.reduced(x)
        return scale * self._of_run(self.distance(same))

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of the loads, see `tissue.fitting.problem.Forward`."""
        scale, same = self.reduced(x)
        distance = self.distance(same)
        found = self._slopes_at(distance) / np.where(self._logarithmic, same, 1.0)
        # below, the loads scale with the first modulus, and the other moduli with its ratio
        if not self.moduli:
            return found
        first = self.moduli[0]
        others = list(self.moduli[1:])
        of_others = found[..., others] @ same[others]
        found *= scale
        found[..., others] /= scale
        found[..., first] = (self._of_run(distance) - of_others) / self.constants[first]
        return found

    def moved(self, constants: Array, run_loads: Array, *, learnt: float) -> "OrganForward":
        """Return a model with the loads of another run as its base, and with corrected slopes.

        With the corrected slopes, the present model predicts the loads of the other run (Broyden
        1965).

        Parameters
        ----------
        constants, run_loads
            Constants of the other run, and its loads.
        learnt
            Smallest step from the last run, in standard deviations of the priors, for which the
            slopes are corrected. On a shorter step, the change of the loads comes mainly from
            single mesh nodes that come into contact.
        """
        distance = self.distance(constants)
        middle = np.array([each.prior.value for each in self.parameters])
        widths = np.array([each.prior.slope(0.0) for each in self.parameters])
        step = distance / np.where(self._logarithmic, widths / middle, widths)
        slopes = self._slopes_at(distance)
        # a shorter step would explain single nodes that come into contact
        if np.linalg.norm(step) >= learnt:
            missed = run_loads - self._of_run(distance)
            along = np.divide(step**2, distance, out=np.zeros_like(step), where=distance != 0.0)
            slopes = slopes + missed[..., None] * along / (step @ step)
        return replace(self, constants=constants, run_loads=run_loads, slopes=slopes)

    def distance(self, x: Array) -> Array:
        """Return the difference between `x` and the constants of the run, shape (p,)."""
        return np.where(self._logarithmic, np.log(x / self.constants), x - self.constants)

    @cached_property
    def _logarithmic(self) -> Array:
        return np.array([each.name.endswith("_s") for each in self.parameters])

    def _of_run(self, distance: Array) -> Array:
        return np.asarray(self.run_loads + (self.slopes + self.curved @ distance) @ distance)

    def _slopes_at(self, distance: Array) -> Array:
        return np.asarray(self.slopes + 2.0 * self.curved @ distance)


EVERY = 2
"""Ticks between two loads that a run keeps. A log is averaged over more ticks than this."""
STEPS = (0.1, 1.0)
"""Limits of the change of a constant from which a slope is computed [prior standard deviations].

Between these limits, the change equals the uncertainty of the constant. The load difference after a
smaller change would show single nodes that enter or leave the contact.
"""
FIRST_STEP = 0.5
"""One-sided change of a constant for its first slope, in standard deviations of its prior."""
SETTLED = 0.3
"""Distance of fitted constants from the last run's constants below which no run is added.

The distance is measured in standard deviations of the constants. A 90 % interval is 3.3 standard
deviations wide.
"""
ROUNDS = 3
TRIES = 6
"""Largest number of further runs before the slopes are computed again.

`ROUNDS` is the largest number of times that slopes are computed.

These numbers limit the runs of a fit that does not converge. `UNSETTLED` is the message about such
a fit.
"""
LEARNT = 0.1
"""Step of the constants above which slopes are corrected, in prior standard deviations."""
UNSETTLED = (
    "the runs and the result do not agree yet, so the intervals are not reliable. Free "
    "fewer constants"
)
FINER = 1.4
"""Edge length of a fit's mesh, divided by the edge length of the finer comparison mesh."""
PARTS = 4
"""Number of parts of a log. For each part, one fit uses the finer mesh only in this part.

The four parts are approximately press, hold, retreat and rest.
"""
WIDE = 0.2
"""Standard deviation, relative to the prior, above which constants are also changed in pairs.

Every two constants above this limit are changed together in one run, which gives the coefficient of
the product of their changes.
"""
FARTHEST = 3.0
"""Largest distance of a run's constant from the median of its prior [standard deviations].

The ends of a cited range are 1.6 standard deviations from its median.
"""


@dataclass(frozen=True, eq=False)
class Settled:
    """Model of the forces, valid for constants near the most probable constants.

    Attributes
    ----------
    forward
        Model of the loads.
    posterior
        Posterior of the constants given the log.
    away
        Largest distance of a most probable constant from its value in the last run, in standard
        deviations of the constant.
    """

    forward: OrganForward
    posterior: Posterior
    away: float


def organ_problem(
    scene: Scene, log: MeasuredLog, free: Sequence[str], *, cores: int | None, progress: Progress
) -> Problem:
    """Return the fit data for the log of a probe that presses an organ (see `fit_scene`).

    The organ is simulated along the poses of the log with the initial constants, and then with one
    constant changed at a time. Further runs use the fitted constants, until the next fit agrees
    with the constants of the last run.
    """
    poses = Poses(log.times_s, log.tips_m, log.quaternions_of(scene))
    parameters, moduli = organ_parameters(scene, free)
    measured, ticks = log.averaged()
    runs = OrganRuns(scene, poses, log.channels, every=EVERY, cores=cores or os.cpu_count() or 1)
    with names_of_caller({"motion": "measured"}):
        found = settled(parameters, moduli, runs, measured, progress)
        finer, note = _on_finer_mesh(scene, found, runs)
    notes = (*_notes(found, runs.count), note)
    return Problem(
        found.forward,
        measured,
        ticks * TICK_S,
        dict,
        notes,
        finer=finer,
        # Convergence of second order.
        mesh_factor=1.0 / (1.0 - FINER**-2.0),
    )


def _on_finer_mesh(
    scene: Scene, found: Settled, runs: OrganRuns
) -> tuple[tuple[OrganForward, ...] | None, str]:
    """Return the loads on a finer mesh for `Problem.finer`, and a note.

    One run on the finer mesh gives the loads near the fitted constants. The slopes are taken from
    the mesh of the fit.
    """
    forward = found.forward
    try:
        base = runs.of(finer_scene(scene), _named(forward.parameters, forward.constants))
    except InputError as refusal:
        return None, f"the intervals do not contain the error of the mesh: {refusal}"
    share = float(np.linalg.norm(base - forward.run_loads) / np.linalg.norm(base))
    parts = []
    for rows in np.array_split(np.arange(len(base)), PARTS):
        mixed = forward.run_loads.copy()
        mixed[rows] = base[rows]
        parts.append(replace(forward, run_loads=mixed))
    return (replace(forward, run_loads=base), *parts), (
        f"a mesh with {1.0 / FINER:.0%} of the edge lengths changes the loads by {share:.1%}. The "
        "intervals contain this change"
    )


def finer_scene(scene: Scene) -> Scene:
    """Return a scene whose organ has a finer mesh."""
    anatomy = scene.anatomy
    tool = scene.tool
    assert isinstance(anatomy, SoftAnatomy) and isinstance(tool, Probe)
    touch_mm = anatomy.touch_edge_mm or 0.25 * tool.size_mm
    changes: dict[str, object] = {"anatomy.touch_edge_mm": touch_mm / FINER}
    # Tetrahedra from a file have their own edges.
    if not isinstance(anatomy, LiverFile):
        changes["anatomy.edge_mm"] = anatomy.edge_mm / FINER
    return changed(scene, changes)


def settled(
    parameters: tuple[Parameter, ...],
    moduli: tuple[int, ...],
    runs: OrganRuns,
    measured: MeasuredLoads,
    progress: Progress,
) -> Settled:
    """Compute a model of the loads from runs near the most probable constants of a log.

    Slopes are computed from the load differences between runs with nearby constants. Further runs
    use the fitted constants and serve to correct the slopes. They end when the fitted constants
    agree with the constants of the last run. The slopes are then computed again at these constants.
    The change of each constant is as large as its uncertainty.
    """
    at = np.array([each.prior.x(0.0) for each in parameters])
    spread = None
    away = np.inf
    (base,) = runs([_named(parameters, at)])
    times_s = runs.poses.times_s[0] + EVERY * TICK_S * np.arange(len(base), dtype=np.float64)
    flat = np.zeros((*base.shape, len(parameters)))
    curved = np.zeros((*flat.shape, len(parameters)))
    forward = OrganForward(parameters, measured.channels, times_s, moduli, at, base, flat, curved)
    for number in range(ROUNDS):
        # three rounds fill three quarters of the progress; `fit_scene` continues at 0.8
        progress(f"round {number + 1} of runs of the organ", 0.25 * number)
        forward = _sloped(forward, runs, spread)
        # before the first slopes, the loads do not depend on the constants
        if number == 0:
            require_signs(forward, measured)
        for tried in range(TRIES + 1):
            posterior = maximum_posterior(forward, measured)
            spread = np.sqrt(np.diag(posterior.covariance_z))
            at, away = _next(forward, posterior, spread)
            if away < SETTLED or tried == TRIES:
                break
            progress(f"run {runs.count + 1} of the organ", 0.25 * (number + (tried + 1) / TRIES))
            forward = forward.moved(at, runs([_named(parameters, at)])[0], learnt=LEARNT)
        # the first slopes are one-sided, so that a second round always follows
        if number and away < SETTLED:
            break
    return Settled(forward, posterior, away)


def _next(forward: OrganForward, posterior: Posterior, spread: Array) -> tuple[Array, float]:
    """Return the constants of the next run and their distance from the last run's constants.

    The distance is in standard deviations.
    """
    x_of = posterior.target.x
    _, same = forward.reduced(x_of(posterior.mean_z))
    wanted, last = (
        np.array([prior.z(x) for prior, x in zip(posterior.priors, of, strict=True)])
        for of in (same, forward.constants)
    )
    at = x_of(np.clip(wanted, -FARTHEST, FARTHEST))
    return at, float(np.max(np.abs(wanted - last) / spread))


def _sloped(forward: OrganForward, runs: OrganRuns, spread: Array | None) -> OrganForward:
    """Return the model with new slopes, computed from runs near the constants of the model.

    The constants are changed to one side if no constant has been estimated yet, and to both sides
    otherwise. Two constants whose standard deviations exceed `WIDE` are also changed together,
    because the posterior may have a ridge along both.
    """
    places = [at for at in range(len(forward.constants)) if at not in forward.moduli[:1]]
    if not places:
        return forward
    reach = (
        np.full(len(forward.constants), FIRST_STEP) if spread is None else np.clip(spread, *STEPS)
    )

    def stepped(*moves: tuple[int, float]) -> Array:
        x = forward.constants.copy()
        for at, sign in moves:
            prior = forward.parameters[at].prior
            x[at] = prior.x(prior.z(x[at]) + sign * reach[at])
        return x

    signs = (1.0,) if spread is None else (1.0, -1.0)
    wide = [] if spread is None else [at for at in places if spread[at] > WIDE]
    pairs = list(combinations(wide, 2))
    points = [stepped((at, sign)) for at in places for sign in signs]
    points += [stepped((first, 1.0), (second, 1.0)) for first, second in pairs]
    found = np.array(runs([_named(forward.parameters, x) for x in points]))
    # there are as many runs as coefficients; a step to one side shows no curvature
    distances = np.array([forward.distance(x) for x in points])
    products = pairs if spread is None else [*((at, at) for at in places), *pairs]
    terms = [(at,) for at in places] + products
    design = np.column_stack([distances[:, list(term)].prod(axis=1) for term in terms])
    coefficients = np.tensordot(np.linalg.inv(design), found - forward.run_loads, 1)
    slopes = np.zeros_like(forward.slopes)
    curved = np.zeros_like(forward.curved)
    slopes[..., places] = np.moveaxis(coefficients[: len(places)], 0, -1)
    for (first, second), each in zip(products, coefficients[len(places) :], strict=True):
        curved[..., first, second] += 0.5 * each
        curved[..., second, first] += 0.5 * each
    return replace(forward, slopes=slopes, curved=curved)


def _named(parameters: Sequence[Parameter], x: Array) -> dict[str, float]:
    return {each.name: float(value) for each, value in zip(parameters, x, strict=True)}


def _notes(found: Settled, count: int) -> tuple[str, ...]:
    notes = [
        f"{count} runs of the organ, the last {found.away:.2g} standard deviations from the result"
    ]
    if found.away >= SETTLED:
        notes.append(UNSETTLED)
    keys = [
        f"--set {name}={found.posterior.interval(at)[1]:.4g}"
        for at, name in enumerate(found.posterior.names)
        if name.startswith(KEYS)
    ]
    if keys:
        notes.append(f"keys of the scene, not in fitted.toml: {' '.join(keys)}")
    return tuple(notes)
