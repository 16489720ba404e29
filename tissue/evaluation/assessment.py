"""Assessment of a trainee's run against a reference run of the same scene."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError, counted, require_positive
from tissue.evaluation.same_task import (
    AssessedRun,
    coupling_notes,
    is_event_of,
    require_same_task,
    scene_notes,
    uncommon_parts,
)
from tissue.evaluation.statistics.metrics import (
    aligned_rows,
    deviation_mm,
    followed_ticks,
    force_error,
    overshoot_mm,
)
from tissue.evaluation.steadiness import Steadiness, steadiness
from tissue.haptics.device.device import device_parameters
from tissue.materials.scene_constants import Materials
from tissue.scene.scene import Scene
from tissue.scene.tool import ThrustMotion
from tissue.simulation.bone_surface import tool_axes
from tissue.simulation.findings import TOLERANCE_MM, thrust_depth_mm
from tissue.simulation.run_folder import Summary
from tissue.simulation.trace import Table

NUMBER = re.compile(r"(?:(?<![\w)\]])-)?\d+(?:\.\d+)?(?:e[+-]\d+)?")
"""Number in a sentence about a run, with its sign. A hyphen after a word is not a sign."""
GAP_S = 0.15
"""Longest time [s] between two exceedances of a limit that count as one.

The value is a period of slow tremor. Without this rule, a trembling hand near a limit would exceed
the limit once in each period.
"""
FORCE_MARGIN = 1.25
"""Default limit of the trainee's force, divided by the peak force of the reference run.

The value is a convention, not a standard.
"""


class NoSharedContactError(InputError):
    """Error for a run that does not touch the tissue at the places where the reference run does.

    The attribute `reason` describes the contact of the run, for example "touches nothing".
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
class Breach:
    """Time span in which an assessed quantity is beyond its limit in the trainee's run."""

    what: str
    start_s: float
    end_s: float
    worst: float
    worst_at_s: float
    limit: float
    unit: str

    @property
    def sentence(self) -> str:
        """Start, end, limit and worst value of the breach, as a sentence."""
        # the worst value lies beyond the limit
        side = "above" if self.worst > self.limit else "below"
        return (
            f"{self.what} {side} {self.limit:.3g} {self.unit} from {self.start_s:.3f} to "
            f"{self.end_s:.3f} s, "
            f"at worst {self.worst:.3g} {self.unit} at {self.worst_at_s:.3f} s"
        )


@dataclass(frozen=True)
class Quantity:
    """Assessed quantity in every tick of the trainee's run.

    Attributes
    ----------
    what, unit
        Name and unit of the quantity.
    values
        Values in the trainee's run, shape (ticks,).
    limit
        Limit of the values.
    reference
        For each tick of the trainee's run, the value in the reference run at the corresponding
        place, shape (ticks,). NaN for ticks of the trainee's run with no corresponding place. None
        for a quantity, such as the deviation, that does not exist in the reference run.
    limited
        True for ticks in which the limit applies, shape (ticks,). None if it applies in all ticks.
    is_minimum
        True if the limit is the smallest allowed value instead of the largest.
    """

    what: str
    unit: str
    values: Array
    limit: float
    reference: Array | None = None
    limited: Flags | None = None
    is_minimum: bool = False

    def breaches(self, time_s: Array) -> list[Breach]:
        """Return the time spans in which the values are beyond the limit.

        Two spans are joined if the time between them is at most `GAP_S`.
        """
        sign = -1.0 if self.is_minimum else 1.0
        signed = sign * self.values
        is_beyond = signed > sign * self.limit
        if self.limited is not None:
            is_beyond = is_beyond & self.limited
        beyond = np.flatnonzero(is_beyond)
        found = []
        for span in np.split(beyond, np.flatnonzero(np.diff(time_s[beyond]) > GAP_S) + 1):
            # without any breach, the only span is empty
            if len(span):
                worst = span[signed[span].argmax()]
                start, end, at = time_s[[span[0], span[-1], worst]].tolist()
                size = float(self.values[worst])
                found.append(Breach(self.what, start, end, size, at, self.limit, self.unit))
        return found


