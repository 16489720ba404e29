"""A force that comes 4 ms late is wrong by 3 to 4 % on a stiff wall; how much of that can a prediction take back?

Expected: three hands, one of each group, push a ball onto a wall with 4 ms of latency between the force and the device.
Played as it comes, the force is off the reference by 3.4 % of its size, a straight line through the last ten
milliseconds leaves 2.3 %, and the lifted linear predictor that ships with the scene 1.6 %: less than half, and less
than the best that knows nothing of the wall. It has learnt from other hands; what it looks at are the last 21
positions and forces, and how deep a steady speed would lead into the wall after 0, 2, 4 and 8 ms. Errors are
||played - reference|| / ||reference|| over a run, with the low-pass of 1 ms and the encoder's steps in them, so they
show how well latency is hidden, not how true the wall is. With prediction the coupling may be stiffer, and is: 400 N/m
instead of 360.
Run: python examples/09_latency_hidden_by_prediction.py [--out FILE.png]
"""

import sys
from pathlib import Path

import numpy as np

from tissue import load_scene, simulate
from tissue.simulation.trace import Table

HANDS = ("novice", "intermediate", "expert")
PREDICTIONS = {"none": "as it comes", "linear": "straight line", "koopman": "lifted predictor"}
LATENCY_MS = 4


def run(hand: str, seed: int, prediction: str) -> Table:
    """Trace of a hand on the wall."""
    scene = load_scene("wall", {"hand": hand, "seed": seed, "prediction": prediction, "coupling.delay_ms": LATENCY_MS})
    return simulate(scene).trace


def error(trace: Table) -> float:
    """Error of the played force against the reference, which has no delay."""
    reference, played = trace.vectors("raw_force", "N"), trace.vectors("filtered_force", "N")
    return float(np.linalg.norm(played - reference) / np.linalg.norm(reference))


def main(out: Path | None = None) -> None:
    traces = {kind: [run(hand, 500 + i, kind) for i, hand in enumerate(HANDS)] for kind in PREDICTIONS}
    errors = {kind: float(np.mean([error(trace) for trace in found])) for kind, found in traces.items()}
    for kind, name in PREDICTIONS.items():
        print(f"{name:>16}: {100.0 * errors[kind]:.2f} % of the force, {LATENCY_MS} ms late")
    trusted = np.mean([trace["predicted_by"].mean() for trace in traces["koopman"]])
    print(f"the lifted predictor was trusted in {100.0 * trusted:.1f} % of the ticks")
    assert abs(errors["none"] - 0.034) < 0.004
    assert abs(errors["koopman"] - 0.016) < 0.003
    assert errors["koopman"] < 0.5 * errors["none"] and errors["koopman"] < errors["linear"] < errors["none"]
    if out is not None:
        draw({kind: found[0] for kind, found in traces.items()}, out)
        print("picture in", out)


def draw(traces: dict[str, Table], out: Path) -> None:
    """The first touch: reference and played force over time, without and with prediction."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, 2, figsize=(9.0, 3.6), sharey=True, layout="constrained")
    for panel, kind in zip(panels, ("none", "koopman"), strict=True):
        trace = traces[kind]
        reference, played = trace["raw_force_z_N"], trace["filtered_force_z_N"]
        first = int(np.flatnonzero(reference)[0])
        shown = slice(first - 15, first + 75)
        time_ms = 1e3 * (trace["time_s"][shown] - trace["time_s"][first])
        panel.plot(time_ms, reference[shown], color="0.15", linewidth=2.0, label="without delay")
        panel.plot(time_ms, played[shown], color="#D55E00", linestyle="--", linewidth=1.6, label="played")
        panel.set(title=PREDICTIONS[kind], xlabel="time since the touch / ms")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("force on the device / N")
    panels[0].legend(frameon=False)
    figure.savefig(out, dpi=200)


if __name__ == "__main__":
    main(Path(sys.argv[2]) if "--out" in sys.argv else None)
