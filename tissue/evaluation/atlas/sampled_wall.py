"""E10: positive gains at 1 kHz are not enough; sampling and hold leak energy that only physical damping pays."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.drawing import BLUE, GREEN, GREY, ORANGE, RED, divided, panel
from tissue.evaluation.atlas.page import Answer, Data, Page, Verdict, error_of, refused, shown
from tissue.haptics.device.device import device_parameters
from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m, in_hands, judge, require_stable
from tissue.haptics.loop.passivity import PassivityControl, PassivityObserver
from tissue.haptics.loop.stability_bounds import passive_bound_N_m
from tissue.haptics.loop.stability_map import measured_critical_N_m

__all__ = ["PAGE"]

DEVICE = replace(device_parameters("omni"), friction_N=0.0, encoder_step_m=0.0, transport_delay_s=0.0,
                 amplifier_Hz=float("inf"))  # fmt: skip
"""The omni's mass and viscous friction alone, as the theory asks for."""
HANDS = ((0.0, 0.0, 0.0), (300.0, 4.0, 0.1), (3000.0, 0.0, 0.0), (1e5, 0.01, 2.0))
"""No hand, a loose one, and two that damp nothing: stiffness [N/m], damping [N s/m], mass [kg]."""
TICK_S, SPEED_M_S, SAMPLES = 1e-3, 0.1, 100
DAMPING_N_S_M = 0.5 * DEVICE.mass_kg / TICK_S
"""Most that the controller may add: half of what would itself be unstable."""


def cycle_J(stiffness: float, *, supervised: bool) -> float:
    """Energy that a wall gives to a device that is led into it and out at constant speed, by the motors' work [J]."""
    control = PassivityControl(DAMPING_N_S_M) if supervised else None
    depths = -SPEED_M_S * TICK_S * np.concatenate([np.arange(SAMPLES), np.arange(SAMPLES, -1, -1)])
    given, before = 0.0, depths[0]
    for depth, following in pairwise(depths.tolist()):
        force = np.array([0.0, 0.0, max(-stiffness * depth, 0.0)])
        if control is not None:
            speed = (depth - before) / TICK_S if depth != before else (following - depth) / TICK_S
            force = control.step(force, np.array([0.0, 0.0, depth]), np.array([0.0, 0.0, speed]), TICK_S)
        given, before = given + float(force[2]) * (following - depth), depth
    return given


def measure(quick: bool) -> Data:
    """Critical stiffness over rate, and energy leaked over stiffness."""
    rates = np.array([1000.0, 4000.0] if quick else [250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0])
    loops = [replace(DEVICE, rate_Hz=rate).loop(1.0) for rate in rates.tolist()]
    stiffnesses = np.geomspace(100.0, 1e4, 3 if quick else 9)
    return {
        "rate": {
            "rate_hz": rates,
            "measured_N_m": np.array([measured_critical_N_m([each], ticks=1200)[0] for each in loops]),
            "exact_N_m": np.array([critical_stiffness_N_m(each) for each in loops]),
            "worst_hand_N_m": np.array([min(map(critical_stiffness_N_m, in_hands(each, HANDS))) for each in loops]),
            "passive_N_m": np.array([passive_bound_N_m(each) for each in loops]),
        },
        "leak": {
            "stiffness_N_m": stiffnesses,
            "hold_J": np.array([cycle_J(k, supervised=False) for k in stiffnesses.tolist()]),
            "supervised_J": np.array([cycle_J(k, supervised=True) for k in stiffnesses.tolist()]),
            "theory_J": SAMPLES * stiffnesses * (SPEED_M_S * TICK_S) ** 2,
        },
    }


