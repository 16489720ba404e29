"""Encoder steps: friction must dissipate the energy that a quantised wall creates, or the device
keeps buzzing.
"""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.page import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    TINTS,
    Answer,
    Conduct,
    Data,
    Page,
    Verdict,
    panel,
    refused,
    shown,
    sweep,
)
from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import HandAction, hand_parameters
from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m, quantised_bound_N_m
from tissue.haptics.rigid_wall import knock
from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate

__all__ = ["PAGE"]

TICK_S = 1e-3
ENCODER_M = 1e-4
DEVICE = DeviceParameters(mass_kg=0.05, damping_N_s_m=1.0, encoder_step_m=ENCODER_M)
"""Device with coarse encoders whose viscous friction alone allows 2 b / T = 2 kN/m."""
SECONDS = 1.0
BUZZ_STEPS = 0.1
"""Swing that counts as buzzing [encoder steps]. A resting device has none."""
PUSHES_N = (0.11, 0.37)
"""Steady pushes onto the wall [N]. They bring the device to rest at different places between two
encoder steps.
"""


class Push:
    """Steady push, with a knock of 2 N in the first tick."""

    def __init__(self, steady_N: float) -> None:
        self._steady = steady_N

    def act(self, time_s: float, position_m: tuple[float, float, float]) -> HandAction:
        """Return the push."""
        return HandAction(
            push_N=(0.0, 0.0, -self._steady - (2.0 if time_s < 0.5 * TICK_S else 0.0))
        )


