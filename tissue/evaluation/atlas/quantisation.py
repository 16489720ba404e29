"""Encoder steps: friction must pay what a quantised wall creates, or the wall keeps buzzing."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tissue.evaluation.atlas.drawing import BLUE, GREEN, GREY, ORANGE, RED, TINTS, finish
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import HandAction, hand_parameters
from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m
from tissue.haptics.loop.stability_bounds import quantised_bound_N_m
from tissue.haptics.renderable_stiffness import knock
from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["QUANTISATION"]

TICK_S, ENCODER_M = 1e-3, 1e-4
DEVICE = DeviceParameters(mass_kg=0.05, damping_N_s_m=1.0, encoder_step_m=ENCODER_M)
"""A device whose viscous friction alone allows 2 b / T = 2 kN/m, with coarse encoders."""
SECONDS = 1.0
BUZZ_STEPS = 0.1
"""Swing that counts as buzzing [encoder steps]: a resting device has none."""
PUSHES_N = (0.11, 0.37)
"""Steady pushes onto the wall [N]: where between two encoder steps it comes to rest differs."""


class Push:
    """Nobody, but a steady push and a knock of 2 N in the first tick."""

    def __init__(self, steady_N: float) -> None:
        self._steady = steady_N

    def act(self, time_s: float, position_m: tuple[float, float, float]) -> HandAction:
        """The push."""
        return HandAction(push_N=(0.0, 0.0, -self._steady - (2.0 if time_s < 0.5 * TICK_S else 0.0)))


def swing_steps(stiffness: float, friction: float) -> float:
    """Peak to peak of the position in the last third, in encoder steps, of the worst push; the wall also pulls."""
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
    """From which stiffness on the device keeps buzzing, over friction; and the swing over stiffness at one friction."""
    frictions = np.array([0.003, 0.03]) if quick else np.array([0.003, 0.008, 0.02, 0.04, 0.08])
    ladder = np.geomspace(40.0, 1950.0, 5 if quick else 9)
    swings = np.array([[swing_steps(k, f) for k in ladder.tolist()] for f in frictions.tolist()])
    loop = DEVICE.loop(1.0)
    buzzes = swings > BUZZ_STEPS
    first = np.where(buzzes.any(axis=1), ladder[np.argmax(buzzes, axis=1)], critical_stiffness_N_m(loop))
    last = np.array([ladder[:at][-1] if at else 0.0 for at in np.argmax(buzzes, axis=1)])
    return {
        "friction": {
            "friction_N": frictions,
            "buzzes_from_N_m": first,
            "quiet_to_N_m": np.where(buzzes.any(axis=1), last, first),
            "bound_N_m": np.array(
                [quantised_bound_N_m(loop, friction_N=f, encoder_m=ENCODER_M) for f in frictions.tolist()]
            ),
            "critical_N_m": np.full(len(frictions), critical_stiffness_N_m(loop)),
        },
        "swing": {
            "stiffness_N_m": np.tile(ladder, len(frictions)),
            "friction_N": np.repeat(frictions, len(ladder)),
            "swing_steps": swings.ravel(),
        },
    }


def judge(data: Data) -> Verdict:
    """Buzzing below what the eigenvalues allow, and none below the bound that counts encoder and friction."""
    table, swing = data["friction"], data["swing"]
    early = float((table["buzzes_from_N_m"] / table["critical_N_m"]).min())
    bound = np.interp(swing["friction_N"], table["friction_N"], table["bound_N_m"])
    inside = swing["stiffness_N_m"] <= bound
    worst = float(swing["swing_steps"][inside].max()) if inside.any() else 0.0
    return Verdict(
        early < 0.5,
        worst <= BUZZ_STEPS,
        f"With little friction the device buzzes from {100 * early:.0f} % of the stiffness on at which its eigenvalues "
        f"leave the circle ({table['critical_N_m'][0]:.0f} N/m): those know of no encoder steps. In none of "
        f"{int(inside.sum())} runs within min(2b/T, 2f_c/Δ) is it more than {worst:.2f} steps; the bound is safe and, "
        f"with some friction, far from tight.",
    )


def ask() -> list[Answer]:
    """The devices of the engine: what friction allows, what is chosen, and how that runs."""
    answers = []
    for name in ("touch", "omni", "six-dof"):
        device = device_parameters(name)
        allowed = 2.0 * device.friction_N / device.encoder_step_m
        run, _ = knock(device, hand_parameters("expert"), "proxy", device.stiffness_limit_N_m)
        ripple = run.ripple_N(0.2)
        beyond = {"device": name, "coupling.stiffness_N_m": allowed, "duration_s": 0.3}
        answers.append(
            refused(
                f"the scene wall on {name} at {allowed:.0f} N/m, where friction no longer pays for the encoder",
                lambda beyond=beyond: simulate(load_scene("wall", beyond)),  # type: ignore[misc]
            )
        )
        answers.append(
            shown(
                f"{name} at its vendor's limit of {device.stiffness_limit_N_m:g} N/m",
                device.stiffness_limit_N_m < allowed and ripple < 0.05,
                f"after a knock the force ripples by {ripple:.3f} N",
            )
        )
    return [
        *answers,
        refused("a bound for encoders without a step",
                lambda: quantised_bound_N_m(DEVICE.loop(1.0), friction_N=0.1, encoder_m=0.0)),
    ]  # fmt: skip


def draw(data: Data, chart: "Figure") -> None:
    """Stiffness over friction; swing over stiffness."""
    left, right = chart.subplots(1, 2)
    table, swing = data["friction"], data["swing"]
    friction, top = table["friction_N"], 6e3
    left.fill_between(friction, 20.0, table["bound_N_m"], color=TINTS[Conduct.HOLDS], zorder=0, label="engine holds")
    left.fill_between(
        friction, table["critical_N_m"], top, color=TINTS[Conduct.REFUSES], zorder=0, label="engine refuses"
    )
    left.fill_between(
        friction, table["bound_N_m"], table["critical_N_m"], facecolor="none", edgecolor="0.75", hatch="//",
        linewidth=0.0, zorder=0, label="may buzz: none of the engine's devices",
    )  # fmt: skip
    left.loglog(friction, table["critical_N_m"], color=GREY, label="eigenvalues: no encoder")
    left.loglog(friction, table["bound_N_m"], "--", color=GREEN, label="min(2b/T, 2f_c/Δ)")
    left.loglog(friction, table["quiet_to_N_m"], "o", color=BLUE, label="measured: quiet to")
    left.loglog(friction, table["buzzes_from_N_m"], "s", color=RED, label="measured: buzzes from")
    finish(
        left,
        "Coulomb friction / N",
        "stiffness / (N/m)",
        legend="lower right",
        ylim=(20.0, top),
        xlim=friction[[0, -1]],
    )
    known = np.unique(swing["friction_N"])
    shown_at = known[:: max(len(known) // 3, 1)]
    for value, colour, marker in zip(shown_at.tolist(), (RED, ORANGE, GREEN, BLUE), "s^Do", strict=False):
        here = swing["friction_N"] == value
        right.loglog(swing["stiffness_N_m"][here], np.maximum(swing["swing_steps"][here], 1e-3), marker, color=colour,
                     label=f"friction {1e3 * value:g} mN: bound {2.0 * value / ENCODER_M:g} N/m")  # fmt: skip
    right.axhline(BUZZ_STEPS, color=GREY, linestyle=":", label="counts as buzzing")
    finish(right, "stiffness / (N/m)", "swing that stays / encoder steps", legend="upper left", ylim=(5e-4, 3e3))


QUANTISATION = Page(
    "quantisation",
    "Quantisation: encoder steps against friction",
    "A device with encoder steps of 0.1 mm is knocked onto a stiff wall. Does it come to rest, or does it buzz by some "
    "steps for ever?",
    "Abbott and Okamura (2005), in the plane of Diolaiti et al. (2006); 50 g, 1 N s/m, 1 kHz, two steady pushes",
    measure,
    judge,
    ask,
    draw,
)