@dataclass(frozen=True)
class Assessment:
    """Comparison of a trainee's run with the reference.

    Attributes
    ----------
    steadiness
        Tremor and score of the trainee's hand. None if the run has no score.
    figures
        Results, keyed by name; the name of a numerical result ends with its unit. A result that
        exists for both runs is a dict {"trainee": ..., "reference": ...}.
    breaches
        Time spans in which a limit was exceeded, in chronological order.
    events
        Events that occur only in the trainee's run, each as a time [s] and a sentence. Two events
        count as equal if their sentences differ only in numbers.
    missing
        Events that occur only in the reference run, in the form of `events`.
    time_s
        Times of the trainee's ticks [s], shape (ticks,).
    deviation, force, depth
        The three assessed quantities: distance [mm] between the tool and the path of the reference
        run, magnitude of the force [N], and depth [mm]. The depth is measured from the point of
        first contact in the reference run, along the mean direction of the tool's axis in that run.
    notes
        One sentence for each difference between the two runs that makes `figures` less comparable.
    unscored
        Reason why the run has no score. Empty if the run has a score.
    clearances
        Distances [mm] of the trainee's tool from the protected structures, keyed by structure. The
        limit is `keep_clear.margin_mm` of the scene of the reference run. Empty without a margin.
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
    missing: tuple[tuple[float, str], ...] = ()
    clearances: Mapping[str, Quantity] = field(default_factory=dict)

    @property
    def breached(self) -> tuple[str, ...]:
        """Names of the protected structures that the trainee's tool breached."""
        return _breached(self.figures["keep_clear"])


def assess(
    trainee: AssessedRun,
    reference: AssessedRun,
    *,
    force_limit_N: float | None = None,
    deviation_limit_mm: float = 1.0,
    overshoot_limit_mm: float = 0.5,
) -> Assessment:
    """Compare a run with a reference run of the same task.

    The runs are aligned by the position of the tool, not by time. For each tick of the trainee's
    run, dynamic time warping (Sakoe and Chiba 1978) of the two tool paths finds the corresponding
    tick of the reference run. A pause of the trainee is therefore not an error.

    The score rates the steadiness of the hand (see `tissue.evaluation.steadiness`). Distances from
    the path and forces do not affect the score, because they depend more on the device than on the
    hand.

    If the scene of the reference run has `keep_clear.margin_mm`, this margin is a limit of the
    distance from each protected structure. The limit does not apply after the trainee's tool left
    the simulated region.

    Parameters
    ----------
    trainee, reference
        Run of the trainee, and reference run.
    force_limit_N
        Limit of the force on the tool [N]. Default: 1.25 times the peak force of the reference run.
    deviation_limit_mm
        Limit of the distance from the path of the reference run [mm]. The limit applies only in
        ticks in which the trainee's tool touches the tissue, or the reference tool touches it at
        the corresponding place.
    overshoot_limit_mm
        Allowed depth [mm] of the tip below the deepest point of the tip in the reference run.

    Raises
    ------
    InputError
        If a run has no trace of at least ten ticks, the reference run has no contact, or a limit is
        not positive.
    OtherTaskError
        If the runs have different tasks (another anatomy, tool or material).
    NoSharedContactError
        If the trainee's run has no contact, or if the reference run has no contact at the
        corresponding places.
    """
    require_same_task(trainee, reference)
    mine = _trace(trainee, "run")
    theirs = _trace(reference, "reference")
    path = mine.vectors("tool", "mm")
    model = theirs.vectors("tool", "mm")
    rows = aligned_rows(path, model)
    deviation = deviation_mm(path, model, rows)
    followed = followed_ticks(model, rows)
    axis, start = _approach(theirs)
    depth = (start - path) @ axis
    ideal_depth = (start - model) @ axis
    forces = mine.vectors("model_force", "N")
    ideal_forces = theirs.vectors("model_force", "N")
    force = np.linalg.norm(forces, axis=1)
    ideal_force = np.linalg.norm(ideal_forces, axis=1)
    peak = float(ideal_force.max())
    deepest = float(ideal_depth.max())
    if force_limit_N is None and peak == 0.0:
        raise InputError(
            "the force of the reference run is zero, so it gives no default limit of the force. "
            "Use a reference that touches the tissue, or give --force-limit-N"
        )
    limit = FORCE_MARGIN * peak if force_limit_N is None else force_limit_N
    require_positive("force_limit_N", limit, "use a value such as 30, or leave it out")
    require_positive("deviation_limit_mm", deviation_limit_mm, "use a value such as 1")
    require_positive("overshoot_limit_mm", overshoot_limit_mm, "use a value such as 0.5")
    if not force.any():
        raise NoSharedContactError("touches nothing")
    if not ideal_force[rows].any():
        raise NoSharedContactError("touches only where the reference run does not")
    there = np.where(followed, ideal_force[rows], np.nan)
    # In free air, the distance from the path harms no tissue.
    touches = (force > 0.0) | (ideal_force[rows] > 0.0)
    quantities = (
        Quantity("distance from the path", "mm", deviation, deviation_limit_mm, limited=touches),
        Quantity("force", "N", force, limit, there),
        Quantity(
            "depth",
            "mm",
            depth,
            deepest + overshoot_limit_mm,
            np.where(followed, ideal_depth[rows], np.nan),
        ),
    )
    time = mine["time_s"]
    clearances = _clearances(trainee, reference, np.where(followed, rows, -1))
    limited = (*quantities, *clearances.values())
    breaches = [each for one in limited for each in one.breaches(time)]
    kept = _keep_clear(trainee.summary, mine)
    others = _keep_clear(reference.summary, theirs)
    worst = int(deviation.argmax())
    figures = {
        "scene": trainee.summary.get("scene"),
        "time_in_contact_s": {"trainee": _contact_s(mine), "reference": _contact_s(theirs)},
        "deviation_mm": {
            "mean": float(deviation.mean()),
            "worst": float(deviation[worst]),
            "worst_at_s": float(time[worst]),
        },
        "peak_force_N": {"trainee": float(force.max()), "reference": peak},
        "force_error": force_error(forces[followed], ideal_forces[rows][followed]),
        "overshoot_mm": overshoot_mm(depth, target_mm=deepest),
        "removed_mm3": {"trainee": _removed_mm3(mine), "reference": _removed_mm3(theirs)},
        "least_distance_mm": {
            name: {
                "trainee": each["least_distance_mm"],
                "reference": others[name]["least_distance_mm"],
            }
            for name, each in kept.items()
            if name in others
        },
        "keep_clear": kept,
        "complete": {"trainee": trainee.complete, "reference": reference.complete},
    }
    scale = Materials.cited if reference.scene is None else reference.scene.constants
    hand, unscored = _steadiness(trainee, mine, scale)
    return Assessment(
        hand,
        figures,
        tuple(sorted(breaches, key=lambda each: each.start_s)),
        _events_not_in(reference, trainee),
        time,
        *quantities,
        tuple(_notes(trainee, reference)),
        unscored,
        _events_not_in(trainee, reference),
        clearances,
    )


