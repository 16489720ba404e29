"""Critical stiffness of a wall over damping, delay and rate: measured, by eigenvalues and by
simpler bounds.
"""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.page import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    TINTS,
    Answer,
    Conduct,
    Data,
    Page,
    Verdict,
    error_of,
    panel,
    refused,
    shown,
)
from tissue.haptics.device.device import device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.haptics.loop.critical_stiffness import (
    critical_stiffness_N_m,
    delay_bound_N_m,
    in_hands,
    pade_bound_N_m,
    passive_bound_N_m,
)
from tissue.haptics.loop.filters import ForceRange
from tissue.haptics.loop.sampled_loop import WallLoop
from tissue.haptics.loop.stability_map import measured_critical_N_m
from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate

__all__ = ["PAGE"]

LOOP = in_hands(device_parameters("six-dof").loop(1.0), [hand_parameters("expert").grip[:3]])[0]
"""Device with six degrees of freedom in an expert's hand."""
AXES = {
    "damping": ("virtual damping / (N s/m)", 1.0, np.linspace(0.0, 60.0, 7)),
    "delay": ("delay added to the hold / ms", 1e3, np.linspace(0.0, 8e-3, 7)),
    "rate": ("rate / Hz", 1.0, np.geomspace(250.0, 8000.0, 5)),
}
"""Label, factor to its unit, and values of each axis."""


def loops(along: str, values: Array) -> list[WallLoop]:
    """Return the loop with one parameter at each value."""
    if along == "rate":
        return [replace(LOOP, tick_s=1.0 / value) for value in values.tolist()]
    name = {"damping": "wall_damping_N_s_m", "delay": "delay_s"}[along]
    return [replace(LOOP, **{name: value}) for value in values.tolist()]


def measure(quick: bool) -> Data:
    """Sweep damping, delay and rate."""
    data: Data = {}
    for along in ("delay",) if quick else AXES:
        values = AXES[along][2][:: 3 if quick else 1]
        swept = loops(along, values)
        # Loops that run together share a tick.
        groups = [[each] for each in swept] if along == "rate" else [swept]
        measured = [measured_critical_N_m(group, ticks=800 if quick else 1600) for group in groups]
        data[along] = {
            along: values,
            "measured_N_m": np.concatenate(measured),
            "exact_N_m": np.array([critical_stiffness_N_m(each) for each in swept]),
            "passive_N_m": np.array([passive_bound_N_m(each) for each in swept]),
            "first_order_N_m": np.array([delay_bound_N_m(each) for each in swept]),
            "pade_N_m": np.array([pade_bound_N_m(each) for each in swept]),
        }
    return data


def judge(data: Data) -> Verdict:
    """Compare every bound with the measured critical stiffness."""
    names = ("measured_N_m", "exact_N_m", "passive_N_m", "first_order_N_m", "pade_N_m")
    measured, exact, *bounds = (
        np.concatenate([table[name] for table in data.values()]) for name in names
    )
    off = error_of(exact, measured)
    passive, first_order, pade = (float((bound / measured).max()) for bound in bounds)
    return Verdict(
        max(first_order, pade) > 1.05 and measured.max() > 2.0 * measured.min(),
        off < 0.01 and passive <= 1.001,
        f"The wall rings from {measured.min():.0f} to {measured.max():.0f} N/m on. "
        "Eigenvalues predict this to "
        f"{100 * off:.2f} %. The passive bound never exceeds it. K = (b+B)/(T/2+t) allows up "
        f"to {first_order:.1f} "
        f"times, Padé up to {pade:.1f} times the measured stiffness.",
    )


def ask() -> list[Answer]:
    """Run a scene beyond its critical stiffness, and one at the default stiffness."""
    chosen = {"device": "six-dof", "hand": "expert", "duration_s": 0.6}
    stiff = chosen | {"coupling.stiffness_N_m": 6000.0}
    run = simulate(load_scene("wall", chosen))
    limit = device_parameters("six-dof").force_limit_N
    force = float(np.linalg.norm(run.trace.vectors("device_force", "N"), axis=1).max())
    margin = float(run.trace["margin"][-1])
    played, compressed = ForceRange(limit_N=limit).play(np.array([0.0, 0.0, 5.0 * limit]))
    return [
        refused("the scene wall at 6 kN/m", lambda: simulate(load_scene("wall", stiff))),
        shown(
            "the scene wall with its default stiffness",
            force <= limit and margin > 0.0,
            (
                f"a stable stiffness is chosen, {100 * margin:.0f} % below the critical one; at "
                f"most {force:.2f} N"
            ),
        ),
        shown(
            "five times the force limit of the device",
            compressed and float(played[2]) < limit,
            f"compressed to {played[2]:.2f} of {limit:g} N, and reported",
            conduct=Conduct.FALLS_BACK,
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Draw one panel each for damping, delay and rate."""
    panels = chart.subplots(1, len(data), squeeze=False, sharey=True)[0]
    low = 0.3 * min(t["passive_N_m"][t["passive_N_m"] > 0.0].min() for t in data.values())
    high = 3.0 * max(t["exact_N_m"].max() for t in data.values())
    for axes, (along, table) in zip(panels, data.items(), strict=True):
        label, scale, _ = AXES[along]
        across = scale * table[along]
        exact = table["exact_N_m"]
        is_first = axes is panels[0]
        axes.fill_between(
            across, low, exact, color=TINTS[Conduct.HOLDS], zorder=0, label="engine holds"
        )
        axes.fill_between(
            across, exact, high, color=TINTS[Conduct.REFUSES], zorder=0, label="engine refuses"
        )
        panel(
            axes,
            across,
            (label, "stiffness / (N/m)" if is_first else ""),
            [
                ("eigenvalues", exact, "-", GREY),
                (
                    "passive",
                    np.where(table["passive_N_m"] > 0.0, table["passive_N_m"], np.nan),
                    "--",
                    GREEN,
                ),
                ("first order in delay", table["first_order_N_m"], "-.", ORANGE),
                ("Padé", table["pade_N_m"], ":", PINK),
                ("measured", table["measured_N_m"], "o", BLUE),
            ],
            conduct=(),
            log="xy" if along == "rate" else "y",
            legend="lower right" if is_first else "",
            ylim=(low, high),
        )


PAGE = Page(
    "wall_map",
    "Stiffness × delay × damping × rate",
    "A device with six degrees of freedom in an expert's hand touches a virtual wall. From "
    "which stiffness on does it "
    "ring, over damping, delay and rate, and which bound predicts it?",
    "Colgate and Schenkel (1997), Gil et al. (2009); device and hand of the engine's data files",
    measure,
    judge,
    ask,
    draw,
)
