"""Sections of a report on discrimination, and on the case studies."""

from dataclasses import replace
from itertools import product
from textwrap import wrap

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.evaluation.calibration.force_discrimination import (
    Stimulus,
    calibrated_commands,
    gain_of,
    share_right,
)
from tissue.evaluation.calibration.simulated_observer import draw_observers
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.folder import StudyFolder
from tissue.evaluation.study.paper import CASES
from tissue.evaluation.study.section import Section, against, drawing, image, legend, methods_of, spread, tasks_of
from tissue.haptics.device.device import device_parameters
from tissue.haptics.loop.filters import ForceRange
from tissue.materials.constants import constants
from tissue.scene.registry import GROUPS

__all__ = ["case_sections", "discrimination_section"]

Pair = tuple[Stimulus, Stimulus]
PEOPLE = 200
"""Simulated people of each group who compare."""
WIDEST = 12
"""Letters of a line below a pair of bars."""
TORQUE_STEP_NM = CASES["torque_step_Nm"].mean


def discrimination_section(folder: StudyFolder, table: TrialTable, seed: int) -> Section:
    """Who discriminates what, with and without scaling for the person."""
    pairs = {f"{task}: softer or usual": _specimens(table, task) for task in tasks_of(table)}
    if (needle := _case(folder, "needle")) is not None:
        pairs["capsule or parenchyma"] = _sides(needle)
    if (drilling := _case(folder, "drilling")) is not None:
        pairs["carious or sound"] = _specimens(drilling, "drilling")
    rows, gains, shown = [], [], []
    limits = ForceRange(limit_N=device_parameters("touch").force_limit_N)
    for what, group in product(pairs, GROUPS):
        pair = pairs[what]
        if pair is None:
            continue
        rng = np.random.default_rng([seed, GROUPS.index(group)])
        people = draw_observers(group, PEOPLE, rng)
        commands = calibrated_commands(people, rng)
        before = share_right(people, *pair, seed=seed, limits=limits)
        after = share_right(people, *pair, seed=seed, limits=limits, commands=commands)
        gain = gain_of(before, after, rng)
        gains.append(gain.value)
        shown.append((f"{what}\n{group}", before, after))
        levels = [f"{each.level_N:.3f} ± {each.scatter_N:.3f}" for each in sorted(pair, key=lambda each: each.level_N)]
        change = f"{gain.value:+.1f} [{gain.low:+.1f}, {gain.high:+.1f}]"
        rows.append((what, group, *levels, f"{100 * before.mean():.1f}", f"{100 * after.mean():.1f}", change))
    if not rows:
        return Section("discrimination", "Discrimination", ("No pair of specimens has two trials each yet.",))
    sentences = (
        f"Right answers of {PEOPLE} simulated people of each group in two intervals, 50 % being chance. Forces are "
        "those at the device under the penalty method, with their scatter over trials. Scaling for the person changes "
        f"right answers by {min(gains):+.1f} to {max(gains):+.1f} %; the paper prints +18 to +22 %.",
        "A mapping that rises with the force adds no information to a scatter that went through it. It changes only "
        "how far a difference lies above the person's own noise, where their exponent is not the reference's.",
    )
    header = ("what", "group", "less N", "more N", "right %", "right, scaled %", "change %")
    return Section("discrimination", "Discrimination", sentences, header, tuple(rows), _bars(shown))


def case_sections(folder: StudyFolder, seed: int) -> list[Section]:
    """The case studies that the folder holds."""
    makers = {"needle": _needle, "reaming": _reaming, "drilling": _drilling}
    tables = {task: _case(folder, task) for task in makers}
    return [makers[task](table, seed) for task, table in tables.items() if table is not None]


