"""Assess a trainee's run against a reference run of the same scene, `tissue assess`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypedDict

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from tissue.evaluation.same_task import path_note, require_same_task, scene_notes
from tissue.evaluation.statistics.metrics import (
    acceleration_change_m_s2,
    aligned_rows,
    deviation_mm,
    force_error,
    overshoot_mm,
    spectral_arc_length,
)
from tissue.models.tissue_model import TICK_S
from tissue.scene.scene import Scene
from tissue.simulation.depth_map import tool_axes
from tissue.simulation.run_summary import Summary
from tissue.simulation.trace import Table

__all__ = ["AssessedRun", "Assessment", "Breach", "Quantity", "assess", "assessment_lines"]

GAP_S = 0.15
"""Breaches closer than a period of slow tremor are one."""
MOST_BREACHES = 8
"""More are counted, and listed in the file alone."""
FORCE_MARGIN = 1.25
"""A trainee may press this many times the reference's peak force where no limit is given: a convention, not a norm."""


class AssessedRun(Protocol):
    """What is asked of a run, saved or not; `path` is None of one that is not."""

    @property
    def path(self) -> Path | None: ...
    @property
    def summary(self) -> Summary: ...
    @property
    def trace(self) -> Table | None: ...
    @property
    def complete(self) -> bool: ...
    @property
    def scene(self) -> Scene | None: ...


class Figures(TypedDict):
    scene: object
    time_in_contact_s: dict[str, float]
    deviation_mm: dict[str, float]
    peak_force_N: dict[str, float]
    force_error: float
    overshoot_mm: float
    acceleration_change_m_s2: dict[str, float]
    spectral_arc_length: dict[str, float]
    complete: dict[str, bool]


"""Figures of an assessment by name, with the unit in the name."""


@dataclass(frozen=True)
class Breach:
    """A span of time in which a limit was passed."""

    what: str
    start_s: float
    end_s: float
    worst: float
    worst_at_s: float
    limit: float
    unit: str

    @property
    def sentence(self) -> str:
        """Where it was, and how far."""
        return (
            f"{self.what} above {self.limit:.3g} {self.unit} from {self.start_s:.3f} to {self.end_s:.3f} s, "
            f"at worst {self.worst:.3g} {self.unit} at {self.worst_at_s:.3f} s"
        )


@dataclass(frozen=True)
class Quantity:
    """What is assessed over the trainee's ticks.

    Attributes
    ----------
    what, unit
        Its name and unit.
    values
        Of the trainee, shape (ticks,).
    limit
        What it should not pass.
    reference
        Of the reference at the aligned place, shape (ticks,), if it has one.
    """

    what: str
    unit: str
    values: Array
    limit: float
    reference: Array | None = None

    def breaches(self, time_s: Array) -> list[Breach]:
        """Spans above the limit, those a short gap apart joined."""
        above = np.flatnonzero(self.values > self.limit)
        found = []
        for span in np.split(above, np.flatnonzero(np.diff(time_s[above]) > GAP_S) + 1) if len(above) else []:
            worst = span[self.values[span].argmax()]
            start, end, at = (float(time_s[index]) for index in (span[0], span[-1], worst))
            found.append(Breach(self.what, start, end, float(self.values[worst]), at, self.limit, self.unit))
        return found


@dataclass(frozen=True)
class Assessment:
    """A trainee's run beside the reference.

    Attributes
    ----------
    figures
        Numbers by name, units in the names; where both runs have one, as {"trainee": ..., "reference": ...}.
    breaches
        Limits that were passed, in the order of time.
    events
        What happened to the trainee and not in the reference: time [s] and a sentence each.
    time_s
        Of the trainee's ticks, shape (ticks,).
    deviation, force, depth
        Distance from the reference's path at the aligned place [mm], size of the force [N], and depth along the
        reference tool's axis from its first contact [mm].
    notes
        Differences between the two runs that limit what the figures mean, a sentence each.
    """

    figures: Figures
    breaches: tuple[Breach, ...]
    events: tuple[tuple[float, str], ...]
    time_s: Array
    deviation: Quantity
    force: Quantity
    depth: Quantity
    notes: tuple[str, ...] = ()


