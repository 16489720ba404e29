"""Calibration session of a person: trials, parameter estimates and trial log."""

import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from scipy.special import logit
from scipy.stats import binom

from meshes.base.errors import InputError, counted, enumerated, require_range
from meshes.base.file_limits import require_regular
from meshes.base.hints import suggests_arguments
from meshes.base.text_tables import read_json
from meshes.base.whole_file import package_version, require_version
from tissue.perception.adaptive import (
    EDGE_MASS,
    MAGNITUDE_FORCES_N,
    AdaptiveThreshold,
    MagnitudePosterior,
    ThresholdPrior,
    comparisons,
    fit_magnitudes,
)
from tissue.perception.laws import Weber
from tissue.perception.observer import REPORTED_N, Observer


@suggests_arguments
@dataclass(frozen=True, kw_only=True)
class Plan:
    """Plan of a calibration session, which is fixed before the first trial.

    Attributes
    ----------
    seed
        Seed that determines which interval has the larger force, and in which order forces are
        rated.
    trials
        Number of trials in which two intervals are compared.
    numbers
        Number of trials in which a force is rated with a number.
    force_limit_N
        Largest force of the device [N].
    prior
        Prior distribution of the threshold parameters.
    """

    seed: int = 0
    trials: int = 120
    numbers: int = 24
    force_limit_N: float = 3.3
    prior: ThresholdPrior = field(default_factory=ThresholdPrior)

    def __post_init__(self) -> None:
        require_range("seed", self.seed, 0, 2**32, "use a whole number")
        # more trials than anyone answers in a day: a typing error
        require_range("trials", self.trials, 0, 100_000, "use a value such as 120")
        # as for trials
        require_range("numbers", self.numbers, 0, 100_000, "use a value such as 24")
        require_range(
            "force_limit_N", self.force_limit_N, 0.5, 1000.0, "give the device's largest force"
        )
        counts = (self.seed, self.trials, self.numbers)
        if not all(isinstance(each, int) for each in counts):
            raise InputError(
                "plan",
                "have whole numbers as seed, trials and numbers",
                enumerated(counts),
                "write them without a decimal point",
            )
        if self.trials + self.numbers == 0:
            raise InputError(
                "trials and numbers", "not both be 0", "0 and 0", "use values such as 120 and 24"
            )


@dataclass(frozen=True)
class Comparison:
    """Trial that compares two forces in turn; the answer, 1 or 2, names the larger force."""

    base_N: float
    step_N: float
    greater: int

    @property
    def forces_N(self) -> tuple[float, float]:
        """Forces of the first and of the second interval [N]."""
        both = (self.base_N + self.step_N, self.base_N)
        return both if self.greater == 1 else both[::-1]


@dataclass(frozen=True)
class Magnitude:
    """Trial with one force, which the person rates with a number above 0."""

    force_N: float


