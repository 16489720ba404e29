"""Errors of predictors in closed loop, where the predicted force also moves the simulated hand.

Run: `python tests/bench/bench_closed_loop.py [--hands N] [--latency MS] [SCENE ...]`.

For each scene, hand and predictor, a run is simulated. For each predictor, the script prints means
over the hands: the error at the motor, the error of a perfect prediction from the same encoder
steps, and the excess error divided by the excess error of zero-order hold. The last column is the
largest difference between the error of a run and the error of zero-order hold with the same hand,
in percent of the force. Two processes simulate.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from harness import machine, table

from meshes.base.arrays import Array
from tissue.evaluation.recorded_runs import trial
from tissue.evaluation.statistics.metrics import excess_error, force_error
from tissue.scene.load import changed, load_scene
from tissue.simulation.reference_force import motor_forces
from tissue.simulation.simulate import simulate

FIRST_SEED = 30_000
KINDS = ("hold", "koopman-look-ahead", "koopman-online")


def errors(name: str, index: int, kind: str, late_ms: int) -> Array:
    """Return error, lower bound and excess of a run at the motor."""
    held = trial(load_scene(name), index, delay_ms=late_ms)
    run = simulate(changed(held, {"prediction": kind}), cores=1, allow_unstable=True)
    forces = motor_forces(run)
    error = force_error(forces.played, forces.ideal)
    least = force_error(forces.nearest, forces.ideal)
    return np.array((error, least, excess_error(error, least)))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", default=["wall", "milling"])
    parser.add_argument("--hands", type=int, default=10)
    parser.add_argument("--latency", type=int, default=4, help="latency of the loop [ms]")
    given = parser.parse_args()
    print(machine())
    with ProcessPoolExecutor(2) as pool:
        for name in given.scenes:
            seeds = range(FIRST_SEED, FIRST_SEED + given.hands)
            tasks = {
                kind: [pool.submit(errors, name, seed, kind, given.latency) for seed in seeds]
                for kind in KINDS
            }
            found = {
                kind: np.array([each.result() for each in runs]) for kind, runs in tasks.items()
            }
            held = found["hold"]
            rows = []
            for kind, each in found.items():
                error, least, excess = each.mean(axis=0)
                over = (each[:, 0] - held[:, 0]).max()
                share = excess / held[:, 2].mean()
                rows.append(
                    (
                        kind,
                        f"{100 * error:.2f}",
                        f"{100 * least:.2f}",
                        f"{share:.2f}",
                        f"{100 * over:+.2f}",
                    )
                )
            print(f"\n{name}, {given.hands} hands, {given.latency} ms late")
            print(
                table(rows, ("predictor", "error %", "least %", "share", "over hold %")), flush=True
            )


if __name__ == "__main__":
    main()
