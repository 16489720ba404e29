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
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter

from harness import machine, table

from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.hand.hand import HandParameters, hand_parameters
from tissue.haptics.loop.critical_stiffness import (
    critical_stiffness_N_m,
    in_hands,
    passive_bound_N_m,
)
from tissue.haptics.rigid_wall import knock
from tissue.scene.registry import DEVICES, RENDERERS

RUNG = 10.0 ** (1.0 / 16.0)
"""Step of the ladder of stiffnesses: 15 %."""


LOWEST_N_M, HIGHEST_N_M = 50.0, 4e4


RINGING_N = 0.05
"""Ripple that counts as ringing [N].

It is below the 7 % of about 1 N that a person discriminates (Pang et al., 1991).
"""


@dataclass(frozen=True)
class WallLimit:
    """Result of a wall: the largest stiffness that was played.

    Attributes
    ----------
    renderer, rate_Hz, delay_s
        Settings of the run.
    reached_N_m
        Last stiffness of the ladder before the first that rings [N/m]; 0 if the lowest does.
    held_N_m, free_N_m
        Critical stiffness of the linear loop in this hand and without a hand [N/m].
    passive_N_m
        Bound of a wall that is passive by itself [N/m].
    """

    renderer: str
    rate_Hz: float
    delay_s: float
    reached_N_m: float
    held_N_m: float
    free_N_m: float
    passive_N_m: float

    @property
    def ratio(self) -> float:
        """Largest stiffness reached over the limit of the linear loop in this hand.

        The ratio is not 1 for three reasons. The device leaves the wall and touches it again and
        the encoders step, which lowers it: each bounce is a new impact, and the hold adds and
        removes energy. Friction takes energy that the linear loop does not have. A controller adds
        its own damping, which raises the ratio.
        """
        return self.reached_N_m / self.held_N_m


def wall_limits(
    device: DeviceParameters,
    hand: HandParameters,
    *,
    rates_Hz: Sequence[float] = (500.0, 1000.0, 2000.0, 4000.0),
    delays_s: Sequence[float] = (0.0, 1e-3, 2e-3, 4e-3),
    renderers: Sequence[str] | None = None,
) -> list[WallLimit]:
    """The stiffest quiet wall for every renderer (without them all that are known), rate and delay.

    Stiffness climbs in steps of 15 % until the force ripples by more than 0.05 N, 0.3 to 0.5 s
    after the jerk.
    """
    found = []
    for rate in rates_Hz:
        for delay in delays_s:
            at = replace(device, rate_Hz=rate, transport_delay_s=delay)
            loop = at.loop(1.0)
            held = critical_stiffness_N_m(in_hands(loop, [hand.grip[:3]])[0])
            free, passive = critical_stiffness_N_m(loop), passive_bound_N_m(loop)
            for kind in renderers or RENDERERS:
                found.append(
                    WallLimit(kind, rate, delay, _reached(at, hand, kind), held, free, passive)
                )
    return found


def _reached(device: DeviceParameters, hand: HandParameters, kind: str) -> float:
    """Last stiffness before the first that rings [N/m]."""
    reached, stiffness = 0.0, LOWEST_N_M
    while stiffness < HIGHEST_N_M:
        run, _ = knock(device, hand, kind, stiffness)
        if not run.ripple_N(0.2) < RINGING_N:
            break
        reached, stiffness = stiffness, stiffness * RUNG
    return reached


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
