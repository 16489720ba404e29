"""Assessment of a trainee's run against a reference run of the same scene."""

import filecmp
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from meshes.base.text_tables import shown
from tissue.evaluation.statistics.metrics import (
    aligned_rows,
    deviation_mm,
    force_error,
    overshoot_mm,
)
from tissue.evaluation.steadiness import Steadiness, steadiness
from tissue.haptics.device.device import device_parameters
from tissue.scene.part import is_file_key
from tissue.scene.scene import Scene
from tissue.simulation.bone_surface import tool_axes
from tissue.simulation.run_folder import Summary
from tissue.simulation.trace import Table

__all__ = [
    "AssessedRun",
    "Assessment",
    "Breach",
    "NoSharedContactError",
    "Quantity",
    "assess",
    "path_note",
]


GAP_S = 0.15
"""Longest time between two breaches that count as one [s], about a period of slow tremor.

Without this rule, a trembling hand that rests at a limit would make one breach in each period of
the tremor.
"""
FORCE_MARGIN = 1.25
"""Default limit of the trainee's force, as a ratio to the peak force of the reference.

The value is a convention, not a standard.
"""


class NoSharedContactError(InputError):
    """Error for a run that does not touch the tissue where the reference run does.

    `reason` is the end of a sentence whose subject is the run.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(
            "run",
            "touch the tissue where the reference run does",
            f"a run that {reason}",
            "run the scene again and move the tool along the path of the reference run",
        )
        self.reason = reason


@dataclass(frozen=True)
class AssessedRun:
    """Data of a run that an assessment reads. `path` is None if the run has no folder."""

    path: Path | None
    summary: Summary
    trace: Table | None
    complete: bool
    scene: Scene | None


@dataclass(frozen=True)
class Breach:
    """Span of time above a limit."""

    what: str
    start_s: float
    end_s: float
    worst: float
    worst_at_s: float
    limit: float
    unit: str

    @property
    def sentence(self) -> str:
        """Time and size of the breach in words."""
        return (
            f"{self.what} above {self.limit:.3g} {self.unit} from {self.start_s:.3f} to "
            f"{self.end_s:.3f} s, "
            f"at worst {self.worst:.3g} {self.unit} at {self.worst_at_s:.3f} s"
        )


@dataclass(frozen=True)
class Quantity:
    """Assessed quantity over the ticks of the trainee.

    Attributes
    ----------
    what, unit
        Name and unit.
    values
        Values of the trainee, shape (ticks,).
    limit
        Limit of the values.
    reference
        Values of the reference at the place that is aligned with each tick, shape (ticks,).
    """

    what: str
    unit: str
    values: Array
    limit: float
    reference: Array | None = None

    def breaches(self, time_s: Array) -> list[Breach]:
        """Return the spans above the limit.

        Two spans are joined if the time between them is at most `GAP_S`.
        """
        above = np.flatnonzero(self.values > self.limit)
        found = []
        for span in (
            np.split(above, np.flatnonzero(np.diff(time_s[above]) > GAP_S) + 1)
            if len(above)
            else []
        ):
            worst = span[self.values[span].argmax()]
            start, end, at = (float(time_s[index]) for index in (span[0], span[-1], worst))
            found.append(
                Breach(self.what, start, end, float(self.values[worst]), at, self.limit, self.unit)
            )
        return found


@dataclass(frozen=True)
class Assessment:
    """Comparison of a trainee's run with the reference.

    Attributes
    ----------
    steadiness
        Tremor and score of the trainee's hand. None without a score.
    figures
        Numbers by name, units in the names. Numbers that both runs have are given as {"trainee":
        ..., "reference": ...}.
    breaches
        Spans of time in which a limit was exceeded, in the order of time.
    events
        Events of the trainee that the reference does not have: time [s] and a sentence each.
    time_s
        Times of the trainee's ticks [s], shape (ticks,).
    deviation, force, depth
        Distance from the reference's path at the aligned place [mm], size of the force [N], and
        depth along the reference tool's axis from its first contact [mm].
    notes
        One sentence for each difference between the two runs that limits the meaning of the
        figures.
    unscored
        Reason why the run has no score; empty with a score.
    """

    steadiness: Steadiness | None
    figures: dict[str, Any]
    breaches: tuple[Breach, ...]
    events: tuple[tuple[float, str], ...]
    time_s: Array
    deviation: Quantity
    force: Quantity
    depth: Quantity
    notes: tuple[str, ...] = ()
    unscored: str = ""


def assess(
    trainee: AssessedRun,
    reference: AssessedRun,
    *,
    force_limit_N: float | None = None,
    deviation_limit_mm: float = 1.0,
    overshoot_limit_mm: float = 0.5,
) -> Assessment:
    """Compare a run with a reference run of the same scene.

    The runs are aligned by place, not by time. Dynamic time warping (Sakoe and Chiba 1978) of the
    tool's paths finds the corresponding moment of the reference for each tick of the trainee. A
    pause is therefore not an error.

    The score rates the steadiness of the hand (see `tissue.evaluation.steadiness`). Distances from
    the path and forces are not part of it: these figures depend on the device more than on the
    hand.

    Parameters
    ----------
    trainee, reference
        Runs.
    force_limit_N
        Limit of the force on the tool [N]. Default: 1.25 times the reference's peak.
    deviation_limit_mm
        Limit of the distance from the reference's path [mm].
    overshoot_limit_mm
        Allowed depth of the tip below the reference's deepest point [mm].

    Raises
    ------
    InputError
        If the runs have different tasks (another anatomy, tool or material), a run holds no trace,
        or the reference has no contact.
    NoSharedContactError
        If the run has no contact where the reference has contact.
    """
    _require_same_task(trainee, reference)
    mine = _trace(trainee, "run")
    theirs = _trace(reference, "reference")
    path = mine.vectors("tool", "mm")
    model = theirs.vectors("tool", "mm")
    rows = aligned_rows(path, model)
    apart = deviation_mm(path, model, rows)
    force = mine.vectors("model_force", "N")
    ideal = theirs.vectors("model_force", "N")
    size = np.linalg.norm(force, axis=1)
    ideal_size = np.linalg.norm(ideal, axis=1)
    axis, start = _approach(theirs)
    depth = (start - path) @ axis
    plan = (start - model) @ axis
    time = mine["time_s"]
    deepest = float(plan.max())
    limit = FORCE_MARGIN * float(ideal_size.max()) if force_limit_N is None else force_limit_N
    # a reference without a force would give a default limit of zero
    require_positive(
        "force_limit_N", limit, "use a reference that touches the tissue, or give --force-limit-N"
    )
    require_positive("deviation_limit_mm", deviation_limit_mm, "use 1")
    require_positive("overshoot_limit_mm", overshoot_limit_mm, "use 0.5")
    _require_shared_contact(size, ideal_size[rows])
    quantities = (
        Quantity("distance from the path", "mm", apart, deviation_limit_mm),
        Quantity("force", "N", size, limit, ideal_size[rows]),
        Quantity("depth", "mm", depth, deepest + overshoot_limit_mm, plan[rows]),
    )
    worst = int(apart.argmax())
    figures = {
        "scene": trainee.summary.get("scene"),
        "time_in_contact_s": _both(_contact_s, mine, theirs),
        "deviation_mm": {
            "mean": float(apart.mean()),
            "worst": float(apart[worst]),
            "worst_at_s": float(time[worst]),
        },
        "peak_force_N": {"trainee": float(size.max()), "reference": float(ideal_size.max())},
        "force_error": force_error(force, ideal[rows]),
        "overshoot_mm": overshoot_mm(depth, target_mm=deepest),
        "least_distance_mm": _least_distances(trainee.summary, reference.summary),
        "complete": {"trainee": trainee.complete, "reference": reference.complete},
    }
    breaches = sorted(
        (each for one in quantities for each in one.breaches(time)), key=lambda each: each.start_s
    )
    hand, unscored = _steadiness(trainee, mine)
    return Assessment(
        hand,
        figures,
        tuple(breaches),
        _new_events(trainee.summary, reference.summary),
        time,
        *quantities,
        tuple(_notes(trainee, reference)),
        unscored,
    )


def _require_shared_contact(size: Array, ideal_size: Array) -> None:
    """Check that a run has contact, and that the reference has contact at an aligned place.

    The arguments are the sizes of both forces over the ticks of the run [N], shape (ticks,).
    """
    if not size.any():
        raise NoSharedContactError("touches nothing")
    if not ideal_size.any():
        raise NoSharedContactError("touches only where the reference run does not")


def _new_events(mine: Summary, theirs: Summary) -> tuple[tuple[float, str], ...]:
    """Return time [s] and sentence of the events that only the trainee's run has."""
    known = {each["what"] for each in theirs.get("events", ())}
    return tuple(
        (each["time_s"], each["what"])
        for each in mine.get("events", ())
        if each["what"] not in known
    )


