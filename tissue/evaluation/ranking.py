"""Ranking of trainees by breaches and scores of their runs, with learning curves."""

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, counted
from meshes.base.text_tables import natural_order
from meshes.base.whole_file import whole_file
from tissue.evaluation.assessment import Assessment, NoSharedContactError, assess
from tissue.evaluation.same_task import AssessedRun, OtherTaskError, coupling_notes
from tissue.evaluation.statistics.intervals import mean_interval
from tissue.evaluation.steadiness import SCALE, Steadiness
from tissue.show.figures.figure import figure, save
from tissue.system.owned_folder import OwnedFolder

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "Attempt",
    "Person",
    "Ranking",
    "is_run",
    "rank",
    "ranking_lines",
    "write_ranking",
]

FILES = ("ranking.csv", "ranking.png")
COLUMNS = (
    "rank",
    "trainee",
    "attempt",
    "score",
    "score_low",
    "score_high",
    "tremor_mm",
    "mean_deviation_mm",
    "overshoot_mm",
    "peak_force_N",
    "force_error",
    "limits_exceeded",
)
LEAST_ATTEMPTS = 3
"""Smallest number of attempts of a trainee from whose spread an interval is computed."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "os^DvPX"
BREACHED = "#D55E00"
INCH_PER_ROW = 0.32
"""Height of the row of each trainee in the picture [inches]."""


@dataclass(frozen=True)
class Attempt:
    """Assessed run of a trainee, with the name of the run."""

    name: str
    found: Assessment

    @property
    def steadiness(self) -> Steadiness:
        """Tremor and score of the hand in the run. Every attempt has a score."""
        assert self.found.steadiness is not None, self.name
        return self.found.steadiness


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
        """Fraction of the attempts in which the tool breached a structure to keep clear."""
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
        each = [one.steadiness for one in self.attempts]
        below = np.array([one.score - one.low for one in each])
        above = np.array([one.high - one.score for one in each])
        return (
            self.mean - float(np.linalg.norm(below)) / count,
            self.mean + float(np.linalg.norm(above)) / count,
        )

    @property
    def gain(self) -> tuple[float, float, float] | None:
        """Change of the score from one attempt to the next, with the ends of its 95 % interval.

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

    Trainees who breached a structure in a smaller fraction of their runs come first. Trainees with
    equal fractions are ordered by the mean score.

    Attributes
    ----------
    scene
        Name of the scene.
    people
        Ordered trainees.
    left_out
        Sentence for each run that is not ranked. Such a run has another task, has no score, or has
        no contact where the reference run has contact.
    notes
        Names of runs, keyed by the sentence on a difference between their scenes and the scene of
        the reference run.
    """

    scene: str
    people: tuple[Person, ...]
    left_out: tuple[str, ...] = ()
    notes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def is_run(folder: Path) -> bool:
    """Return whether a folder is the folder of a run."""
    return (folder / "summary.json").is_file()


def rank(folder: Path, reference: AssessedRun, load: Callable[[Path], AssessedRun]) -> Ranking:
    """Assess the runs of trainees against a reference run, and order the trainees.

    See `Ranking` for the order.

    Parameters
    ----------
    folder
        Folder with a folder for each trainee. The folder of a trainee is a run folder, or contains
        the run folders of all attempts. Attempts are ordered by name: ``attempt2`` comes before
        ``attempt10``.
    reference
        Run with which all other runs are compared.
    load
        Function that reads the run of a folder.

    Raises
    ------
    InputError
        If the folder of a trainee contains no run, or no run can be ranked.
    """
    people = []
    left_out = []
    notes = _Notes(reference)
    for person in _folders(folder):
        runs = [person] if is_run(person) else [each for each in _folders(person) if is_run(each)]
        if not runs:
            raise InputError(
                "folder",
                "hold at least one run for each trainee",
                f"no run in {person}",
                f"remove the folder {person}",
            )
        attempts = []
        for run in runs:
            assessed = load(run)
            try:
                found = assess(assessed, reference)
            except NoSharedContactError as problem:
                left_out.append(f"{run} {problem.reason}")
                continue
            except OtherTaskError as problem:
                left_out.append(
                    f"{run} is of another task than the reference: {problem.difference}. "
                    "Run the scene of the reference"
                )
                continue
            except InputError as refusal:
                raise InputError(f"{run}: {refusal}") from refusal
            if found.steadiness is None:
                breached = ", ".join(found.breached)
                harm = f"breached {breached} and " if breached else ""
                left_out.append(f"{run} {harm}has no score: {found.unscored}")
            else:
                notes.add(run.relative_to(folder).as_posix(), assessed, found)
                attempts.append(Attempt(run.name, found))
        if attempts:
            people.append(Person(person.name, tuple(attempts)))
    if not people and left_out:
        raise InputError(left_out[0])
    if not people:
        raise InputError(
            "folder",
            "hold folders of trainees",
            f"none in {folder}",
            "give the folder that holds one folder for each trainee",
        )
    people.sort(key=lambda person: (person.breached_share, -person.mean))
    scene = str(reference.summary.get("scene"))
    return Ranking(scene, tuple(people), tuple(left_out), notes.runs)


class _Notes:
    """Collector of notes on differences between scenes, with the runs that each note concerns.

    Runs with different scales of the coupling are not comparable. If the reference run has no
    device, it has no coupling. The couplings are then compared with the coupling of the first
    ranked run.
    """

    def __init__(self, reference: AssessedRun) -> None:
        self._reference = reference
        self._first: tuple[str, AssessedRun] | None = None
        self._runs: dict[str, list[str]] = {}

    def add(self, name: str, run: AssessedRun, found: Assessment) -> None:
        """Add the notes of a ranked run."""
        notes = list(found.notes)
        scene = self._reference.scene
        if scene is None or scene.device is None:
            first_name, first = self._first = self._first or (name, run)
            notes += coupling_notes(run, first, first_name)
        for note in notes:
            self._runs.setdefault(note, []).append(name)

    @property
    def runs(self) -> dict[str, tuple[str, ...]]:
        """Names of the runs of each note."""
        return {note: tuple(runs) for note, runs in self._runs.items()}


def ranking_lines(found: Ranking) -> list[str]:
    """Return the ranking in words."""
    people = counted(len(found.people), "trainee")
    runs = counted(sum(len(person.attempts) for person in found.people), "run")
    lines = [f"{found.scene}: {people}, {runs}; {SCALE}"]
    if structures := _structures(found):
        lines.append(
            f"order: first by the share of runs that breached {' or '.join(structures)}, "
            "the smallest first, then by the mean score"
        )
    for place, person in enumerate(found.people, 1):
        low, high = person.interval
        count = len(person.attempts)
        line = (
            f"{place}. {person.name}: {person.mean:.0f} (95 %: {low:.0f} to {high:.0f}), "
            f"{counted(count, 'attempt')}"
        )
        if (gain := person.gain) is not None:
            line += f", {gain[0]:+.1f} an attempt ({gain[1]:+.1f} to {gain[2]:+.1f})"
            if gain[1] <= 0.0 <= gain[2]:
                line += ": the attempts show no change, because this interval contains 0"
        lines.append(line)
        lines += [f"   least distance to {each}" for each in _distance_texts(person, structures)]
    for note, noted in found.notes.items():
        lines.append(f"note: {note}")
        lines += [f"   {each}" for each in _runs_by_trainee(noted)]
    return lines + [f"left out: {each}" for each in found.left_out]


def _runs_by_trainee(runs: Sequence[str]) -> Iterator[str]:
    """Yield the names of the runs of each trainee in one text."""
    held: dict[str, list[str]] = {}
    for run in runs:
        held.setdefault(run.partition("/")[0], []).append(run)
    for each in held.values():
        yield ", ".join(each)


def _structures(found: Ranking) -> list[str]:
    """Return the names of the structures that the runs had to keep clear of."""
    return list(
        dict.fromkeys(
            name
            for person in found.people
            for attempt in person.attempts
            for name in attempt.found.figures["keep_clear"]
        )
    )


def _least_mm(attempt: Attempt, structure: str) -> float:
    """Return the smallest distance of the tool from a structure in a run [mm], NaN if unknown."""
    kept = attempt.found.figures["keep_clear"]
    return float(kept[structure]["least_distance_mm"]) if structure in kept else float("nan")


def _distance_texts(person: Person, structures: Sequence[str]) -> Iterator[str]:
    """Yield a text for each structure, with the smallest distance in each attempt and breaches."""
    for name in structures:
        each = [
            f"{_least_mm(attempt, name):.2f} mm"
            + (" (breached)" if name in attempt.found.breached else "")
            for attempt in person.attempts
        ]
        yield f"{name}: {', '.join(each)}"


def write_ranking(found: Ranking, folder: Path, *, overwrite: bool) -> list[Path]:
    """Write ``ranking.csv``, which has a row for each run, and ``ranking.png``.

    Raises InputError if the folder is a file, or holds another ranking.
    """
    with OwnedFolder(folder, "ranking", FILES, overwrite=overwrite):
        with (
            whole_file(folder / FILES[0]) as temporary,
            temporary.open("w", encoding="utf-8", newline="") as file,
        ):
            writer = csv.writer(file)
            structures = _structures(found)
            distances = [f"least_distance_{name}_mm" for name in structures]
            writer.writerow([*COLUMNS, *distances, *(f"breached_{name}" for name in structures)])
            writer.writerows(_rows(found, structures))
        _draw(found, folder / FILES[1])
    return [folder / name for name in FILES]


def _rows(found: Ranking, structures: Sequence[str]) -> list[tuple[object, ...]]:
    """Return a table row for each run: values of `COLUMNS`, distances, and breaches."""
    return [
        (
            place,
            person.name,
            attempt.name,
            round(attempt.steadiness.score, 2),
            round(attempt.steadiness.low, 2),
            round(attempt.steadiness.high, 2),
            round(attempt.steadiness.tremor_mm, 4),
            round(attempt.found.figures["deviation_mm"]["mean"], 4),
            round(attempt.found.figures["overshoot_mm"], 4),
            round(attempt.found.figures["peak_force_N"]["trainee"], 4),
            round(attempt.found.figures["force_error"], 4),
            len({breach.what for breach in attempt.found.breaches}),
            *(round(_least_mm(attempt, name), 4) for name in structures),
            *(name in attempt.found.breached for name in structures),
        )
        for place, person in enumerate(found.people, 1)
        for attempt in person.attempts
    ]


def _draw(found: Ranking, path: Path) -> None:
    """Draw scores, smallest distances to structures and, for several attempts, learning curves."""
    people = found.people
    structures = _structures(found)
    most = max(len(person.attempts) for person in people)
    count = 1 + bool(structures) + (most > 1)
    # inches: a row for each trainee, and space for title and axis
    chart = figure(2.0 + 4.0 * count, max(2.6, 1.3 + INCH_PER_ROW * len(people)))
    chart.set_layout_engine("constrained")
    panels = chart.subplots(1, count, squeeze=False)[0]
    _draw_scores(people, panels[0])
    if structures:
        _draw_distances(people, structures, panels[1])
    for axes in panels[: 1 + bool(structures)]:
        axes.set_ylim(len(people) - 0.4, -0.6)
        axes.set_yticks(range(len(people)), [person.name for person in people])
        axes.grid(axis="x", alpha=0.3)
    if most > 1:
        _draw_learning(people, panels[-1])
        panels[-1].set_xticks(range(1, most + 1))
    title = f"{found.scene}: steadiness of the hand, mean with 95 % interval"
    spread = (
        f"interval from the spread of {LEAST_ATTEMPTS} or more attempts; with fewer attempts, "
        "from the intervals of the runs"
    )
    chart.suptitle(f"{title}\n{spread}", size=9)
    save(chart, path)


def _look(place: int) -> tuple[str, str]:
    """Return colour and marker of the trainee at a place.

    The first 49 trainees have different combinations of colour and marker.
    """
    return COLOURS[place % len(COLOURS)], MARKERS[place // len(COLOURS) % len(MARKERS)]


def _draw_scores(people: Sequence[Person], axes: "Axes") -> None:
    """Draw the mean score of each trainee with its interval, and the score of each run."""
    for place, person in enumerate(people):
        colour, marker = _look(place)
        axes.plot(person.interval, [place, place], color=colour, linewidth=2)
        axes.plot(person.mean, place, marker, color=colour)
        axes.plot(person.scores, [place] * len(person.scores), "|", color=colour)
    for value, name in ((0.0, "a novice"), (100.0, "an expert")):
        axes.axvline(value, color="0.6", linestyle=":")
        axes.annotate(
            name, (value, 1.0), xycoords=("data", "axes fraction"), ha="center", va="bottom"
        )
    axes.set_xlabel("score")


def _draw_distances(people: Sequence[Person], structures: Sequence[str], axes: "Axes") -> None:
    """Draw the smallest distance of the tool from each structure in each run, and mark breaches."""
    for index, name in enumerate(structures):
        marker = MARKERS[index % len(MARKERS)]
        breached_at: list[tuple[float, int]] = []
        distances: list[tuple[float, int]] = []
        for place, person in enumerate(people):
            for attempt in person.attempts:
                point = (_least_mm(attempt, name), place)
                (breached_at if name in attempt.found.breached else distances).append(point)
        for points, colour, text in (
            (distances, "0.4", f"{name}, not breached"),
            (breached_at, BREACHED, f"{name}, breached"),
        ):
            if points:
                across, rows = zip(*points, strict=True)
                axes.plot(across, rows, marker, color=colour, label=text)
    axes.axvline(0.0, color=BREACHED, linestyle="--")
    axes.set_xlabel("least distance of each run / mm")
    axes.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)


def _draw_learning(people: Sequence[Person], axes: "Axes") -> None:
    """Draw the score against the number of the attempt, for each trainee with several attempts."""
    for place, person in enumerate(people):
        if len(person.attempts) > 1:
            attempts = np.arange(1, len(person.attempts) + 1)
            colour, marker = _look(place)
            axes.plot(attempts, person.scores, f"{marker}-", color=colour, label=person.name)
    axes.set(xlabel="attempt", ylabel="score")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _folders(folder: Path) -> list[Path]:
    """Return the folders in a folder, sorted by name.

    Numbers in the names are compared as numbers.
    """
    if not folder.is_dir():
        raise InputError("folder", "exist", folder, "name the folder of the trainees")
    found = (each for each in folder.iterdir() if each.is_dir() and not each.name.startswith("."))
    return sorted(found, key=lambda each: natural_order(each.name))
