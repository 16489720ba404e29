"""All settings of a scene, measured once and kept, and those of them that nothing beats."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from hashlib import blake2b
from io import StringIO
from math import isnan
from pathlib import Path

from meshes.base.cache import cache_folder, read_entry, write_entry
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.evaluation.charts.error_bounds import bound_row, float32_error
from tissue.evaluation.charts.keys import machine, scene_text, setting_key, sources
from tissue.evaluation.charts.law import LawError, law_error
from tissue.evaluation.charts.measure import Measured, excerpt, measure
from tissue.evaluation.charts.reference import of_model, reference_gap
from tissue.evaluation.charts.settings import Setting, settings_of
from tissue.scene.scene import Scene

__all__ = ["Frontier", "frontier_of", "measured_keys", "measured_of", "short_of", "undominated", "write_measured"]

OFFERED_US = 800.0
"""99th percentile of a tick from which on nothing finer is offered [us]: the hand's loop has the rest of 1 ms."""
COLUMNS = tuple(entry.name for entry in fields(Measured))


@dataclass(frozen=True)
class Frontier:
    """What was measured of a scene.

    Attributes
    ----------
    scene
        The scene.
    points
        A measurement for each setting.
    gap
        What the reference leaves open: its uncertainty, or a grid-convergence index, see `reference_gap`.
    settings
        The settings in the order of the points.
    rounding
        Change of the force by what float32 rounds; NaN where it was not asked for or nothing is computed in it.
    law
        The linear law against a neo-Hookean one; None where it was not asked for or there is no organ to compare.
    """

    scene: Scene
    points: tuple[Measured, ...]
    gap: float
    settings: tuple[Setting, ...]
    rounding: float = float("nan")
    law: LawError | None = None

    @property
    def best(self) -> tuple[Measured, ...]:
        """Settings that no other beats in both cost and error, cheapest first."""
        return tuple(undominated(self.points))

    @property
    def bounds(self) -> tuple[Measured, ...]:
        """Rows of a table that are no settings: of the law and of rounding, where they were measured."""
        law = self.law.rows(self.scene) if self.law else ()
        return law if isnan(self.rounding) else (*law, bound_row(self.scene, "float32", "rounding", self.rounding))


def undominated(points: Sequence[Measured]) -> list[Measured]:
    """Those of some measurements that no other beats in both median tick and error, cheapest first."""
    found: list[Measured] = []
    for point in sorted(points, key=lambda each: (each.median_us, each.force_error)):
        if not found or point.force_error < found[-1].force_error:
            found.append(point)
    return found


def frontier_of(scene: Scene, *, quick: bool = True, report: Progress = silent) -> Frontier:
    """Measure every setting of a scene that was not measured on this machine before.

    Every measurement is kept at once, so that one that is interrupted goes on where it was.

    Parameters
    ----------
    scene
        A scene; with a device the settings are those of its loop, without one those of its model.
    quick
        Fewer settings, a shorter excerpt and a coarser reference.
    report
        Called with what is being measured.
    """
    path = _store(scene, quick=quick)
    known = {point.key: point for point in _kept(path)}
    settings = settings_of(scene, quick=quick)
    short: Scene | None = None
    points, offered = list[Measured](), list[Setting]()
    full = False  # whether a finer setting took all the time that a tick has for it
    for index, setting in enumerate(settings):
        if full and setting.finer:
            continue
        report(f"{scene.name}: {setting.name}", index / (len(settings) + 1))
        key = setting_key(scene, setting, quick=quick)
        if key not in known:
            if short is None:
                short = short_of(scene, quick)
            known[key] = replace(measure(short, setting, quick=quick), key=key)
            known = {point.key: point for point in _kept(path)} | known  # of another process that charts it
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


def short_of(scene: Scene, quick: bool) -> Scene:
    """The excerpt of a scene that its settings are run on."""
    return excerpt(scene, settings_of(of_model(scene), quick=quick)[0].changes, quick=quick)


def measured_keys(scene: Scene, *, quick: bool) -> set[str]:
    """Keys of the settings that were measured on this machine before."""
    return {point.key for point in _kept(_store(scene, quick=quick))}


def _gap(scene: Scene, path: Path, *, quick: bool) -> float:
    """What the reference leaves open, kept beside the measurements."""
    gap_file = path.with_suffix(".gap")
    if (kept := read_entry(gap_file)) is None:
        short = short_of(of_model(scene), quick)
        kept = repr(reference_gap(short, quick=quick, by_hand=scene.device is not None))
        write_entry(gap_file, kept)
    return float(kept)


def _store(scene: Scene, *, quick: bool) -> Path:
    """Where a scene's measurements are kept: with the computed arrays of this machine."""
    text = f"{scene_text(scene)}|{machine()}|{quick}|{sources()}"
    return cache_folder() / "frontiers" / f"{scene.name}-{blake2b(text.encode(), digest_size=8).hexdigest()}.csv"


def write_measured(path: Path, points: Sequence[Measured]) -> None:
    """Write measurements as a table; a reader never sees half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_bytes(_table(points).encode())


def _kept(path: Path) -> list[Measured]:
    """Measurements of an entry of the cache."""
    return measured_of(read_entry(path) or "")


def measured_of(text: str) -> list[Measured]:
    """Measurements of a table's text; none where it has other columns."""
    table = csv.DictReader(StringIO(text, newline=""))
    if tuple(table.fieldnames or ()) != COLUMNS:
        return []
    return [Measured.of_row(row) for row in table if None not in row.values()]


def _table(points: Sequence[Measured]) -> str:
    text = StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS)
    writer.writeheader()
    writer.writerows(point.row() for point in points)
    return text.getvalue()
