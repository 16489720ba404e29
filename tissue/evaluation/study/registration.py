"""Registration of a study's plan before its trials, with a hash that detects later edits.

A registration contains the text of the plan, with its hypothesis tests and their power, and the
hash of this text.
"""

import json
import tomllib
from collections.abc import Mapping
from functools import lru_cache
from hashlib import sha256
from importlib.util import find_spec
from inspect import getsource
from math import ceil, log2
from pathlib import Path
from typing import Any

import tomli_w

from meshes.base.errors import InputError
from meshes.base.extras import install_command
from meshes.base.whole_file import claim, package_version, whole_file
from tissue.evaluation.statistics.hypothesis_test import ALPHA
from tissue.evaluation.statistics.planned_power import (
    EFFECT,
    POPULATIONS,
    POWER,
    effect_names,
    planned_people,
    planned_power,
)
from tissue.evaluation.study.plan import (
    COMPARED,
    DIRECTIONS,
    LATENCY_MS,
    METHODS,
    PERSONAL,
    TASKS,
    USERS,
    Plan,
    method_settings,
    seeded,
)
from tissue.scene.plugins import package_of
from tissue.scene.registry import PREDICTORS

PLAN_FILE = "plan.toml"
Registration = dict[str, str | int]
"""Registered plan.

The entry ``file`` is the name of the plan's file, ``sha256`` the hash of the file, and
``trials_before`` the number of trials in the folder before the registration.
"""
STREAM = 2000
"""Key of the random generator for the computed power of tests.

Random generators of trials and people have keys below 1001.
"""
UNITS = {"force_error": "1", "ratio_error": "1", "position_error_mm": "mm"}
"""Units of the tested metrics, keyed by the name of the metric."""
DESCRIBED = (
    "least_error: least force error that the device's encoder allows, 1",
    "latency_ms: residual latency, ms, nearer to zero is better",
    "time_s: time to the end of the task, s, less is better",
    "acceleration_change_m_s2: mean change of acceleration, m/s2, less is smoother",
    (
        "skin_N: force at the skin, from which discrimination (d' and right answers) follows, "
        "more is better"
    ),
    "excess_mm: travel of a needle after its puncture, mm, less is better; a puncture that "
    "nobody notices counts as "
    "the longest travel, so that medians are compared",
    "noticed: share of punctures that are noticed, 1, more is better",
    "composite index of the metrics by weights from their own spread, more is better",
)
"""Descriptions of the metrics that are reported with intervals, but not tested."""
EXCLUSIONS = (
    "no trial that did not fail is excluded, and no value is an outlier",
    "a trial that failed under a method leaves that method's row out, with the sentence of "
    "its failure; a hand that "
    "stops before the capsule breaks is one",
    "a person without a trial under every method that a test compares is left out of that test",
    (
        "a method that gives another's value of a metric in every trial of a task, to a thousandth "
        "of the metric's spread over trials, is left out of that test"
    ),
)
HEAD = """\
# What this study registered before its first trial, written by tissue. Its SHA-256
# stands in study.json and in every trial. To change the plan, write another into a new folder
# with `tissue study plan`.

"""


def register(
    folder: Path, plan: Plan, held: list[Registration], *, trials: int
) -> list[Registration]:
    """Write a plan to its file; return all registrations including the new one, newest last.

    The file of an earlier plan is kept under another name.

    Parameters
    ----------
    folder
        Existing folder of the study.
    plan
        Plan to register.
    held
        Earlier registrations.
    trials
        Number of trials in the folder.
    """
    kept = list(held)
    path = folder / PLAN_FILE
    # a wider plan: the earlier file is kept under its number
    if kept:
        earlier = f"plan-{len(kept)}.toml"
        claim(folder / earlier)
        path.replace(folder / earlier)
        kept[-1] = kept[-1] | {"file": earlier}
    text = plan_text(plan).encode("utf-8")
    if not kept and path.is_file() and path.read_bytes() != text:
        raise InputError(
            "out",
            f"contain no {PLAN_FILE} other than the plan of this study",
            f"another {PLAN_FILE} in {folder}",
            "choose another folder, or write the file with `tissue study plan`",
        )
    with whole_file(path) as temporary:
        temporary.write_bytes(text)
    return [*kept, {"file": PLAN_FILE, "sha256": sha256(text).hexdigest(), "trials_before": trials}]