def _notes(trainee: AssessedRun, reference: AssessedRun) -> Iterator[str]:
    """Yield sentences on differences of the scenes, and on paths that were not finished."""
    yield from _scene_notes(trainee.scene, reference.scene)
    for who, run in (("trainee", trainee), ("reference", reference)):
        if note := path_note(run.summary):
            yield f"the path of the {who} is {note}"


def _trace(run: AssessedRun, name: str) -> Table:
    """Return the trace of a run; raise InputError if it has fewer than ten ticks."""
    # a path needs several ticks
    if run.trace is None or len(run.trace.rows) < 10:
        got = run.path or "a run"
        raise InputError(
            name,
            "hold a trace of ten ticks or more",
            f"{got} without such a trace",
            "run the scene again",
        )
    return run.trace


def _both(of: Callable[[Table], float], mine: Table, theirs: Table) -> dict[str, float]:
    """Return a figure of the trainee's run and of the reference."""
    return {"trainee": of(mine), "reference": of(theirs)}


def _steadiness(run: AssessedRun, trace: Table) -> tuple[Steadiness | None, str]:
    """Return tremor and score of the hand in a run, or the reason why the run has no score."""
    if run.scene is None or run.scene.device is None or "device_x_mm" not in trace.columns:
        return None, "the run has no device whose constants are known"
    constants = run.scene.constants
    try:
        found = steadiness(
            1e-3 * trace.vectors("device", "mm"),
            trace.vectors("device_force", "N"),
            device_parameters(run.scene.device.kind, constants),
            constants=constants,
        )
    except InputError as refusal:
        return None, str(refusal)
    return found, ""