@suggests_arguments
class Session:
    """State of a calibration session, with all answers so far.

    The state depends only on the plan and the answers.

    Attributes
    ----------
    plan
        Plan of the session.
    threshold
        Posterior distribution of the threshold parameters.
    asked
        Comparison trials that were answered, each with the answer.
    given
        Forces [N] that were rated, each with the number that the person gave.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.threshold = AdaptiveThreshold(
            plan.prior, comparisons(force_limit_N=plan.force_limit_N)
        )
        self.asked: list[tuple[Comparison, int]] = []
        self.given: list[tuple[float, float]] = []
        forces = np.array([force for force in MAGNITUDE_FORCES_N if force <= plan.force_limit_N])
        repeats = -(-plan.numbers // len(forces))
        order = np.random.default_rng([plan.seed, 1])
        self._forces = [
            float(force) for _ in range(repeats) for force in order.permutation(forces)
        ][: plan.numbers]

    @property
    def trial(self) -> int:
        """Number of answered trials."""
        return len(self.asked) + len(self.given)

    @property
    def complete(self) -> bool:
        """True if all trials of the plan are answered."""
        return self.trial == self.plan.trials + self.plan.numbers

    def ask(self) -> Comparison | Magnitude:
        """Return the next trial: first all comparisons, then all ratings with numbers."""
        if len(self.asked) == self.plan.trials:
            return Magnitude(self._forces[len(self.given)])
        index = int(self.threshold.propose()[0])
        # 0 distinguishes this stream from other users of the seed
        greater = int(np.random.default_rng([self.plan.seed, 0, self.trial]).integers(1, 3))
        return Comparison(
            float(self.threshold.base_N[index]), float(self.threshold.step_N[index]), greater
        )

    def take(self, asked: Comparison | Magnitude, answer: float) -> None:
        """Record the answer to a trial.

        Raises
        ------
        InputError
            If the answer is impossible, or the trial is not in this plan. The state of the session
            is then unchanged.
        """
        foreign = InputError("trial", "belong to the plan", asked, "use the log of this plan")
        if isinstance(asked, Magnitude):
            if not 0.0 < answer < np.inf:
                raise InputError(
                    "answer",
                    "be a number above 0",
                    f"{answer:g}",
                    "enter the strength of the force",
                )
            if self.complete or asked.force_N not in self._forces:
                raise foreign
            self.given.append((asked.force_N, float(answer)))
            return
        if answer not in (1, 2):
            raise InputError(
                "answer", "be 1 or 2", f"{answer:g}", "enter the number of the stronger force"
            )
        stimuli = (self.threshold.base_N == asked.base_N) & (self.threshold.step_N == asked.step_N)
        if not stimuli.any() or asked.greater not in (1, 2) or len(self.asked) == self.plan.trials:
            raise foreign
        self.threshold.answer(np.flatnonzero(stimuli)[:1], np.array([answer == asked.greater]))
        self.asked.append((asked, int(answer)))

    def magnitudes(self) -> MagnitudePosterior:
        """Return the posterior of Stevens' factor and exponent."""
        return fit_magnitudes(
            [force for force, _ in self.given], [number for _, number in self.given]
        )

    def observer(self, name: str) -> Observer:
        """Return an observer with parameter mean and covariance from the present posteriors."""
        weber, offset, lapse, _ = self.plan.prior.parameters()
        coordinates = np.array([np.log(weber), np.log(offset), logit(lapse)])
        masses = self.threshold.posterior[:, 0]
        threshold = coordinates @ masses
        numbers = self.magnitudes()
        log_sigma, log_sigma_variance = numbers.log_sigma()
        # blocks: two parameters of Stevens' law, three of the threshold, one of the scatter of
        # numbers
        covariance = np.zeros((6, 6))
        covariance[:2, :2] = numbers.covariance
        covariance[2:5, 2:5] = (coordinates * masses) @ coordinates.T - np.outer(
            threshold, threshold
        )
        covariance[5, 5] = log_sigma_variance
        mean = np.array([*numbers.mean, *threshold, log_sigma])
        return Observer(
            name=name, mean=mean, covariance=0.5 * (covariance + covariance.T), trials=self.trial
        )

    def lines(self) -> list[str]:
        """Return the present estimates as sentences.

        The numbers equal the numbers in the observer's file.
        """
        # the ends of the 95 % interval
        low, high = self.threshold.weber_quantiles(np.array([0.025, 0.975]))[:, 0]
        weber, _ = self.threshold.weber()
        law = Weber(kappa=float(weber[0]), offset=float(self.threshold.offset_N()[0]))
        notes = [
            f"Weber fraction {100 * law.kappa:.1f} % (95 % within {100 * low:.1f} to "
            f"{100 * high:.1f} %), "
            f"threshold at {REPORTED_N:g} N {law.threshold(REPORTED_N):.3f} N, "
            f"after {counted(len(self.asked), 'comparison')}"
        ]
        if self.given:
            # the median and the ends of the 95 % interval
            least, exponent, most = self.magnitudes().exponent_at([0.025, 0.5, 0.975])
            notes.append(
                f"Stevens' exponent {exponent:.2f} (95 % within {least:.2f} to {most:.2f}), "
                f"after {counted(len(self.given), 'number')}"
            )
        return notes

    def notes(self) -> list[str]:
        """Return warnings about parameters that the answers do not determine.

        The list is empty if there is no such parameter.
        """
        found = []
        count = len(self.asked)
        right = sum(answer == asked.greater for asked, answer in self.asked)
        # one-sided: right answers alone bound the threshold from above
        high = float(self.threshold.weber_quantiles(np.array([0.95]))[0, 0])
        # ten answers in a row are right by guessing once in a thousand sessions
        if count >= 10 and right == count:
            found.append(
                f"all {count} comparisons were right, which gives only an upper limit: the Weber "
                f"fraction lies below {100 * high:.1f} % with a probability of 95 %. Ask more "
                "trials"
            )
        # guessing gives this many right answers or more with a probability above 5 %
        if count >= 10 and binom.sf(right - 1, count, 0.5) > 0.05:
            found.append(
                f"{right} of {count} comparisons were right, no more than by guessing: the "
                "threshold lies above the compared differences, nothing was felt, or 1 and 2 were "
                "mixed up"
            )
        prior = self.plan.prior
        lower, upper = (float(mass[0]) for mass in self.threshold.edge_mass())
        for mass, bound, word, side in (
            (lower, prior.lowest, "below", "lowest"),
            (upper, prior.highest, "above", "highest"),
        ):
            if mass > EDGE_MASS:
                found.append(
                    f"{100 * mass:.0f} % of the posterior lies at the prior's {side} Weber "
                    f"fraction of {100 * bound:g} %, and the true fraction may lie {word} it. "
                    "Calibrate again with a wider prior"
                )
        # a slope needs two forces
        if len({force for force, _ in self.given}) < 2:
            found.append(
                "fewer than two forces were rated by numbers: Stevens' exponent has the value of "
                "the prior"
            )
        return found