def registered(content: Mapping[str, Any]) -> list[Registration]:
    """Return the registrations in the content of a file ``study.json``.

    Raises
    ------
    TypeError, KeyError
        If the content does not have the expected form.
    """
    return [
        {
            "file": str(each["file"]),
            "sha256": str(each["sha256"]),
            "trials_before": int(each["trials_before"]),
        }
        for each in content["registrations"]
    ]


def packages_of(plan: Plan) -> dict[str, str]:
    """Return the name and code hash of each registered predictor's origin, keyed by method.

    The origin is a package or, for a predictor that a script registers, its class or function.
    """
    own = [method for method in plan.methods if method not in (*METHODS, *PREDICTORS.built_in)]
    found = {method: package_of(PREDICTORS.group, method) or _source_of(method) for method in own}
    return {method: package for method, package in found.items() if package}


def _source_of(method: str) -> str:
    """Return name and source hash of the class or function that a script registered.

    The hash does not contain the rest of the script, such as a number of trials, which may change.
    The result is empty without a source file.
    """
    make = getattr(PREDICTORS[method].make, "make", None)
    try:
        source = getsource(make)  # type: ignore[arg-type]
    except (OSError, TypeError):
        return ""
    digest = sha256(source.encode("utf-8")).hexdigest()
    return f"{getattr(make, '__name__', method)} of a script, SHA-256 {digest[:16]}"