def _clearances(trainee: AssessedRun, reference: AssessedRun, rows: Ints) -> dict[str, Quantity]:
    """Return the distances of the trainee's tool from the protected structures, with their margin.

    `rows` holds the corresponding tick of the reference run for each tick of the trainee's run, or
    -1. The result is empty if the reference has no margin.
    """
    wanted = None if reference.scene is None else reference.scene.keep_clear
    mine = _trace(trainee, "run")
    theirs = _trace(reference, "reference")
    if wanted is None or wanted.margin_mm == 0.0:
        return {}
    # Distances are not valid after the tool left the simulated region.
    is_valid = mine["time_s"] <= trainee.summary.get("left_region_s", np.inf)
    found = {}
    for name in (*wanted.names, *wanted.files):
        column = f"distance_{name}_mm"
        if column not in mine.columns:
            continue
        there = None
        if column in theirs.columns:
            there = np.where(rows >= 0, theirs[column][rows], np.nan)
        found[name] = Quantity(
            f"distance to {name}",
            "mm",
            mine[column],
            wanted.margin_mm,
            there,
            is_valid,
            is_minimum=True,
        )
    return found


def _events_not_in(other: AssessedRun, run: AssessedRun) -> tuple[tuple[float, str], ...]:
    """Return the events of a run that the other run does not have, as times and sentences.

    Events of a part that only one of the scenes computes, such as heat, are left out.
    """
    scenes = [each.scene for each in (run, other) if each.scene is not None]
    uncommon = uncommon_parts(scenes)
    known = {without_numbers(each["what"]) for each in other.summary.get("events", ())}
    return tuple(
        (each["time_s"], each["what"])
        for each in run.summary.get("events", ())
        if without_numbers(each["what"]) not in known and not is_event_of(each["what"], uncommon)
    )


def without_numbers(sentence: str) -> str:
    """Return a sentence in which each number is replaced by "…".

    The same event in two runs then has the same sentence.
    """
    return NUMBER.sub("…", sentence)


def _notes(trainee: AssessedRun, reference: AssessedRun) -> Iterator[str]:
    """Yield warnings about different scenes and about runs that are valid only up to some time."""
    yield from scene_notes(trainee.scene, reference.scene)
    yield from coupling_notes(trainee, reference, "the reference")
    for who, run in (("trainee", trainee), ("reference", reference)):
        if note := path_note(run.summary):
            yield f"the path of the {who} is {note}"
        if (left_s := run.summary.get("left_region_s")) is not None:
            yield (
                f"the tool of the {who} left the simulated region at {left_s:.3f} s, so its "
                "smallest distances and breaches hold only up to this time"
            )


