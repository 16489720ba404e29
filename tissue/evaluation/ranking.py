"""Ranking of trainees by the score of their runs against one reference, with learning curves."""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, counted
from meshes.base.text_tables import natural_order
from meshes.base.whole_file import whole_file
from tissue.evaluation.assessment import AssessedRun, Assessment, NoSharedContactError, assess
from tissue.evaluation.statistics.intervals import mean_interval
from tissue.evaluation.steadiness import Steadiness
from tissue.show.figures.figure import figure, save
from tissue.system.owned_folder import OwnedFolder

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
"""Smallest number of attempts for which the interval is computed from their spread."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
INCH_PER_ROW = 0.32
"""Height of the row of a trainee in the picture [inches]."""


@dataclass(frozen=True)
class Attempt:
    """Assessed run of a trainee, and its name."""

    name: str
    found: Assessment

    @property
    def steadiness(self) -> Steadiness:
        """Tremor and score. Only runs with a score are attempts."""
        assert self.found.steadiness is not None, self.name
        return self.found.steadiness


@dataclass(frozen=True)
class Person:
    """Trainee with all attempts, in their order."""

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
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mean score.

        It follows from the spread of the attempts (Student's t). For one or two attempts it
        follows from the interval of each attempt.
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
        """Change of the score from attempt to attempt, with its 95 % interval.

        The change is the slope of a straight line that is fitted to the scores. It is None for
        fewer than three attempts.
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
    """Trainees in the order of their mean score, the best first.

    `left_out` has a sentence for each run that is not ranked. A run that is not ranked has no
    score, or has no contact where the reference has contact.
    """

    scene: str
    people: tuple[Person, ...]
    left_out: tuple[str, ...] = ()


def is_run(folder: Path) -> bool:
    """Return whether a folder holds a run."""
    return (folder / "summary.json").is_file()


def rank(folder: Path, reference: AssessedRun, load: Callable[[Path], AssessedRun]) -> Ranking:
    """Assess the runs of trainees against a reference, and order the trainees by score.

    Parameters
    ----------
    folder
        Folder with a folder for each trainee. The folder of a trainee is a run, or contains the
        runs of all attempts. The names of the runs give their order: ``attempt2`` comes before
        ``attempt10``.
    reference
        Run with which all other runs are compared.
    load
        Function that reads the run of a folder.

    Raises
    ------
    InputError
        If a folder holds no run, a run has another task than the reference, or no run can be
        ranked.
    """
    people = []
    left_out = []
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
            except InputError as refusal:
                raise InputError(f"{run}: {refusal}") from refusal
            if found.steadiness is None:
                left_out.append(f"{run} has no score: {found.unscored}")
            else:
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
    people.sort(key=lambda person: -person.mean)
    return Ranking(str(reference.summary.get("scene")), tuple(people), tuple(left_out))


def ranking_lines(found: Ranking) -> list[str]:
    """Return the ranking in words."""
    people = counted(len(found.people), "trainee")
    runs = counted(sum(len(person.attempts) for person in found.people), "run")
    lines = [f"{found.scene}: {people}, {runs}; a novice has a score of 0, an expert 100"]
    for place, person in enumerate(found.people, 1):
        low, high = person.interval
        count = len(person.attempts)
        line = (
            f"{place}. {person.name}: {person.mean:.0f} (95 %: {low:.0f} to {high:.0f}), "
            f"{counted(count, 'attempt')}"
        )
        if (gain := person.gain) is not None:
            line += f", {gain[0]:+.1f} an attempt ({gain[1]:+.1f} to {gain[2]:+.1f})"
        lines.append(line)
    return lines + [f"left out: {each}" for each in found.left_out]


def write_ranking(found: Ranking, folder: Path, *, overwrite: bool) -> list[Path]:
    """Write ``ranking.csv``, a row for each run, and ``ranking.png``.

    Raises InputError if the folder is a file, or holds another ranking.
    """
    with OwnedFolder(folder, "ranking", FILES, overwrite=overwrite):
        with (
            whole_file(folder / FILES[0]) as temporary,
            temporary.open("w", encoding="utf-8", newline="") as file,
        ):
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            writer.writerows(_rows(found))
        _draw(found, folder / FILES[1])
    return [folder / name for name in FILES]


def _rows(found: Ranking) -> list[tuple[object, ...]]:
    """Return the values of `COLUMNS` for each run."""
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
        )
        for place, person in enumerate(found.people, 1)
        for attempt in person.attempts
    ]


def _draw(found: Ranking, path: Path) -> None:
    """Draw the scores with their intervals and, for several attempts, the learning curves."""
    people = found.people
    most = max(len(person.attempts) for person in people)
    # inches: a row for each trainee, and space for title and axis
    chart = figure(9.0 if most > 1 else 6.0, max(2.6, 1.3 + INCH_PER_ROW * len(people)))
    chart.set_layout_engine("constrained")
    panels = chart.subplots(1, 2 if most > 1 else 1, squeeze=False)[0]
    for place, person in enumerate(people):
        colour = COLOURS[place % len(COLOURS)]
        low, high = person.interval
        panels[0].plot([low, high], [place, place], color=colour, linewidth=2)
        panels[0].plot(person.mean, place, "o", color=colour)
        panels[0].plot(person.scores, [place] * len(person.scores), "|", color=colour)
        if most > 1:
            attempts = np.arange(1, len(person.attempts) + 1)
            panels[1].plot(attempts, person.scores, "o-", color=colour)
    for value, name in ((0.0, "a novice"), (100.0, "an expert")):
        panels[0].axvline(value, color="0.6", linestyle=":")
        panels[0].annotate(
            name, (value, 1.0), xycoords=("data", "axes fraction"), ha="center", va="bottom"
        )
    panels[0].set(xlabel="score", ylim=(len(people) - 0.4, -0.6))
    panels[0].set_yticks(range(len(people)), [person.name for person in people])
    panels[0].grid(axis="x", alpha=0.3)
    if most > 1:
        panels[1].set(xlabel="attempt", ylabel="score", xticks=range(1, most + 1))
        panels[1].grid(alpha=0.3)
    chart.suptitle(f"{found.scene}: steadiness of the hand, mean with 95 % interval", size=10)
    save(chart, path)


def _folders(folder: Path) -> list[Path]:
    """Return the folders in a folder, sorted by name.

    Numbers in the names are compared as numbers.
    """
    if not folder.is_dir():
        raise InputError("folder", "exist", folder, "name the folder of the trainees")
    found = (each for each in folder.iterdir() if each.is_dir() and not each.name.startswith("."))
    return sorted(found, key=lambda each: natural_order(each.name))
