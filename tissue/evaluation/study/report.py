"""Report of a study: one HTML file with all sections and pictures, and tables as CSV."""

import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError, counted, enumerated
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import package_version, write_text
from tissue.evaluation.charts.settings import code_sha256
from tissue.evaluation.study.cases import case_sections
from tissue.evaluation.study.discrimination import discrimination_section
from tissue.evaluation.study.fidelity import (
    force_section,
    latency_section,
    task_section,
)
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.plan import (
    LATENCY_MS,
    TASKS,
    USERS,
    Plan,
)
from tissue.evaluation.study.registration import file_sha256
from tissue.evaluation.study.section import CHOSEN_AFTER, SOURCE, Section
from tissue.evaluation.study.tested import statistics_sections
from tissue.evaluation.study.trial import (
    Trial,
    failures_of,
    trial_seed,
)
from tissue.system.html import html_page, html_picture
from tissue.system.owned_folder import OwnedFolder

WIDE = ".wide { overflow-x: auto; } .wide td { overflow-wrap: break-word; }"
HEADLINES = ("registration", "force", "discrimination", "case-needle", "latency")
"""Names of the sections whose main findings are listed first in the report, in this order."""
MOST_HEADLINES = 4
NAMED = 5
"""Largest number of names that are listed in a table cell or in a sentence."""
Difference = tuple[str, str, str]
"""Difference of a study from its registered plan: kind, object and detail."""


def write_report(path: Path, *, report: Progress = silent) -> tuple[Path, list[str]]:
    """Write the report ``report/index.html`` and its tables into the folder of a study.

    Return the path of the report, and the sentences of its first three sections.

    Parameters
    ----------
    path
        Folder of the study.
    report
        Called with the progress.

    Raises
    ------
    InputError
        If the folder does not hold a study, if it contains no trial of the plan's tasks, or if
        another process is writing a report.
    """
    folder = StudyFolder(path)
    out = path / "report"
    folder.plan()  # refuses a folder that is no study before anything is made in it
    page = out / "index.html"
    with OwnedFolder(out, "study report", (), shared=["index.html"]):
        sections = sections_of(folder, report=report)
        links = " · ".join(
            f'<a href="#{escape(each.name)}">{escape(each.title)}</a>' for each in sections
        )
        body = "\n".join(_as_html(section, section.write_csv(out)) for section in sections)
        write_text(page, html_page("Study", f'<p class="soft">{links}</p>\n{body}', style=WIDE))
    return page, [sentence for section in sections[:3] for sentence in section.sentences]


def sections_of(folder: StudyFolder, *, report: Progress = silent) -> list[Section]:
    """Return all report sections for which the study has trials."""
    plan = folder.plan()
    folder.write_tables()
    sections: list[Section] = []
    whole = None
    # without compared tasks, a study has case studies alone
    if plan.compared:
        table = folder.table(*plan.compared)
        whole = table.complete()
        if not len(whole):
            raise InputError(
                "study",
                "contain at least one trial without a failure",
                counted(table.failed, "failure"),
                "see the reasons in trials.csv",
            )
        # the progress follows the time of the sections: the tests take half of it
        report("force and tasks", 0.1)
        sections += [force_section(whole), latency_section(whole), task_section(whole)]
        report("tests", 0.2)
        sections += statistics_sections(table, np.random.default_rng(plan.seed))
    report("discrimination", 0.7)
    sections.append(discrimination_section(folder, whole, plan.seed))
    report("case studies", 0.9)
    sections += case_sections(folder, plan.seed)
    differences = registration_section(folder, [each for each in sections if each.name == "tests"])
    found = found_section([*sections, differences])
    return [found, _overview(folder), differences, *sections]


def found_section(sections: Sequence[Section]) -> Section:
    """Return the first section of the report, which lists the main findings.

    The last sentence states how many results agree with the published results.
    """
    headlines = {each.name: each.headline for each in sections}
    # an empty headline: the section has no finding
    found = [headlines[name] for name in HEADLINES if headlines.get(name)]
    return Section("found", "What was found", [*found[:MOST_HEADLINES], _agreement(sections)])


def _agreement(sections: Sequence[Section]) -> str:
    """Return a sentence with the number of results that agree with published values.

    The sentence also lists the results that do not agree.
    """
    compared = 0
    apart = []
    for section in sections:
        for row in section.table:
            verdict = row.get("against paper", "")
            compared += bool(verdict)
            if verdict not in ("", "agrees"):
                first, second, *_ = row.values()
                apart.append(f"{section.title.lower()} {first} {second} ({verdict})")
    text = (
        f"Results that agree with the paper: {compared - len(apart)} of {compared}. Agreement "
        "means a difference of at most the root of the sum of both squared standard deviations."
    )
    if not apart:
        return text
    begin = "The first results" if len(apart) > NAMED else "The results"
    return f"{text} {begin} that do not agree: {', '.join(apart[:NAMED])}."