def _trace(run: AssessedRun, name: str) -> Table:
    """Return the trace of a run; raise InputError if it has fewer than ten ticks."""
    # a path needs several ticks
    ticks = 0 if run.trace is None else len(run.trace.rows)
    if run.trace is None or ticks < 10:
        got = f"{run.path or 'a run'} with {counted(ticks, 'tick')}"
        raise InputError(
            name,
            "have a trace of at least ten ticks",
            got,
            "run the scene again",
        )
    return run.trace


def _steadiness(run: AssessedRun, trace: Table, scale: Materials) -> tuple[Steadiness | None, str]:
    """Return tremor and score of the hand in a run, or the reason why the run has no score.

    `scale` holds the constants of the reference run, which define the tremors with the scores 0 and
    100. The trainee's run may have other constants, which would change the scores.
    """
    if run.scene is None or run.scene.device is None or "device_x_mm" not in trace.columns:
        return None, "the run has no device whose constants are known"
    try:
        found = steadiness(
            1e-3 * trace.vectors("device", "mm"),
            trace.vectors("device_force", "N"),
            device_parameters(run.scene.device.kind, run.scene.constants),
            constants=scale,
            scored=_drilling_ticks(run.scene, trace),
        )
    except InputError as refusal:
        return None, str(refusal)
    return found, ""


def _drilling_ticks(scene: Scene, trace: Table) -> int:
    """Return the number of ticks until a tool pushed by a thrust reaches `motion.depth_mm`.

    The hand rests afterwards. For any other motion, the number of all ticks is returned.
    """
    if not isinstance(scene.motion, ThrustMotion):
        return len(trace.rows)
    depth_mm = thrust_depth_mm(scene.motion, trace)
    reached = np.flatnonzero(depth_mm >= scene.motion.depth_mm - TOLERANCE_MM)
    return int(reached[0]) if len(reached) else len(trace.rows)


def breached_structures(run: AssessedRun) -> tuple[str, ...]:
    """Return the names of the protected structures that the tool of a run breached."""
    return _breached(_keep_clear(run.summary, run.trace))


def _breached(kept: Mapping[str, Mapping[str, float | None]]) -> tuple[str, ...]:
    """Return the names of the structures with a breach."""
    return tuple(name for name, each in kept.items() if each.get("first_breach_s") is not None)


def _keep_clear(summary: Summary, trace: Table | None) -> dict[str, dict[str, float | None]]:
    """Return the smallest tool distance and the breach, if any, for each protected structure.

    For a run that was stopped early, the values are computed from the distances in the trace,
    because its summary does not contain them.
    """
    if "keep_clear" in summary:
        return dict(summary["keep_clear"])
    found: dict[str, dict[str, float | None]] = {}
    if trace is None:
        return found
    for column in trace.columns:
        if not column.startswith("distance_"):
            continue
        distance_mm = trace[column]
        least_mm = float(distance_mm.min())
        first_s = float(trace["time_s"][np.argmax(distance_mm < 0.0)]) if least_mm < 0.0 else None
        found[column.removeprefix("distance_").removesuffix("_mm")] = {
            "least_distance_mm": least_mm,
            "breach_depth_mm": max(0.0, -least_mm),
            "first_breach_s": first_s,
        }
    return found


def _removed_mm3(trace: Table) -> float:
    """Return the volume of tissue that a run removed [mm3]; zero if the tool removes no tissue."""
    return float(trace["removed_mm3"][-1]) if "removed_mm3" in trace.columns else 0.0


def _contact_s(trace: Table) -> float:
    """Return the time from the first contact to the last [s], zero without contact."""
    rows = np.flatnonzero(trace["contact_mm2"] > 0.0)
    return float(trace["time_s"][rows[-1]] - trace["time_s"][rows[0]]) if len(rows) else 0.0


def _approach(trace: Table) -> tuple[Array, Array]:
    """Return the mean tool axis over ticks in contact, and the tip at the first contact [mm].

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


def path_note(summary: Summary) -> str:
    """Return the reason why a run did not finish its path; empty for a finished path."""
    notes = summary.get("notes")
    text = str(notes.get("path", "")) if isinstance(notes, Mapping) else ""
    return text if text.startswith("not finished") else ""
