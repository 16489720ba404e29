"""A log of a needle as a fit takes it: its travel along its axis, the force along it, and the jumps of the force."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.fitting.averaged import block_averages, block_ticks
from tissue.fitting.forward import Forward
from tissue.fitting.log import MeasuredLog
from tissue.fitting.measured import MeasuredLoads
from tissue.fitting.needle import CHANNEL, NeedleForward, needle_names
from tissue.fitting.needle_events import median_jumps
from tissue.fitting.needle_search import with_jumps
from tissue.fitting.needle_walls import KEYS, stated_forces, walls_of
from tissue.fitting.parameter import Parameter, chosen
from tissue.fitting.posterior import Posterior
from tissue.fitting.problem import Problem
from tissue.materials.prior import Prior
from tissue.models.tissue_model import TICK_S
from tissue.scene.organ import LayersAnatomy
from tissue.scene.registry import NEEDLES
from tissue.scene.scene import Scene

__all__ = ["needle_problem"]

STEP_S = 4e-3
"""Time between two poses of the law [s]: 0.1 mm at 25 mm/s, a tenth of the shortest travel over which loads change."""
LEAST_COSINE = 0.17
"""As `tissue.models.needle.model.NeedleModel` has it: more than 10 degrees to the surface."""
FEEDS_M_S, DEPTHS_M = (2e-3, 10e-3, 50e-3), (0.02, 0.06)
"""Feeds and depths of what could be measured next: those of hands and machines (Okamura 2004 pushed at 3 mm/s)."""
AIR_M, REST_S = 5e-3, 2.0
FALL, CLEAR = 0.2, 6.0
"""Share of the force that a puncture takes off (a quarter by the cited constants), and that over the noise."""


def needle_problem(
    scene: Scene, log: MeasuredLog, free: Sequence[str], *, cores: int | None, progress: Progress
) -> Problem:
    """A needle pushed into an organ and drawn out; see `tissue.fitting.fit.fit_scene`.

    The jumps are found in the log, see `tissue.fitting.needle_search`.
    """
    del cores
    assert isinstance(scene.anatomy, LayersAnatomy)
    if scene.tool.kind not in NEEDLES.built_in:
        raise InputError(f"scene must have a needle whose law is known, got {scene.tool.kind}: fit one of kind needle")
    times_s, travel_m, notes = _travel(scene, log)
    axes = Rotation.from_quat(log.quaternions_of(scene)).as_matrix()[:, :, 2]
    along = _along(log, np.column_stack([np.interp(log.load_times_s, log.times_s, each) for each in axes.T]))
    ticks = block_ticks(float(log.load_times_s[-1] - log.load_times_s[0]), log.load_period_s)
    measured = block_averages(log.load_times_s, along[:, None], (CHANNEL,), ticks)
    plain = _forward(scene, times_s, travel_m, free)
    progress("finding punctures", 0.0)
    _refuse_early_puncture(plain, measured)
    forward, usable = with_jumps(plain, measured)
    seen = [each.kind for each in forward.events if each.seen]
    notes += (f"jumps of the force: {', '.join(seen).replace('_', ' ') or 'none'}",)
    if unused := [name for name in log.channels if name.startswith("torque_")]:
        notes += (f"not used for a needle: {', '.join(unused)}",)
    if keys := [each.name for each in forward.parameters if each.name.startswith(KEYS)]:
        notes += (f"keys of the scene, not in fitted.toml: give them by --set or in the scene: {', '.join(keys)}",)
    return Problem(forward, usable, ticks * TICK_S, lambda posterior: _candidates(forward, posterior), notes)


def _forward(scene: Scene, times_s: Array, travel_m: Array, free: Sequence[str]) -> NeedleForward:
    """The law with its free constants: all with a range by default."""
    assert isinstance(scene.anatomy, LayersAnatomy)
    walls = walls_of(scene.anatomy)
    stated, free_of_them = stated_forces(scene.anatomy)
    names = [name for name in needle_names(walls) if name not in stated]
    known = {name: scene.constants.constants(*name.split(".")[:2])[name.split(".")[2]] for name in names}
    parameters = [Parameter(name, Prior.of(each, name)) for name, each in known.items() if each.low < each.high]
    return NeedleForward(
        tuple(chosen(free, [*parameters, *free_of_them])),
        {name: each.value for name, each in known.items()} | stated,
        times_s,
        travel_m,
        walls=walls,
    )


def _travel(scene: Scene, log: MeasuredLog) -> tuple[Array, Array, tuple[str, ...]]:
    """Travel of the tip beyond the surface along the axis [m] at one rate, of the log's first insertion."""
    cosine = Rotation.from_quat(log.quaternions_of(scene)).as_matrix()[:, 2, 2]
    below = -log.tips_m[:, 2]
    if (cosine < LEAST_COSINE)[below > 0.0].any():
        raise InputError(
            "measured must hold a needle that meets the surface z = 0 at more than 10 degrees, got one that lies "
            "flatter: give its poses in the scene's frame, z out of the organ"
        )
    travel = np.where(below > 0.0, below / np.maximum(cosine, LEAST_COSINE), below)
    if not (travel > 0.0).any():
        raise InputError(
            "measured must bring the needle into the organ, got a log whose tip stays above z = 0: give one of an "
            "insertion, or its poses in the scene's frame"
        )
    enters = np.flatnonzero((travel[1:] > 0.0) & (travel[:-1] <= 0.0))
    last = len(travel)
    notes: tuple[str, ...] = ()
    if len(enters) > 1:
        last = int(enters[1]) + 1
        notes = (f"only the first of {len(enters)} insertions is used, up to {log.times_s[last - 1]:.3g} s",)
    count = int((log.times_s[last - 1] - log.times_s[0]) / STEP_S) + 1
    times_s = log.times_s[0] + STEP_S * np.arange(count)
    return times_s, np.interp(times_s, log.times_s[:last], travel[:last]), notes


