"""Tasks, methods and plan of a study, and the seed of every trial."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.errors import InputError, require_range
from meshes.base.hints import suggests_arguments
from meshes.base.text_tables import unknown_name
from tissue.scene.registry import GROUPS, PREDICTORS

COMPARED = ("force_error", "ratio_error", "position_error_mm")
"""Metrics of hypothesis tests; each is tested alone, and all are tested together."""
DIRECTIONS = {
    "force_error": -1,
    "ratio_error": -1,
    "position_error_mm": -1,
    "acceleration_change_m_s2": -1,
    "time_s": -1,
}
"""Metrics of the composite index, each with its direction: -1 if a lower value is better."""
USERS = 10
"""Number of simulated people in a group.

The trials of a group are assigned to the people in turn.
"""
LATENCY_MS = 4
"""Latency of the haptic loop in every trial [ms]; the published study has a mean of 4.3 ms."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """Task of a study in a built-in scene.

    Attributes
    ----------
    title
        Description of the task.
    scene
        Name of the scene.
    changes
        New values of scene keys for the task, by dotted key. The changes shorten the run and switch
        off computations that do not affect the force.
    specimens
        For each specimen, the new values of scene keys, by dotted key. Each person gets all
        specimens, one after the other. The discrimination of forces is evaluated for the first two
        specimens.
    case
        True for a case study, which is reported separately and is not part of the hypothesis tests.
    wanted_mm
        Corners of the target path of the tool [mm]. Default: the path of the motion.
    most
        Largest number of trials for each expertise group.
    known_difference
        Description of a known difference from the corresponding task in the published study. If
        this text is not empty, results are not compared with the published study. The comparison is
        limited, because the published study states no geometry, tool or path.
    """

    title: str
    scene: str
    changes: Mapping[str, object]
    specimens: tuple[Mapping[str, object], ...]
    case: bool = False
    wanted_mm: tuple[tuple[float, float, float], ...] = ()
    most: int = 10_000
    known_difference: str = ""


def _scaled(
    nominal: Mapping[str, float], shares: Sequence[float]
) -> tuple[Mapping[str, object], ...]:
    """Return a specimen for each factor in `shares`: every nominal value times the factor."""
    return tuple({name: share * value for name, value in nominal.items()} for share in shares)


SLAB = {"organ.young_kPa": 5.0, "organ.young_end_kPa": 50.0}
WALL = {"anatomy.stiffness_kN_m": 10.0}
BONE = {"anatomy.density_kg_m3": 1800.0}
TOOTH = {"stress": None, "voxels.spacing_mm": 0.1, "voxels.margin_mm": 1.0, "motion.feed_mm_s": 2.0}
TASKS = {
    "T1": Task(
        title="palpation of tissue graded from 5 to 50 kPa",
        scene="palpation",
        changes={
            "organ.interval_ms": 0.0,
            "anatomy.nodule_diameter_mm": 0.0,
            "motion.points_mm": [[-12, 0, 2], [-12, 0, -4], [12, 0, -4], [12, 0, 2]],
            "motion.feed_mm_s": 18.0,
        },
        specimens=_scaled(SLAB, (0.7, 1.0, 1.3)),
    ),
    "T2": Task(
        title="abrupt contact with a wall",
        scene="wall",
        changes={"duration_s": None},
        specimens=_scaled(WALL, (0.7, 1.0, 1.3)),
        # No hand brings the ball into the wall, so the ball should stay on the surface.
        wanted_mm=((0.0, 0.0, 20.0), (0.0, 0.0, 0.0), (50.0, 0.0, 0.0)),
    ),
    "T3": Task(
        title="milling of cortical bone in steps of 0.1 mm",
        scene="milling",
        changes={
            "anatomy.size_mm": [14, 10, 4],
            "voxels.spacing_mm": 0.1,  # the force is 1 % off that of 0.05 mm voxels and shell
            "tool.shell_spacing_mm": 0.1,
            "device": "touch",
            # At a motion scale of 1, the force of 0.1 mm more depth moves the hand back by
            # millimetres. The hand then presses any bone with the same force. See
            # docs/guide/study.md.
            "coupling.motion_scale": 0.1,
            "coupling.force_scale": 0.04,
            "motion.points_mm": [
                [-2.5, -0.5, 0.3],
                [-2.5, -0.5, -0.1],
                [2.5, -0.5, -0.1],
                [2.5, -0.5, -0.2],
                [-2.5, -0.5, -0.2],
                [-2.5, -0.5, 0.3],
            ],
            "motion.feed_mm_s": 5.0,
            "duration_s": None,
        },
        specimens=_scaled(BONE, (0.6, 1.0, 1.1)),
        known_difference="the motion of the hand is scaled to a tenth at the burr, so that the "
        "hand feels the bone",
    ),
    "needle": Task(
        title="needle pushed through the capsule of a liver, to stop as it breaks",
        case=True,
        scene="needle",
        changes={
            "anatomy.interval_ms": 0.0,
            "anatomy.membrane_depths_mm": None,
            "motion.points_mm": [[0, 0, 0.05], [0, 0, -60]],  # where a push ends that nobody stops
            "device": "touch",
            "coupling.force_scale": 1.0,  # the force that the hand raises is the needle's
        },
        specimens=({},),
        known_difference="the paper measures the distance from a target depth, here the needle is "
        "stopped as the capsule breaks",
    ),
    "reaming": Task(
        title="reaming of a glenoid",
        case=True,
        scene="glenoid",
        changes={
            "voxels.spacing_mm": 0.2,
            "voxels.margin_mm": 1.0,
            "device": "touch",
            "coupling.force_scale": 0.03,
            # presses with some 40 N, 2 mm deep
            "motion.points_mm": [[0, 0, 0.3], [0, 0, -3.5], [0, 0, 1]],
            "motion.feed_mm_s": 3.0,
            "duration_s": None,
        },
        specimens=({},),
        # two for each person; 60 in all, where the paper has 50
        most=2 * USERS,
    ),
    "drilling": Task(
        title="drilling of a molar at 400,000 rpm, carious or sound",
        case=True,
        scene="caries",
        changes=TOOTH | {"motion.points_mm": [[0, 0, 0.3], [0, 0, -1.5]], "duration_s": None},
        specimens=({}, {"anatomy.caries_depth_mm": None, "anatomy.caries_diameter_mm": None}),
        known_difference="the paper compares textures at more than 10,000 rpm, here mean forces "
        "are compared at 400,000 rpm",
    ),
}
"""Tasks by name.

