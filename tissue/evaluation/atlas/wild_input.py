"""NaN and wild device input: what a sample that no hand could have made commands, with and without a guard."""

from math import inf, nan

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.drawing import BLUE, GREY, RED, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, error_of, refused, shown
from tissue.evaluation.atlas.pressing import DEVICE, FAULT_S, STIFFNESS_N_M, TICK_S, pressed
from tissue.haptics.device.device import Sample
from tissue.haptics.device.sample_guard import GuardLimits, SampleGuard
from tissue.haptics.loop.filters import ForceRange

__all__ = ["PAGE"]

LIMITS = GuardLimits()
VALID_M = LIMITS.fastest_m_s * (TICK_S + LIMITS.oldest_s)
"""Longest jump in a tick that a hand could have made [m]."""


def forced(jump_m: float, *, guarded: bool) -> tuple[float, float, int]:
    """Force just before a sample lies so much deeper, and with it [N]; samples that were not accepted."""

    def change(sample: Sample) -> Sample:
        x, y, z = sample.position_m
        return sample._replace(position_m=(x, y, z - jump_m))

    run, guard = pressed(seconds=FAULT_S + 3e-3, guarded=guarded, change=change)
    size, tick = np.linalg.norm(run.force_N, axis=1), round(FAULT_S / TICK_S)
    return float(size[tick - 1]), float(size[tick]), 0 if guard is None else guard.bad_ticks


def measure(quick: bool) -> Data:
    """Commanded force over the size of the jump."""
    jumps = np.array([1e-3, 1e-2, 1.0, 1e9]) if quick else np.concatenate(
        [np.geomspace(1e-4, 1e-2, 6), VALID_M * np.array([0.9, 1.1]), 10.0 ** np.array([-1, 0, 2, 4, 6, 9])]
    )  # fmt: skip
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
    """What one sample commands without a guard; the bound with it, and where it stops accepting."""
    table = data["jump"]
    beyond = table["jump_m"] > VALID_M
    off, worst = error_of(table["bare_N"], table["theory_N"]), float(table["guarded_N"].max())
    bridged = float(np.abs(table["guarded_N"][beyond] / table["before_N"][beyond] - 0.95).max())
    return Verdict(
        bool(table["bare_N"].max() > 1e6 and off < 0.01),
        (table["not_believed"] == beyond).all() and worst <= DEVICE.force_limit_N * (1.0 + 1e-12) and bridged < 1e-6,
        f"Accepted as it comes, one sample commands k·jump, up to {table['bare_N'].max():.1e} N. The guard accepts "
        f"jumps below {1e3 * VALID_M:.1f} mm (5 m/s over a tick and the age allowed) and none above; it never "
        f"commands more than {worst:.2f} N, and a rejected sample takes off 5 % of the force.",
    )


def ask() -> list[Answer]:
    """Numbers that are none, from the device and from a model."""
    answers = []
    for what, wrong in (("NaN", nan), ("infinite", inf)):
        guard = SampleGuard(force_limit_N=DEVICE.force_limit_N)
        valid = guard.validate_sample(Sample(0.0, (0.0, wrong, 0.0)), 0.0)
        answers.append(
            shown(f"a first sample that is {what}", valid is None, guard.events[0][1], conduct=Conduct.FALLS_BACK)
        )
    guard = SampleGuard(force_limit_N=DEVICE.force_limit_N)
    for tick in range(40):
        guard.validate_sample(Sample(TICK_S * tick, (0.0, 0.0, 0.0)), TICK_S * tick)
        force, _ = guard.limit_force(np.array([0.0, nan if tick >= 30 else 1.0, 0.0]))
    kept = bool(np.isfinite(force).all())
    return [
        *answers,
        shown("a model that answers NaN for 10 ms", kept and 0.0 < force[1] < 1.0,
              f"{guard.events[-1][1]}; {force[1]:.2f} of 1 N is left", conduct=Conduct.FALLS_BACK),
        refused("a force that is not finite brought into the device's range",
                lambda: ForceRange(limit_N=3.3).play(np.array([nan, 0.0, 0.0]))),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """Force over the jump."""
    order = np.argsort(data["jump"]["jump_m"])
    table = {name: values[order] for name, values in data["jump"].items()}
    jump = table["jump_m"]
    panel(chart.subplots(), jump, "jump of one sample into the wall / m", "commanded force / N", [
        ("theory: force before + k·jump", table["theory_N"], "-", GREY),
        ("every sample accepted", table["bare_N"], "s", RED),
        ("with the sample guard (ours)", table["guarded_N"], "o", BLUE),
        ("the device's limit", DEVICE.force_limit_N, ":", GREY),
    ], conduct=[(Conduct.HOLDS, jump[0], VALID_M), (Conduct.FALLS_BACK, VALID_M, jump[-1])])  # fmt: skip


PAGE = Page(
    "wild_input",
    "NaN and wild device input",
    "One sample of a device that is pressed onto a wall lies 0.1 mm to 1e9 m deeper than the last, or is no number. "
    "What does the loop command?",
    "Sample guard: 5 m/s over a tick and 2.5 ms of age; Omni, wall of 1.5 kN/m",
    measure,
    judge,
    ask,
    draw,
)
