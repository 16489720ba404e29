"""Section of a report on the needle: how far it goes on after its puncture, of all people and of those who notice."""

from itertools import product
from math import inf, isfinite

import numpy as np

from meshes.base.arrays import Array
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.felt_pairs import right_percent, sides
from tissue.evaluation.study.paper import CASES
from tissue.evaluation.study.section import Section, against, methods_of, spread
from tissue.scene.registry import GROUPS

__all__ = ["PAPERS", "as_text", "median_interval", "needle_section", "noticed_percent", "travel_by_people"]

PAPERS = {"penalty": CASES["overshoot_penalty_mm"], "koopman": CASES["overshoot_koopman_mm"]}
"""The paper's travel by method, a mean with its standard deviation."""


def travel_by_people(needle: TrialTable, method: str) -> Array:
    """Median of each person's travel after the puncture [mm], infinite where they did not notice, shape (people,)."""
    part = needle.where(method=method)
    travel = np.where(part.values("noticed") > 0.0, part.values("excess_mm"), inf)
    people = part.people()
    with np.errstate(invalid="ignore"):  # between two that are infinite
        medians = [_middle(np.sort(travel[people == each])) for each in np.unique(people)]
    return np.array(medians)


def median_interval(values: Array) -> tuple[float, float, float]:
    """Median and its interval of at least 95 %, by ranks, so that values may be infinite.

    The interval reaches from the k-th smallest value to the k-th largest, k being the greatest for which a binomial
    count of n at 0.5 lies below k with at most 2.5 %; of fewer than six values there is none, and it is infinite.
    """
    from scipy.stats import binom

    ordered = np.sort(values)
    rank = int(binom.ppf(0.025, len(ordered), 0.5))
    if len(ordered) < 6:
        return _middle(ordered), -inf, inf
    return _middle(ordered), float(ordered[rank - 1]), float(ordered[len(ordered) - rank])


def noticed_percent(needle: TrialTable, method: str) -> float:
    """Share of a method's punctures that are noticed [%]."""
    return 100.0 * float(needle.where(method=method).values("noticed").mean())


def needle_section(table: TrialTable, seed: int) -> Section:
    """Travel by group and method, who notices, and capsule or parenchyma."""
    rows = []
    for method, group in product(methods_of(table), (each for each in GROUPS if each in table.group)):
        part = table.where(method=method, group=group)
        noticed = part.values("noticed") > 0.0
        felt = part.values("excess_mm")[noticed]
        middle = as_text(_middle(np.sort(np.where(noticed, part.values("excess_mm"), inf))))
        means = (spread(felt), *against(felt, PAPERS.get(method))) if len(felt) else ("", "", "")
        rows.append((group, method, f"{noticed.sum()} of {len(noticed)}", middle, *means))
    pair = sides(table.where(method=methods_of(table)[0]))
    sentences = ["There are too few trials to discriminate capsule from parenchyma."]
    if pair is not None:
        wrong = {group: 100.0 - share for group, share in right_percent(pair, seed).items()}
        text = ", ".join(f"{group} {value:.1f} %" for group, value in wrong.items())
        sentences = [
            f"Capsule ({pair.more.stimulus.level_N:.2f} N at the skin in the tenth of a second before its puncture) "
            f"and parenchyma ({pair.less.stimulus.level_N:.2f} N after) are confused by {text}; the paper prints less "
            "than 10 %: " + ("so it is here." if max(wrong.values()) < 10.0 else "here it is more."),
        ]
    shared = table.shared()
    sentences.append(
        f"Of {len(shared.where(method=methods_of(shared)[0]))} trials in which the capsule broke before the hand "
        f"stopped under every method, {_noticing(shared)}."
        if len(shared)
        else "There is no trial in which the capsule broke before the hand stopped under every method."
    )
    sentences.append(
        "A puncture that nobody notices counts as the longest travel, so that the median is of all; the mean is of "
        "those who noticed. The hand pushes with a rising force and stops a reaction after it has felt the force fall. "
        "What the springs of grip and coupling give back at the puncture is part of this travel, whatever the reaction."
    )
    header = ("group", "method", "noticed", "median", "mean of noticed mm", "paper mm", "against paper")
    return Section("case-needle", "Case: needle", tuple(sentences), header, tuple(rows))


def as_text(travel_mm: float) -> str:
    """A travel in words."""
    return f"{travel_mm:.2f} mm" if isfinite(travel_mm) else "not noticed"


def _noticing(shared: TrialTable) -> str:
    """Share of punctures that are noticed and median travel over people, by method."""
    found = []
    for method in methods_of(shared):
        middle, low, high = median_interval(travel_by_people(shared, method))
        bounds = f" [{as_text(low)}, {as_text(high)}]" if low > -inf else ""
        found.append(
            f"{method} lets {noticed_percent(shared, method):.0f} % notice, travel {as_text(middle)}{bounds} in the "
            "median over people"
        )
    return "; ".join(found)


def _middle(ordered: Array) -> float:
    """Median of sorted values, of which some may be infinite."""
    low, high = ordered[(len(ordered) - 1) // 2], ordered[len(ordered) // 2]
    return float(low if low == high else 0.5 * (low + high))
