"""Stored measurements of a scene's numerical settings, and the Pareto-optimal settings."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

from meshes.base.cache import Arrays, cached_arrays
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import write_rows
from tissue.evaluation.charts.law import with_law
from tissue.evaluation.charts.measure import (
    Measured,
    measure,
    of_model,
    reference_gap,
    reference_words,
    short_of,
)
from tissue.evaluation.charts.settings import (
    Setting,
    force_only,
    machine,
    scene_text,
    settings_of,
    sources,
)
from tissue.scene.coupling import Fidelity
from tissue.scene.load import changed
from tissue.scene.scene import Scene

TICK_LIMIT_US = 800.0
"""Limit of the computing time of a tick [us], as 99th percentile, in the search for finer settings.

If a finer setting exceeds the limit, no setting that is finer still is measured. The haptic loop
needs the rest of the tick of 1 ms.
"""


@dataclass(frozen=True)
class Frontier:
    """Measurements of a scene at all its numerical settings.

    Attributes
    ----------
    scene
        Measured scene.
    points
        One measurement for each setting.
    gap
        Relative uncertainty of the reference force; force errors are computed relative to this
        force. See `reference_gap`.
    settings
        Numerical settings, in the same order as `points`.
    """

    scene: Scene
    points: tuple[Measured, ...]
    gap: float
    settings: tuple[Setting, ...]

    @property
    def best(self) -> tuple[Measured, ...]:
        """Measurements that are Pareto-optimal in tick time and force error, fastest first."""
        return tuple(undominated(self.points))


def undominated(points: Sequence[Measured]) -> list[Measured]:
    """Return the measurements that are Pareto-optimal in tick time and error, fastest first."""
    best: list[Measured] = []
    for point in sorted(points, key=lambda each: (each.median_us, each.force_error)):
        if not best or point.force_error < best[-1].force_error:
            best.append(point)
    return best


def frontier_of(scene: Scene, *, quick: bool = True, report: Progress = silent) -> Frontier:
    """Return measurements for all settings of a scene; measure settings without a stored result.

    Every measurement is stored at once, so that an interrupted series of measurements can continue.

    Parameters
    ----------
    scene
        Scene. If the scene has a device, the settings of the haptic loop are measured; otherwise,
        the settings of the tissue model.
    quick
        If true, use fewer settings, a shorter part of the run and a coarser reference.
    report
        Called with the name and the progress of each measurement.
    """
    settings = settings_of(scene, quick=quick)
    points = list[Measured]()
    offered = list[Setting]()
    full = False  # whether a finer setting took all the time that a tick has for it
    for index, setting in enumerate(settings):
        if full and setting.finer:
            continue
        report(f"{scene.name}: {setting.name}", index / (len(settings) + 1))
        point = _measured(scene, setting, quick=quick)
        points.append(point)
        offered.append(setting)
        full = full or (setting.finer and point.p99_us > TICK_LIMIT_US)
    report(f"{scene.name}: reference", len(settings) / (len(settings) + 1))
    return Frontier(scene, tuple(points), _gap(scene, quick=quick), tuple(offered))


def _measured(scene: Scene, setting: Setting, *, quick: bool) -> Measured:
    """Return the measurement of a setting on this machine, from disk if it was measured before."""

    def make() -> Arrays:
        found = vars(measure(short_of(scene, quick), setting, quick=quick))
        return {name: np.array(each) for name, each in found.items() if not isinstance(each, str)}

    key = (scene_text(scene), setting, quick, machine(), sources())
    numbers = {name: each.item() for name, each in cached_arrays("setting", key, make).items()}
    return Measured(
        scene=scene.name,
        setting=setting.name,
        family=setting.family,
        machine=machine(),
        **numbers,
    )


def _gap(scene: Scene, *, quick: bool) -> float:
    """Return the relative uncertainty of the reference, from disk if it was computed before."""
    by_hand = scene.device is not None

    def make() -> Arrays:
        short = short_of(of_model(scene), quick)
        return {"gap": np.array(reference_gap(short, quick=quick, by_hand=by_hand))}

    key = (scene_text(scene), quick, sources())
    return float(cached_arrays("gap", key, make)["gap"])


def write_measured(path: Path, points: Sequence[Measured]) -> None:
    """Write measurements as a table."""
    write_rows(path, [[each.name for each in fields(Measured)], *map(astuple, points)])


SAFETY = 1.5
"""Safety factor on force errors that were measured at a few places.