def _least_distances(mine: Summary, theirs: Summary) -> dict[str, dict[str, float]]:
    """Return the smallest distances of both runs from the structures that are kept clear [mm]."""
    first, second = (
        {name: each["least_distance_mm"] for name, each in one.get("keep_clear", {}).items()}
        for one in (mine, theirs)
    )
    return {
        name: {"trainee": first[name], "reference": second[name]}
        for name in first
        if name in second
    }


def _contact_s(trace: Table) -> float:
    """Return the time from the first contact to the last [s], zero without contact."""
    rows = np.flatnonzero(trace["contact_mm2"] > 0.0)
    return float(trace["time_s"][rows[-1]] - trace["time_s"][rows[0]]) if len(rows) else 0.0


def _approach(trace: Table) -> tuple[Array, Array]:
    """Return the mean axis of the tool in contact and the place of the first contact [mm].

    The axis points out of the tissue.
    """
    rows = np.flatnonzero(trace["contact_mm2"] > 0.0)
    if not len(rows):
        raise InputError(
            "reference", "touch the tissue", "a run without contact", "choose another reference"
        )
    quaternions = np.column_stack([trace[f"tool_q{c}"][rows] for c in "xyzw"])
    axis = tool_axes(quaternions).mean(axis=0)
    return axis / np.linalg.norm(axis), trace.vectors("tool", "mm")[rows[0]]


