"""The report of a study: sections as one HTML file that needs no other, and as CSV."""

from collections import Counter
from html import escape
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError
from meshes.base.file_version import package_version
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.cases import case_sections
from tissue.evaluation.study.deviations import registration_section
from tissue.evaluation.study.discrimination import case_table, discrimination_section
from tissue.evaluation.study.fidelity import force_section, latency_section, task_section
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.found import found_section
from tissue.evaluation.study.paper import CHOSEN_AFTER, SOURCE
from tissue.evaluation.study.parameters import parameters_section
from tissue.evaluation.study.plan import LATENCY_MS, USERS
from tissue.evaluation.study.section import Section
from tissue.evaluation.study.sensitivity import reference_section, sensitivity_section, speed_section
from tissue.evaluation.study.tasks import TASKS
from tissue.evaluation.study.tested import composite_section, power_section, regression_section, tests_sections
from tissue.evaluation.study.trial import failures_of
from tissue.system.html import html_page, html_picture
from tissue.system.owned_folder import listed_files, owned_folder

__all__ = ["sections_of", "write_report"]

WIDE = ".wide { overflow-x: auto; } .wide td { overflow-wrap: break-word; }"


def write_report(path: Path, *, report: Progress = silent) -> tuple[Path, list[str]]:
    """Write ``report/index.html`` and its tables into a study's folder; its path, and the first sentences of it.

    Raises
    ------
    InputError
        If the folder is no study, holds no trial of the tasks that are compared, or another process writes a report.
    """
    folder, out = StudyFolder(path), path / "report"
    folder.plan()  # refuses what is no study before anything is made in it
    page = out / "index.html"
    # The folder of a study of version 0.2 has no marker: what lies in its report is that of an earlier report.
    listed = listed_files(out) or listed_files(path)
    earlier = () if listed else {each.name for each in (page, *out.glob("*.csv")) if each.is_file()}
    with owned_folder(out, "study report", (), shared=["index.html"], adopted=earlier):
        sections = sections_of(folder, report=report)
        links = " · ".join(f'<a href="#{escape(each.name)}">{escape(each.title)}</a>' for each in sections)
        body = "\n".join(_as_html(section, section.write_csv(out)) for section in sections)
        with whole_file(page) as temporary:
            temporary.write_text(html_page("Study", f'<p class="soft">{links}</p>\n{body}', style=WIDE), "utf-8")
    return page, [sentence for section in sections[:3] for sentence in section.sentences]


def sections_of(folder: StudyFolder, *, report: Progress = silent) -> list[Section]:
    """All sections that a study's trials allow."""
    plan = folder.plan()
    folder.write_tables()
    sections = [_overview(folder)]
    whole: TrialTable | None = None
    if plan.compared:
        table = folder.table(*plan.compared)
        whole = table.complete()
        if not len(whole):
            raise InputError(f"study must hold a trial that did not fail, got {table.failed} failures: see trials.csv")
        report("force and tasks", 0.1)
        sections += [force_section(whole), latency_section(whole), task_section(whole)]
        report("discrimination", 0.2)
        sections.append(discrimination_section(folder, whole, plan.seed))
        report("tests", 0.4)
        sections += _tested(table, np.random.default_rng(plan.seed))
    report("case studies", 0.9)
    sections += case_sections(folder, plan.seed)
    sections += [each for each in (sensitivity_section(folder), reference_section(folder)) if each is not None]
    tests = [each for each in sections if each.name == "tests"]
    sections.insert(1, registration_section(folder, tests))
    found = found_section(whole, case_table(folder, "needle"), sections)
    return [found, *sections, speed_section(folder), parameters_section(plan)]


def _tested(table: TrialTable, rng: np.random.Generator) -> list[Section]:
    """All that needs several people a group, or why there is none."""
    try:
        sections = tests_sections(table, rng)
    except InputError as error:
        return [Section("tests", "Tests", (f"Nothing could be tested: {error}.",))]
    for name, title, make in (
        ("index", "Composite index", composite_section),
        ("regression", "Task error against force error and latency", regression_section),
        ("power", "Power and error rates", power_section),
    ):
        try:
            sections.append(Section(name, title, *make(table, rng)))
        except InputError as error:
            sections.append(Section(name, title, (f"This could not be tested: {error}.",)))
    return sections


def _overview(folder: StudyFolder) -> Section:
    """What was run, what is missing, what failed, and by which parameters."""
    plan = folder.plan()
    kept = list(folder.trials(variant=None))
    counts = Counter((trial.key.task, trial.key.group) for trial in kept if not trial.key.variant)
    rows = tuple(
        (task, TASKS[task].title, _describe(task), ", ".join(f"{group} {counts[task, group]}" for group in plan.groups))
        for task in plan.tasks
    )
    empty = [group for group in plan.groups if not any(counts[task, group] for task in plan.tasks)]
    sentences = [
        f"{len(kept)} of {sum(1 for _ in plan.all_trials())} trials are there, seed {plan.seed}, version "
        f"{package_version()}; methods {', '.join(plan.methods)}. Every trial has a latency of {LATENCY_MS} ms on the "
        "device touch.",
        f"{USERS} simulated people a group differ in pace, exponent and threshold, groups in hand and threshold. "
        "No person took part, and nothing here is a measure of physical fidelity: forces are held against the "
        "engine's own ideal, as the paper's are against its own.",
        f"Figures of the paper: {SOURCE}. Chosen after results had been seen: {'; '.join(CHOSEN_AFTER)}.",
    ]
    if empty:
        sentences.append(f"No trial yet of {', '.join(empty)}: the figures are of the other groups.")
    sentences += [f"{len(names)} failed, {what} ({names[0]}{', ...' * (len(names) > 1)})."
                  for what, names in failures_of(kept).items()]  # fmt: skip
    return Section("overview", "What was run", tuple(sentences), ("task", "what", "scene and changes", "trials"), rows)


def _describe(task: str) -> str:
    """Changes of a task's scene in words."""
    changes, *specimens = (
        ", ".join(map(_entry, each.items())) for each in (TASKS[task].changes, *TASKS[task].specimens)
    )
    text = f"{TASKS[task].scene}: {changes}"
    return f"{text}; specimens: {' or '.join(each or 'as it is' for each in specimens)}" if len(specimens) > 1 else text


def _entry(item: tuple[str, object]) -> str:
    """An entry of a scene in words."""
    name, value = item
    return f"{name} {'left out' if value is None else f'{value:g}' if isinstance(value, float) else value}"


def _as_html(section: Section, file: str) -> str:
    """One section, with the file that holds its table."""
    text = "".join(f'<p class="verdict">{escape(each)}</p>\n' for each in section.sentences)
    shown = [(section.title, section.picture), *section.pictures]
    picture = "".join(html_picture(what, each) for what, each in shown if each)
    table = ""
    if section.rows:
        head = "".join(f"<th>{escape(each)}</th>" for each in section.header)
        body = "".join(f"<tr>{''.join(f'<td>{escape(each)}</td>' for each in row)}</tr>" for row in section.rows)
        table = f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'
        table += f'<p class="soft">Data: <a href="{escape(file)}">{escape(file)}</a></p>'
    return f'<section id="{escape(section.name)}"><h2>{escape(section.title)}</h2>\n{text}{picture}{table}</section>'
