"""What a study does: tasks, groups of people, methods, and the seed of every trial."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from meshes.base.errors import InputError, require_range
from tissue.evaluation.study.tasks import METHODS, TASKS, VARIANTS
from tissue.scene.registry import GROUPS

__all__ = ["LATENCY_MS", "REFERENCE", "USERS", "Plan", "TrialKey"]

USERS = 10
"""People in a group; trials go round among them."""
LATENCY_MS = 4
"""Latency of the loop in every trial, the paper's mean being 4.3 ms."""
REFERENCE = "reference"
"""Variant in which the reference itself is held against the finest model."""
SENSITIVITY_TRIALS, REFERENCE_TRIALS = 6, 2
"""Trials a task for each variant; reference trials take longest, so there are few."""
MIDDLE = "intermediate"
"""Group of the variants."""


@dataclass(frozen=True, order=True)
class TrialKey:
    """One trial; it is run once under each method.

    Attributes
    ----------
    task, group
        What is done, and by whom.
    trial
        Number within both.
    variant
        What is varied in it; empty in the study itself.
    """

    task: str
    group: str
    trial: int
    variant: str = ""

    @property
    def user(self) -> int:
        """Number of the person within the group."""
        return self.trial % USERS

    @property
    def name(self) -> str:
        """Name of its file, and how it is called for alone."""
        return f"{self.task}-{self.group}-{self.trial:04d}" + f"-{self.variant}" * bool(self.variant)

    @classmethod
    def named(cls, name: str) -> "TrialKey":
        """The trial of a name such as ``T1-novice-0007``.

        Raises
        ------
        InputError
            If there can be no such trial.
        """
        task, group, number, variant, *_ = *name.split("-", 3), "", "", ""
        known = task in TASKS and group in GROUPS and variant in ("", REFERENCE, *VARIANTS)
        if not (known and number.isdecimal()):
            raise InputError(f"trial must be named as its file is, got {name}: use for example T1-novice-0007")
        return cls(task, group, int(number), variant)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A study.

    Attributes
    ----------
    seed
        Seed of everything; a trial's own follows from it and the trial's key alone.
    trials
        Trials for each task and group.
    tasks, groups, methods
        What is compared.
    sensitivity
        Whether a few trials are repeated with one parameter changed, and against the finest model.

    Raises
    ------
    InputError
        If there is no trial, or a name is unknown.
    """

    seed: int = 0
    trials: int = 100
    tasks: tuple[str, ...] = tuple(TASKS)
    groups: tuple[str, ...] = GROUPS
    methods: tuple[str, ...] = tuple(METHODS)
    sensitivity: bool = True

    def __post_init__(self) -> None:
        require_range("trials", self.trials, 1, 10_000, "use 100")
        require_range("seed", self.seed, 0, 2**63 - 1, "use 0")
        for name, known in (("tasks", tuple(TASKS)), ("groups", GROUPS), ("methods", tuple(METHODS))):
            chosen = getattr(self, name)
            strange = [each for each in chosen if each not in known]
            if strange or not chosen or len(set(chosen)) < len(chosen):
                got = strange[0] if strange else ",".join(chosen) or "nothing"
                raise InputError(f"{name} must each be one of {', '.join(known)}, got {got}: choose among these, once")

    @property
    def compared(self) -> tuple[str, ...]:
        """Its tasks but for the case studies."""
        return tuple(task for task in self.tasks if not TASKS[task].case)

    def all_trials(self) -> Iterator[TrialKey]:
        """All trials, groups and tasks in turn, so that a study that is stopped is balanced."""
        for trial in range(self.trials):
            for task in self.tasks:
                for group in self.groups:
                    if trial < TASKS[task].most:
                        yield TrialKey(task, group, trial)
        if not self.sensitivity:
            return
        for variant, most in {REFERENCE: REFERENCE_TRIALS, **dict.fromkeys(VARIANTS, SENSITIVITY_TRIALS)}.items():
            for trial in range(min(self.trials, most)):
                for task in self.compared:
                    yield TrialKey(task, MIDDLE, trial, variant)

    def holds(self, other: "Plan") -> bool:
        """Whether every trial of another plan is one of this, so that its folder can be gone on with."""
        same = self.seed == other.seed and self.methods == other.methods
        wider = set(other.tasks) <= set(self.tasks) and set(other.groups) <= set(self.groups)
        return same and wider and other.trials <= self.trials and other.sensitivity <= self.sensitivity

    def rng(self, key: TrialKey) -> np.random.Generator:
        """Generator of a trial; a variant has that of the trial it varies."""
        place = (list(TASKS).index(key.task), GROUPS.index(key.group), key.trial)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=place))

    def person(self, key: TrialKey) -> np.random.Generator:
        """Generator of the person whose trial it is, the same in every task."""
        place = (1000, GROUPS.index(key.group), key.user)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=place))
