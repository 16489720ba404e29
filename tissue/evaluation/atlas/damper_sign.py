"""E9: a damper +b v on the device feeds it; one on the relative velocity can only take."""

from math import pi

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.drawing import BLUE, GREY, RED, panel
from tissue.evaluation.atlas.page import Answer, Data, Page, Verdict, refused, shown
from tissue.haptics.renderer import ProxyRenderer

__all__ = ["PAGE"]

STIFFNESS_N_M, MASS_KG, STEP_S = 500.0, 0.05, 1e-4
RADIUS_M, TURN_HZ = 1e-3, 1.0
STILL = np.zeros(3)


def printed(damping: float, position: Array, velocity: Array) -> Array:
    """The printed law with the proxy at rest in 0: k (p_proxy - p) + b v."""
    return -STIFFNESS_N_M * position + damping * velocity


def cycle_J(damping: float, *, ours: bool) -> float:
    """Energy that the contact gives to a device that is led once around a circle inside it [J]."""
    law, given = ProxyRenderer(STIFFNESS_N_M, damping), 0.0
    for time in np.arange(0.0, 1.0 / TURN_HZ, 10.0 * STEP_S).tolist():
        angle = 2.0 * pi * TURN_HZ * time
        at = RADIUS_M * np.array([np.sin(angle), 0.0, np.cos(angle) - 2.0])
        speed = 2.0 * pi * TURN_HZ * RADIUS_M * np.array([np.cos(angle), 0.0, -np.sin(angle)])
        force = law.render(at, speed, STILL, STILL, STEP_S) if ours else printed(damping, at, speed)
        given += float(force @ speed) * 10.0 * STEP_S
    return given


def swing_m(damping: float, *, ours: bool, steps: int) -> Array:
    """Amplitude of a mass that is let go 1 mm off in a contact, in steps that leak nothing to speak of [m]."""
    law, at, speed, amplitudes = ProxyRenderer(STIFFNESS_N_M, damping), np.array([0.0, 0.0, -1e-3]), np.zeros(3), []
    for _ in range(steps):
        force = law.render(at, speed, STILL, STILL, STEP_S) if ours else printed(damping, at, speed)
        speed = speed + STEP_S / MASS_KG * force
        at = at + STEP_S * speed
        amplitudes.append(np.sqrt(at[2] ** 2 + MASS_KG / STIFFNESS_N_M * speed[2] ** 2))
    return np.array(amplitudes)


def measure(quick: bool) -> Data:
    """Energy of a cycle over the damper, and the swing of a mass over time."""
    dampings = np.linspace(0.0, 4.0, 3 if quick else 9)
    theory = dampings * (2.0 * pi * TURN_HZ * RADIUS_M) ** 2 / TURN_HZ
    steps = 1000 if quick else 2000
    return {
        "cycle": {
            "damping_N_s_m": dampings,
            "printed_J": np.array([cycle_J(b, ours=False) for b in dampings.tolist()]),
            "ours_J": np.array([cycle_J(b, ours=True) for b in dampings.tolist()]),
            "theory_J": theory,
        },
        "swing": {
            "time_s": STEP_S * np.arange(1, steps + 1),
            "printed_m": swing_m(2.0, ours=False, steps=steps),
            "ours_m": swing_m(2.0, ours=True, steps=steps),
        },
    }


def judge(data: Data) -> Verdict:
    """Both signs of the energy against b times the squared speed, and growth against decay."""
    cycle, swing = data["cycle"], data["swing"]
    scale = cycle["theory_J"].max()
    printed_off = np.abs(cycle["printed_J"] - cycle["theory_J"]).max() / scale
    ours_off = np.abs(cycle["ours_J"] + cycle["theory_J"]).max() / scale
    grown, left = swing["printed_m"][-1] / swing["printed_m"][0], swing["ours_m"][-1] / swing["ours_m"][0]
    return Verdict(
        bool(printed_off < 0.01 and grown > 2.0),
        bool(ours_off < 0.01 and left < 0.5),
        f"With b = {cycle['damping_N_s_m'][-1]:g} N s/m the printed sign gives the device "
        f"{1e6 * cycle['printed_J'][-1]:.0f} µJ a cycle, ours takes as much (b∮v²dt to {100 * ours_off:.1f} %). A mass "
        f"let go in the contact swings {grown:.0f} times as wide after {swing['time_s'][-1]:.1f} s; with ours "
        f"{100 * left:.1g} % is left.",
    )


def ask() -> list[Answer]:
    """Wrong signs, and a pair that moves together."""
    together = ProxyRenderer(STIFFNESS_N_M, 2.0).render(
        np.array([0.0, 0.0, -1e-3]), np.array([0.3, 0.0, 0.0]), STILL, np.array([0.3, 0.0, 0.0]), 1e-3
    )
    return [
        refused("a damper of −2 N s/m", lambda: ProxyRenderer(STIFFNESS_N_M, -2.0)),
        shown(
            "device and proxy that slide together",
            bool(abs(together[0]) < 1e-15 and abs(together[2] - 0.5) < 1e-12),
            f"no drag: {together[0]:g} N along, {together[2]:g} N of spring",
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Energy over the damper; swing over time."""
    left, right = chart.subplots(1, 2)
    cycle, swing = data["cycle"], data["swing"]
    panel(left, cycle["damping_N_s_m"], "damping b / (N s/m)", "energy given to the device / µJ a cycle", [
        ("theory: ±b∮v²dt", 1e6 * cycle["theory_J"], "-", GREY),
        ("_", -1e6 * cycle["theory_J"], "-", GREY),
        ("printed: k(p_p − p) + bv", 1e6 * cycle["printed_J"], "s", RED),
        ("ours: k(p_p − p) + b(v_p − v)", 1e6 * cycle["ours_J"], "o", BLUE),
    ], log="")  # fmt: skip
    panel(right, 1e3 * swing["time_s"], "time / ms", "swing of 50 g in the contact / mm", [
        ("printed, b = 2 N s/m", 1e3 * swing["printed_m"], "--", RED),
        ("ours, b = 2 N s/m", 1e3 * swing["ours_m"], "-", BLUE),
    ], log="y")  # fmt: skip


PAGE = Page(
    "damper_sign",
    "E9 · Does +b·v of the device damp a contact?",
    "The printed contact force is k(p_proxy − p_end) + b·v_end. In which direction does its damper move energy?",
    "Statement E9; the damper of the god-object acts on the relative velocity",
    measure,
    judge,
    ask,
    draw,
)