def judge_wall(data: Data) -> Verdict:
    """Walls of positive gains at 1 kHz and more that grow; the leak; and the passive bound in every hand."""
    rate, leak = data["rate"], data["leak"]
    fast = rate["rate_hz"] >= 1000.0
    at = int(np.argmax(fast))
    leak_off, off = error_of(leak["hold_J"], leak["theory_J"]), error_of(rate["measured_N_m"], rate["exact_N_m"])
    safe = bool((rate["passive_N_m"] <= rate["worst_hand_N_m"] * (1.0 + 1e-6)).all())
    return Verdict(
        bool(np.isfinite(rate["measured_N_m"][fast]).all() and leak_off < 1e-6),
        bool(off < 0.01 and safe and leak["supervised_J"].max() < 1e-12),
        f"At {rate['rate_hz'][at]:g} Hz a wall of k, b > 0 grows from {rate['measured_N_m'][at]:.0f} N/m on "
        f"(eigenvalues {rate['exact_N_m'][at]:.0f}, {100 * off:.2f} % off at most). The hold leaks ½K(vT)² a sample, "
        f"in and out, to {leak_off:.0e}; the passivity controller pays all of it, at "
        f"this speed by taking the force off where nothing is left in store. No hand of four brings the boundary below "
        f"Colgate's bound 2b/T = {rate['passive_N_m'][at]:.0f} N/m.",
    )


def ask() -> list[Answer]:
    """The same device above and below the boundary, and energy booked by the observer."""
    loop = DEVICE.loop(1.0)
    critical, bound = critical_stiffness_N_m(loop), passive_bound_N_m(loop)
    observer = PassivityObserver()
    for tick in range(SAMPLES):
        observer.observe(np.array([0.0, 0.0, -1e-4 * tick]))
        observer.hold(np.array([0.0, 0.0, 0.1 * tick]))
    observer.observe(np.array([0.0, 0.0, -1e-4 * SAMPLES]))
    wanted = 0.5 * 1000.0 * (1e-4 * SAMPLES) ** 2 * (1.0 - 1.0 / SAMPLES)
    return [
        refused("5 % more than the critical stiffness", lambda: require_stable(loop.with_stiffness(1.05 * critical))),
        refused(
            "damping by the wall alone, 2.2 m/T",
            lambda: require_stable(DEVICE.loop(100.0, wall_damping_N_s_m=2.2 * DEVICE.mass_kg / TICK_S)),
        ),
        shown("Colgate's bound in four hands", judge(loop.with_stiffness(bound), HANDS).stable, "accepted in all"),
        shown(
            "energy booked on the path into 1 kN/m",
            abs(observer.energy_J / wanted - 1.0) < 1e-9,
            f"{1e3 * observer.energy_J:.3f} mJ taken, ½Kx² less the leak is {1e3 * wanted:.3f} mJ",
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Stiffness over rate; energy over stiffness."""
    left, right = chart.subplots(1, 2)
    rate, leak = data["rate"], data["leak"]
    hertz, exact = rate["rate_hz"], rate["exact_N_m"]
    low, high = 0.3 * exact.min(), 5.0 * exact.max()
    divided(left, hertz, exact, low, high)
    left.axvline(1000.0, color=RED, linestyle=":", label="printed: passive from 1 kHz on")
    panel(left, hertz, "rate / Hz", "critical stiffness / (N/m)", [
        ("eigenvalues, nobody holds it", exact, "-", GREY),
        ("passive: 2b/T (Colgate)", rate["passive_N_m"], "--", GREEN),
        ("measured", rate["measured_N_m"], "o", BLUE),
    ], conduct=(), ylim=(low, high), legend="upper left")  # fmt: skip
    panel(right, leak["stiffness_N_m"], "stiffness / (N/m)", "energy given, in and out at 0.1 m/s / mJ", [
        ("theory: nK(vT)²", 1e3 * leak["theory_J"], "-", GREY),
        ("held spring, measured", 1e3 * leak["hold_J"], "s", ORANGE),
        ("with passivity controller", 1e3 * leak["supervised_J"], "o", BLUE),
    ], log="x", ylim=(-0.01, 2e3 * leak["theory_J"].max()))  # fmt: skip
    right.set_yscale("symlog", linthresh=0.1)


PAGE = Page(
    "sampled_wall",
    "E10 · Is a wall passive because k, b > 0 and the loop runs at 1 kHz?",
    "A published theorem claims it. How stiff may the wall be at a rate, and what does the hold leak?",
    "Statement E10; Colgate and Schenkel (1997), Hannaford and Ryu (2002); device: mass and damping of the Omni",
    measure,
    judge_wall,
    ask,
    draw,
)
