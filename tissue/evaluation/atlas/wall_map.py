"""Stiffness against damping, delay and rate: where a wall on a device rings, measured and by eigenvalues."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tissue.evaluation.atlas.drawing import BLUE, GREEN, GREY, ORANGE, PINK, divided, finish
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.haptics.device.device import device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m, in_hands
from tissue.haptics.loop.filters import ForceRange
from tissue.haptics.loop.sampled_loop import WallLoop
from tissue.haptics.loop.stability_bounds import delay_bound_N_m, pade_bound_N_m, passive_bound_N_m
from tissue.haptics.loop.stability_map import measured_critical_N_m
from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["WALL_MAP"]

LOOP = in_hands(device_parameters("six-dof").loop(1.0), [hand_parameters("expert").grip[:3]])[0]
"""The device of six degrees of freedom in an expert's hand."""
AXES = {
    "damping": ("virtual damping / (N s/m)", 1.0),
    "delay": ("delay added to the hold / ms", 1e3),
    "rate": ("rate / Hz", 1.0),
}


def loops(along: str, quick: bool) -> tuple[np.ndarray, list[WallLoop]]:
    """Values of what is varied, and the loops."""
    count = 3 if quick else 7
    if along == "damping":
        values = np.linspace(0.0, 60.0, count)
        return values, [replace(LOOP, wall_damping_N_s_m=value) for value in values.tolist()]
    if along == "delay":
        values = np.linspace(0.0, 8e-3, count)
        return values, [replace(LOOP, delay_s=value) for value in values.tolist()]
    values = np.array([250.0, 1000.0, 4000.0]) if quick else np.geomspace(250.0, 8000.0, 5)
    return values, [replace(LOOP, tick_s=1.0 / value) for value in values.tolist()]


def measure(quick: bool) -> Data:
    """Boundaries over damping, delay and rate."""
    data: Data = {}
    ticks = 800 if quick else 1600
    for along in ("delay",) if quick else AXES:
        values, swept = loops(along, quick)
        together = [swept] if along != "rate" else [[each] for each in swept]  # loops that run at once share a tick
        data[along] = {
            along: values,
            "measured_N_m": np.concatenate([measured_critical_N_m(group, ticks=ticks) for group in together]),
            "exact_N_m": np.array([critical_stiffness_N_m(each) for each in swept]),
            "passive_N_m": np.array([passive_bound_N_m(each) for each in swept]),
            "first_order_N_m": np.array([delay_bound_N_m(each) for each in swept]),
            "pade_N_m": np.array([pade_bound_N_m(each) for each in swept]),
        }
    return data


def judge(data: Data) -> Verdict:
    """How far each line is from what was measured."""
    off = max(float(np.abs(t["exact_N_m"] / t["measured_N_m"] - 1.0).max()) for t in data.values())
    passive = all(bool((t["passive_N_m"] <= 1.001 * t["measured_N_m"]).all()) for t in data.values())
    unsafe = {
        name: max(float((t[f"{name}_N_m"] / t["measured_N_m"]).max()) for t in data.values())
        for name in ("first_order", "pade")
    }
    low = min(float(t["measured_N_m"].min()) for t in data.values())
    high = max(float(t["measured_N_m"].max()) for t in data.values())
    return Verdict(
        max(unsafe.values()) > 1.05 and high > 2.0 * low,
        off < 0.01 and passive,
        f"The wall rings from {low:.0f} to {high:.0f} N/m on, and eigenvalues predict where to {100 * off:.2f} %. The "
        f"passive bound is never passed; K = (b+B)/(T/2+t) promises up to {unsafe['first_order']:.1f} times, Padé up "
        f"to {unsafe['pade']:.1f} times what holds.",
    )


def ask() -> list[Answer]:
    """A scene beyond the boundary, and one within it."""

    def scene(stiffness: float) -> object:
        changed = {"device": "six-dof", "hand": "expert", "coupling.stiffness_N_m": stiffness, "duration_s": 0.3}
        return simulate(load_scene("wall", changed))

    run = simulate(load_scene("wall", {"device": "six-dof", "hand": "expert", "duration_s": 0.6}))
    limit = device_parameters("six-dof").force_limit_N
    force = float(np.linalg.norm(run.trace.vectors("device_force", "N"), axis=1).max())
    margin = float(run.trace["margin"][-1])
    played, compressed = ForceRange(limit_N=limit).play(np.array([0.0, 0.0, 5.0 * limit]))
    return [
        refused("the scene wall at 6 kN/m", lambda: scene(6000.0)),
        shown(
            "the same scene without a stiffness of its own",
            force <= limit and margin > 0.0,
            f"a stable one is chosen, {100 * margin:.0f} % below the critical stiffness; {force:.2f} N at most",
        ),
        shown(
            "five times the force that the device can play",
            compressed and float(played[2]) < limit,
            f"compressed to {played[2]:.2f} of {limit:g} N, and reported",
            conduct=Conduct.FALLS_BACK,
        ),
    ]


def draw(data: Data, chart: "Figure") -> None:
    """One panel for each of damping, delay and rate."""
    panels = chart.subplots(1, len(data), squeeze=False, sharey=True)[0]
    low = 0.3 * min(t["passive_N_m"][t["passive_N_m"] > 0.0].min() for t in data.values())
    high = 3.0 * max(t["exact_N_m"].max() for t in data.values())
    for axes, (along, table) in zip(panels, data.items(), strict=True):
        label, scale = AXES[along]
        across = scale * table[along]
        divided(axes, across, table["exact_N_m"], low, high)
        axes.semilogy(across, table["exact_N_m"], color=GREY, label="eigenvalues")
        axes.semilogy(across, np.where(table["passive_N_m"] > 0.0, table["passive_N_m"], np.nan), "--", color=GREEN,
                      label="passive")  # fmt: skip
        axes.semilogy(across, table["first_order_N_m"], "-.", color=ORANGE, label="first order in delay")
        axes.semilogy(across, table["pade_N_m"], ":", color=PINK, label="Padé")
        axes.semilogy(across, table["measured_N_m"], "o", color=BLUE, label="measured")
        first = axes is panels[0]
        finish(axes, label, "stiffness / (N/m)" if axes is panels[0] else "", legend="lower right" if first else "",
               ylim=(low, high), xscale="log" if along == "rate" else "linear")  # fmt: skip


WALL_MAP = Page(
    "wall_map",
    "Stiffness × delay × damping × rate",
    "A device of six degrees of freedom in an expert's hand on a virtual wall: from which stiffness on does it ring, "
    "over damping, delay and rate, and which line of theory predicts it?",
    "Colgate and Schenkel (1997), Gil et al. (2009); device and hand of the engine's data files",
    measure,
    judge,
    ask,
    draw,
)
