"""NaN and implausible device samples: commanded force with and without the sample guard."""

from math import inf, nan

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.hands import FAULT_S, OMNI, STIFFNESS_N_M, TICK_S, pressed
from tissue.evaluation.atlas.page import (
    BLUE,
    GREY,
    RED,
    Answer,
    Conduct,
    Data,
    Page,
    Verdict,
    error_of,
    panel,
    refused,
    shown,
)
from tissue.haptics.device.device import Sample
from tissue.haptics.device.sample_guard import GuardLimits, SampleGuard
from tissue.haptics.loop.filters import ForceRange

__all__ = ["PAGE"]

LIMITS = GuardLimits()
VALID_M = LIMITS.fastest_m_s * (TICK_S + LIMITS.oldest_s)
"""Longest plausible jump in a tick [m]."""


def forced(jump_m: float, *, guarded: bool) -> tuple[float, float, int]:
    """Measure the force before and at a sample that lies deeper by a jump [N].

    The number of rejected samples is returned too.
    """

    def change(sample: Sample) -> Sample:
        x, y, z = sample.position_m
        return sample._replace(position_m=(x, y, z - jump_m))

    run, guard = pressed(seconds=FAULT_S + 3e-3, guarded=guarded, change=change)
    size = np.linalg.norm(run.force_N, axis=1)
    tick = round(FAULT_S / TICK_S)
    return float(size[tick - 1]), float(size[tick]), 0 if guard is None else guard.bad_ticks


def measure(quick: bool) -> Data:
    """Sweep the size of the jump."""
    jumps = np.array([1e-3, 1e-2, 1.0, 1e9])
    if not quick:
        near = VALID_M * np.array([0.9, 1.1])
        jumps = np.sort(
            np.concatenate(
                [np.geomspace(1e-4, 1e-2, 6), near, 10.0 ** np.array([-1, 0, 2, 4, 6, 9])]
            )
        )
    bare = np.array([forced(jump, guarded=False) for jump in jumps.tolist()])
    guarded = np.array([forced(jump, guarded=True) for jump in jumps.tolist()])
    return {
        "jump": {
            "jump_m": jumps,
            "bare_N": bare[:, 1],
            "guarded_N": guarded[:, 1],
            "theory_N": bare[:, 0] + STIFFNESS_N_M * jumps,
            "before_N": guarded[:, 0],
            "not_believed": guarded[:, 2],
        }
    }


def judge(data: Data) -> Verdict:
    """Compare the force of one sample without the guard with that in its bounds."""
    table = data["jump"]
    beyond = table["jump_m"] > VALID_M
    off = error_of(table["bare_N"], table["theory_N"])
    worst = float(table["guarded_N"].max())
    bridged = float(np.abs(table["guarded_N"][beyond] / table["before_N"][beyond] - 0.95).max())
    return Verdict(
        bool(table["bare_N"].max() > 1e6 and off < 0.01),
        (table["not_believed"] == beyond).all()
        and worst <= OMNI.force_limit_N * (1.0 + 1e-12)
        and bridged < 1e-6,
        f"Without a guard one sample commands k·jump, up to {table['bare_N'].max():.1e} N. "
        "The guard accepts jumps "
        f"below {1e3 * VALID_M:.1f} mm (5 m/s over a tick and the allowed age) and rejects "
        "longer ones. It never "
        f"commands more than {worst:.2f} N, and a rejected sample takes 5 % of the force.",
    )


def ask() -> list[Answer]:
    """Give the engine NaN and infinite values, from the device and from a model."""
    answers = []
    for name, value in (("NaN", nan), ("infinite", inf)):
        guard = SampleGuard(force_limit_N=OMNI.force_limit_N)
        valid = guard.validate_sample(Sample(0.0, (0.0, value, 0.0)), 0.0)
        report = guard.events[0][1]
        answers.append(
            shown(
                f"a first sample that is {name}", valid is None, report, conduct=Conduct.FALLS_BACK
            )
        )
    guard = SampleGuard(force_limit_N=OMNI.force_limit_N)
    for tick in range(40):
        guard.validate_sample(Sample(TICK_S * tick, (0.0, 0.0, 0.0)), TICK_S * tick)
        force, _ = guard.limit_force(np.array([0.0, nan if tick >= 30 else 1.0, 0.0]))
    return [
        *answers,
        shown(
            "a model that returns NaN for 10 ms",
            bool(np.isfinite(force).all()) and 0.0 < force[1] < 1.0,
            f"{guard.events[-1][1]}; {force[1]:.2f} of 1 N is left",
            conduct=Conduct.FALLS_BACK,
        ),
        refused(
            "the device's range for a force that is NaN",
            lambda: ForceRange(limit_N=3.3).play(np.array([nan, 0.0, 0.0])),
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Draw the force over the jump."""
    table = data["jump"]
    jump = table["jump_m"]
    conduct = [(Conduct.HOLDS, jump[0], VALID_M), (Conduct.FALLS_BACK, VALID_M, jump[-1])]
    panel(
        chart.subplots(),
        jump,
        ("jump of one sample into the wall / m", "commanded force / N"),
        [
            ("theory: force before + k·jump", table["theory_N"], "-", GREY),
            ("every sample accepted", table["bare_N"], "s", RED),
            ("with the sample guard (engine)", table["guarded_N"], "o", BLUE),
            ("limit of the device", OMNI.force_limit_N, ":", GREY),
        ],
        conduct=conduct,
    )


PAGE = Page(
    "wild_input",
    "NaN and wild device input",
    "One sample of a device that is pressed onto a wall lies 0.1 mm to 1e9 m deeper than the "
    "last, or is NaN. Which "
    "force does the loop command?",
    "Sample guard: 5 m/s over a tick and 2.5 ms of age; Omni, wall of 1.5 kN/m",
    measure,
    judge,
    ask,
    draw,
)
