"""A wall that feels hard needs about 1 kN/m; which rate plays it on a device that nobody holds?

Expected: without delay and amplifier lag the six-degree-of-freedom device (75 g, 0.4 N s/m) is stable up to 801 N/m at
1 kHz and 1601 N/m at 2 kHz, so 1 kHz is not enough and 2 kHz is. With half a millisecond of delay and an amplifier of
300 Hz it is stable up to 262 N/m at 1 kHz and 371 N/m at 10 kHz: then no rate is enough, and only a hand is, whose
damping allows 2906 N/m at 1 kHz. A model that answers at 100 Hz and whose force is held in the meantime allows that
hand no more than 770 N/m; the loop may be as quick as it likes. Every figure is an eigenvalue's, and a loop left to run
grows 5 % above and fades 5 % below it. The 0.8 to 1 kN/m are Choi and Tan's (2004), the device's damping is a prior.
Run: python examples/08_where_1_khz_is_not_enough.py [--out FILE.png]
"""

import sys
from collections.abc import Iterable
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np

from tissue.haptics.device.device import device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m, in_hands
from tissue.haptics.loop.sampled_loop import WallLoop
from tissue.haptics.loop.stability_map import growth_while_running

HARD_N_M = 1000.0
RATES_HZ = (250.0, 500.0, 1000.0, 2000.0, 5000.0, 10000.0)


def loops() -> dict[str, list[WallLoop]]:
    """The device at each rate: without lag, as it is, and held by an expert."""
    device = device_parameters("six-dof")
    real = [replace(device, rate_Hz=rate).loop(HARD_N_M) for rate in RATES_HZ]
    grip = hand_parameters("expert").grip[:3]
    return {
        "free, no lag": [replace(each, delay_s=0.0, amplifier_Hz=inf) for each in real],
        "free": real,
        "held": [in_hands(each, [grip])[0] for each in real],
    }


def runs_as_judged(loop: WallLoop) -> bool:
    """Whether a loop left to run for four seconds grows above its critical stiffness and fades below it."""
    critical = critical_stiffness_N_m(loop)
    ticks = round(4.0 / loop.tick_s / loop.model_ticks) * loop.model_ticks
    above, below = growth_while_running([loop, loop], np.array([1.05, 0.95]) * critical, ticks=ticks)
    return bool(above > 1.0 > below)


def _list(numbers: Iterable[float]) -> str:
    return ", ".join(f"{number:.0f}" for number in numbers)


def main(out: Path | None = None) -> None:
    cases = loops()
    critical = {name: np.array([critical_stiffness_N_m(each) for each in row]) for name, row in cases.items()}
    for name, row in critical.items():
        enough = [f"{rate:g}" for rate, value in zip(RATES_HZ, row, strict=True) if value > HARD_N_M]
        print(f"{name}: {_list(row)} N/m at {_list(RATES_HZ)} Hz; hard enough at {', '.join(enough) or 'none'}")
    at_1_khz = RATES_HZ.index(1000.0)
    slow = replace(cases["held"][at_1_khz], model_ticks=10)
    slow_critical = critical_stiffness_N_m(slow)
    print(f"held, 1 kHz, model at 100 Hz: {slow_critical:.0f} N/m")

    free, real, held = critical.values()
    assert abs(free[at_1_khz] - 801.0) < 1.0 and abs(free[at_1_khz + 1] - 1601.0) < 1.0
    assert free[at_1_khz] < HARD_N_M < free[at_1_khz + 1]
    assert abs(real[at_1_khz] - 262.0) < 1.0 and abs(real[-1] - 371.0) < 1.0 and real.max() < HARD_N_M
    assert abs(held[at_1_khz] - 2906.0) < 2.0
    assert abs(slow_critical - 770.0) < 2.0
    assert all(runs_as_judged(row[at_1_khz]) for row in cases.values()) and runs_as_judged(slow)
    if out is not None:
        draw(critical, out)
        print("picture in", out)


def draw(critical: dict[str, np.ndarray], out: Path) -> None:
    """Critical stiffness over rate."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7.5, 4.6), layout="constrained")
    for (name, row), colour, marker in zip(critical.items(), ("#0072B2", "#E69F00", "#009E73"), "os^", strict=True):
        axes.loglog(RATES_HZ, row, color=colour, marker=marker, label=name)
    axes.axhspan(800.0, 1000.0, color="0.85", zorder=0)
    axes.text(RATES_HZ[0], 890.0, "feels hard", color="0.3", va="center")
    axes.set(xlabel="rate / Hz", ylabel="critical stiffness / (N/m)", title="Stable stiffness of a wall over rate")
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    figure.savefig(out, dpi=150)
    pyplot.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[2]) if sys.argv[1:2] == ["--out"] else None)
