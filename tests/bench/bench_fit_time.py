"""Time of a fit to a log of 10 s at 1 kHz with forces and torques.

Run: `python tests/bench/bench_fit_time.py`.

The log is a run of the built-in glenoid with autocorrelated noise with heavy tails, 3 % of the
largest load, and a bias.
"""

import tempfile
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from harness import machine
from scipy.signal import lfilter

import tissue

SETTINGS = {"duration_s": 10.0}


def write_log(path: Path) -> None:
    """Poses of a run, and what a sensor would measure along it."""
    table, rng = (
        tissue.simulate(tissue.load_scene("glenoid", SETTINGS)).to_pandas(),
        np.random.default_rng(1),
    )
    log = table.filter(regex="^(time_s|tool_|model_force_|model_torque_)")
    log = log.rename(columns=lambda name: name.removeprefix("model_"))
    for kind, unit in (("force", "N"), ("torque", "Nm")):
        names = [f"{kind}_{axis}_{unit}" for axis in "xyz"]
        size = log[names].abs().to_numpy().max()
        noise = lfilter([1.0], [1.0, -0.9], rng.standard_t(4.0, (len(log), 3)), axis=0)
        log[names] += size * (0.03 * noise + 0.1)
    log.to_csv(path, index=False)


def main() -> None:
    """Fit once after the kernels are compiled."""
    print(machine())
    with tempfile.TemporaryDirectory() as name:
        path, scene = Path(name) / "log.csv", tissue.load_scene("glenoid", SETTINGS)
        write_log(path)
        wall, spent = perf_counter(), process_time()
        tissue.fit(scene, path).save(Path(name) / "fit")
        print(
            f"log of 10 s: {perf_counter() - wall:.1f} s, {process_time() - spent:.1f} s of "
            "this process"
        )


if __name__ == "__main__":
    main()