def _needle(table: TrialTable, seed: int) -> Section:
    """Excess travel by group and method, capsule or parenchyma."""
    rows = []
    papers = {"penalty": CASES["overshoot_penalty_mm"], "koopman": CASES["overshoot_koopman_mm"]}
    for method, group in product(methods_of(table), (each for each in GROUPS if each in table.group)):
        part = table.where(method=method, group=group).values("excess_mm")
        rows.append((group, method, spread(part), *against(part, papers.get(method)), str(len(part))))
    pair = _sides(table)
    wrong = {group: 100.0 - share for group, share in _right_percent(pair, seed).items()}
    text = ", ".join(f"{group} {value:.1f} %" for group, value in wrong.items())
    means = {m: float(table.where(method=m).values("excess_mm").mean()) for m in papers if m in table.method}
    sentences = [
        f"Capsule ({pair[0].level_N:.2f} N in the tenth of a second before its puncture) and parenchyma "
        f"({pair[1].level_N:.2f} N after) are confused by {text}; the paper prints less than 10 %: "
        + ("so it is here." if max(wrong.values()) < 10.0 else "here it is more."),
    ]
    if len(means) == 2:
        change = 100.0 * (means["koopman"] / means["penalty"] - 1.0) if means["penalty"] > 0.0 else 0.0
        sentences.append(
            f"After the puncture the tip goes on by {means['penalty']:.2f} mm without prediction and by "
            f"{means['koopman']:.2f} mm with it ({change:+.0f} %; the paper prints -31 %). The hand pushes with a "
            "rising force and stops a reaction after it has felt the force fall. What the springs of grip and coupling "
            "give back at the puncture is part of this travel, whatever the reaction."
        )
    header = ("group", "method", "excess mm", "paper mm", "against paper", "trials")
    return Section("case-needle", "Case: needle", tuple(sentences), header, tuple(rows))


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
    torque, scale = constants("perception", "torque"), 0.03
    people = draw_observers("expert", PEOPLE, np.random.default_rng(seed))
    kappa = torque["kappa"].value * people.kappa / np.median(people.kappa)
    holders = replace(people, kappa=kappa, offset_N=np.full(PEOPLE, torque["offset_Nm"].value))
    shares = []
    for where, factor in (("at the tool", 1.0), ("scaled into the device's range", scale)):
        pair = [Stimulus(factor * each, factor * scatter) for each in (level, level + TORQUE_STEP_NM)]
        share = share_right(holders, *pair, seed=seed, limits=ForceRange(limit_N=1e3)).mean()
        shares.append(f"{100.0 * share:.0f} % {where}")
    sentences = (
        f"RMS of the force's tracking error over {rows[0][-1]} trials, in newtons at the reamer, of forces up to "
        f"{float(table.values('peak_force_N').max()) / scale:.0f} N; the paper prints less than "
        f"{papers['tracking_rms_N']} N. At a feed of half a millimetre a second the force changes slowly, so that this "
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
    rows = tuple(
        (method, spread(lag), f"< {paper}", spread(100.0 * table.where(method=method).values("force_error")))
        for method, lag in lags.items()
    )
    pair = _specimens(table, "drilling")
    text = "there are too few trials to discriminate carious from sound"
    if pair is not None:
        shares = _right_percent(pair, seed).values()
        text = (
            f"carious ({pair[0].level_N:.3f} N at the device) and sound ({pair[1].level_N:.3f} N) are discriminated in "
            f"{min(shares):.0f} to {max(shares):.0f} % of answers; the paper prints {CASES['caries_right_percent']} %"
        )
    late = [method for method, lag in lags.items() if round(float(lag.mean()), 2) >= paper.mean]
    sentences = (
        f"At 400,000 rpm {text}. The latency is {'not ' if late else ''}below {paper} ms"
        + (f" under {', '.join(late)}" if late else " under every method")
        + ": spin adds none, as the force is the mean over a revolution.",
    )
    header = ("method", "latency ms", "paper ms", "force error %")
    return Section("case-drilling", "Case: drilling of caries", sentences, header, rows)


def _right_percent(pair: Pair, seed: int) -> dict[str, float]:
    """Right answers of simulated people by group [%]."""
    rngs = {group: np.random.default_rng([seed, index]) for index, group in enumerate(GROUPS)}
    people = {group: draw_observers(group, PEOPLE, rng) for group, rng in rngs.items()}
    return {group: 100.0 * float(share_right(each, *pair, seed=seed).mean()) for group, each in people.items()}


def _specimens(table: TrialTable, task: str) -> Pair | None:
    """Force on the first two specimens of a task, or None where one has less than two trials."""
    part = table.where(task=task)
    part = part.where(method="penalty" if "penalty" in part.method else part.method[0])
    levels = [part.values("level_N")[part.values("specimen") == index] for index in (0.0, 1.0)]
    return (_level(levels[0]), _level(levels[1])) if min(map(len, levels)) >= 2 else None


def _sides(needle: TrialTable) -> Pair:
    """Force before and after the capsule's puncture."""
    return _level(needle.values("capsule_N")), _level(needle.values("parenchyma_N"))


def _level(values: Array) -> Stimulus:
    """Mean and scatter over trials."""
    return Stimulus(float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else 0.0)


def _case(folder: StudyFolder, task: str) -> TrialTable | None:
    """Trials of a case study that did not fail, or None."""
    try:
        table = folder.table(task).complete()
    except InputError:
        return None
    return table if len(table) else None


def _bars(shown: list[tuple[str, Array, Array]]) -> bytes:
    """Right answers before and after scaling, with 95 % intervals over people."""
    figure, (axes,) = drawing(11.0, 4.4)
    names, before, after = zip(*shown, strict=True)
    for shift, colour, what, shares in ((-0.2, "#999999", "as it is", before),
                                        (0.2, "#009E73", "scaled for the person", after)):  # fmt: skip
        means = 100.0 * np.mean(shares, axis=1)
        half = 196.0 * np.std(shares, axis=1, ddof=1) / PEOPLE**0.5
        at = np.arange(len(shown)) + shift
        axes.bar(at, means, 0.38, color=colour, label=what)
        axes.errorbar(at, means, half, fmt="none", ecolor="#333333", capsize=2, lw=1.0)
    axes.axhline(50.0, color="black", lw=0.8, ls=":")
    words = ["\n".join(line for part in name.splitlines() for line in wrap(part, WIDEST)) for name in names]
    axes.set_xticks(range(len(shown)), words, fontsize=8)
    axes.set_ylim(0.0, 100.0)
    axes.set_ylabel("right answers / %; dotted: by guessing")
    legend(figure, axes)
    return image(figure)
