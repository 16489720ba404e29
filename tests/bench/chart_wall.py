"""Stiffness of the walls that a device can play, for three renderers over rate and delay.

`python tests/bench/chart_wall.py --out DIR [--device omni|six-dof|touch] [--quick]` writes
`wall_DEVICE.csv`. A simulated hand touches a rigid wall, presses, and is
jerked. The stiffest wall on which the force becomes quiet again counts. Held: the critical
stiffness of the linear loop in the same hand, from its eigenvalues. Passive: the bound below which
the wall is passive in any hand. The simulated device has friction and encoder
steps, the linear loop has neither.
"""

import argparse
import csv
from dataclasses import asdict
from pathlib import Path
from time import perf_counter

from harness import machine, table
from wall_limits import wall_limits

from tissue.haptics.device.device import device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.scene.registry import DEVICES


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