A setting satisfies a demanded force error if its measured error times this factor does not exceed
the demanded error.

The factor covers larger errors at places that were not measured. It was chosen with seeds 1-10 of
an earlier force law. It was tested with five other motions on each of four scenes and of four
imaged teeth and scapulae (tests/bench/held_out.py). With a factor of 1.5, no error exceeds the
demanded error. With 1.25, the error is too large on one tooth. With 1 and a demanded error of 1 %,
the error is too large for three of five motions on another tooth.
"""


def choose(points: Sequence[Measured], wanted: Fidelity, *, gap: float = 0.0) -> Measured:
    """Return the measurement of the cheapest setting that satisfies a demanded fidelity.

    If only the tick time is limited, the most accurate setting within this limit is chosen.
    Measured errors are multiplied by `SAFETY`. `gap` is the relative uncertainty of the reference
    force; smaller errors are replaced by `gap`.

    Raises
    ------
    InputError
        If no setting satisfies the demand. The message names the setting that comes closest.
    """

    def error_of(point: Measured) -> float:
        return max(SAFETY * point.force_error, gap)

    def excess(point: Measured) -> float:
        """Return the largest ratio of a measured to a demanded value."""
        error = 0.0 if wanted.force_error is None else error_of(point) / wanted.force_error
        tick = 0.0 if wanted.tick_ms is None else 1e-3 * point.p99_us / wanted.tick_ms
        return max(error, tick)

    fits = [point for point in points if excess(point) <= 1.0]
    # with a demanded error, all that fits is accurate enough
    if fits and wanted.force_error is not None:
        return min(fits, key=lambda point: point.median_us)
    if fits:
        return min(fits, key=lambda point: point.force_error)
    nearest = min(points, key=excess)
    raise InputError(
        "fidelity",
        f"be reachable with a setting of {nearest.scene} on this machine",
        _asked(wanted),
        (
            f"use a value that the nearest setting reaches: {nearest.setting} has "
            f"force_error = {error_of(nearest):.2g} and tick_ms = "
            f"{1e-3 * nearest.p99_us:.2g}"
        ),
    )


def with_fidelity(scene: Scene, *, report: Progress = silent) -> tuple[Scene, str]:
    """Return a scene with a setting that satisfies its key `fidelity`, and the reason for it.

    The setting is chosen by `choose`. Settings that were not measured on this machine are measured
    first.

    Raises
    ------
    InputError
        If no setting satisfies the demand.
    """
    wanted = scene.fidelity
    if wanted is None:
        return scene, "as it is: no fidelity was asked for"
    plain = changed(scene, {"fidelity": None})
    found = frontier_of(plain, report=report)
    point = choose(found.points, wanted, gap=found.gap)
    setting = next(each for each in found.settings if each.name == point.setting)
    at, law = with_law(changed(plain, setting.changes), wanted)
    rank = "the cheapest" if wanted.force_error is not None else "the most accurate"
    names = "; ".join(each.name for each in found.settings)
    sentence = (
        f"{setting.name} is {rank} setting that meets {_asked(wanted)}, "
        f"of {len(found.points)} measured settings: "
        f"force error of {100.0 * point.force_error:.2g} % over ticks and "
        f"{100.0 * point.error_50_ms:.2g} % over 50 ms, against "
        f"{reference_words(scene, found.gap)}; tick of {point.median_us:.0f} µs, 99 % of ticks "
        f"below {point.p99_us:.0f} µs; measured settings: {names}{law}"
    )
    if force_only(plain):
        sentence += "; without displacement and stress, which no force needs"
    return at, sentence


def _asked(wanted: Fidelity) -> str:
    """Return a demanded fidelity as text in the form of a scene file."""
    return ", ".join(f"{name} = {value:g}" for name, value in wanted if value is not None)
