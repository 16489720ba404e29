"""Section of a report: what differs between the plan that was registered and what is reported."""

import tomllib
from collections.abc import Callable, Iterator, Sequence

from tissue.evaluation.study.folder import Stamp, StudyFolder
from tissue.evaluation.study.plan import Plan, TrialKey
from tissue.evaluation.study.registered import code_sha256, file_sha256
from tissue.evaluation.study.section import Section
from tissue.evaluation.study.tested import COMPARED
from tissue.evaluation.study.trial import Trial, failures_of, trial_seed

__all__ = ["registration_section"]

NAMED = 5
"""Names that a row gives before it stops."""
REFUSED = " could not be tested: "
"""Words of the tests' section before the reason of a test that its data refuse."""
Difference = tuple[str, str, str]
"""Kind, what, and detail."""


def registration_section(folder: StudyFolder, tests: Sequence[Section]) -> Section:
    """What differs from the registered plan, or that nothing does.

    Parameters
    ----------
    folder
        The study.
    tests
        The report's section on tests; none where nothing is compared.
    """
    plan, there = folder.plan(), folder.registrations()
    if not there:
        return Section(
            "registration",
            "What differs from the registered plan",
            ("No plan was registered before the first trial of this study, so that nothing can be held against it.",),
        )
    kept = list(folder.trials(variant=None))
    found = [*_plans(folder), *_trials(folder, plan, kept), *_origins(folder, plan, kept), *_tests(folder, tests)]
    newest = there[-1]
    first = (
        f"{newest['file']} was registered before the first trial (SHA-256 {str(newest['sha256'])[:16]})"
        if not newest["trials_before"]
        else f"{newest['file']} was registered after {newest['trials_before']} trials"
    )
    kinds = list(dict.fromkeys(kind for kind, _, _ in found))
    sentences = (
        f"{first}. "
        + (f"{len(found)} differences from it: {', '.join(kinds)}." if found else "Nothing differs from it."),
        "Hashes find slips and changes made in passing; they prove nothing against a person who computes them anew, "
        "which a copy of the plan in other hands would.",
    )
    return Section("registration", "What differs from the registered plan", sentences,
                   ("kind", "what", "detail") if found else (), tuple(found))  # fmt: skip


def _plans(folder: StudyFolder) -> Iterator[Difference]:
    """Plans that were edited, taken away or followed by another."""
    there = folder.registrations()
    for each in there:
        if (got := file_sha256(folder.path / str(each["file"]))) != each["sha256"]:
            how = f"its SHA-256 is {got[:16]}" if got else "it is not there"
            yield "plan changed", str(each["file"]), f"registered as {str(each['sha256'])[:16]}, {how}"
    for each in there:
        if each["trials_before"]:
            detail = f"registered when {each['trials_before']} trials were there, whose results could be seen"
            yield "plan after the first trial", str(each["file"]), detail


def _trials(folder: StudyFolder, plan: Plan, kept: list[Trial]) -> Iterator[Difference]:
    """Trials that are missing, failed or were never planned."""
    keys = list(plan.all_trials())
    held = {trial.key for trial in kept}
    missing = [key for key in keys if key not in held]
    for group in plan.groups:
        if any(key.group == group for key in keys) and not any(key.group == group for key in held):
            yield "group missing", group, "no trial of it"
    for task in plan.tasks:
        if names := [key.name for key in missing if key.task == task]:
            yield "trials missing", task, _named(names)
    for what, names in failures_of(kept).items():
        yield "trials failed and left out", what, _named(names)
    for method in plan.methods:
        without = [trial.key.name for trial in kept if not trial.key.variant
                   and all(row["method"] != method for row in trial.rows)]  # fmt: skip
        if without:
            yield "method missing", method, _named(without)
    planned = {key.name for key in keys}
    if strange := sorted(each.stem for each in (folder.path / "trials").glob("*.json") if each.stem not in planned):
        yield "trials not planned", "files that the report leaves out", _named(strange)


