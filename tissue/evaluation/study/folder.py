"""Folder of a study: the plan, a file for each trial, and tables of all trials."""

import gc
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import cache, partial
from pathlib import Path

from pydantic import TypeAdapter

from meshes.base.errors import InputError, enumerated, require_range
from meshes.base.file_limits import require_regular
from meshes.base.hints import suggests_arguments
from meshes.base.progress import Progress, silent
from meshes.base.text_tables import read_json
from meshes.base.whole_file import claim, package_version, require_version, write_text
from tissue.evaluation.charts.settings import code_sha256
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.duration import cost, expected_text
from tissue.evaluation.study.plan import TASKS, Plan, TrialKey
from tissue.evaluation.study.registration import (
    PLAN_FILE,
    Registration,
    content_sha256,
    notes_before,
    register,
    registered,
    require_unchanged,
)
from tissue.evaluation.study.trial import Row, Trial, error_sentence, run_trial, trial_seed
from tissue.system.owned_folder import LOCK, MARKER, OwnedFolder, require_listed
from tissue.system.workers import finished

FORMAT = 2
"""Version of the format of a study folder."""
PLAN = "study.json"
KIND = "study"
"""Kind of output that the marker file of the folder names."""
TABLES = ("trials.csv", *(f"{name}.csv" for name, task in TASKS.items() if task.case))


READ_TRIAL = TypeAdapter(Trial)