def require_unchanged(folder: Path, held: list[Registration], plan: Plan) -> None:
    """Check that the files of registered plans and the code of their methods are unchanged.

    Raises
    ------
    InputError
        If the file of a plan does not have the recorded hash, or the code of a method of `plan`
        has changed.
    """
    for each in held:
        if (got := file_sha256(folder / str(each["file"]))) != each["sha256"]:
            raise InputError(
                each["file"],
                # twelve digits of a checksum are enough to compare by eye
                f"have the registered SHA-256 {str(each['sha256'])[:12]}",
                f"{got[:12] or 'no such file'} in {folder}",
                "restore the registered file, or run the changed plan in a new folder",
            )
    newest = tomllib.loads((folder / str(held[-1]["file"])).read_text("utf-8"))
    recorded = newest["design"].get("packages", {})
    found = packages_of(plan)
    for method in sorted(recorded.keys() & set(plan.methods)):
        package = found.get(method, "code without a source file")
        if recorded[method] != package:
            raise InputError(
                f"method {method}",
                f"come from the registered code ({recorded[method]})",
                package,
                "restore the registered version, or run the study in a new folder",
            )


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file; empty if the file cannot be read."""
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def content_sha256(content: Mapping[str, object]) -> str:
    """Return the SHA-256 of a trial's content.

    The hash detects accidental edits. It does not detect edits by a person who also replaces the
    hash.
    """
    return sha256(json.dumps(content, sort_keys=True).encode("utf-8")).hexdigest()


def notes_before(plan: Plan) -> list[str]:
    """Return the reasons, if any, why the report on a planned study cannot show an effect."""
    if not plan.compared:
        return []
    notes = []
    if find_spec("statsmodels") is None:
        notes.append(
            "The report will contain no tests, because statsmodels is not installed. Run "
            f"{install_command('study')}"
        )
    tests = len(planned_tests(plan))
    if not tests:
        return notes
    people = min(plan.trials, USERS) * len(plan.groups)
    needed = max(2 * len(plan.groups), 1 + ceil(log2(tests / ALPHA)))
    remedy = (
        f"Plan for {needed} people or more: each of the first {USERS} trials of a group has "
        "another person"
    )
    # the measured signs and their opposites reach the statistic, of 2^people combinations
    smallest_p = 2.0 ** (1 - people)
    if plan.trials == 1:
        notes.append(
            "Nothing will be tested: each group has one person, and a test needs at least two "
            f"people in each group. {remedy}"
        )
    elif len(plan.methods) > 1 and tests * smallest_p > ALPHA:
        notes.append(
            f"No test of methods can show an effect: with {people} people, its p value is at least "
            f"{smallest_p:.2g} ({min(1.0, tests * smallest_p):.2g} after Bonferroni's correction "
            f"for {tests} tests), and the level is {ALPHA:g}. {remedy}"
        )
    return notes


def planned_tests(plan: Plan) -> list[str]:
    """Return the hypothesis tests that a plan implies, each as a text with task and question.

    An example is ``T1 force_error: method``.

    For each task, every effect is tested on each compared metric. Methods and groups are then
    tested on all metrics together. Finally, every effect on each metric is tested over all tasks.
    """
    groups = len(plan.groups)
    methods = len(plan.methods)
    factors = ["method"] * (methods > 1) + ["group"] * (groups > 1)
    together = ", ".join(COMPARED)
    found = []
    for task in plan.compared:
        effects = effect_names(group=groups, method=methods)
        found += [f"{task} {metric}: {effect}" for metric in COMPARED for effect in effects]
        found += [f"{task} {together}: {factor}" for factor in factors]
    if plan.compared:
        effects = effect_names(group=groups, task=len(plan.compared), method=methods)
        found += [f"all {metric}: {effect}" for metric in COMPARED for effect in effects]
    return found


# powers take some seconds
@lru_cache(maxsize=16)
def plan_text(plan: Plan) -> str:
    """Return the text of a plan as TOML.

    In the same version of tissue, equal plans give equal texts.
    """
    tests = planned_tests(plan)
    keys = list(plan.all_trials())
    people = min(plan.trials, USERS)
    packages = packages_of(plan)
    alpha = ALPHA / max(1, len(tests))
    table = {
        "tissue": package_version(),
        "design": {
            "tasks": {task: TASKS[task].title for task in plan.tasks},
            "groups": list(plan.groups),
            "methods": {
                method: ", ".join(
                    f"{name} = {value}" for name, value in method_settings(method).items()
                )
                + ", perception = the person's own" * (method in PERSONAL)
                for method in plan.methods
            },
            "trials_per_task_and_group": plan.trials,
            "people_per_group": people,
            "trials_in_all": len(keys),
            "latency_ms": LATENCY_MS,
            **({"packages": packages} if packages else {}),
        },
        "seeds": {
            "seed": plan.seed,
            "rule": "a trial's seed follows from this seed, its task, its group and its number "
            "alone, and is written into its file; a trial is the same under every method",
        },
        "specimens": "each person gets the specimens of a task in turn, trial by trial, and people "
        "begin with different ones",
        "measures": {
            "primary": [
                {
                    "name": name,
                    "unit": UNITS.get(name, name.rsplit("_", 1)[-1]),
                    "better": "less" if DIRECTIONS[name] < 0 else "more",
                }
                for name in COMPARED
            ],
            "described": list(DESCRIBED),
        },
        "tests": {
            "method": "sign flips with people as the unit decide: the largest t over all pairs of "
            "levels or groups, each with its own standard error, against sign flips of the "
            "differences within people or, between groups, of the residuals about their means; "
            "several metrics together by the largest t over all of them. F of strata, "
            "multivariate analysis, mixed model and Tukey's test are listed in addition with "
            "their measured rates of false alarms and decide nothing",
            "correction": f"Bonferroni over all {len(tests)} tests"
            if tests
            else "none, as nothing is tested",
            "alpha": ALPHA,
            "alpha_of_one_test": alpha,
            "planned": tests,
        },
        "exclusions": list(EXCLUSIONS),
        "power": {
            "effect_of_interest_sd": EFFECT,
            "effect": "one method, group, or method in one group differs from the rest, which are "
            "equal; in standard deviations of differences within people, or of people",
            "method": f"{POPULATIONS} simulated studies with normal values and equal spreads, for "
            "the deciding test of one metric on one task; people_per_group is the smallest number "
            f"with a power of {POWER} after correction",
            **(_powers(plan, people, alpha) if tests else {}),
        },
    }
    return HEAD + tomli_w.dumps(table)


def _powers(plan: Plan, people: int, alpha: float) -> dict[str, dict[str, float] | dict[str, int]]:
    """Return the power of each test, and the number of people for a power of 0.8.

    Both are given with and without the correction for several tests. `alpha` is the significance
    level of one test after the correction.
    """
    design = (len(plan.groups), len(plan.methods))
    rng = seeded(plan.seed, STREAM)
    return {
        "corrected": _rounded(planned_power(people, *design, alpha=alpha, rng=rng)),
        # a test decides after correction
        "people_per_group": planned_people(*design, alpha=alpha, rng=rng),
        "uncorrected": _rounded(
            planned_power(people, *design, alpha=ALPHA, rng=seeded(plan.seed, STREAM))
        ),
    }


def _rounded(power: dict[str, float]) -> dict[str, float]:
    # to one per cent, the noise of the simulation; machines that round differently write the
    # same text
    return {name: round(value, 2) for name, value in power.items()}
