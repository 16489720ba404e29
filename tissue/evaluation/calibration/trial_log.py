"""Log of a session's trials, one line per trial.

A line is on disk before the next question is asked. The session is restored from the log.
"""

import json
import os
from dataclasses import asdict
from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.file_limits import require_regular
from meshes.base.text_tables import read_json
from meshes.base.whole_file import package_version, require_version
from tissue.evaluation.calibration.session import Comparison, Magnitude, Plan, Session
from tissue.perception.adaptive import ThresholdPrior

__all__ = ["TrialLog", "log_path", "read_log"]

FORMAT = "tissue trials"
VERSION = 1


def log_path(out: Path) -> Path:
    """Return the path of the trial log next to an observer's file: observer.json has
    observer.trials.jsonl.
    """
    return out.with_name(out.stem + ".trials.jsonl")


class TrialLog:
    """Writer that appends trials to a file and syncs each one to disk before it returns.

    Parameters
    ----------
    path
        Log file. An existing file is continued if it belongs to this observer and this plan.
    observer
        Observer who answers, as given to the command.
    plan
        Plan of the session.

    Attributes
    ----------
    session
        Session with all trials that the file held.
    mended
        True if the file ended within a line, for example after a loss of power. This one trial is
        asked again.

    Raises
    ------
    InputError
        If the file is of another origin, observer or plan, or holds a line that is not a trial. The
        file is left unchanged.
    """

    def __init__(self, path: Path, observer: str, plan: Plan) -> None:
        about = {
            "format": FORMAT,
            "version": VERSION,
            "tissue": package_version(),
            "observer": observer,
        }
        head = json.dumps(about | {"plan": asdict(plan)}) + "\n"
        self.path = require_regular(path)
        self.mended = False
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            text = path.read_bytes() if path.exists() else b""
            if head.encode().startswith(text):
                self.mended = 0 < len(text) < len(head)
                self.session = Session(plan)
                kept = head.encode()
            else:
                who, self.session = read_log(path)
                if who != observer or self.session.plan != plan:
                    difference = _difference(who, self.session.plan, observer, plan)
                    raise InputError(
                        "out",
                        "go on with the session it began",
                        f"{difference} in {path}",
                        "use the same again, another --out, or --overwrite",
                    )
                kept = text[: text.rfind(b"\n") + 1]
                self.mended = kept != text
            if kept != text:
                with path.open("r+b" if path.exists() else "xb") as file:
                    file.write(kept)
                    file.truncate()
                    os.fsync(file.fileno())
            self._file = path.open("ab")
        except OSError as problem:
            raise InputError(
                "out",
                "be a file that can be written",
                f"{path} ({problem.strerror})",
                "choose another folder",
            ) from problem

    def take(self, asked: Comparison | Magnitude, answer: float) -> None:
        """Take an answer into the session and bring it to disk."""
        trial = self.session.trial
        self.session.take(asked, answer)
        entry = {
            "trial": trial,
            "ask": type(asked).__name__.lower(),
            **vars(asked),
            "answer": answer,
        }
        self._file.write(json.dumps(entry).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_log(path: Path) -> tuple[str, Session]:
    """Read a log; return its observer and the session without an incomplete last line.

    Raises
    ------
    InputError
        If the file is not the log of a session, or a line of it is not a trial of the session. The
        message names the line.
    """
    require_regular(path)
    try:
        text = path.read_bytes().decode()
    except (OSError, UnicodeDecodeError) as problem:
        found = str(problem.strerror) if isinstance(problem, OSError) else "other data"
        raise InputError(
            "log", "be a file of trials", f"{found} in {path}", "give one that tissue wrote"
        ) from problem
    lines = text[: text.rfind("\n") + 1].splitlines()
    try:
        head = read_json(lines[0])
        known = head["format"] == FORMAT
    except (IndexError, ValueError, TypeError, KeyError):
        known = False
    if not known:
        raise InputError(
            "log", "be a file of trials", f"{path}, which is something else", "choose another --out"
        )
    require_version("log", head, VERSION, key="version", where=path, remedy="begin anew")
    try:
        plan = Plan(**(head["plan"] | {"prior": ThresholdPrior(**head["plan"]["prior"])}))
        who = str(head["observer"])
    except (KeyError, TypeError, InputError) as problem:
        raise InputError(
            "log", "begin with a plan", f"another first line in {path}", "begin anew"
        ) from problem
    session = Session(plan)
    for number, line in enumerate(lines[1:], start=2):
        try:
            asked, answer, trial = _entry(line)
            if trial != session.trial:
                raise InputError(f"trial must be {session.trial}, got {trial}")
            session.take(asked, answer)
        except (ValueError, KeyError, TypeError) as problem:
            wrong = problem if isinstance(problem, InputError) else "something else"
            raise InputError(
                "log",
                "hold one trial of its session a line",
                f"{wrong} in line {number} of {path}",
                "fix that line or choose another --out",
            ) from problem
    return who, session


def _entry(line: str) -> tuple[Comparison | Magnitude, float, int]:
    """Return a line's trial, answer and number."""
    entry = read_json(line)
    if not isinstance(entry, dict):
        raise ValueError(f"{line[:40]}")
    trial = entry.pop("trial")
    answer = entry.pop("answer")
    what = entry.pop("ask")
    if isinstance(answer, bool) or not isinstance(answer, int | float):
        raise InputError(f"answer must be a number, got {answer!r}")
    kinds = {"comparison": Comparison, "magnitude": Magnitude}
    return kinds[what](**entry), answer, trial


def _difference(who: str, held: Plan, observer: str, plan: Plan) -> str:
    """Return the difference between the session in a file and the requested one."""
    if who != observer:
        return f"observer {who} instead of {observer}"
    name = next(name for name in vars(plan) if getattr(held, name) != getattr(plan, name))
    return f"{name} {getattr(held, name)} instead of {getattr(plan, name)}"
