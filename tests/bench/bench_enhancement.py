"""What each part of an enhancement costs and does: slope, coupling, fidelity, and the force that reaches the hand.

By hand on the device touch, tuned to the population. Run: python tests/bench/bench_enhancement.py [scene ...]
"""

import sys

import numpy as np
from harness import machine, table

import tissue
from tissue.builders.loop import judged_loop
from tissue.builders.loop_settings import loop_settings
from tissue.simulation.simulate import TICK_S

PARTS: dict[str, dict[str, object]] = {
    "plain": {},
    "lift 1.5": {"enhancement.lift": 1.5},
    "contrast 1.25": {"enhancement.contrast": 1.25},
    "contrast 1.5": {"enhancement.contrast": 1.5},
    "cue 0.3 N": {"enhancement.cue_N": 0.3},
    "tuned": {"enhancement.tuned": True, "perception": "population"},
}
SCENES = ("palpation", "wall", "needle", "caries")


def measured(name: str, part: str) -> tuple[str, ...]:
    """One run: what it was judged by, what it costs, and percentiles of the force at the hand in contact."""
    usual = {"stress": None} if name == "caries" else {}
    scene = tissue.load_scene(name, {"device": "touch", **usual, **PARTS[part]})
    settings = loop_settings(scene)
    slope = 1.0 if settings.enhancing is None else settings.enhancing.steepest
    run = tissue.simulate(scene)
    cost = run.summary.get("enhancement", {"force_error": 0.0, "beside_a_gain": 0.0, "gain": 1.0})
    met = np.linalg.norm(run.trace.vectors("raw_force", "N"), axis=1)
    skin = np.linalg.norm(run.trace.vectors("hand_force", "N"), axis=1)[met > 0.05 * met.max()]
    stiffness = judged_loop(settings, step_s=TICK_S).stiffness_N_m
    figures = (100.0 * cost["force_error"], 100.0 * cost["beside_a_gain"])
    return (
        name, part, f"{slope:.2f}", f"{stiffness:.0f}", *(f"{each:.1f}" for each in figures), f"{cost['gain']:.2f}",
        *(f"{each:.2f}" for each in np.percentile(skin, (5, 50, 95))),
    )  # fmt: skip


def main() -> None:
    """Print the table."""
    rows = [measured(name, part) for name in sys.argv[1:] or SCENES for part in PARTS]
    head = ("scene", "part", "slope", "coupling N/m", "force error %", "beside a gain %", "gain", "skin 5 %", "50 %",
            "95 % N")  # fmt: skip
    print(machine(), "\n")
    print(table(rows, head))


if __name__ == "__main__":
    main()
