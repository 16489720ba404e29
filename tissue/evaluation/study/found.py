"""The first section of a report: what was found, in five sentences and three pictures made of the data."""

from collections.abc import Mapping, Sequence

import numpy as np

from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.discrimination import LEAST_D
from tissue.evaluation.study.found_pictures import force_dots, index_dots, overshoot_dots, sensitivity_dots
from tissue.evaluation.study.needle import PAPERS, as_text, median_interval, noticed_percent, travel_by_people
from tissue.evaluation.study.paper import LATENCY
from tissue.evaluation.study.section import Section, methods_of, tasks_of

__all__ = ["found_section"]

PLAIN, BASELINE = "koopman", "penalty"
"""Method of plain scaling, and the one without prediction."""
MOST = 6
"""Deviations from the paper that the last sentence names before it counts the rest."""


def found_section(table: TrialTable | None, needle: TrialTable | None, sections: Sequence[Section]) -> Section:
    """Five sentences and up to three pictures; what the data do not hold is named as missing.

    Parameters
    ----------
    table
        Trials of the compared tasks that did not fail, or None.
    needle
        Trials of the needle that did not fail, or None.
    sections
        The other sections; those on discrimination, index and the registered plan are read, if they are there.
    """
    by_name = {each.name: each for each in sections}
    sensitivity = _sensitivities(by_name.get("discrimination"))
    sentences = (
        _force(table),
        _latency(table),
        _discrimination(sensitivity),
        _overshoot(needle),
        _against(sections, by_name.get("registration")),
    )
    pictures: list[tuple[str, bytes]] = []
    if table is not None and "force_error" in table.metrics:
        pictures.append(("force error at the motor, with its least error", force_dots(table)))
    if sensitivity:
        pictures.append(("discrimination at the skin", sensitivity_dots(sensitivity)))
    if needle is not None and "excess_mm" in needle.metrics:
        pictures.append(("travel of the needle after its puncture", overshoot_dots(needle)))
    elif means := _index_means(by_name.get("index")):
        pictures.append(("composite index", index_dots(means)))
    return Section("found", "What was found", sentences, pictures=tuple(pictures))


def _means(table: TrialTable, metric: str) -> dict[tuple[str, str], float]:
    """Mean over trials by method and task."""
    parts = {(method, task): table.where(task=task) for method in methods_of(table) for task in tasks_of(table)}
    return {
        key: float(part.where(method=key[0]).values(metric).mean())
        for key, part in parts.items()
        if key[0] in part.method
    }


def _by_task(table: TrialTable, metric: str, words: str) -> str:
    """Means of a metric in words, tasks in turn for each method that every task has; ``words`` formats one."""
    means, tasks = _means(table, metric), tasks_of(table)
    rows = {
        method: [words.format(means[method, task]) for task in tasks]
        for method in methods_of(table)
        if all((method, task) in means for task in tasks)
    }
    return "; ".join(f"{method} {', '.join(row)}" for method, row in rows.items())


def _force(table: TrialTable | None) -> str:
    """Error of force at the motor by task: of the baseline and its least error, and what the others leave of it."""
    if table is None or "force_error" not in table.metrics:
        return "No force error was measured, as the study has no trial of a compared task."
    means, tasks = _means(table, "force_error"), tasks_of(table)
    if any((BASELINE, task) not in means for task in tasks):
        return f"The force error at the motor is, in {', '.join(tasks)}, {_by_task(table, 'force_error', '{:.1%}')}."
    least = _means(table, "least_error") if "least_error" in table.metrics else {}
    base = ", ".join(
        f"{task} {100.0 * means[BASELINE, task]:.1f} %" + (f" ({100.0 * least[BASELINE, task]:.1f} %)" if least else "")
        for task in tasks
    )
    left = "; ".join(
        f"{method} {', '.join(f'{means[method, task] / means[BASELINE, task]:.2f}' for task in tasks)}"
        for method in methods_of(table)
        if method != BASELINE and all((method, task) in means for task in tasks)
    )
    remark = "in brackets the least that the encoder allows" if least else "the least error was not measured"
    others = f", of which the others leave {left} in these tasks" if left else ""
    return f"The force error at the motor under {BASELINE} is {base}, {remark}{others}."


def _latency(table: TrialTable | None) -> str:
    """Residual latency by method."""
    if table is None or "latency_ms" not in table.metrics:
        return "No residual latency was measured, as the study has no trial of a compared task."
    return (
        f"The residual latency at the motor is, in {', '.join(tasks_of(table))}, "
        f"{_by_task(table, 'latency_ms', '{:+.1f}')} ms, where below zero the force comes early and the paper prints "
        f"{LATENCY} ms."
    )


