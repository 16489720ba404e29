"""Measurements of the settings of a scene, which are stored, and the Pareto-optimal settings."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from hashlib import blake2b
from io import StringIO
from math import isnan, nan
from pathlib import Path

from meshes.base.cache import cache_folder, read_entry, write_entry
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.evaluation.charts.law import LawError, law_error, with_law
from tissue.evaluation.charts.measure import (
    BOUNDS,
    Measured,
    float32_error,
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
    setting_key,
    settings_of,
    sources,
)
from tissue.scene.coupling import Fidelity
from tissue.scene.load import changed
from tissue.scene.scene import Scene

__all__ = [
    "SAFETY",
    "Frontier",
    "choose",
    "frontier_of",
    "measured_of",
    "undominated",
    "with_fidelity",
    "write_measured",
]

OFFERED_US = 800.0
"""Largest 99th percentile of the time of a tick [us] at which finer settings are still measured.

The loop of device and hand needs the remaining time of a tick of 1 ms.
"""
COLUMNS = tuple(entry.name for entry in fields(Measured))


@dataclass(frozen=True)
class Frontier:
    """Measurements of all settings of a scene.

    Attributes
    ----------
    scene
        Measured scene.
    points
        One measurement for each setting.
    gap
        Relative uncertainty of the reference force, see `reference_gap`.
    settings
        Settings in the order of the points.
    rounding
        Relative change of the force by rounding to float32. NaN if it was not measured.
    law
        Error of the linear elastic law against a neo-Hookean law. None if it was not measured.
    """

    scene: Scene
    points: tuple[Measured, ...]
    gap: float
    settings: tuple[Setting, ...]
    rounding: float = nan
    law: LawError | None = None

    @property
    def best(self) -> tuple[Measured, ...]:
        """Measurements that are Pareto-optimal in tick time and force error, cheapest first."""
        return tuple(undominated(self.points))

    @property
    def bounds(self) -> tuple[Measured, ...]:
        """Table rows of errors that no setting reduces: elastic law and rounding."""
        law = nan if self.law is None else self.law.error
        errors = {("linear law", "law"): law, ("float32", "rounding"): self.rounding}
        return tuple(
            Measured(
                scene=self.scene.name,
                setting=name,
                family=family,
                force_error=error,
                machine=machine(),
            )
            for (name, family), error in errors.items()
            if not isnan(error)
        )


def undominated(points: Sequence[Measured]) -> list[Measured]:
    """Return the measurements that are Pareto-optimal in tick time and error, cheapest first."""
    best: list[Measured] = []
    for point in sorted(points, key=lambda each: (each.median_us, each.force_error)):
        if not best or point.force_error < best[-1].force_error:
            best.append(point)
    return best


def frontier_of(scene: Scene, *, quick: bool = True, report: Progress = silent) -> Frontier:
    """Return the measurements of a scene; measure the settings without a stored measurement.

    Every measurement is stored immediately, so that an interrupted chart can continue.

    Parameters
    ----------
    scene
        Scene. If the scene has a device, the settings of the haptic loop are measured; otherwise,
        the settings of the tissue model.
    quick
        Use fewer settings, a shorter excerpt and a coarser reference.
    report
        Called with the name and the progress of each measurement.
    """
    path = _store(scene, quick=quick)
    known = _kept(path)
    settings = settings_of(scene, quick=quick)
    short: Scene | None = None
    points = list[Measured]()
    offered = list[Setting]()
    full = False  # whether a finer setting took all the time that a tick has for it
    for index, setting in enumerate(settings):
        if full and setting.finer:
            continue
        report(f"{scene.name}: {setting.name}", index / (len(settings) + 1))
        key = setting_key(scene, setting, quick=quick)
        if key not in known:
            short = short or short_of(scene, quick)
            known[key] = replace(measure(short, setting, quick=quick), key=key)
            known = _kept(path) | known  # another process may chart the scene too
            write_entry(path, _table(list(known.values())))
        points.append(known[key])
        offered.append(setting)
        full = full or (setting.finer and known[key].p99_us > OFFERED_US)
    report(f"{scene.name}: reference", len(settings) / (len(settings) + 1))
    found = Frontier(scene, tuple(points), _gap(scene, path, quick=quick), tuple(offered))
    # rounding and law belong to the model, which the full chart by script measures
    if quick or scene.device is not None:
        return found
    short = short or short_of(scene, quick)
    return replace(found, rounding=float32_error(short), law=law_error(short, report=report))


def _gap(scene: Scene, path: Path, *, quick: bool) -> float:
    """Return the relative uncertainty of the reference, and store it next to the measurements."""
    gap_file = path.with_suffix(".gap")
    if (kept := read_entry(gap_file)) is None:
        short = short_of(of_model(scene), quick)
        kept = repr(reference_gap(short, quick=quick, by_hand=scene.device is not None))
        write_entry(gap_file, kept)
    return float(kept)


def _store(scene: Scene, *, quick: bool) -> Path:
    """Return the path of the file with a scene's measurements, in the cache folder."""
    # 8 bytes: the name of the scene is in the file name too
    text = f"{scene_text(scene)}|{machine()}|{quick}|{sources()}"
    return (
        cache_folder()
        / "frontiers"
        / f"{scene.name}-{blake2b(text.encode(), digest_size=8).hexdigest()}.csv"
    )


