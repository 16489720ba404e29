"""Report sections on the three case studies: needle, reaming and drilling."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from math import inf, isfinite

import numpy as np
from scipy.stats import binom

from meshes.base.arrays import Array
from meshes.base.errors import counted
from tissue.evaluation.calibration.observers import Stimulus, draw_observers, share_right
from tissue.evaluation.looks import looks
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.discrimination import PEOPLE, case_table
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.plan import TASKS
from tissue.evaluation.study.section import (
    CASES,
    Section,
    drawing,
    image,
    methods_of,
    spread,
)
from tissue.haptics.loop.filters import ForceRange
from tissue.materials.constants import constants
from tissue.scene.registry import GROUPS

TEETH = ("carious", "sound")
"""Names of the two specimens (teeth) of the drilling task.

The specimens are reported separately, because their errors differ more than the errors of different
methods.
"""
TORQUE_STEP_NM = CASES["torque_step_Nm"].mean


def case_sections(folder: StudyFolder, seed: int) -> list[Section]:
    """Return a report section for each case study that has trials in a study's folder."""
    makers: dict[str, Callable[[TrialTable], Section]] = {
        "needle": needle_section,
        "reaming": partial(_reaming, seed=seed),
        "drilling": _drilling,
    }
    tables = {task: case_table(folder, task) for task in makers}
    return [makers[task](table) for task, table in tables.items() if table is not None]


def _reaming(table: TrialTable, seed: int) -> Section:
    """Report force error, path error and discrimination of torques for the reaming task."""
    force = CASES["reaming_rms_N"]
    rows = []
    for method in methods_of(table):
        part = table.where(method=method)
        rms = part.values("tracking_rms_N")
        off = part.values("position_error_mm")
        rows.append(
            {
                "method": method,
                "tracking RMS N": spread(rms, 3),
                "paper N": f"< {force}",
                "against paper": "agrees" if rms.max() < force.mean else "exceeds the paper's",
                "position error mm": spread(off, 3),
                "trials": str(len(part)),
            }
        )
    level, scatter = (table.values(name).mean() for name in ("torque_Nm", "torque_scatter_Nm"))
    torque = constants("perception", "torque")
    # of force at the device
    scale = np.median(table.values("force_rms_N") / table.values("tracking_rms_N"))
    people = draw_observers("expert", PEOPLE, np.random.default_rng(seed))
    kappa = torque["kappa"].value * people.kappa / np.median(people.kappa)
    holders = replace(people, kappa=kappa, offset_N=np.full(PEOPLE, torque["offset_Nm"].value))
    shares = []
    for where, factor in (
        ("at the tool", 1.0),
        (f"scaled into the device's range by {scale:.2g}", scale),
    ):
        pair = [
            Stimulus(factor * each, factor * scatter) for each in (level, level + TORQUE_STEP_NM)
        ]
        # torques in N m are passed as forces in N: no limit of a device applies
        share = share_right(holders, *pair, seed=seed, limits=ForceRange(limit_N=1e3)).mean()
        shares.append(f"{100.0 * share:.0f} % {where}")
    sentences = (
        f"RMS of the force's tracking error over {rows[0]['trials']} trials, in newtons at the "
        f"reamer, of forces up to {table.values('peak_force_N').max() / scale:.1f} N. The "
        f"paper states less than {force} N. The force changes slowly, so the error depends little "
        "on latency. Bone guides the reamer, so its distance from the path depends little on the "
        "hand.",
        f"A step of {TORQUE_STEP_NM} N m on {level:.3f} N m (SD {scatter:.3f}) is discriminated in "
        f"{', '.join(shares)} of the answers (threshold: 75 %). The paper states that this step "
        "is felt.",
    )
    return Section("case-reaming", "Case: reaming of a glenoid", sentences, rows)


def _drilling(table: TrialTable) -> Section:
    """Report latency and force error of the drilling task, in carious and in sound teeth."""
    rows = []
    lags = []
    for method in methods_of(table):
        part = table.where(method=method)
        lag = part.values("latency_ms")
        lags.append(f"{method} {lag.mean():.1f} ms")
        for number, tooth in enumerate(TEETH):
            chosen = part.values("specimen") == number
            if chosen.any():
                rows.append(
                    {
                        "method": method,
                        "tooth": tooth,
                        "latency ms": spread(lag[chosen]),
                        "force error %": spread(100.0 * part.values("force_error")[chosen]),
                        "trials": str(chosen.sum()),
                    }
                )
    sentences = (
        f"At 400,000 rpm the mean lag is {', '.join(lags)}. The spin adds no lag, because the "
        "force is the mean over a revolution.",
        _difference("drilling"),
    )
    return Section("case-drilling", "Case: drilling of caries", sentences, rows)


def travel_by_people(needle: TrialTable, method: str) -> Array:
    """Return each person's median needle travel after the puncture [mm], shape (people,).

    A trial in which the person did not notice the puncture counts as infinite travel.
    """
    part = needle.where(method=method)
    travel = np.where(part.values("noticed") > 0.0, part.values("excess_mm"), inf)
    people = part.people()
    with np.errstate(invalid="ignore"):  # between two that are infinite
        medians = [_middle(np.sort(travel[people == each])) for each in np.unique(people)]
    return np.array(medians)