def _discrimination(sensitivity: Mapping[tuple[str, str], Sequence[float]]) -> str:
    """Sensitivity d' by method against plain scaling."""
    if not sensitivity:
        return "No discrimination was measured, as people have too few trials on two specimens each."
    methods = list(dict.fromkeys(method for _, method in sensitivity))
    means = {key: float(np.mean(values)) for key, values in sensitivity.items()}
    pairs = list(dict.fromkeys(pair for pair, _ in sensitivity))
    first = PLAIN if PLAIN in methods else methods[0]
    known = [pair for pair in pairs if means.get((pair, first), 0.0) >= LEAST_D]
    levels = ", ".join(f"{pair} {means[pair, first]:.2f}" for pair in pairs if (pair, first) in means)
    changes = "; ".join(
        f"{method} " + ", ".join(f"{100.0 * (means[pair, method] / means[pair, first] - 1.0):+.0f}" for pair in known)
        for method in methods
        if method != first and all((pair, method) in means for pair in known)
    )
    others = f", and changes in % where it is {LEAST_D} or more, in turn, under {changes}" if known and changes else ""
    against = ", where the paper prints +18 to +22 % for scaling" if others else ""
    return f"Discrimination from the force at the skin has, under {first}, a d′ of {levels}{others}{against}."


def _overshoot(needle: TrialTable | None) -> str:
    """Travel of the needle after its puncture by method: the median over people, of whom some do not notice it."""
    if needle is None or "excess_mm" not in needle.metrics or not len(shared := needle.shared()):
        return "No overshoot after a puncture was measured, as the study has no trial of the needle."
    travels = {method: travel_by_people(shared, method) for method in methods_of(shared)}
    medians = {method: median_interval(travel)[0] for method, travel in travels.items()}
    text = ", ".join(
        f"{method} {as_text(medians[method])} ({noticed_percent(shared, method):.0f} % noticed)" for method in travels
    )
    paper = f"{PAPERS['penalty']} mm without prediction and {PAPERS['koopman']} mm with it, -31 %"
    change = ""
    if 0.0 < medians.get(BASELINE, 0.0) < np.inf and np.isfinite(medians.get(PLAIN, np.inf)):
        change = f"; prediction changes it by {100.0 * (medians[PLAIN] / medians[BASELINE] - 1.0):+.0f} %"
    return (
        f"After its puncture the needle goes on, in the median over people, by {text}{change}, where the paper prints "
        f"{paper}."
    )


def _against(sections: Sequence[Section], registration: Section | None) -> str:
    """What does not agree with the paper, and how many differences from the registered plan there are."""
    compared, apart = 0, []
    for section in sections:
        for column in (at for at, name in enumerate(section.header) if name.endswith("against paper")):
            for row in section.rows:
                compared += bool(row[column])
                if row[column] and row[column] != "agrees":
                    what = section.header[column].replace("against paper", "").strip()
                    apart.append(" ".join([section.title.lower(), what, *row[:2], row[column]]).replace("  ", " "))
    if not compared:
        paper = "Nothing could be held against the paper's figures"
    elif apart:
        rest = f" and {len(apart) - MOST} more" if len(apart) > MOST else ""
        paper = (
            f"Of {compared} figures held against the paper {len(apart)} do not agree: {', '.join(apart[:MOST])}{rest}"
        )
    else:
        paper = f"All {compared} figures held against the paper agree with it"
    if registration is None:
        return f"{paper}."
    count = len(registration.rows)
    plan = (
        f"{count} differences from the registered plan are listed below" if count else "nothing differs from the plan"
    )
    if not count and registration.sentences[0].startswith("No plan"):
        plan = "no plan was registered before the trials"
    return f"{paper}; {plan}."


def _sensitivities(section: Section | None) -> dict[tuple[str, str], list[float]]:
    """Values of d' by pair and method over groups, from the rows of the section on discrimination."""
    found: dict[tuple[str, str], list[float]] = {}
    names = ("what", "method", "d′")
    if section is None or not set(names) <= set(section.header):
        return found
    what, method, value = map(section.header.index, names)
    for row in section.rows:
        found.setdefault((row[what], row[method]), []).append(float(row[value]))
    return found


def _index_means(section: Section | None) -> dict[str, tuple[float, float, float]]:
    """Mean, low and high of the composite index by method."""
    if section is None or not section.rows:
        return {}
    return {row[1]: (float(row[2]), float(row[3]), float(row[4])) for row in section.rows if row[0] == "mean"}