def _along(log: MeasuredLog, axes: Array) -> Array:
    """Force along the needle's axis, of the components that were measured, shape (m,)."""
    places = {name: at for at, name in enumerate(log.channels)}
    found = [
        (log.loads[:, places[name]], axes[:, at]) for at, c in enumerate("xyz") if (name := f"force_{c}_N") in places
    ]
    share = sum(axis**2 for _, axis in found)
    if float(np.min(share)) < 0.5:
        raise InputError(
            "measured must hold the force along the needle, got components across it only: give force_x_N, force_y_N "
            "and force_z_N, or the needle's orientation"
        )
    return np.asarray(sum(force * axis for force, axis in found) / share)


def _refuse_early_puncture(plain: NeedleForward, measured: MeasuredLoads) -> None:
    """Refuse a log whose force falls like a puncture where the capsule's cited force is not reached at all."""
    if any(each.kind == "puncture" for each in plain.expected_events()):
        return
    known = np.isfinite(measured.values[:, 0])
    force = np.interp(plain.times_s, measured.times_s[known], measured.values[known, 0])
    jumps = np.where(plain.travel_m > 0.0, median_jumps(plain.times_s, force), 0.0)
    at, noise = int(np.argmin(jumps)), 1.4826 * float(np.median(np.abs(jumps)))
    level, left = (float(np.median(each)) for each in (force[max(at - 4, 0) : at + 1], force[at + 1 : at + 6]))
    if -jumps[at] > max(FALL * level, CLEAR * noise):
        raise InputError(
            f"measured falls from {level:.3g} to {left:.3g} N at {1e3 * plain.travel_m[at]:.3g} mm, "
            "like a puncture, where the range of needle.liver.capsule_puncture_N lets expect none: give a file of "
            "constants (materials) whose range of it holds this force"
        )


def _candidates(forward: NeedleForward, posterior: Posterior) -> list[tuple[str, Forward]]:
    """Insertions with a rest and a withdrawal, at other feeds and depths, with the constants as they are known now."""
    values = posterior.target.x(posterior.mean_z)
    known = forward.known | {each.name: float(v) for each, v in zip(forward.parameters, values, strict=True)}
    found: list[tuple[str, Forward]] = []
    for feed in FEEDS_M_S:
        for depth in DEPTHS_M:
            step = feed * STEP_S
            inwards = np.arange(-AIR_M, depth, step)
            travel = np.concatenate([inwards, np.full(int(REST_S / STEP_S), inwards[-1]), inwards[::-1]])
            times = STEP_S * np.arange(len(travel), dtype=np.float64)
            new = replace(forward, known=known, times_s=times, travel_m=travel, events=())
            label = f"an insertion {1e3 * depth:g} mm deep at {1e3 * feed:g} mm/s, {REST_S:g} s of rest, and out"
            found.append((label, replace(new, events=new.expected_events())))
    return found
