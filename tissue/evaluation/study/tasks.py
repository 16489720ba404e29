"""What is done in a study: three tasks, three case studies, and what is varied to see how much hangs on it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

__all__ = ["METHODS", "PERSONAL", "TASKS", "VARIANTS", "Task", "Variant"]


@dataclass(frozen=True, kw_only=True)
class Task:
    """A task on a built-in scene.

    Attributes
    ----------
    title
        What is done.
    scene
        Name of the scene.
    changes
        What is changed in it, by dotted key: force alone, and short enough for thousands of trials.
    specimens
        What is met, one in turn by chance; the first two are to be discriminated.
    extremes
        Softer and harder than any specimen, for the sensitivity; none for a case study.
    wanted_mm
        Where the tool should go, corner by corner [mm]; the motion's own path where it is left out.
    most
        Trials for each group at most.
    """

    title: str
    scene: str
    changes: Mapping[str, object]
    specimens: tuple[Mapping[str, object], ...]
    extremes: tuple[Mapping[str, object], ...] = ()
    wanted_mm: tuple[tuple[float, float, float], ...] = ()
    most: int = 10_000

    @property
    def case(self) -> bool:
        """Whether it is a case study, with a table of its own, and not one of the tasks that are compared."""
        return not self.extremes


def _scaled(nominal: Mapping[str, float], shares: Sequence[float]) -> tuple[Mapping[str, object], ...]:
    """Specimens with numbers scaled by shares."""
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
        extremes=_scaled(SLAB, (0.5, 2.0)),
    ),
    "T2": Task(
        title="abrupt contact with a wall",
        scene="wall",
        changes={"duration_s": None},
        specimens=_scaled(WALL, (0.7, 1.0, 1.3)),
        extremes=_scaled(WALL, (0.5, 2.0)),
        # No hand brings the ball into the wall, so that it should stay on it.
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
            "coupling.force_scale": 0.04,  # the one chosen for a path follows its depth, which is the hand's aim here
            # The hand aims as far below the bone, and before the teeth's pull, as its grip gives way to 10 to 15 N.
            "motion.points_mm": [
                [-3, -0.5, 1],
                [-3, -0.5, -1.4],
                [3, -0.5, -1.4],
                [3, -0.5, 3],
                [-3, -0.5, 3],
                [-3, -0.5, -1.9],
                [3, -0.5, -1.9],
                [3, -0.5, 3],
            ],
            "motion.feed_mm_s": 10.0,
            "duration_s": None,
        },
        specimens=_scaled(BONE, (0.9, 1.0, 1.1)),
        extremes=_scaled(BONE, (0.8, 1.1)),
        wanted_mm=(
            (-3, 0, 1),
            (-3, 0, -0.1),
            (3, 0, -0.1),
            (3, 0, 3),
            (-3, 0, 3),
            (-3, 0, -0.2),
            (3, 0, -0.2),
            (3, 0, 3),
        ),
    ),
    "needle": Task(
        title="needle pushed through the capsule of a liver, to stop as it breaks",
        scene="needle",
        changes={
            "anatomy.interval_ms": 0.0,
            "anatomy.membrane_depths_mm": None,
            "motion.points_mm": [[0, 0, 0.05], [0, 0, -60]],  # where a push ends that nobody stops
            "device": "touch",
            "coupling.force_scale": 1.0,  # the force that the hand raises is the needle's
        },
        specimens=({},),
    ),
    "reaming": Task(
        title="reaming of a glenoid",
        scene="glenoid",
        changes={
            "voxels.spacing_mm": 0.2,
            "voxels.margin_mm": 1.0,
            "device": "touch",
            "coupling.force_scale": 0.03,
            "motion.points_mm": [[0, 0, 0.3], [0, 0, -3.5], [0, 0, 1]],  # presses with some 40 N, 2 mm deep
            "motion.feed_mm_s": 3.0,
            "duration_s": None,
        },
        specimens=({},),
        most=17,
    ),
    "drilling": Task(
        title="drilling of a molar at 400,000 rpm, carious or sound",
        scene="caries",
        changes=TOOTH | {"motion.points_mm": [[0, 0, 0.3], [0, 0, -1.5]], "duration_s": None},
        specimens=({}, {"anatomy.caries_depth_mm": None, "anatomy.caries_diameter_mm": None}),
    ),
}
"""Tasks by name. Specimens differ by 30 % in stiffness, bone by 10 % in density. Reaming stops at 51 trials, the
published number being 50."""
METHODS: dict[str, Mapping[str, object]] = {
    "penalty": {"renderer": "penalty"},
    "energy": {"renderer": "passivity"},
    "koopman": {"renderer": "proxy", "prediction": "koopman"},
    "koopman-look-ahead": {"renderer": "proxy", "prediction": "koopman-look-ahead"},
    "koopman-perception": {"renderer": "proxy", "prediction": "koopman"},
}
"""Methods that make a contact a force; the last one is for the person whose trial it is."""
PERSONAL = ("koopman-perception",)
"""Methods that scale the force for the person."""


@dataclass(frozen=True)
class Variant:
    """One parameter at another value; the rest is as in the study, seeds among it.

    Attributes
    ----------
    parameter, value
        What is varied, and the value in words.
    changes
        By dotted key.
    pace
        Factor on the hand's pace.
    extreme
        Which of the task's extremes replaces the specimen.
    """

    parameter: str
    value: str
    changes: Mapping[str, object]
    pace: float = 1.0
    extreme: int | None = None


VARIANTS = {
    "latency-low": Variant("latency", "2 ms instead of 4", {"coupling.delay_ms": 2}),
    "latency-high": Variant("latency", "8 ms instead of 4", {"coupling.delay_ms": 8}),
    "hand-novice": Variant("hand", "a novice's instead of an intermediate's", {"hand": "novice"}),
    "hand-expert": Variant("hand", "an expert's instead of an intermediate's", {"hand": "expert"}),
    "device-omni": Variant("device", "omni (encoder step 55 um) instead of touch (55 um)", {"device": "omni"}),
    "device-six-dof": Variant("device", "six-dof (encoder step 30 um) instead of touch (55 um)", {"device": "six-dof"}),
    "tissue-soft": Variant("tissue", "half as stiff, bone four fifths as dense", {}, extreme=0),
    "tissue-hard": Variant("tissue", "twice as stiff, bone 10 % denser", {}, extreme=1),
    "pace-slow": Variant("pace", "0.7 of the usual", {}, pace=0.7),
    "pace-fast": Variant("pace", "1.4 of the usual", {}, pace=1.4),
}
"""Five parameters, low and high, in the hand of an intermediate."""