@suggests_arguments
class StudyFolder:
    """Study on disk.

    Every trial has its own file, which is written at once after the trial. A study can therefore be
    stopped at any moment and continued later. A truncated file counts as missing.

    Parameters
    ----------
    path
        Folder of the study.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def begin(self, plan: Plan) -> list[str]:
        """Create the folder, or prepare to continue the study in it; return warnings.

        If the folder contains a study, the new plan must contain all trials of the plan in the
        folder. The plan is registered by writing ``plan.toml`` and then ``study.json`` with the
        hash of the plan. If the plan has more trials than the earlier one, it is registered as a
        further plan, and the earlier one is kept.

        Raises
        ------
        InputError
            If the folder holds another study, a study of another version of tissue, an edited plan,
            or unrelated files.
        """
        there = self._require_same(plan)
        registers = not there or plan != self.plan()
        self.path.mkdir(parents=True, exist_ok=True)
        if registers:
            count = sum(1 for _ in (self.path / "trials").glob("*.json"))
            there = register(self.path, plan, there, trials=count)
            content = (
                {"format": FORMAT, "tissue": package_version()}
                | asdict(plan)
                | {"registrations": there}
            )
            _write(self.path / PLAN, content)
        (self.path / "trials").mkdir(exist_ok=True)
        broken = [key for key in plan.all_trials() if self.has(key) and self.read(key) is None]
        for key in broken:
            self._file(key).unlink()
        return [f"trial {key.name} was cut short and is run again" for key in broken]

    @contextmanager
    def held(self, plan: Plan) -> Iterator[list[str]]:
        """Lock the folder against other processes for the duration of a ``with`` block.

        The value of the ``with`` statement is the list of warnings from `begin`. Raises the same
        errors as `begin`.
        """
        self._require_same(plan)
        folder = OwnedFolder(self.path, KIND, ())
        try:
            self._require_same(plan)  # another process may have begun a study since
            folder.begin()
            # listed now, since a report writes them while another process holds the folder
            for name in TABLES:
                claim(self.path / name)
            yield self.begin(plan)
        finally:
            folder.release()

    def _require_same(self, plan: Plan) -> list[Registration]:
        """Check that the folder is empty or contains this study; return the registered plans."""
        if (self.path / PLAN).is_file():
            held = self.plan()
            if not plan.holds(held):
                values = {
                    name: value
                    for name, value in asdict(held).items()
                    if value != getattr(plan, name)
                }
                other = ", ".join(
                    f"{name} = {enumerated(value) if value and isinstance(value, tuple) else value}"
                    for name, value in values.items()
                )
                raise InputError(
                    "out",
                    "contain trials of the same study",
                    f"a study with {other} in {self.path}",
                    "choose another folder",
                )
            there = self.registrations()
            require_unchanged(self.path, there, plan)
            return there
        # the marker, the lock and a registered plan may be there before the first trial
        if self.path.is_dir() and any(
            each.name not in (LOCK, MARKER, PLAN_FILE) for each in self.path.iterdir()
        ):
            raise InputError(
                "out",
                "be empty or contain this study",
                f"other files in {self.path}",
                "choose another folder",
            )
        return []

    def plan(self) -> Plan:
        """Return the plan of the study.

        Raises
        ------
        InputError
            If the folder contains no plan, or if the plan is from another version of tissue.
        """
        return self._begun()[0]

    def registrations(self) -> list[Registration]:
        """Return the registered plans, the newest last.

        Raises InputError if the folder contains no plan, or if the plan is from another version of
        tissue.
        """
        return self._begun()[1]

    def _begun(self) -> tuple[Plan, list[Registration]]:
        """Return the plan of the study and all registered plans."""
        path = require_regular(self.path / PLAN)
        try:
            held = read_json(path.read_text("utf-8"))
            require_version(
                "study", held, FORMAT, where=path, remedy="run the study in a new folder"
            )
            made = held.get("tissue", "unknown")
            if made != package_version():
                raise InputError(
                    "study",
                    f"be recorded with tissue {package_version()}",
                    # a damaged file may hold any text
                    f"tissue {str(made)[:40]} in {path}",
                    "run the study in a new folder: trials of two versions are not combined",
                )
            fields = {name: tuple(held[name]) for name in ("tasks", "groups", "methods")}
            plan = Plan(seed=held["seed"], trials=held["trials"], **fields)
            return plan, registered(held)
        except InputError:
            raise
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            raise InputError(
                "study",
                "be a folder that `tissue study run` wrote",
                self.path,
                "choose another folder",
            ) from None

    def has(self, key: TrialKey) -> bool:
        """Return whether the folder has the file of a trial."""
        return self._file(key).is_file()

    def read(self, key: TrialKey) -> Trial | None:
        """Return a trial, or None if its file is missing or truncated."""
        try:
            held = dict(read_json(require_regular(self._file(key)).read_text("utf-8")))
            stated = held.pop("sha256", None)
            whole = stated in (None, content_sha256(held))
            trial = READ_TRIAL.validate_python(held | {"key": key, "whole": whole})
        except (OSError, ValueError, TypeError, RecursionError):
            return None
        return trial if all(map(_is_row, trial.rows)) else None

    def write(self, trial: Trial) -> None:
        """Write a trial to its file."""
        there = self.registrations()
        content = {
            "seed": trial.seed,
            # to 1 ms, far below what a trial takes
            "took_s": round(trial.took_s, 3),
            "plan_sha256": there[-1]["sha256"] if there else "",
            "code_sha256": code_sha256(),
            "rows": trial.rows,
        }
        _write(self._file(trial.key), content | {"sha256": content_sha256(content)})

    def forget_failures(self) -> None:
        """Delete the files of trials in which a method failed."""
        for trial in self.trials():
            if trial.failed:
                self._file(trial.key).unlink()

    def trials(self) -> Iterator[Trial]:
        """Yield the trials that have a complete file, in the order of the plan."""
        for key in self.plan().all_trials():
            if (trial := self.read(key)) is not None:
                yield trial

    def table(self, *tasks: str) -> TrialTable:
        """Return the table of the trials of some tasks.

        Raises
        ------
        InputError
            If there is no trial of these tasks.
        """
        rows = [
            {
                "task": key.task,
                "group": key.group,
                "user": f"{key.user:02d}",
                "trial": key.trial,
                "seed": trial.seed,
            }
            | row
            for trial in self.trials()
            for row in trial.rows
            if (key := trial.key).task in tasks
        ]
        if not rows:
            raise InputError(
                "study",
                f"contain trials of {enumerated(tasks, 'or')}",
                f"none in {self.path}",
                "run the study first",
            )
        return TrialTable.from_rows(rows)

    def write_tables(self) -> None:
        """Write ``trials.csv``, and a separate table for each case study."""
        families: dict[str, list[str]] = {}
        there = {trial.key.task for trial in self.trials()}
        for task in (each for each in self.plan().tasks if each in there):
            families.setdefault(task if TASKS[task].case else "trials", []).append(task)
        for name, tasks in families.items():
            require_listed(self.path, KIND, f"{name}.csv")
            self.table(*tasks).write_csv(self.path / f"{name}.csv")

    def _file(self, key: TrialKey) -> Path:
        return self.path / "trials" / f"{key.name}.json"


def _is_row(row: Row) -> bool:
    """Return whether a row consists of a method's name and either numbers or a failure."""
    return "method" in row and all(
        isinstance(value, str) == (name in ("method", "failure")) for name, value in row.items()
    )


