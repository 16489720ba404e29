"""What a study registers before its first trial: measures, tests, exclusions, seeds, effect of interest and power."""

from itertools import combinations

from meshes.base.file_version import package_version
from tissue.evaluation.statistics.hypothesis_test import ALPHA
from tissue.evaluation.study.plan import LATENCY_MS, USERS, Plan
from tissue.evaluation.study.planned_power import EFFECT, planned_power
from tissue.evaluation.study.tasks import METHODS, PERSONAL, TASKS
from tissue.evaluation.study.tested import COMPARED, DIRECTIONS

__all__ = ["plan_text", "planned_tests"]

UNITS = {"force_error": "1", "ratio_error": "1", "position_error_mm": "mm"}
"""Units of the measures that are tested; a name that is not here carries its unit at its end."""
DESCRIBED = (
    "least_error: least force error that the device's encoder allows, 1",
    "latency_ms: residual latency, ms, nearer to zero is better",
    "time_s: time to the end of the task, s, less is better",
    "acceleration_change_m_s2: mean change of acceleration, m/s2, less is smoother",
    "skin_N: force at the skin, from which discrimination (d' and right answers) follows, more is better",
    "excess_mm: travel of a needle after its puncture, mm, less is better; a puncture that nobody notices counts as "
    "the longest travel, so that medians are compared",
    "noticed: share of punctures that are noticed, 1, more is better",
    "composite index of the metrics by weights from their own spread, more is better",
)
"""Measures that are reported with intervals and not tested."""
EXCLUSIONS = (
    "no trial that did not fail is excluded, and no value is an outlier",
    "a trial that failed under a method leaves that method's row out, with the sentence of its failure; a hand that "
    "stops before the capsule breaks is one",
    "a person without a trial under every method that a test compares is left out of that test",
    "a method that gives another's value of a metric in every trial of a task is left out of that test",
)
HEAD = """\
# What this study registered before its first trial, written by tissue. Its SHA-256 stands in study.json and in every
# trial: to change the plan, write another into a new folder with `tissue study plan`.

"""


def planned_tests(plan: Plan) -> list[str]:
    """Tests that the report of a plan makes, as task and question, such as ``T1 force_error: method``.

    Of every compared metric on every task each effect, then metrics together by multivariate analysis, then each metric
    over all tasks.
    """
    methods, groups = len(plan.methods) > 1, len(plan.groups) > 1
    found = []
    for task in plan.compared:
        found += [
            f"{task} {metric}: {effect}"
            for metric in COMPARED
            for effect in _effects(["group"] * groups + ["method"] * methods)
        ]
        together = ", ".join(COMPARED)
        found += [f"{task} {together}: {factor}" for factor in ["method"] * methods + ["group"] * groups]
    tasks = len(plan.compared) > 1
    factors = ["group"] * groups + ["task"] * tasks + ["method"] * methods
    found += [f"all {metric}: {effect}" for metric in COMPARED for effect in _effects(factors) if plan.compared]
    return found


def plan_text(plan: Plan) -> str:
    """The plan as TOML; the same plan gives the same text under one version of tissue."""
    import tomli_w

    tests = planned_tests(plan)
    keys = list(plan.all_trials())
    people = min(plan.trials, USERS)
    alpha = ALPHA / max(1, len(tests))
    design = len(plan.groups), len(plan.methods)
    table = {
        "tissue": package_version(),
        "design": {
            "tasks": {task: TASKS[task].title for task in plan.tasks},
            "groups": list(plan.groups),
            "methods": {
                method: ", ".join(f"{name} = {value}" for name, value in METHODS[method].items())
                + ", perception = the person's own" * (method in PERSONAL)
                for method in plan.methods
            },
            "trials_per_task_and_group": plan.trials,
            "people_per_group": people,
            "sensitivity": plan.sensitivity,
            "trials_in_all": len(keys),
            "latency_ms": LATENCY_MS,
        },
        "seeds": {
            "seed": plan.seed,
            "rule": "a trial's seed follows from this seed, its task, its group and its number alone, and is written "
            "into its file; a trial is the same under every method",
        },
        "measures": {
            "primary": [
                {"name": name, "unit": UNITS.get(name, name.rsplit("_", 1)[-1]), "better": _better(name)}
                for name in COMPARED
            ],
            "described": list(DESCRIBED),
        },
        "tests": {
            "method": "analysis of strata with people as the unit; multivariate analysis of metrics together; a mixed "
            "model over all tasks; tests that rest on less stand beside them and decide nothing",
            "correction": f"Bonferroni over all {len(tests)} tests" if tests else "none, as nothing is tested",
            "alpha": ALPHA,
            "alpha_of_one_test": alpha,
            "planned": tests,
        },
        "exclusions": list(EXCLUSIONS),
        "power": {
            "effect_of_interest_sd": EFFECT,
            "effect": "one method, group, or method in one group differs from the rest, which are equal; in standard "
            "deviations of differences within people, or of people",
            "method": "noncentral F distribution, Cohen 1988, chapter 8; normal values and sphericity; for one metric "
            "on one task",
            "corrected": _rounded(planned_power(people, *design, alpha=alpha)) if tests else {},
            "uncorrected": _rounded(planned_power(people, *design, alpha=ALPHA)) if tests else {},
        },
    }
    return HEAD + tomli_w.dumps(table)


def _better(metric: str) -> str:
    return "less" if DIRECTIONS[metric] < 0 else "more"


def _effects(factors: list[str]) -> list[str]:
    """Main effects and interactions of factors."""
    return [" x ".join(chosen) for count in range(1, len(factors) + 1) for chosen in combinations(factors, count)]


def _rounded(power: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 3) for name, value in power.items()}
