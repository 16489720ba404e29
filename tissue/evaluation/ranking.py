"""Ranking of trainees by breached structures and scores of their runs."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, counted
from meshes.base.text_tables import natural_order
from meshes.base.whole_file import write_rows
from tissue.evaluation.assessment import (
    NUMBER,
    Assessment,
    NoSharedContactError,
    Quantity,
    assess,
    breached_structures,
    without_numbers,
)
from tissue.evaluation.assessment_files import limits_line
from tissue.evaluation.same_task import AssessedRun, OtherTaskError, coupling_notes
from tissue.evaluation.statistics.intervals import mean_interval
from tissue.evaluation.steadiness import SCALE, Steadiness
from tissue.show.figures.figure import figure, save
from tissue.system.owned_folder import OwnedFolder

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FILES = ("ranking.csv", "ranking.png")
LEAST_ATTEMPTS = 3
"""Smallest number of attempts for an interval from the spread of a trainee's scores."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "os^DvPX"
BREACHED = "#D55E00"
INCH_PER_ROW = 0.32
"""Height [inches] of a trainee's row in the picture."""


@dataclass(frozen=True)
class Attempt:
    """Assessed run of a trainee, with the name of the run."""

    name: str
    found: Assessment

    @property
    def steadiness(self) -> Steadiness:
        """Tremor and score of the hand in the run."""
        assert self.found.steadiness is not None, self.name
        return self.found.steadiness

    def least_mm(self, structure: str) -> float:
        """Return the smallest distance [mm] of the tool from a structure; NaN if it is unknown."""
        kept = self.found.figures["keep_clear"]
        return float(kept[structure]["least_distance_mm"]) if structure in kept else float("nan")