def _kept(path: Path) -> dict[str, Measured]:
    """Read the measurements in a file of the cache, as a dictionary from key to measurement."""
    return {point.key: point for point in measured_of(read_entry(path) or "")}


def write_measured(path: Path, points: Sequence[Measured]) -> None:
    """Write measurements as a table.

    The file is replaced at once, so a reader never sees an incomplete table.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_bytes(_table(points).encode())


def measured_of(text: str) -> list[Measured]:
    """Return the measurements in the text of a table.

    The list is empty if the table has other columns, for example from an earlier version.
    """
    table = csv.DictReader(StringIO(text, newline=""))
    if tuple(table.fieldnames or ()) != COLUMNS:
        return []
    return [Measured.of_row(row) for row in table if None not in row.values()]


def _table(points: Sequence[Measured]) -> str:
    """Return measurements as the text of a table."""
    text = StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS)
    writer.writeheader()
    writer.writerows(point.row() for point in points)
    return text.getvalue()


SAFETY = 1.5
"""Safety factor on force errors that were measured at a few places.

A setting satisfies a demanded error if its measured error times this factor is at most the demanded
error.

The factor keeps the error within the demand at other places too. It was chosen with seeds 1-10 of
an earlier force law. It was then tested with five further motions on each of four scenes and of
four imaged teeth and scapulae. With a factor of 1.5, the error stays within every demand. With a
factor of 1.25, the error exceeds a demand on one tooth. With a factor of 1, the error stays within
a demand of 1 % for only two of five motions on another tooth (tests/bench/held_out.py).
"""


def choose(points: Sequence[Measured], wanted: Fidelity, *, gap: float = 0.0) -> Measured:
    """Return the measurement of the cheapest setting that satisfies a demanded fidelity.

    If only a tick time is demanded, the most accurate setting that satisfies it is chosen. Measured
    errors are multiplied by `SAFETY`. An error below `gap`, the uncertainty of the reference,
    counts as `gap`. Rows of the families in `BOUNDS` are ignored.

    Raises
    ------
    InputError
        If no setting satisfies the demand. The message names the setting that comes closest.
    """
    settings = [point for point in points if point.family not in BOUNDS]

    def error_of(point: Measured) -> float:
        return max(SAFETY * point.force_error, gap)

    def excess(point: Measured) -> float:
        """Return the largest ratio of a measured to a demanded value."""
        error = 0.0 if wanted.force_error is None else error_of(point) / wanted.force_error
        tick = 0.0 if wanted.tick_ms is None else 1e-3 * point.p99_us / wanted.tick_ms
        return max(error, tick)

    fits = [point for point in settings if excess(point) <= 1.0]
    # with a demanded error, all that fits is accurate enough
    if fits and wanted.force_error is not None:
        return min(fits, key=lambda point: point.median_us)
    if fits:
        return min(fits, key=lambda point: point.force_error)
    nearest = min(settings, key=excess)
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
    """Return a scene at the setting that its `fidelity` demands, and the reason for the choice.

    See `choose` for the choice. Settings that were not measured on this machine are measured first.

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
        f"{setting.name}, of {names}: force {100.0 * point.force_error:.2g} % over ticks, "
        f"{100.0 * point.error_50_ms:.2g} % over 50 ms, from {reference_words(scene, found.gap)}; "
        f"tick {point.median_us:.0f} µs, 99 % {point.p99_us:.0f} µs, {rank} of "
        f"{len(found.points)} settings that meets {_asked(wanted)}{law}"
    )
    if force_only(plain):
        sentence += "; leaves out displacement and stress, which no force needs"
    return at, sentence


def _asked(wanted: Fidelity) -> str:
    """Return a demanded fidelity as text in the form of a scene file."""
    return ", ".join(f"{name} = {value:g}" for name, value in wanted if value is not None)
