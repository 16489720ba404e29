"""Sections of a report on the case studies."""

from dataclasses import replace
from itertools import product

import numpy as np

from tissue.evaluation.calibration.force_discrimination import (
    Stimulus,
    share_right,
)
from tissue.evaluation.calibration.simulated_observer import draw_observers
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.discrimination import case_table
from tissue.evaluation.study.felt_pairs import PEOPLE, right_percent, specimens
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.needle import needle_section
from tissue.evaluation.study.paper import CASES
from tissue.evaluation.study.section import Section, methods_of, spread
from tissue.haptics.loop.filters import ForceRange
from tissue.materials.constants import constants

__all__ = ["case_sections"]

TEETH = ("carious", "sound")
"""Specimens of the drilling, whose errors differ by more than those of methods."""
TORQUE_STEP_NM = CASES["torque_step_Nm"].mean


def case_sections(folder: StudyFolder, seed: int) -> list[Section]:
    """The case studies that the folder holds."""
    makers = {"needle": needle_section, "reaming": _reaming, "drilling": _drilling}
    tables = {task: case_table(folder, task) for task in makers}
    return [makers[task](table, seed) for task, table in tables.items() if table is not None]


def _reaming(table: TrialTable, seed: int) -> Section:
    """Tracking error in newtons at the reamer, distance from its path, and steps of torque."""
    rows = []
    papers = {"tracking_rms_N": CASES["reaming_rms_N"], "position_error_mm": CASES["reaming_position_mm"]}
    for method in methods_of(table):
        row = [method]
        for metric, paper in papers.items():
            part = table.where(method=method).values(metric)
            row += [spread(part, 3), f"< {paper}", "agrees" if part.max() < paper.mean else "exceeds it"]
        rows.append((*row, str(len(table.where(method=method)))))
    level, scatter = (float(table.values(name).mean()) for name in ("torque_Nm", "torque_scatter_Nm"))
    torque = constants("perception", "torque")
    scale = float(np.median(table.values("force_rms_N") / table.values("tracking_rms_N")))  # of force at the device
    people = draw_observers("expert", PEOPLE, np.random.default_rng(seed))
    kappa = torque["kappa"].value * people.kappa / np.median(people.kappa)
    holders = replace(people, kappa=kappa, offset_N=np.full(PEOPLE, torque["offset_Nm"].value))
    shares = []
    for where, factor in (("at the tool", 1.0), (f"scaled into the device's range by {scale:.2g}", scale)):
        pair = [Stimulus(factor * each, factor * scatter) for each in (level, level + TORQUE_STEP_NM)]
        share = share_right(holders, *pair, seed=seed, limits=ForceRange(limit_N=1e3)).mean()
        shares.append(f"{100.0 * share:.0f} % {where}")
    sentences = (
        f"RMS of the force's tracking error over {rows[0][-1]} trials, in newtons at the reamer, of forces up to "
        f"{float(table.values('peak_force_N').max()) / scale:.1f} N; the paper prints less than "
        f"{papers['tracking_rms_N']} N. The force changes slowly, so that this "
        "depends little on latency. Bone guides the reamer: its distance from the path depends little on hands.",
        f"A step of {TORQUE_STEP_NM} N m on {level:.3f} ± {scatter:.3f} N m is discriminated in {', '.join(shares)} of "
        "the answers, 75 % being the threshold; the paper states that it is felt.",
    )
    return Section("case-reaming", "Case: reaming of a glenoid", sentences,
                   ("method", "tracking RMS N", "paper N", "force against paper", "position error mm", "paper mm",
                    "position against paper", "trials"), tuple(rows))  # fmt: skip


def _drilling(table: TrialTable, seed: int) -> Section:
    """Carious or sound, and latency at 400,000 rpm."""
    paper = CASES["drilling_latency_ms"]
    lags = {method: table.where(method=method).values("latency_ms") for method in methods_of(table)}
    rows = []
    for method, tooth in product(lags, TEETH):
        part = table.where(method=method)
        chosen = part.values("specimen") == TEETH.index(tooth)
        if chosen.any():
            lag, error = part.values("latency_ms")[chosen], 100.0 * part.values("force_error")[chosen]
            rows.append((method, tooth, spread(lag), f"< {paper}", spread(error), str(chosen.sum())))
    pair = specimens(table.where(method=methods_of(table)[0]))
    text = "there are too few trials to discriminate carious from sound"
    if pair is not None:
        shares = right_percent(pair, seed).values()
        carious, sound = pair.less.stimulus.level_N, pair.more.stimulus.level_N
        text = (
            f"carious ({carious:.3f} N at the skin) and sound ({sound:.3f} N) are discriminated in "
            f"{min(shares):.0f} to {max(shares):.0f} % of answers; the paper prints {CASES['caries_right_percent']} %"
        )
    late = [method for method, lag in lags.items() if round(float(lag.mean()), 2) >= paper.mean]
    sentences = (
        f"At 400,000 rpm {text}. The latency is {'not ' if late else ''}below {paper} ms"
        + (f" under {', '.join(late)}" if late else " under every method")
        + ": spin adds none, as the force is the mean over a revolution.",
    )
    header = ("method", "tooth", "latency ms", "paper ms", "force error %", "trials")
    return Section("case-drilling", "Case: drilling of caries", sentences, header, tuple(rows))