TASK = ("anatomy", "keep_clear", "organ", "cutting", "tool")
"""Parts of a scene that define the task.

The correct forces and depths depend on the tissue and on the tool.
"""
NUMERICAL = frozenset(
    f"organ.{name}" for name in ("law_interval_ms", "order", "path", "basis_size", "interval_ms")
)
"""Keys of the parts in `TASK` that change only the computation, not the task."""
FREE = ("name", "description", "seed", "device", "output", "fidelity")
"""Scene keys that may differ between a trainee's run and the reference without a note.

These keys describe the run, the user who moves the tool, and the device.
"""


def _require_same_task(trainee: AssessedRun, reference: AssessedRun) -> None:
    """Check that two runs have the same scene, tissue, tool and material."""
    names = [str(each.summary.get("scene")) for each in (trainee, reference)]
    differences = [("scene", *names)] if names[0] != names[1] else []
    if trainee.scene is not None and reference.scene is not None:
        differences += [
            (key, shown(mine), shown(theirs))
            for key, mine, theirs in _differences(trainee.scene, reference.scene)
            if key.partition(".")[0] in TASK and key not in NUMERICAL
        ]
        if trainee.scene.constants.key != reference.scene.constants.key:
            files = [each.materials or "the library" for each in (trainee.scene, reference.scene)]
            differences.append(("materials", *map(str, files)))
    for key, first, second in differences:
        raise InputError(
            "run and reference",
            "be runs of the same task",
            f"{key} = {first} and {second}",
            "run the scene of the reference",
        )


def _scene_notes(trainee: Scene | None, reference: Scene | None) -> Iterator[str]:
    """Yield sentences on further differences between the two scenes."""
    if trainee is None or reference is None:
        yield "a run has no scene.toml: whether both are of one tissue and tool is not known"
        return
    for key, mine, theirs in _differences(trainee, reference):
        part = key.partition(".")[0]
        if part not in FREE and part != "materials" and (part not in TASK or key in NUMERICAL):
            yield f"the scenes differ in {key}: trainee {shown(mine)}, reference {shown(theirs)}"


def path_note(summary: Summary) -> str:
    """Return the reason why a run did not finish its path, empty for a finished path."""
    notes = summary.get("notes")
    text = str(notes.get("path", "")) if isinstance(notes, Mapping) else ""
    return text if text.startswith("not finished") else ""


def _differences(one: Scene, other: Scene) -> Iterator[tuple[str, object, object]]:
    """Yield each key whose value differs between two scenes, with both values.

    Keys with default values are included. A key that only one of the scenes has gets the value
    "nothing" for the other scene.
    """
    first, second = (dict(_flat(tomllib.loads(each.to_toml()))) for each in (one, other))
    for key in dict.fromkeys((*first, *second)):
        if first.get(key) != second.get(key) and not _same_file(
            key, first.get(key), second.get(key)
        ):
            yield key, first.get(key, "nothing"), second.get(key, "nothing")


def _same_file(key: str, one: object, other: object) -> bool:
    """Return whether a key names two files of the same name and content.

    A file that is not on this machine is compared by its name. A trainee's run may come from
    another machine with another path to the anatomy.
    """
    names_file = is_file_key(key.rpartition(".")[2]) or key.startswith("keep_clear.files.")
    if not names_file or not isinstance(one, str) or not isinstance(other, str):
        return False
    first = Path(one)
    second = Path(other)
    if first.name != second.name:
        return False
    return not (first.is_file() and second.is_file()) or filecmp.cmp(first, second, shallow=False)


def _flat(table: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
