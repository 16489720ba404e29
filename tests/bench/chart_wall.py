"""Stiffness of the walls that a device can play, for three renderers over rate and delay.

`python tests/bench/chart_wall.py --out DIR [--device omni|six-dof|touch] [--quick]` writes
`wall_DEVICE.csv` and `wall_DEVICE.png`. A simulated hand touches a rigid wall, presses, and is
jerked. The stiffest wall on which the force becomes quiet again counts. The black line is the
critical stiffness of the linear loop in the same hand, from its eigenvalues. The grey line is the
bound below which the wall is passive in any hand. The simulated device has friction and encoder
steps, the linear loop has neither.
"""

import argparse
import csv
from dataclasses import asdict
from pathlib import Path
from time import perf_counter

from harness import machine, table
from wall_limits import HIGHEST_N_M, WallLimit, wall_limits

from tissue.haptics.device.device import device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.scene.registry import DEVICES

COLOURS = {"penalty": "#0072B2", "passivity": "#E69F00", "proxy": "#009E73"}
MARKERS = {"penalty": "o", "passivity": "s", "proxy": "x"}


def draw(found: list[WallLimit], device: str, out: Path) -> None:
    """One panel a rate, delay along it."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.rcParams.update({"font.size": 12})
    rates = sorted({each.rate_Hz for each in found})
    figure, axes = pyplot.subplots(
        1, len(rates), figsize=(4.4 * len(rates), 5), sharey=True, layout="constrained"
    )
    for axis, rate in zip(axes, rates, strict=True):
        here = [each for each in found if each.rate_Hz == rate]
        for kind, colour in COLOURS.items():
            mine = [each for each in here if each.renderer == kind]
            at = [1e3 * each.delay_s for each in mine]
            axis.plot(
                at,
                [max(each.reached_N_m, 40.0) for each in mine],
                color=colour,
                marker=MARKERS[kind],
                markersize=9,
                linestyle="-" if kind != "proxy" else ":",
                label=kind,
            )
        mine = [each for each in here if each.renderer == here[0].renderer]
        at = [1e3 * each.delay_s for each in mine]
        axis.plot(
            at,
            [each.held_N_m for each in mine],
            color="black",
            linestyle="--",
            label="linear loop, held",
        )
        axis.plot(
            at,
            [each.passive_N_m for each in mine],
            color="0.6",
            linestyle="--",
            label="passive by itself",
        )
        axis.set(
            yscale="log",
            title=f"{rate:g} Hz",
            xlabel="transport delay / ms",
            ylim=(30.0, 1.2 * HIGHEST_N_M),
        )
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("stiffest quiet wall / (N/m)")
    axes[0].legend(fontsize=10)
    figure.suptitle(f"{device} in an expert's hand on a rigid wall")
    figure.savefig(out, dpi=110)
    pyplot.close(figure)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--device", choices=DEVICES, default="six-dof")
    options.add_argument("--quick", action="store_true")
    given = options.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    start = perf_counter()
    rates, delays = (
        ((500.0, 1000.0), (0.0, 2e-3))
        if given.quick
        else ((500.0, 1000.0, 2000.0, 4000.0), (0.0, 5e-4, 1e-3, 2e-3, 4e-3))
    )
    found = wall_limits(
        device_parameters(given.device), hand_parameters("expert"), rates_Hz=rates, delays_s=delays
    )
    rows = [asdict(each) | {"ratio": each.ratio} for each in found]
    with (given.out / f"wall_{given.device}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    draw(found, given.device, given.out / f"wall_{given.device}.png")
    print(
        table(
            [
                tuple(f"{v:.3g}" if isinstance(v, float) else v for v in row.values())
                for row in rows
            ],
            tuple(rows[0]),
        )
    )
    print(f"{perf_counter() - start:.0f} s on {machine()}")


if __name__ == "__main__":
    main()
