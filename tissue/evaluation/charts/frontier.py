"""Settings of a scene, measured once and kept, and the Pareto-optimal ones."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from hashlib import blake2b
from io import StringIO
from math import isnan, nan
from pathlib import Path

from meshes.base.cache import cache_folder, read_entry, write_entry
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.evaluation.charts.keys import machine, scene_text, setting_key, sources
from tissue.evaluation.charts.law import LawError, law_error
from tissue.evaluation.charts.measure import Measured, measure, short_of
from tissue.evaluation.charts.reference import float32_error, of_model, reference_gap
from tissue.evaluation.charts.settings import Setting, settings_of
from tissue.scene.scene import Scene

__all__ = ["Frontier", "frontier_of", "measured_of", "undominated", "unmeasured", "write_measured"]

OFFERED_US = 800.0
"""99th percentile of a tick above which no finer setting is offered [us].

The loop of the hand takes the remaining time.
"""
COLUMNS = tuple(entry.name for entry in fields(Measured))


@dataclass(frozen=True)
class Frontier:
    """Measurements of a scene.

    Attributes
    ----------
    scene
        Measured scene.
    points
        One measurement for each setting.
    gap
        Uncertainty of the reference, see `reference_gap`.
    settings
        Settings in the order of the points.
    rounding
        Change of the force by the rounding of float32. NaN if it was not measured.
    law
        Error of the linear law against a neo-Hookean law. None if it was not measured.
    """

    scene: Scene
    points: tuple[Measured, ...]
    gap: float
    settings: tuple[Setting, ...]
    rounding: float = nan
    law: LawError | None = None

    @property
    def best(self) -> tuple[Measured, ...]:
        """Pareto-optimal settings in cost and error, cheapest first."""
        return tuple(undominated(self.points))

    @property
    def bounds(self) -> tuple[Measured, ...]:
        """Rows of a table that are no settings: of the law and of rounding, where they were
        measured.
        """
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
    """Return the Pareto-optimal measurements in median tick and error, cheapest first."""
    best: list[Measured] = []
    for point in sorted(points, key=lambda each: (each.median_us, each.force_error)):
        if not best or point.force_error < best[-1].force_error:
            best.append(point)
    return best


def frontier_of(scene: Scene, *, quick: bool = True, report: Progress = silent) -> Frontier:
    """Measure every setting of a scene that was not measured on this machine before.

    Every measurement is kept at once, so that an interrupted chart continues.

    Parameters
    ----------
    scene
        Scene. With a device, the settings of its loop are measured; without a device, the settings
        of its model.
    quick
        Use fewer settings, a shorter excerpt and a coarser reference.
    report
        Called with the current measurement.
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
    if quick or scene.device is not None:
        return found
    short = short or short_of(scene, quick)
    return replace(found, rounding=float32_error(short), law=law_error(short, report=report))


def unmeasured(scene: Scene, *, quick: bool) -> list[Setting]:
    """Return the settings that were not measured on this machine yet."""
    known = _kept(_store(scene, quick=quick))
    settings = settings_of(scene, quick=quick)
    return [each for each in settings if setting_key(scene, each, quick=quick) not in known]


def _gap(scene: Scene, path: Path, *, quick: bool) -> float:
    """Return the uncertainty of the reference, kept next to the measurements."""
    gap_file = path.with_suffix(".gap")
    if (kept := read_entry(gap_file)) is None:
        short = short_of(of_model(scene), quick)
        kept = repr(reference_gap(short, quick=quick, by_hand=scene.device is not None))
        write_entry(gap_file, kept)
    return float(kept)


def _store(scene: Scene, *, quick: bool) -> Path:
    """Return the file of a scene's measurements, next to the computed arrays of this machine."""
    text = f"{scene_text(scene)}|{machine()}|{quick}|{sources()}"
    return (
        cache_folder()
        / "frontiers"
        / f"{scene.name}-{blake2b(text.encode(), digest_size=8).hexdigest()}.csv"
    )


def _kept(path: Path) -> dict[str, Measured]:
    """Read the measurements of a file of the cache, by key."""
    return {point.key: point for point in measured_of(read_entry(path) or "")}


def write_measured(path: Path, points: Sequence[Measured]) -> None:
    """Write measurements as a table. A reader never sees half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_bytes(_table(points).encode())


def measured_of(text: str) -> list[Measured]:
    """Return the measurements of a table's text, without rows if it has other columns."""
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