def _origins(folder: StudyFolder, plan: Plan, kept: list[Trial]) -> Iterator[Difference]:
    """Trials of another seed, plan or code than was registered, or changed since they were written."""
    plans = {str(each["sha256"]) for each in folder.registrations()}
    stamps = {trial.key: folder.stamp(trial.key) for trial in kept}
    codes = sorted({stamp.code_sha256 for stamp in stamps.values()})
    odd: dict[str, Callable[[TrialKey, Stamp], bool]] = {
        "trials changed after they were written": lambda key, stamp: not stamp.whole,
        "trials of no registered plan": lambda key, stamp: stamp.plan_sha256 not in plans,
    }
    for kind, is_odd in odd.items():
        if names := [key.name for key, stamp in stamps.items() if is_odd(key, stamp)]:
            yield kind, "SHA-256 in their files", _named(names)
    if names := [trial.key.name for trial in kept if trial.seed != trial_seed(plan, trial.key)]:
        yield "trials of another seed", f"plan has {plan.seed}", _named(names)
    if len(codes) > 1:
        yield "code changed between trials", f"{len(codes)} versions", ", ".join(each[:12] or "none" for each in codes)
    elif codes and codes != [code_sha256()]:
        detail = f"trials {codes[0][:12] or 'none'}, report {code_sha256()[:12]}"
        yield "code changed before the report", "trials and report", detail


def _tests(folder: StudyFolder, tests: Sequence[Section]) -> Iterator[Difference]:
    """Tests that were planned and not made, with the reason, and those that were made and not planned."""
    try:
        plan = tomllib.loads((folder.path / str(folder.registrations()[-1]["file"])).read_text("utf-8"))
        planned = [str(each) for each in plan["tests"]["planned"]]
    except (OSError, ValueError, KeyError, TypeError):
        return  # a plan that was spoilt is a difference of its own
    made = [f"{row[0]} {row[1]}" for section in tests for row in section.rows]
    sentences = [sentence for section in tests for sentence in section.sentences]
    known, wanted = set(map(_same, made)), set(map(_same, planned))
    absent: dict[str, list[str]] = {}
    for test in planned:
        if _same(test) not in known:
            absent.setdefault(_reason(test, sentences), []).append(test)
    for why, names in absent.items():
        yield "tests planned and not made", why, _named(names, "; ")
    if names := [test for test in made if _same(test) not in wanted]:
        yield "tests made and not planned", "", _named(names, "; ")
    for sentence in sentences:
        if "is left out" in sentence:
            yield "method left out of tests, by the plan's rule", sentence.split(":")[0], sentence


def _same(test: str) -> tuple[str, frozenset[str]]:
    """A test without the order of its factors."""
    what, _, factors = test.rpartition(": ")
    return what, frozenset(factors.split(" x "))


def _reason(test: str, sentences: Sequence[str]) -> str:
    """Why a test was not made, from the sentences of the tests' section."""
    (task, _, question), factor = test.partition(" "), test.rpartition(": ")[2]
    metric = question.rpartition(": ")[0]
    attempt = f"{task} {metric}"
    if task == "all":
        attempt = f"{metric} over all tasks"
    elif metric not in COMPARED:
        attempt = f"{task} all metrics by {factor}"
    for sentence in sentences:
        before, found, why = sentence.partition(REFUSED)
        if found and attempt in before.split("; "):
            return why.rstrip(".")
        if sentence.startswith("Nothing could be tested: "):
            return sentence.removeprefix("Nothing could be tested: ").rstrip(".")
    return "its data hold no such factor"


def _named(names: Sequence[str], mark: str = ", ") -> str:
    """How many, and the first of them."""
    return f"{len(names)}: {mark.join(names[:NAMED])}{f'{mark}...' * (len(names) > NAMED)}"
