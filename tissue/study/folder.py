"""The folder of a study: its plan, a file a trial, and the tables of what it holds."""

import json
from collections.abc import Iterator
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from meshes.errors import InputError
from meshes.whole_file import whole_file
from tissue.statistics import TrialTable
from tissue.study.plan import Plan, TrialKey
from tissue.study.tasks import TASKS
from tissue.study.trial import Trial

__all__ = ["StudyFolder", "engine_version"]

FORMAT = 1
"""Version of a study's folder."""
PLAN = "study.json"
KEYS = {"seed", "took_s", "rows"}


def engine_version() -> str:
    """Version of this library, by which trials may be put together."""
    try:
        return version("tissue-sim")
    except PackageNotFoundError:
        return "unknown"


class StudyFolder:
    """A study on disk.

    Every trial is a file of its own, written at once and whole, so that a study can be stopped at any moment; a file
    that is cut short all the same counts as missing.

    Parameters
    ----------
    path
        Where it lies.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def begin(self, plan: Plan) -> list[str]:
        """Make the folder, or go on with one whose trials are all in the plan; sentences on what was found amiss.

        Raises
        ------
        InputError
            If it holds another study, one of another version, or other files.
        """
        if (self.path / PLAN).is_file():
            held = self.plan()
            if not plan.holds(held):
                names = [name for name in asdict(plan) if getattr(held, name) != getattr(plan, name)]
                told = ", ".join(f"{name} {_told(getattr(held, name))}" for name in names)
                raise InputError(
                    f"out must hold a part of the same study, got one with {told} in {self.path}: choose another folder"
                )
        elif self.path.is_dir() and any(self.path.iterdir()):
            raise InputError(f"out must be empty or hold this study, got other files in {self.path}: choose another")
        (self.path / "trials").mkdir(parents=True, exist_ok=True)
        _write(self.path / PLAN, {"format": FORMAT, "version": engine_version()} | asdict(plan))
        broken = [key for key in plan.all_trials() if self._file(key).exists() and self.read(key) is None]
        for key in broken:
            self._file(key).unlink()
        return [f"trial {key.name} was cut short and is run again" for key in broken]

    def plan(self) -> Plan:
        """The plan.

        Raises
        ------
        InputError
            If there is none, or it is of another version.
        """
        path = self.path / PLAN
        try:
            held: dict[str, Any] = json.loads(path.read_text("utf-8"))
            made = (held.pop("format"), held.pop("version", "unknown"))
            if made != (FORMAT, engine_version()):
                raise InputError(
                    f"study must be of format {FORMAT} and version {engine_version()}, got {made[0]} and {made[1]} in "
                    f"{self.path}: run it in a new folder"
                )
            kept: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in held.items()}
            return Plan(**kept)
        except InputError:
            raise
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            raise InputError(
                f"study must be a folder that `tissue study run` wrote, got {self.path}: choose another"
            ) from None

    def has(self, key: TrialKey) -> bool:
        """Whether a trial is there."""
        return self._file(key).is_file()

    def read(self, key: TrialKey) -> dict[str, Any] | None:
        """A trial, or None where its file is missing or cut short."""
        try:
            held = json.loads(self._file(key).read_text("utf-8"))
        except (OSError, ValueError):
            return None
        return held if isinstance(held, dict) and held.keys() >= KEYS else None

    def write(self, trial: Trial) -> None:
        """Keep a trial."""
        content = {"seed": trial.seed, "took_s": round(trial.took_s, 3), "rows": list(trial.rows)}
        _write(self._file(trial.key), content)

    def forget_failures(self, plan: Plan) -> None:
        """Take away the trials of a plan in which a method failed."""
        for key in plan.all_trials():
            held = self.read(key)
            if held is not None and any("failure" in row for row in held["rows"]):
                self._file(key).unlink()

    def trials(self, *, variant: str | None = "") -> Iterator[tuple[TrialKey, dict[str, Any]]]:
        """Trials that are there, in the plan's order: of the study itself, of one variant, or with None of all."""
        for key in self.plan().all_trials():
            if variant in (None, key.variant) and (held := self.read(key)) is not None:
                yield key, held

    def table(self, *tasks: str) -> TrialTable:
        """Table of the study's own trials of some tasks.

        Raises
        ------
        InputError
            If there is none.
        """
        rows = []
        for key, held in self.trials():
            if key.task in tasks:
                place = {"task": key.task, "group": key.group, "user": f"{key.user:02d}", "trial": key.trial}
                rows += [place | {"seed": held["seed"]} | row for row in held["rows"]]
        if not rows:
            raise InputError(f"study must hold trials of {', '.join(tasks)}, got none in {self.path}: run it first")
        return TrialTable.from_rows(rows)

    def write_tables(self) -> list[Path]:
        """Write ``trials.csv`` with the tasks that are compared, and a file for each case study."""
        families: dict[str, list[str]] = {}
        there = {key.task for key, _ in self.trials()}
        for task in (each for each in self.plan().tasks if each in there):
            families.setdefault(task if TASKS[task].case else "trials", []).append(task)
        written = []
        for name, tasks in families.items():
            path = self.path / f"{name}.csv"
            self.table(*tasks).write_csv(path)
            written.append(path)
        return written

    def _file(self, key: TrialKey) -> Path:
        return self.path / "trials" / f"{key.name}.json"


def _told(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _write(path: Path, content: dict[str, Any]) -> None:
    """Write JSON so that a reader never sees half of it."""
    with whole_file(path) as beside:
        beside.write_text(json.dumps(content, indent=1), "utf-8")
