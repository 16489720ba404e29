"""A force that comes 4 ms late is wrong by 4 % on a stiff wall; how much of that can a prediction take back?

Expected: three hands, one of each group, push a ball onto a wall with 4 ms of latency between the force and the device.
Errors are ||F - ideal|| / ||ideal|| over a run where the motor acts, the ideal force being that of a loop without
delay at the device's true position. Played as it comes, the force is off by 4.4 % of its size, a straight
line through the last ten milliseconds leaves 2.3 %, and the wall's own law at the end of the path that a
lifted operator foresees 1.0 %. A perfect prediction of what the encoders' steps give would leave
0.5 %. With prediction the coupling may be stiffer, and is: 400 N/m instead of 360.
Run: python examples/09_latency_hidden_by_prediction.py [--out FILE.png]
"""

import sys
from pathlib import Path

import numpy as np

from tissue import load_scene, simulate
from tissue.simulation.reference_force import MotorForces, ideal_force_N, motor_forces

HANDS = ("novice", "intermediate", "expert")
OURS = "koopman-look-ahead"
PREDICTIONS = {"none": "as it comes", "linear": "straight line", OURS: "lifted path, wall's law"}
LATENCY_MS = 4


def run(hand: str, seed: int, prediction: str) -> tuple[MotorForces, float]:
    """Forces of a hand on the wall where the motor acts, and the share of ticks in which the predictor was trusted."""
    scene = load_scene("wall", {"hand": hand, "seed": seed, "prediction": prediction, "coupling.delay_ms": LATENCY_MS})
    found = simulate(scene)
    trusted = found.trace["predicted_by"].mean() if prediction != "none" else 1.0
    return motor_forces(found, ideal_force_N(found)), float(trusted)


def error(force_N: np.ndarray, ideal_N: np.ndarray) -> float:
    """What is wrong with a force, as a share of the ideal one."""
    return float(np.linalg.norm(force_N - ideal_N) / np.linalg.norm(ideal_N))


def main(out: Path | None = None) -> None:
    runs = {kind: [run(hand, 500 + i, kind) for i, hand in enumerate(HANDS)] for kind in PREDICTIONS}
    errors = {kind: float(np.mean([error(each.played, each.ideal) for each, _ in of])) for kind, of in runs.items()}
    least = float(np.mean([error(each.nearest, each.ideal) for each, _ in runs[OURS]]))
    for kind, name in PREDICTIONS.items():
        print(f"{name:>23}: {100.0 * errors[kind]:.2f} % of the force, {LATENCY_MS} ms late")
    print(f"{'foreseen without error':>23}: {100.0 * least:.2f} %")
    print(f"the lifted predictor was trusted in {100.0 * np.mean([each for _, each in runs[OURS]]):.1f} % of the ticks")
    assert abs(errors["none"] - 0.044) < 0.004 and abs(errors[OURS] - 0.0105) < 0.002 and abs(least - 0.005) < 0.001
    assert errors[OURS] < 0.5 * errors["linear"] and errors["linear"] < 0.6 * errors["none"]
    if out is not None:
        draw({kind: found[0][0] for kind, found in runs.items()}, out)
        print("picture in", out)


def draw(forces: dict[str, MotorForces], out: Path) -> None:
    """The first touch: ideal and played force over time, without and with prediction."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, 2, figsize=(9.0, 3.6), sharey=True, layout="constrained")
    for panel, kind in zip(panels, ("none", OURS), strict=True):
        found = forces[kind]
        first = int(np.flatnonzero(found.ideal[:, 2])[0])
        shown = slice(first - 15, first + 75)
        time_ms = np.arange(-15, 75)
        panel.plot(time_ms, found.ideal[shown, 2], color="0.15", linewidth=2.0, label="ideal")
        panel.plot(time_ms, found.played[shown, 2], color="#D55E00", linestyle="--", linewidth=1.6, label="played")
        panel.set(title=PREDICTIONS[kind], xlabel="time since the touch / ms")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("force at the motor / N")
    panels[0].legend(frameon=False)
    figure.savefig(out, dpi=200)


if __name__ == "__main__":
    main(Path(sys.argv[2]) if "--out" in sys.argv else None)