def swing_steps(stiffness: float, friction: float) -> float:
    """Measure the peak-to-peak position in the last third of the worst push [encoder steps].

    The wall also pulls.
    """
    worst = 0.0
    for steady in PUSHES_N:
        device = SimulatedDevice(replace(DEVICE, friction_N=friction), Push(steady), substeps=3)
        depth = []
        for tick in range(round(SECONDS / TICK_S)):
            sample = device.read(tick * TICK_S)
            measured = 0.0 if sample is None else sample.position_m[2]
            depth.append(device.translation.position[2])
            device.command(np.array([0.0, 0.0, -stiffness * measured]), np.zeros(3))
        worst = max(worst, float(np.ptp(depth[-len(depth) // 3 :])) / ENCODER_M)
    return worst


def measure(quick: bool) -> Data:
    """Sweep friction and stiffness."""
    frictions = np.array([0.003, 0.03]) if quick else np.array([0.003, 0.008, 0.02, 0.04, 0.08])
    ladder = np.geomspace(40.0, 1950.0, 5 if quick else 9)
    swings = np.array([[swing_steps(k, f) for k in ladder.tolist()] for f in frictions.tolist()])
    loop = DEVICE.loop(1.0)
    critical = critical_stiffness_N_m(loop)

    def buzzing(friction: float) -> dict[str, float]:
        """Return the lowest stiffness with buzzing, the highest without, and both bounds."""
        buzzes = swings[frictions == friction][0] > BUZZ_STEPS
        first = int(np.argmax(buzzes)) if buzzes.any() else len(ladder)
        rungs = [0.0, *ladder.tolist(), critical]
        return {
            "buzzes_from_N_m": rungs[first + 1],
            "quiet_to_N_m": rungs[first] if buzzes.any() else critical,
            "bound_N_m": quantised_bound_N_m(loop, friction_N=friction, encoder_m=ENCODER_M),
            "critical_N_m": critical,
        }

    return {
        "friction": sweep("friction_N", frictions, buzzing),
        "swing": {
            "stiffness_N_m": np.tile(ladder, len(frictions)),
            "friction_N": np.repeat(frictions, len(ladder)),
            "swing_steps": swings.ravel(),
        },
    }


def judge(data: Data) -> Verdict:
    """Check for buzzing below the critical stiffness and for quiet below the bound.

    The bound follows from encoder and friction.
    """
    table = data["friction"]
    swing = data["swing"]
    early = float((table["buzzes_from_N_m"] / table["critical_N_m"]).min())
    bound = np.interp(swing["friction_N"], table["friction_N"], table["bound_N_m"])
    inside = swing["stiffness_N_m"] <= bound
    worst = float(swing["swing_steps"][inside].max()) if inside.any() else 0.0
    return Verdict(
        early < 0.5,
        worst <= BUZZ_STEPS,
        f"With little friction the device buzzes from {100 * early:.0f} % of the critical "
        "stiffness of the eigenvalues "
        f"on ({table['critical_N_m'][0]:.0f} N/m), because these do not include encoder "
        "steps. In none of "
        f"{int(inside.sum())} runs within min(2b/T, 2f_c/Δ) is the swing larger than "
        f"{worst:.2f} steps. The bound is "
        "safe and, with some friction, far from tight.",
    )


def answers_of(name: str) -> list[Answer]:
    """Run a device beyond the stiffness that its friction allows, and at its vendor's limit."""
    device = device_parameters(name)
    allowed = 2.0 * device.friction_N / device.encoder_step_m
    run, _ = knock(device, hand_parameters("expert"), "proxy", device.stiffness_limit_N_m)
    ripple = run.ripple_N(0.2)
    beyond = {"device": name, "coupling.stiffness_N_m": allowed, "duration_s": 0.3}
    return [
        refused(
            (
                f"the scene wall on {name} at {allowed:.0f} N/m, the limit of friction over "
                "encoder step"
            ),
            lambda: simulate(load_scene("wall", beyond)),
        ),
        shown(
            f"{name} at its vendor's limit of {device.stiffness_limit_N_m:g} N/m",
            device.stiffness_limit_N_m < allowed and ripple < 0.05,
            f"after a knock the force ripples by {ripple:.3f} N",
        ),
    ]


def ask() -> list[Answer]:
    """Run the devices of the engine at and beyond their limits."""
    answers = [answer for name in ("touch", "omni", "six-dof") for answer in answers_of(name)]
    no_step = refused(
        "a bound for encoders without a step",
        lambda: quantised_bound_N_m(DEVICE.loop(1.0), friction_N=0.1, encoder_m=0.0),
    )
    return [*answers, no_step]


def draw(data: Data, chart: Figure) -> None:
    """Draw stiffness over friction, and swing over stiffness."""
    left, right = chart.subplots(1, 2)
    table = data["friction"]
    friction = table["friction_N"]
    bound = table["bound_N_m"]
    critical = table["critical_N_m"]
    top = 6e3
    tint = {"zorder": 0, "linewidth": 0.0}
    left.fill_between(
        friction, 20.0, bound, color=TINTS[Conduct.HOLDS], label="engine holds", **tint
    )
    left.fill_between(
        friction, critical, top, color=TINTS[Conduct.REFUSES], label="engine refuses", **tint
    )
    left.fill_between(
        friction,
        bound,
        critical,
        facecolor="none",
        edgecolor="0.75",
        hatch="//",
        label="may buzz: no device of the engine",
        **tint,
    )
    panel(
        left,
        friction,
        ("Coulomb friction / N", "stiffness / (N/m)"),
        [
            ("eigenvalues: no encoder", critical, "-", GREY),
            ("min(2b/T, 2f_c/Δ)", bound, "--", GREEN),
            ("measured: quiet to", table["quiet_to_N_m"], "o", BLUE),
            ("measured: buzzes from", table["buzzes_from_N_m"], "s", RED),
        ],
        conduct=(),
        legend="lower right",
        ylim=(20.0, top),
    )
    swing = data["swing"]
    swings = np.maximum(swing["swing_steps"], 1e-3).reshape(len(friction), -1)
    looks = (("s", RED), ("^", ORANGE), ("D", GREEN), ("o", BLUE))
    curves = [
        (
            f"friction {1e3 * friction[row]:g} mN: bound {2.0 * friction[row] / ENCODER_M:g} N/m",
            swings[row],
            *look,
        )
        for row, look in zip(
            range(0, len(friction), max(len(friction) // 3, 1)), looks, strict=False
        )
    ]
    labels = ("stiffness / (N/m)", "remaining swing / encoder steps")
    panel(
        right,
        np.unique(swing["stiffness_N_m"]),
        labels,
        [*curves, ("counts as buzzing", BUZZ_STEPS, ":", GREY)],
        conduct=(),
        legend="upper left",
        ylim=(5e-4, 3e3),
    )


PAGE = Page(
    "quantisation",
    "Quantisation: encoder steps against friction",
    "A device with encoder steps of 0.1 mm is knocked onto a stiff wall. Does it come to "
    "rest, or does it keep buzzing "
    "by some steps?",
    (
        "Abbott and Okamura (2005), in the plane of Diolaiti et al. (2006); 50 g, 1 N s/m, 1 "
        "kHz, two steady pushes"
    ),
    measure,
    judge,
    ask,
    draw,
)