def _overview(folder: StudyFolder) -> Section:
    """Report the tasks, their scenes, the numbers of trials, and the reasons for failures."""
    plan = folder.plan()
    kept = list(folder.trials())
    counts = Counter((trial.key.task, trial.key.group) for trial in kept)
    rows = [
        {
            "task": task,
            "what": TASKS[task].title,
            "scene and changes": _describe(task),
            "compared with the paper": f"no: {TASKS[task].known_difference}"
            if TASKS[task].known_difference
            else "yes",
            "trials": ", ".join(f"{group} {counts[task, group]}" for group in plan.groups),
        }
        for task in plan.tasks
    ]
    empty = [group for group in plan.groups if not any(counts[task, group] for task in plan.tasks)]
    sentences = [
        f"{len(kept)} of {sum(1 for _ in plan.all_trials())} trials are complete, seed "
        f"{plan.seed}, "
        f"version {package_version()}; methods {', '.join(plan.methods)}. Every trial has a "
        f"latency of {LATENCY_MS} ms on the device touch.",
        "Simulated people differ in pace, exponent and threshold. Groups differ in hand and "
        f"threshold. A group has at most {counted(min(plan.trials, USERS), 'simulated user')}. "
        "No real person took part. The results do not measure physical fidelity: forces are "
        "compared with the ideal force of this program, as the paper compares its forces with its "
        "own ideal.",
        f"Figures of the paper: {SOURCE}. Only tasks that meet all conditions stated in the paper "
        "are compared with it. The paper states no geometry, tool or path.",
    ]
    if after := [text for text, tasks in CHOSEN_AFTER if set(tasks) & set(plan.tasks)]:
        sentences.append(f"Chosen after results of earlier studies were known: {' '.join(after)}")
    if empty:
        sentences.append(
            f"There is no trial of {enumerated(empty, 'or')} yet: the figures hold for the "
            "other groups."
        )
    for what, names in failures_of(kept).items():
        sentences.append(f"{len(names)} failed, {what} ({names[0]}{', ...' * (len(names) > 1)}).")
    return Section("overview", "What was run", sentences, rows)


def _describe(task: str) -> str:
    """Return the scene of a task, with its changes and specimens, as text."""
    changes, *specimens = (
        ", ".join(
            f"{name} {'left out' if value is None else value}" for name, value in each.items()
        )
        for each in (TASKS[task].changes, *TASKS[task].specimens)
    )
    text = f"{TASKS[task].scene}: {changes}"
    if len(specimens) == 1:
        return text
    return f"{text}; specimens: {' or '.join(each or 'as it is' for each in specimens)}"


def registration_section(folder: StudyFolder, tests: Sequence[Section]) -> Section:
    """List how the study deviates from its registered plan.

    Parameters
    ----------
    folder
        Folder of the study.
    tests
        Report sections on hypothesis tests. Empty if the study has no tests.
    """
    plan = folder.plan()
    kept = list(folder.trials())
    found = [
        *_plans(folder),
        *_trials(folder, plan, kept),
        *_origins(folder, plan, kept),
        *_tests(folder, tests),
    ]
    # its SHA-256 is shown by 16 digits, which distinguish versions of a plan
    newest = folder.registrations()[-1]
    before = newest["trials_before"]
    when = f"after {counted(int(before), 'trial')}" if before else "before the first trial"
    differs = "nothing differs from it"
    if found:
        points: dict[str, list[str]] = {}
        for kind, what, _ in found:
            points.setdefault(kind, []).append(what.split(":")[0])
        kinds = "; ".join(
            # several points of a kind differ in their subjects
            f"{kind}: {', '.join(subjects)}" if len(subjects) > 1 else kind
            for kind, subjects in points.items()
        )
        differs = f"the study differs from it in {counted(len(found), 'point')} ({kinds})"
    digits = str(newest["sha256"])[:16]
    headline = f"{newest['file']} was registered {when} (SHA-256 {digits}); {differs}."
    limits = (
        "The hashes reveal accidental changes. They do not reveal changes by a person who computes "
        "the hashes again. A copy of the plan that another person keeps reveals these, too."
    )
    rows = [dict(zip(("kind", "what", "detail"), each, strict=True)) for each in found]
    title = "What differs from the registered plan"
    return Section("registration", title, (headline, limits), rows, headline=headline)


def _plans(folder: StudyFolder) -> Iterator[Difference]:
    """Yield differences: plans that were edited, removed, or registered after the first trial."""
    for each in folder.registrations():
        name = str(each["file"])
        if (got := file_sha256(folder.path / name)) != each["sha256"]:
            # 16 digits distinguish versions of a plan
            how = f"its SHA-256 is {got[:16]}" if got else "it is not there"
            yield "plan changed", name, f"registered as {str(each['sha256'])[:16]}, {how}"
        if each["trials_before"]:
            detail = (
                f"registered after {counted(int(each['trials_before']), 'trial')}, "
                "whose results could be seen"
            )
            yield "plan after the first trial", name, detail