def median_interval(values: Array) -> tuple[float, float, float]:
    """Return the median, and the ends of its rank-based 95 % interval.

    Values may be infinite. The interval extends from the k-th smallest to the k-th largest of the n
    values. Let X be a binomial variable with n draws of probability 0.5. k is the largest number
    for which X < k has a probability of at most 2.5 %. The coverage is therefore at least 95 %. For
    fewer than six values there is no such interval, and infinite ends are returned.
    """
    ordered = np.sort(values)
    rank = int(binom.ppf(0.025, len(ordered), 0.5))
    # of five values, even the whole range misses the median with a probability of 2 / 2^5 = 6 %
    if len(ordered) < 6:
        return _middle(ordered), -inf, inf
    return _middle(ordered), ordered[rank - 1], ordered[len(ordered) - rank]


def needle_section(table: TrialTable) -> Section:
    """Report the needle's travel after the puncture, and the number of noticed punctures."""
    rows = []
    groups = (each for each in GROUPS if each in table.group)
    for method, group in product(methods_of(table), groups):
        part = table.where(method=method, group=group)
        noticed = part.values("noticed") > 0.0
        travel = part.values("excess_mm")
        row = {
            "group": group,
            "method": method,
            "noticed": f"{noticed.sum()} of {len(noticed)}",
            "median": _travel_text(_middle(np.sort(np.where(noticed, travel, inf)))),
        }
        if noticed.any():
            row["mean of noticed mm"] = spread(travel[noticed])
        rows.append(row)
    shared = table.shared()
    finding = (
        "There is no trial in which the capsule broke before the hand stopped under every method."
    )
    headline = finding
    picture = b""
    if len(shared):
        text, headline, picture = _travels(shared)
        count = len(shared.where(method=methods_of(shared)[0]))
        finding = (
            f"Of {counted(count, 'trial')} in which the capsule broke before the hand stopped "
            f"under every method, {text}."
        )
    sentences = [
        finding,
        "A puncture that the person does not notice counts as the longest travel. The median is "
        "therefore over all people, and the mean is over the people who noticed. The hand pushes "
        "with a rising force, and stops one reaction time after it has felt the force fall. At the "
        "puncture, the springs of grip and coupling release energy. The motion that they cause is "
        "part of this travel.",
        _difference("needle"),
    ]
    return Section("case-needle", "Case: needle", sentences, rows, picture, headline)


def _difference(task: str) -> str:
    """Return the reason why the results of a task are not compared with the published study."""
    return f"No figure here is compared with the paper's: {TASKS[task].known_difference}."


def _travel_text(travel_mm: float) -> str:
    return f"{travel_mm:.2f} mm" if isfinite(travel_mm) else "not noticed"


def _travels(shared: TrialTable) -> tuple[str, str, bytes]:
    """Report needle travel and fraction of noticed punctures by method.

    Return a text with the medians over people, a sentence with the range over methods, and a
    picture (PNG).
    """
    found = []
    medians = []
    shares = []
    ends = []
    methods = methods_of(shared)
    # 0.4 inches a line, 1.4 for axis and label
    styles = looks(methods)
    figure, (axes,) = drawing(9.0, 0.4 * len(methods) + 1.4)
    for line, method in enumerate(methods):
        middle, low, high = median_interval(travel_by_people(shared, method))
        noticed = 100.0 * shared.where(method=method).values("noticed").mean()
        medians.append(middle)
        shares.append(noticed)
        bounds = f" [{_travel_text(low)}, {_travel_text(high)}]" if low > -inf else ""
        found.append(
            f"the puncture is noticed in {noticed:.0f} % with {method} (median travel over people: "
            f"{_travel_text(middle)}{bounds})"
        )
        # too few people for an interval: only the point
        colour, marker = styles[method]
        if low > -inf:
            axes.plot([low, high], [line, line], color=colour)
            ends.append(high)
        ends.append(middle)
        axes.plot(middle, line, marker, color=colour, mec="black")
    axes.set_yticks(range(len(methods)), methods)
    axes.invert_yaxis()
    # an infinite end lies outside the axes; 5 % of space beyond the largest finite end
    axes.set_xlim(0.0, 1.05 * max((each for each in ends if isfinite(each)), default=1.0))
    axes.set_xlabel("travel after the puncture / mm, median over people with its 95 % interval")
    best = medians.index(min(medians))
    worst = medians.index(max(medians))
    headline = (
        "The median over people of the needle's travel after the puncture is "
        f"{_travel_text(medians[best])} ({methods[best]}) to {_travel_text(medians[worst])} "
        f"({methods[worst]}), and at least {min(shares):.0f} % of the punctures are noticed under "
        "every method."
    )
    return "; ".join(found), headline, image(figure)


def _middle(ordered: Array) -> float:
    """Return the median of sorted values, some of which may be infinite."""
    low = ordered[(len(ordered) - 1) // 2]
    high = ordered[len(ordered) // 2]
    return low if low == high else 0.5 * (low + high)
