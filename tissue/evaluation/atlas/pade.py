"""E4: a first-order Padé delay promises stiffness that runs away once the delay is long."""

from dataclasses import replace
from math import sqrt

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, divided, panel
from tissue.evaluation.atlas.page import Answer, Data, Page, Verdict, error_of, refused, shown
from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m, judge, require_stable
from tissue.haptics.loop.sampled_loop import WallLoop
from tissue.haptics.loop.stability_bounds import pade_bound_N_m
from tissue.haptics.loop.stability_map import growth_while_running, measured_critical_N_m

__all__ = ["PAGE"]

LOOPS = {
    "free": WallLoop(mass_kg=0.05, damping_N_s_m=5.0, stiffness_N_m=1.0),
    "damped": WallLoop(mass_kg=0.05, damping_N_s_m=0.1, wall_damping_N_s_m=5.0, stiffness_N_m=1.0),
}
"""A device with its own damping, and one whose damping is the wall's and comes late."""
TITLES = {"free": "device 50 g, 5 N s/m", "damped": "device 50 g, 0.1 N s/m; wall 5 N s/m"}
LONGEST_S = {"free": 40e-3, "damped": 8e-3}


def measure(quick: bool) -> Data:
    """Critical stiffness over delay: left to run, by eigenvalues, by the Padé delay with and without the hold."""
    data: Data = {}
    for name, loop in list(LOOPS.items())[int(quick) :]:
        delays = np.linspace(0.5e-3, LONGEST_S[name], 4 if quick else 16)
        loops = [replace(loop, delay_s=delay) for delay in delays.tolist()]
        data[name] = {
            "delay_s": delays,
            "measured_N_m": measured_critical_N_m(loops, ticks=1200 if quick else 4000),
            "exact_N_m": np.array([critical_stiffness_N_m(each) for each in loops]),
            "pade_N_m": np.array([pade_bound_N_m(each) for each in loops]),
            "pade_without_hold_N_m": np.array([pade_bound_N_m(each, hold=False) for each in loops]),
        }
    return data


def judge_pade(data: Data) -> Verdict:
    """How far the Padé line promises too much, and how far eigenvalues are from what runs."""
    promised = {name: table["pade_N_m"] / table["measured_N_m"] for name, table in data.items()}
    name = max(promised, key=lambda key: float(promised[key].max()))
    at = int(np.argmax(promised[name]))
    excess = float(promised[name][at]) - 1.0
    turn = sqrt(data[name]["pade_N_m"][at] / LOOPS[name].mass_kg) * data[name]["delay_s"][at]
    short = min(abs(ratio[0] - 1.0) for ratio in promised.values())
    off = max(error_of(table["exact_N_m"], table["measured_N_m"]) for table in data.values())
    return Verdict(
        excess > 0.05,
        off < 0.01,
        f"The Padé delay promises up to {100 * excess:.0f} % more stiffness than runs without growing (there "
        f"ωt = {turn:.1f}); with the shortest delay it is {100 * short:.1f} % off. The eigenvalues with the exact "
        f"delay are within {100 * off:.2f} % of what was measured everywhere.",
    )


def ask() -> list[Answer]:
    """The engine just inside the Padé line and just inside the eigenvalues' one."""
    loop = replace(LOOPS["damped"], delay_s=4e-3)
    promised, critical = pade_bound_N_m(loop), critical_stiffness_N_m(loop)
    good = loop.with_stiffness(0.98 * critical)
    fades = float(growth_while_running([good], np.array([good.stiffness_N_m]))[0])
    return [
        refused("98 % of what the Padé delay promises", lambda: require_stable(loop.with_stiffness(0.98 * promised))),
        shown(
            "98 % of the eigenvalues' critical stiffness",
            judge(good).stable and fades < 1.0,
            f"accepted; left to run the amplitude changes {fades:.2g}-fold",
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Stiffness over delay."""
    for axes, (name, table) in zip(chart.subplots(1, len(data), squeeze=False)[0], data.items(), strict=True):
        delay, exact = 1e3 * table["delay_s"], table["exact_N_m"]
        low, high = 0.5 * exact.min(), 2.0 * exact.max()
        divided(axes, delay, exact, low, high)
        panel(axes, delay, "delay added to the hold / ms", "critical stiffness / (N/m)", [
            ("Padé, hold left out", table["pade_without_hold_N_m"], ":", ORANGE),
            ("Padé (printed)", table["pade_N_m"], "--", RED),
            ("eigenvalues, exact delay", exact, "-", GREY),
            ("measured", table["measured_N_m"], "o", BLUE),
        ], log="y", conduct=(), title=TITLES[name], ylim=(low, high))  # fmt: skip


PAGE = Page(
    "pade",
    "E4 · May a first-order Padé delay decide about stability?",
    "A published analysis replaces the delay by (1 − ts/2)/(1 + ts/2) and reads the stable stiffness from that. Does a "
    "loop left to run agree?",
    "Statement E4; growth measured over 4000 ticks from a push",
    measure,
    judge_pade,
    ask,
    draw,
)