@dataclass(frozen=True)
class Person:
    """Trainee with all attempts, in the order of the attempts."""

    name: str
    attempts: tuple[Attempt, ...]

    @property
    def scores(self) -> Array:
        """Scores of the attempts, shape (attempts,)."""
        return np.array([each.steadiness.score for each in self.attempts])

    @property
    def mean(self) -> float:
        """Mean score of the attempts."""
        return float(self.scores.mean())

    @property
    def breached_share(self) -> float:
        """Fraction of the attempts in which the tool breached a protected structure."""
        return sum(bool(each.found.breached) for each in self.attempts) / len(self.attempts)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mean score.

        For three or more attempts, the interval is computed from the spread of the scores
        (Student's t). For one or two attempts, it is computed from the intervals of the individual
        scores.
        """
        count = len(self.attempts)
        if count >= LEAST_ATTEMPTS:
            found = mean_interval(self.scores)
            return found.low, found.high
        ends = [(one.steadiness.low, one.steadiness.high) for one in self.attempts]
        below, above = np.linalg.norm(np.array(ends) - self.scores[:, None], axis=0) / count
        return self.mean - float(below), self.mean + float(above)

    @property
    def gain(self) -> tuple[float, float, float] | None:
        """Mean change of the score from attempt to attempt, and the ends of its 95 % interval.

        The change is the slope of a straight line that is fitted to the scores. The result is None
        for fewer than three attempts.
        """
        from scipy.stats import linregress, t

        count = len(self.attempts)
        if count < LEAST_ATTEMPTS:
            return None
        line = linregress(np.arange(count), self.scores)
        half = float(t.ppf(0.975, count - 2) * line.stderr)
        return float(line.slope), float(line.slope) - half, float(line.slope) + half


@dataclass(frozen=True)
class Ranking:
    """Trainees ordered by safety and score, the best first.

    Trainees are ordered by the fraction of their runs with a breach, smallest first. Trainees with
    equal fractions are ordered by the mean score.

    Attributes
    ----------
    scene
        Name of the scene.
    people
        Ordered trainees.
    unscored
        Trainees together with those of their runs that have no score. The table lists these runs
        without a rank.
    left_out
        Sentence with the reason for each run that is not ranked. Typical reasons are a task that
        differs from the task of the reference run, and a missing score.
    notes
        Names of the runs to which a note applies, keyed by the note (a sentence). The sentence
        states that the scene differs from that of the reference run, or that the path was not
        finished. Sentences that differ only in numbers are merged into one sentence with ranges of
        the numbers.
    """

    scene: str
    people: tuple[Person, ...]
    unscored: tuple[Person, ...] = ()
    left_out: tuple[str, ...] = ()
    notes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def structures(self) -> list[str]:
        """Names of the protected structures in the scene."""
        people = (*self.people, *self.unscored)
        attempts = (attempt for person in people for attempt in person.attempts)
        kept = (name for each in attempts for name in each.found.figures["keep_clear"])
        return list(dict.fromkeys(kept))

    @property
    def margins(self) -> list[str]:
        """Names of the protected structures that have a margin as a limit."""
        people = (*self.people, *self.unscored)
        attempts = (attempt for person in people for attempt in person.attempts)
        names = (name for attempt in attempts for name in attempt.found.clearances)
        return list(dict.fromkeys(names))


def is_run(folder: Path) -> bool:
    """Return whether a folder is the folder of a run."""
    return (folder / "summary.json").is_file()


def rank(
    folder: Path,
    reference: AssessedRun,
    load: Callable[[Path], AssessedRun],
    **limits: float | None,
) -> Ranking:
    """Assess the runs of trainees against a reference run, and order the trainees.

    See `Ranking` for the order.

    Parameters
    ----------
    folder
        Folder that contains a folder for each trainee. A trainee's folder is either a run folder,
        or contains a run folder for each attempt. Attempts are ordered by name: ``attempt2`` comes
        before ``attempt10``.
    reference
        Run with which all other runs are compared.
    load
        Function that reads the run of a folder.
    **limits
        Limits that all runs are assessed with, see `tissue.evaluation.assessment.assess`.

    Raises
    ------
    InputError
        If the folder of a trainee contains no run, or no run can be assessed.
    """
    people = []
    unscored = []
    left_out = []
    notes: dict[str, list[tuple[str, str]]] = {}
    device = reference.scene and reference.scene.device
    # without a device, the reference has no coupling: the first ranked run has the compared one
    first: tuple[AssessedRun, str] | None = None
    for person in _folders(folder):
        runs = [person] if is_run(person) else [each for each in _folders(person) if is_run(each)]
        if not runs:
            raise InputError(
                "folder",
                "contain at least one run of each trainee",
                f"no run in {person}",
                f"remove the folder {person}",
            )
        attempts = []
        without_score = []
        for path in runs:
            run = load(path)
            breached = ", ".join(breached_structures(run))
            harm = f"breached {breached} and " if breached else ""
            try:
                found = assess(run, reference, **limits)  # type: ignore[arg-type]
            except NoSharedContactError as problem:
                left_out.append(f"{path} {harm}{problem.reason}")
                continue
            except OtherTaskError as problem:
                left_out.append(
                    f"{path} {harm}is of another task than the reference: {problem.difference}. "
                    "Run the scene of the reference"
                )
                continue
            except InputError as refusal:
                raise InputError(f"{path}: {refusal}") from refusal
            if found.steadiness is None:
                left_out.append(f"{path} {harm}has no score: {found.unscored}")
                without_score.append(Attempt(path.name, found))
                continue
            name = path.relative_to(folder).as_posix()
            first = first or (run, name)
            for note in (*found.notes, *(() if device else coupling_notes(run, *first))):
                # For example, each run stops at another depth.
                notes.setdefault(without_numbers(note), []).append((note, name))
            attempts.append(Attempt(path.name, found))
        if attempts:
            people.append(Person(person.name, tuple(attempts)))
        if without_score:
            unscored.append(Person(person.name, tuple(without_score)))
    has_assessed = bool(people or unscored)
    if not has_assessed and left_out:
        raise InputError(f"no run can be assessed: {left_out[0]}")
    if not has_assessed:
        raise InputError(
            "folder",
            "contain folders of trainees",
            f"none in {folder}",
            "give the folder that contains one folder for each trainee",
        )
    people.sort(key=lambda person: (person.breached_share, -person.mean))
    scene = str(reference.summary.get("scene"))
    noted = {}
    for pairs in notes.values():
        sentences, names = zip(*pairs, strict=True)
        noted[_shared_note(sentences)] = names
    return Ranking(scene, tuple(people), tuple(unscored), tuple(left_out), noted)


def _shared_note(notes: Sequence[str]) -> str:
    """Return one note for notes that differ only in numbers.

    A number that differs becomes the range of its values.
    """
    ranges = []
    for values in zip(*(NUMBER.findall(note) for note in notes), strict=True):
        smallest = min(values, key=float)
        largest = max(values, key=float)
        ranges.append(smallest if smallest == largest else f"{smallest} to {largest}")
    remaining = iter(ranges)
    return NUMBER.sub(lambda _: next(remaining), notes[0])


def ranking_lines(found: Ranking) -> list[str]:
    """Return the ranking in words."""
    people = counted(len(found.people), "trainee")
    runs = counted(sum(len(person.attempts) for person in found.people), "run")
    lines = [f"{found.scene}: {people}, {runs}; {SCALE}"]
    if not found.people:
        lines = [f"{found.scene}: no run has a score, so that no trainee has a rank"]
    structures = found.structures
    if structures and found.people:
        lines.append(
            f"order: first by the share of runs that breached {' or '.join(structures)}, "
            "the smallest first, then by the mean score"
        )
    for place, person in enumerate(found.people, 1):
        low, high = person.interval
        line = (
            f"{place}. {person.name}: {person.mean:.0f} (95 %: {low:.0f} to {high:.0f}), "
            f"{counted(len(person.attempts), 'attempt')}"
        )
        if (gain := person.gain) is not None:
            line += f", {gain[0]:+.1f} per attempt ({gain[1]:+.1f} to {gain[2]:+.1f})"
            if gain[1] <= 0.0 <= gain[2]:
                line += ": the attempts show no change, because this interval contains 0"
        lines.append(line)
        for name in structures:
            distances = ", ".join(
                f"{each.least_mm(name):.3f} mm" + " (breached)" * (name in each.found.breached)
                for each in person.attempts
            )
            lines.append(f"   smallest distance to {name}: {distances}")
    lines += _limit_lines(found)
    if len(found.people) > 1 and all(one.name.startswith("attempt") for one in found.people):
        lines.append(
            "hint: every folder counts as a trainee. If these folders are the attempts of one "
            "trainee, give the folder that contains the trainee's folder"
        )
    for note, noted in found.notes.items():
        lines.append(f"note: {note}")
        by_trainee: dict[str, list[str]] = {}
        for run in noted:
            by_trainee.setdefault(run.partition("/")[0], []).append(run)
        lines += [f"   {', '.join(each)}" for each in by_trainee.values()]
    return lines + [f"left out: {each}" for each in found.left_out]


def _limit_lines(found: Ranking) -> list[str]:
    """Return the limits in words, and the trainees who exceeded each limit."""
    by_trainee: dict[str, list[Assessment]] = {}
    for person in (*found.people, *found.unscored):
        assessed = [attempt.found for attempt in person.attempts]
        by_trainee.setdefault(person.name, []).extend(assessed)
    # All runs have the limits of the same reference run.
    some = next(iter(by_trainee.values()))[0]
    lines = [limits_line(some)]
    for quantity in (some.force, some.deviation, some.depth, *some.clearances.values()):
        names = []
        for name, assessed in by_trainee.items():
            over = sum(_intervals_over(each, quantity) > 0 for each in assessed)
            share = f" ({over} of {len(assessed)} attempts)" if len(assessed) > 1 else ""
            if over:
                names.append(name + share)
        if names:
            side = "below" if quantity.is_minimum else "over"
            lines.append(f"   {quantity.what} {side} the limit: {', '.join(names)}")
    return lines


def _intervals_over(found: Assessment, quantity: Quantity) -> int:
    """Return the number of time spans in which a quantity was beyond its limit."""
    return sum(breach.what == quantity.what for breach in found.breaches)


def write_ranking(found: Ranking, folder: Path, *, overwrite: bool) -> list[Path]:
    """Write ``ranking.csv``, which has a row for each run, and ``ranking.png``.

    Runs without a score have no rank, and are not drawn. If no run has a score, only the table is
    written.

    Raises InputError if `folder` is a file, or if it contains a ranking and `overwrite` is false.
    """
    with OwnedFolder(folder, "ranking", FILES, overwrite=overwrite):
        rows = [
            _row(found, place, person, attempt)
            for place, person in enumerate(found.people, 1)
            for attempt in person.attempts
        ]
        rows += [
            _row(found, None, person, attempt)
            for person in found.unscored
            for attempt in person.attempts
        ]
        write_rows(folder / FILES[0], [rows[0], *(row.values() for row in rows)])
        written = [folder / FILES[0]]
        if found.people:
            _draw(found, folder / FILES[1])
            written.append(folder / FILES[1])
    return written


def _row(found: Ranking, place: int | None, person: Person, attempt: Attempt) -> dict[str, object]:
    """Return the table row of a run, keyed by the names of the columns.

    `place` is None for a run without a score. The rank, score and tremor of this run are empty.
    """
    hand = attempt.found.steadiness
    figures = attempt.found.figures
    row: dict[str, object] = {
        "rank": place,
        "trainee": person.name,
        "attempt": attempt.name,
        "score": hand and round(hand.score, 2),
        "score_low": hand and round(hand.low, 2),
        "score_high": hand and round(hand.high, 2),
        "tremor_mm": hand and round(hand.tremor_mm, 4),
        "mean_deviation_mm": round(figures["deviation_mm"]["mean"], 4),
        "overshoot_mm": round(figures["overshoot_mm"], 4),
        "peak_force_N": round(figures["peak_force_N"]["trainee"], 4),
        "force_error": round(figures["force_error"], 4),
        "removed_mm3": round(figures["removed_mm3"]["trainee"], 4),
    }
    one = attempt.found
    for name, each in (("force", one.force), ("deviation", one.deviation), ("depth", one.depth)):
        row[f"{name}_limit_{each.unit}"] = round(each.limit, 4)
        row[f"intervals_over_{name}_limit"] = _intervals_over(one, each)
    for name in found.margins:
        margin = one.clearances.get(name)
        row[f"margin_{name}_mm"] = margin and round(margin.limit, 4)
        row[f"intervals_below_margin_{name}"] = margin and _intervals_over(one, margin)
    least = {
        f"least_distance_{name}_mm": round(attempt.least_mm(name), 4) for name in found.structures
    }
    breached = {f"breached_{name}": name in attempt.found.breached for name in found.structures}
    return row | least | breached


def _draw(found: Ranking, path: Path) -> None:
    """Draw scores, smallest distances to structures and, for several attempts, learning curves."""
    people = found.people
    structures = found.structures
    most = max(len(person.attempts) for person in people)
    count = 1 + bool(structures) + (most > 1)
    # inches: a row for each trainee, and space for title and axis; the title is 6.5 inches wide
    width = max(7.0, 2.0 + 4.0 * count)
    chart = figure(width, max(2.8, 1.5 + INCH_PER_ROW * len(people)))
    chart.set_layout_engine("constrained")
    panels = chart.subplots(1, count, squeeze=False)[0]
    _draw_scores(people, panels[0])
    if structures:
        _draw_distances(found, panels[1])
    for axes in panels[: 1 + bool(structures)]:
        axes.set_ylim(len(people) - 0.4, -0.6)
        axes.set_yticks(range(len(people)), [person.name for person in people])
        axes.grid(axis="x", alpha=0.3)
    if most > 1:
        _draw_learning(people, panels[-1])
        panels[-1].set_xticks(range(1, most + 1))
    chart.suptitle(
        f"{found.scene}: steadiness of the hand, mean with 95 % interval\ninterval from the "
        f"spread of {LEAST_ATTEMPTS} or more attempts; with fewer attempts, from the intervals of "
        f"the runs\n{limits_line(people[0].attempts[0].found)}",
        size=9,
    )
    save(chart, path)


def _look(place: int) -> tuple[str, str]:
    """Return the colour and marker of the trainee at a place of the ranking.

    The first 49 trainees have different combinations of colour and marker.
    """
    return COLOURS[place % len(COLOURS)], MARKERS[place // len(COLOURS) % len(MARKERS)]


def _draw_scores(people: Sequence[Person], axes: "Axes") -> None:
    """Draw the mean score of each trainee with its interval, and the scores of attempts."""
    for place, person in enumerate(people):
        colour, marker = _look(place)
        axes.plot(person.interval, [place, place], color=colour, linewidth=2)
        axes.plot(person.mean, place, marker, color=colour)
        if len(person.attempts) > 1:
            axes.plot(person.scores, [place] * len(person.scores), "x", color=colour)
    for value, name in ((0.0, "a novice"), (100.0, "an expert")):
        axes.axvline(value, color="0.6", linestyle=":")
        axes.annotate(
            name, (value, 1.0), xycoords=("data", "axes fraction"), ha="center", va="bottom"
        )
    is_single = all(len(person.attempts) == 1 for person in people)
    axes.set_xlabel("score" if is_single else "score (x: one attempt)")


def _draw_distances(found: Ranking, axes: "Axes") -> None:
    """Draw the smallest distance of the tool from each structure in each run, and mark breaches."""
    for index, name in enumerate(found.structures):
        for breached, colour, text in (
            (False, "0.4", "not breached"),
            (True, BREACHED, "breached"),
        ):
            points = [
                (attempt.least_mm(name), place)
                for place, person in enumerate(found.people)
                for attempt in person.attempts
                if (name in attempt.found.breached) == breached
            ]
            if points:
                marker = MARKERS[index % len(MARKERS)]
                label = f"{name}, {text}"
                axes.plot(*np.array(points).T, marker, color=colour, label=label)
    axes.axvline(0.0, color=BREACHED, linestyle="--")
    axes.set_xlabel("smallest distance of each run / mm")
    axes.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)


def _draw_learning(people: Iterable[Person], axes: "Axes") -> None:
    """Draw the score against the attempt for each trainee with several attempts."""
    for place, person in enumerate(people):
        if len(person.attempts) > 1:
            attempts = np.arange(1, len(person.attempts) + 1)
            colour, marker = _look(place)
            axes.plot(attempts, person.scores, f"{marker}-", color=colour, label=person.name)
    axes.set(xlabel="attempt", ylabel="score")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _folders(folder: Path) -> list[Path]:
    """Return the subfolders of a folder, sorted by name.

    Numbers in the names are compared as numbers.
    """
    if not folder.is_dir():
        raise InputError("folder", "exist", folder, "name the folder of the trainees")
    found = (each for each in folder.iterdir() if each.is_dir() and not each.name.startswith("."))
    return sorted(found, key=lambda each: natural_order(each.name))