FORMAT = "tissue trials"
VERSION = 1


def log_path(out: Path) -> Path:
    """Return the path of the trial log that belongs to an observer file.

    The log of ``observer.json`` is ``observer.trials.jsonl`` in the same folder.
    """
    return out.with_name(out.stem + ".trials.jsonl")


class TrialLog:
    """Writer that appends the answered trials of a session to a log file.

    Each trial is on disk before the call returns.

    Parameters
    ----------
    path
        Log file. If the file exists with the same observer and plan, new trials are appended.
    observer
        Name of the observer who answers.
    plan
        Plan of the session.

    Attributes
    ----------
    session
        Session with all trials of the file.
    repaired
        True if the file ended within a line, for example after a loss of power. The trial of the
        incomplete line is asked again.

    Raises
    ------
    InputError
        If the file is not a trial log, has another observer or plan, or contains a line that is not
        a trial. The file is left unchanged.
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
        self.repaired = False
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            text = path.read_bytes() if path.exists() else b""
            # the file is new, or ended within its first line
            if head.encode().startswith(text):
                self.repaired = 0 < len(text) < len(head)
                self.session = Session(plan)
                kept = head.encode()
            else:
                who, self.session = read_log(path)
                if who != observer or self.session.plan != plan:
                    raise InputError(
                        "out",
                        "contain a session of this observer and plan",
                        f"a session of the observer {who} with another plan in {path}"
                        if who == observer
                        else f"a session of the observer {who} in {path}",
                        "use the same observer and plan, choose another --out, or pass --overwrite",
                    )
                kept = text[: text.rfind(b"\n") + 1]
                self.repaired = kept != text
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
        """Add an answer to the session and write it to disk."""
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
    """Read a log; return the name of its observer, and its session.

    An incomplete last line is ignored.

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
        found = str(problem.strerror) if isinstance(problem, OSError) else "not a text file"
        raise InputError(
            "log",
            "be a file of trials",
            f"{path} ({found})",
            "give a log that `tissue calibrate` wrote",
        ) from problem
    lines = text[: text.rfind("\n") + 1].splitlines()
    try:
        head = read_json(lines[0])
        known = head["format"] == FORMAT
    except (IndexError, ValueError, TypeError, KeyError):
        known = False
    if not known:
        raise InputError(
            "log", "be a file of trials", f"{path} with other content", "choose another --out"
        )
    require_version("log", head, VERSION, key="version", where=path, remedy="start a new session")
    try:
        plan = Plan(**(head["plan"] | {"prior": ThresholdPrior(**head["plan"]["prior"])}))
        who = str(head["observer"])
    except (KeyError, TypeError, InputError) as problem:
        raise InputError(
            "log",
            "contain a plan in its first line",
            f"another first line in {path}",
            "start a new session",
        ) from problem
    session = Session(plan)
    for number, line in enumerate(lines[1:], start=2):
        try:
            asked, answer, trial = _entry(line)
            if trial != session.trial:
                raise InputError(f"trial must be {session.trial}, got {trial}")
            session.take(asked, answer)
        except (ValueError, KeyError, TypeError) as problem:
            wrong = problem if isinstance(problem, InputError) else "no trial"
            raise InputError(
                "log",
                "contain one trial of its session in each line",
                f"{path} with an error in line {number} ({wrong})",
                "fix that line or choose another --out",
            ) from problem
    return who, session


def _entry(line: str) -> tuple[Comparison | Magnitude, float, int]:
    """Return the trial, the answer and the number of the trial in a line of a log."""
    entry = read_json(line)
    if not isinstance(entry, dict):
        # a damaged line may be long
        raise ValueError(f"{line[:40]}")
    trial = entry.pop("trial")
    answer = entry.pop("answer")
    what = entry.pop("ask")
    if isinstance(answer, bool) or not isinstance(answer, int | float):
        raise InputError(f"answer must be a number, got {answer!r}")
    kinds = {"comparison": Comparison, "magnitude": Magnitude}
    return kinds[what](**entry), answer, trial