def _write(path: Path, content: Mapping[str, object]) -> None:
    """Write a JSON file atomically, so that other processes never read an incomplete file."""
    write_text(path, json.dumps(content, indent=1))


def run_study(
    plan: Plan,
    out: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    retry: bool = False,
    report: Progress = silent,
) -> StudyFolder:
    """Run the missing trials of a plan, and write the tables of all trials.

    The tables are sorted, so they do not depend on the number of workers or on interruptions. If a
    worker process is lost, it is replaced and its trials are run again. A trial that crashes its
    worker repeatedly is recorded as failed.

    Parameters
    ----------
    plan
        Plan of the study.
    out
        Folder of the study. If the folder contains a part of the study, only the missing trials are
        run.
    workers
        Number of worker processes. Default: one per core. If a scheduler is given, this number
        merely limits how many trials are submitted at the same time.
    scheduler
        Address of a Dask scheduler that runs the trials, ``tcp://HOST:PORT`` or
        ``tls://HOST:PORT``. Default: processes on this machine.
    retry
        Run failed trials again.
    report
        Called with the progress and with problems.

    Raises
    ------
    InputError
        If the folder contains another study, the scheduler does not answer, or workers are lost
        again and again.
    """
    # more processes than any machine has cores: a typing error
    count = int(
        require_range(
            "workers",
            (os.cpu_count() or 1) if workers is None else workers,
            1,
            4096,
            "use one for each core",
        )
    )
    folder = StudyFolder(out)
    with folder.held(plan) as sentences:
        if retry:
            folder.forget_failures()
        missing = [key for key in plan.all_trials() if not folder.has(key)]
        share = _done_share(plan, missing)
        for sentence in sentences:
            report(sentence, share)
        # a scheduler's workers are other machines
        if missing and scheduler is None and report is not silent:
            report(expected_text(plan, missing, workers=count), share)
        for note in notes_before(plan) if missing else ():
            report(note, share)
        _run_trials(plan, missing, folder, count, scheduler, report)
        folder.write_tables()
    return folder


def _done_share(plan: Plan, missing: Iterable[TrialKey]) -> float:
    """Return the fraction of a study's work that is completed.

    Trials of an earlier, interrupted run count as completed.
    """
    return 1.0 - cost(plan, missing) / cost(plan, plan.all_trials())


def _run_trials(
    plan: Plan,
    missing: Sequence[TrialKey],
    folder: StudyFolder,
    count: int,
    scheduler: str | None,
    report: Progress,
) -> None:
    """Run the missing trials of a plan, and write each trial when it is finished."""
    total = len(list(plan.all_trials()))
    waiting = dict.fromkeys(missing)

    def report_share(doing: str) -> None:
        report(doing, _done_share(plan, waiting))

    work = partial(_in_worker, plan)
    for trials in finished(work, missing, workers=count, scheduler=scheduler, report=report_share):
        for key, found in trials:
            if isinstance(found, Exception):
                found = _failed(plan, key, error_sentence(found))
            folder.write(found)
            del waiting[key]
        report_share(f"trial {total - len(waiting)} of {total}")


def _failed(plan: Plan, key: TrialKey, failure: str) -> Trial:
    """Return a trial in which every method failed."""
    rows: list[Row] = [{"method": method, "failure": failure} for method in plan.methods]
    return Trial(key, trial_seed(plan, key), tuple(rows), 0.0)


def _in_worker(plan: Plan, key: TrialKey) -> Trial:
    """Run a trial in a worker process."""
    trial = run_trial(plan, key)
    _keep_what_stays()
    return trial


@cache
def _keep_what_stays() -> None:
    """Exclude all present objects, such as modules, from garbage collection.

    The objects are needed until the process ends.
    """
    gc.collect()
    gc.freeze()