T1 and T2 have three specimens with 0.7, 1 and 1.3 times the usual stiffness. T3 has three specimens
with 0.6, 1 and 1.1 times the usual bone density. Reaming has at most 60 trials, two for each
person.
"""
METHODS: dict[str, Mapping[str, object]] = {
    "penalty": {"renderer": "penalty"},
    "energy": {"renderer": "passivity"},
    "koopman": {"renderer": "proxy", "prediction": "koopman"},
    "koopman-look-ahead": {"renderer": "proxy", "prediction": "koopman-look-ahead"},
    "koopman-online": {"renderer": "proxy", "prediction": "koopman-online"},
    "koopman-perception": {"renderer": "proxy", "prediction": "koopman"},
}
"""Settings of the built-in methods that compute the force, by name of the method.

The last method also scales the force for the perception of the person. The name of every other
predictor is a method too; see `method_settings`.
"""
PERSONAL = ("koopman-perception",)
"""Methods that scale the force for the perception of the individual person."""


def method_settings(method: str) -> Mapping[str, object]:
    """Return the scene settings of a method, by dotted key.

    `method` is a key of `METHODS`, or the name of a built-in or registered predictor. If `method`
    is the name of a predictor, the renderer is ``proxy``.

    Raises
    ------
    InputError
        If `method` is unknown.
    """
    if method in METHODS:
        return METHODS[method]
    if method in PREDICTORS:
        return {"renderer": "proxy", "prediction": method}
    raise unknown_name("methods", dict.fromkeys((*METHODS, *PREDICTORS)), method)


@dataclass(frozen=True, order=True)
class TrialKey:
    """Key of a trial.

    A trial is run once with each method.

    Attributes
    ----------
    task, group
        Task and expertise group.
    trial
        Number of the trial within its task and group.
    """

    task: str
    group: str
    trial: int

    @property
    def user(self) -> int:
        """Number of the person within the group."""
        return self.trial % USERS

    @property
    def specimen(self) -> int:
        """Index of the specimen in `Task.specimens`.

        Every person gets all specimens in turn, and different people begin with different
        specimens.
        """
        return (self.trial // USERS + self.user) % len(TASKS[self.task].specimens)

    @property
    def name(self) -> str:
        """Name of the trial's file.

        The method `named` converts the name back to a key.
        """
        return f"{self.task}-{self.group}-{self.trial:04d}"

    @classmethod
    def named(cls, name: str) -> "TrialKey":
        """Return the key of the trial with a name such as ``T1-novice-0007``.

        Raises
        ------
        InputError
            If no trial can have this name.
        """
        # empty texts stand for missing parts, which are refused below
        task, group, number, *_ = *name.split("-", 2), "", ""
        if task not in TASKS or group not in GROUPS or not number.isdecimal():
            raise InputError(
                "trial", "be the name of a trial file", name, "use for example T1-novice-0007"
            )
        return cls(task, group, int(number))


@suggests_arguments
@dataclass(frozen=True, kw_only=True)
class Plan:
    """Plan of a study.

    Attributes
    ----------
    seed
        Seed of the study. The seed of a trial depends only on this seed and on the key of the
        trial.
    trials
        Number of trials for each task and group.
    tasks, groups
        Tasks and expertise groups of the study.
    methods
        Compared methods: keys of `METHODS`, or names of predictors. In a trial, all methods use the
        same coupling stiffness; the coupling must be stable with each method.

    Raises
    ------
    InputError
        If a number is out of range, or a name is unknown or given twice.
    """

    seed: int = 0
    trials: int = 100
    tasks: tuple[str, ...] = tuple(TASKS)
    groups: tuple[str, ...] = GROUPS
    methods: tuple[str, ...] = tuple(METHODS)

    def __post_init__(self) -> None:
        # more than a hundred times the default is a typing error
        require_range("trials", self.trials, 1, 10_000, "use a value such as 100")
        require_range("seed", self.seed, 0, 2**63 - 1, "use a value such as 0")
        for method in self.methods:
            method_settings(method)
        for name, known in (
            ("tasks", tuple(TASKS)),
            ("groups", GROUPS),
            ("methods", self.methods or tuple(METHODS)),
        ):
            chosen = getattr(self, name)
            strange = [each for each in chosen if each not in known]
            if strange or not chosen or len(set(chosen)) < len(chosen):
                got = strange[0] if strange else ",".join(chosen) or "nothing"
                raise InputError(
                    name,
                    f"each be one of {', '.join(known)}",
                    got,
                    "choose one or more of these, without repetition",
                )

    @property
    def compared(self) -> tuple[str, ...]:
        """Tasks of the plan that are not case studies."""
        return tuple(task for task in self.tasks if not TASKS[task].case)

    def all_trials(self) -> Iterator[TrialKey]:
        """Yield the keys of all trials.

        Groups and tasks alternate. The trials of a study that is stopped early are therefore
        balanced.
        """
        for trial in range(self.trials):
            for task in self.tasks:
                for group in self.groups:
                    if trial < TASKS[task].most:
                        yield TrialKey(task, group, trial)

    def holds(self, other: "Plan") -> bool:
        """Return whether this plan contains all trials of another plan.

        If true, a study with the other plan can be continued with this plan.
        """
        same = self.seed == other.seed and self.methods == other.methods
        wider = set(other.tasks) <= set(self.tasks) and set(other.groups) <= set(self.groups)
        return same and wider and other.trials <= self.trials

    def rng(self, key: TrialKey) -> np.random.Generator:
        """Return the random generator of a trial."""
        place = (list(TASKS).index(key.task), GROUPS.index(key.group), key.trial)
        return seeded(self.seed, *place)

    def person(self, key: TrialKey) -> np.random.Generator:
        """Return the random generator from which the person of a trial is drawn.

        The same person gets the same generator, with the same state, in every task.
        """
        # 1000 separates people from the streams of trials, which begin with the index of a task
        return seeded(self.seed, 1000, GROUPS.index(key.group), key.user)


def seeded(seed: int, *place: int) -> np.random.Generator:
    """Return a random generator for a seed and some integers.

    Generators for different integers are independent.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=place))