def _trials(folder: StudyFolder, plan: Plan, kept: list[Trial]) -> Iterator[Difference]:
    """Yield differences: trials that are missing, failed, or were never planned."""
    keys = list(plan.all_trials())
    held = {trial.key for trial in kept}
    for group in plan.groups:
        # a case study with few trials may have no trial of a group
        if {group} & {key.group for key in keys} - {key.group for key in held}:
            yield "group missing", group, "no trial of it"
    for task in plan.tasks:
        if names := [key.name for key in keys if key.task == task and key not in held]:
            yield "trials missing", task, _named(names)
    for what, names in failures_of(kept).items():
        yield "trials failed and left out", what, _named(names)
    for method in plan.methods:
        without = [
            trial.key.name for trial in kept if all(row["method"] != method for row in trial.rows)
        ]
        if without:
            yield "method missing", method, _named(without)
    files = {each.stem for each in (folder.path / "trials").glob("*.json")}
    if strange := sorted(files - {key.name for key in keys}):
        yield "trials not planned", "files that the report leaves out", _named(strange)


def _origins(folder: StudyFolder, plan: Plan, kept: list[Trial]) -> Iterator[Difference]:
    """Yield differences: trials with an edited file, a wrong seed, or changed code."""
    plans = {str(each["sha256"]) for each in folder.registrations()}
    for kind, what, names in (
        (
            "trials changed after they were written",
            "SHA-256 in their files",
            [trial.key.name for trial in kept if not trial.whole],
        ),
        (
            "trials of no registered plan",
            "SHA-256 in their files",
            [trial.key.name for trial in kept if trial.plan_sha256 not in plans],
        ),
        (
            "trials of another seed",
            f"plan has {plan.seed}",
            [trial.key.name for trial in kept if trial.seed != trial_seed(plan, trial.key)],
        ),
    ):
        if names:
            yield kind, what, _named(names)
    codes = sorted({trial.code_sha256 for trial in kept})
    if len(codes) > 1:
        yield (
            "code changed between trials",
            f"{len(codes)} versions",
            # 12 digits distinguish versions of the code
            ", ".join(each[:12] or "none" for each in codes),
        )
    elif codes and codes != [code_sha256()]:
        detail = f"trials {codes[0][:12] or 'none'}, report {code_sha256()[:12]}"
        yield "code changed before the report", "trials and report", detail


def _tests(folder: StudyFolder, tests: Sequence[Section]) -> Iterator[Difference]:
    """Yield differences: tests not made, unplanned tests, and methods omitted from tests."""
    try:
        plan = tomllib.loads(
            (folder.path / str(folder.registrations()[-1]["file"])).read_text("utf-8")
        )
        planned = {_unordered(each): str(each) for each in plan["tests"]["planned"]}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return  # a spoilt plan is a difference of its own
    rows = [f"{row['task']} {row['question']}" for section in tests for row in section.table]
    made = {_unordered(test): test for test in rows}
    sentences = [sentence for section in tests for sentence in section.sentences]
    if names := [test for key, test in planned.items() if key not in made]:
        reasons = ("could not be tested", "Nothing could be")
        why = " ".join(each for each in sentences if any(reason in each for reason in reasons))
        yield "tests planned and not made", why, _named(names, "; ")
    if names := [test for key, test in made.items() if key not in planned]:
        yield "tests made and not planned", "", _named(names, "; ")
    for sentence in sentences:
        if "is left out" in sentence:
            yield (
                "method left out of tests by the rule of the plan",
                sentence.split(":")[0],
                sentence,
            )


def _unordered(test: str) -> tuple[str, frozenset[str]]:
    """Return the name of a test, and its factors as a set, so that their order is ignored."""
    what, _, factors = test.rpartition(": ")
    return what, frozenset(factors.split(" x "))


def _named(names: Sequence[str], mark: str = ", ") -> str:
    """Return the number of names and the first `NAMED` of them, as text."""
    return f"{len(names)}: {mark.join(names[:NAMED])}{f'{mark}...' * (len(names) > NAMED)}"


def _as_html(section: Section, file: str) -> str:
    """Return one section as HTML, with a link to the file that holds its table."""
    text = "".join(f'<p class="verdict">{escape(each)}</p>\n' for each in section.sentences)
    shown = html_picture(section.title, section.picture) if section.picture else ""
    table = ""
    if section.rows:
        head = "".join(f"<th>{escape(each)}</th>" for each in section.header)
        body = "".join(
            f"<tr>{''.join(f'<td>{escape(each)}</td>' for each in row)}</tr>"
            for row in section.rows
        )
        table = f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'
        table += f'<p class="soft">Data: <a href="{escape(file)}">{escape(file)}</a></p>'
    return (
        "<section "
        f'id="{escape(section.name)}"><h2>{escape(section.title)}</h2>\n{text}{shown}{table}</section>'
    )
