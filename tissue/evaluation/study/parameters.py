"""Section of a report on the parameters that a study's numbers come from, with value, range and source of each."""

from collections.abc import Iterator

from tissue.evaluation.study.plan import LATENCY_MS, USERS, Plan
from tissue.evaluation.study.section import Section
from tissue.evaluation.study.tasks import METHODS, PERSONAL
from tissue.evaluation.study.trial import NUMBERS, PACE_SPREAD, WITHIN_SPREAD
from tissue.materials.constants import constants

__all__ = ["parameters_section"]

Row = tuple[str, str, str, str, str, str]
TISSUES = {
    "T3": (("cutting", "bone"),),
    "needle": (("needle", "liver"),),
    "reaming": (("cutting", "bone"), ("perception", "torque")),
    "drilling": (("cutting", "enamel"), ("cutting", "dentin")),
}
"""Cited constants of tissues and senses that a task adds; T1 and T2 have their stiffness in the scene alone."""
STUDY: tuple[Row, ...] = (
    ("study", "latency ms", f"{LATENCY_MS}", "2 to 8, see the sensitivity", "M", "near the paper's mean of 4.3 ms"),
    ("study", "people a group", f"{USERS}", "", "", "trials go round among them"),
    ("study", "spread of the logarithm of pace, people", f"{PACE_SPREAD:g}", "", "L", "assumed"),
    ("study", "spread of the logarithm of pace, trials", f"{WITHIN_SPREAD:g}", "", "L", "assumed"),
    ("study", "numbers given to forces in a calibration", f"{NUMBERS}", "", "L", "assumed"),
)
"""The study's own parameters."""


def parameters_section(plan: Plan) -> Section:
    """Every parameter, those of the scenes apart, which the overview lists."""
    rows = [*STUDY, *_methods(plan)]
    tables = [("devices", "touch"), ("hands", "any"), *(("hands", group) for group in plan.groups)]
    tables += [("perception", "force"), *(("observers", group) for group in plan.groups)]
    tables += [each for task in plan.tasks for each in TISSUES.get(task, ())]
    for table, name in dict.fromkeys(tables):
        rows += [
            (f"{table}, {name}", entry, f"{one.value:g}", f"{one.low:g} to {one.high:g}", one.confidence, one.source)
            for entry, one in constants(table, name).items()
        ]
    unsure = sum(row[4] == "L" for row in rows)
    sentences = (
        f"{len(rows)} parameters; {unsure} of them are of low confidence (L: memory of the literature or assumed), "
        "most of what distinguishes people and groups among them. None was chosen by a figure of the paper but the "
        "latency and the depth that the needle aims at, as its section states.",
    )
    header = ("of", "parameter", "value", "range", "confidence", "source")
    return Section("parameters", "Parameters", sentences, header, tuple(rows))


def _methods(plan: Plan) -> Iterator[Row]:
    """What each method sets."""
    for method in plan.methods:
        keys = dict(METHODS[method]) | ({"perception": "the person's own"} if method in PERSONAL else {})
        for name, value in keys.items():
            yield f"method {method}", name, str(value), "", "", "the method's definition"