def assess(
    trainee: AssessedRun,
    reference: AssessedRun,
    *,
    force_limit_N: float | None = None,
    deviation_limit_mm: float = 1.0,
    overshoot_limit_mm: float = 0.5,
) -> Assessment:
    """Hold one run against another of the same scene.

    The two are aligned by place, not by time: dynamic time warping (Sakoe and Chiba 1978) of the tool's paths finds for
    each tick of the trainee the moment of the reference that it corresponds to, so that a pause is no error.

    Parameters
    ----------
    trainee, reference
        Runs.
    force_limit_N
        Force on the tool that should not be passed [N]; 1.25 times the reference's peak where it is not given.
    deviation_limit_mm
        Distance from the reference's path that should not be passed [mm].
    overshoot_limit_mm
        How far below the reference's deepest point the tip may go [mm].

    Raises
    ------
    InputError
        If the runs are of two tasks (another anatomy, tool or material), hold no trace, or never touch.
    """
    scenes = [each.summary.get("scene") for each in (trainee, reference)]
    if scenes[0] != scenes[1]:
        raise InputError(f"run and reference must be of one scene, got {scenes[0]} and {scenes[1]}: run the same scene")
    require_same_task(trainee.scene, reference.scene)
    mine, theirs = _trace(trainee, "run"), _trace(reference, "reference")
    path, model = mine.vectors("tool", "mm"), theirs.vectors("tool", "mm")
    rows = aligned_rows(path, model)
    apart = deviation_mm(path, model, rows)
    force, ideal = mine.vectors("model_force", "N"), theirs.vectors("model_force", "N")
    size, ideal_size = np.linalg.norm(force, axis=1), np.linalg.norm(ideal, axis=1)
    axis, start = _approach(theirs)
    depth, plan = (start - path) @ axis, (start - model) @ axis
    time, deepest = mine["time_s"], float(plan.max())
    limit = FORCE_MARGIN * float(ideal_size.max()) if force_limit_N is None else force_limit_N
    require_positive("force_limit_N", limit, "use a reference that touches the tissue, or give --force-limit-N")
    require_positive("deviation_limit_mm", deviation_limit_mm, "use 1")
    require_positive("overshoot_limit_mm", overshoot_limit_mm, "use 0.5")
    quantities = (
        Quantity("distance from the path", "mm", apart, deviation_limit_mm),
        Quantity("force", "N", size, limit, ideal_size[rows]),
        Quantity("depth", "mm", depth, deepest + overshoot_limit_mm, plan[rows]),
    )
    worst = int(apart.argmax())
    figures: Figures = {
        "scene": scenes[0],
        "time_in_contact_s": _both(_contact_s, mine, theirs),
        "deviation_mm": {"mean": float(apart.mean()), "worst": float(apart[worst]), "worst_at_s": float(time[worst])},
        "peak_force_N": {"trainee": float(size.max()), "reference": float(ideal_size.max())},
        "force_error": force_error(force, ideal[rows]),
        "overshoot_mm": overshoot_mm(depth, target_mm=deepest),
        "acceleration_change_m_s2": _both(_acceleration_change_m_s2, mine, theirs),
        "spectral_arc_length": _both(_arc_length, mine, theirs),
        "complete": {"trainee": trainee.complete, "reference": reference.complete},
    }
    known = {each["what"] for each in reference.summary.get("events", ())}
    events = [(each["time_s"], each["what"]) for each in trainee.summary.get("events", ()) if each["what"] not in known]
    breaches = sorted((each for one in quantities for each in one.breaches(time)), key=lambda each: each.start_s)
    notes = (*scene_notes(trainee.scene, reference.scene), *_unfinished(trainee, reference))
    return Assessment(figures, tuple(breaches), tuple(events), time, *quantities, notes)


def assessment_lines(found: Assessment) -> list[str]:
    """What a person reads."""
    figures = found.figures
    apart, time, peak = figures["deviation_mm"], figures["time_in_contact_s"], figures["peak_force_N"]
    rough, arc = figures["acceleration_change_m_s2"], figures["spectral_arc_length"]
    more = len(found.breaches) - MOST_BREACHES
    return [
        f"path: {apart['mean']:.2f} mm off on average, {apart['worst']:.2f} at {apart['worst_at_s']:.3f} s",
        f"depth: {figures['overshoot_mm']:.2f} mm beyond the reference's deepest point",
        f"force: peak {peak['trainee']:.3g} N against {peak['reference']:.3g}, "
        f"{100.0 * figures['force_error']:.0f} % from the reference's at the same place",
        f"time from first to last contact: {time['trainee']:.2f} s against {time['reference']:.2f}",
        f"spectral arc length {arc['trainee']:.2f} against {arc['reference']:.2f}, nearer to zero is smoother",
        f"change of acceleration {rough['trainee']:.3g} m/s² against {rough['reference']:.3g}, lower is smoother",
        *(f"breach: {each.sentence}" for each in found.breaches[:MOST_BREACHES]),
        *(f"at {at:.3f} s, and not in the reference: {what}" for at, what in found.events),
        *([f"and {more} more breaches"] if more > 0 else []),
        *([] if found.breaches else ["no limit was passed"]),
        *(f"the {who} was cut short" for who, whole in figures["complete"].items() if not whole),
        *(f"note: {note}" for note in found.notes),
    ]


def _unfinished(trainee: AssessedRun, reference: AssessedRun) -> list[str]:
    """Return sentences on runs that end before their paths do."""
    runs = {"trainee": trainee, "reference": reference}
    return [f"the path of the {who} is {note}" for who, run in runs.items() if (note := path_note(run.summary))]


def _trace(run: AssessedRun, name: str) -> Table:
    """The trace of a saved run, long enough to compare."""
    if run.trace is None or len(run.trace.rows) < 10:
        got = run.path or "a run"
        raise InputError(f"{name} must hold a trace of ten ticks or more, got {got} without: run the scene again")
    return run.trace


def _both(of: Callable[[Table], float], mine: Table, theirs: Table) -> dict[str, float]:
    """A figure of both runs."""
    return {"trainee": of(mine), "reference": of(theirs)}


def _acceleration_change_m_s2(trace: Table) -> float:
    return acceleration_change_m_s2(trace.vectors("velocity", "mm_s"), tick_s=TICK_S)


def _arc_length(trace: Table) -> float:
    return spectral_arc_length(np.linalg.norm(trace.vectors("velocity", "mm_s"), axis=1), tick_s=TICK_S)


def _contact_s(trace: Table) -> float:
    """Time from the first contact to the last [s], zero without any."""
    rows = np.flatnonzero(trace["contact_mm2"] > 0.0)
    return float(trace["time_s"][rows[-1]] - trace["time_s"][rows[0]]) if len(rows) else 0.0


def _approach(trace: Table) -> tuple[Array, Array]:
    """Direction out of the tissue along the tool's axis in contact, and where the first contact was [mm]."""
    rows = np.flatnonzero(trace["contact_mm2"] > 0.0)
    if not len(rows):
        raise InputError("reference must touch the tissue, got a run without contact: choose another reference")
    quaternions = np.column_stack([trace[f"tool_q{c}"][rows] for c in "xyzw"])
    axis = tool_axes(quaternions).mean(axis=0)
    return axis / np.linalg.norm(axis), trace.vectors("tool", "mm")[rows[0]]
