"""Atlas pages on faulty device samples: lost, late, repeated and implausible samples."""

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.page import (
    ENGINE,
    FAILING,
    GREEN,
    GREY,
    ORANGE,
    THEORY,
    Conduct,
    Data,
    Page,
    Table,
    Verdict,
    error_of,
    panel,
)
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.recorded import Fault, FaultKind, FaultyDevice
from tissue.haptics.device.sample_guard import FADE_S, FASTEST_M_S, OLDEST_S, SampleGuard
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, hand_parameters, waypoints
from tissue.haptics.renderer import renderer
from tissue.haptics.rigid_wall import press_wall
from tissue.models.tissue_model import TICK_S

OMNI = device_parameters("omni")
STIFFNESS_N_M = 1500.0
"""Stiffness of the virtual wall [N/m].

With this stiffness, the haptic loop is stable, and the simulated expert presses with 1.2 N.
"""
FAULT_S = 0.15
"""Time at which the faults start [s]. At this time, the hand rests in contact with the wall."""
FIRST = round(FAULT_S / TICK_S)
STYLES: dict[FaultKind, tuple[str, str]] = {
    "dropped": ENGINE,
    "late": ("s", ORANGE),
    "duplicated": ("^", GREEN),
}
VALID_M = FASTEST_M_S * (TICK_S + OLDEST_S)
"""Longest jump of the position [m] from tick to tick that the sample guard accepts."""


def simulate_press(
    fault: Fault, *, seconds: float, guarded: bool
) -> tuple[Array, SampleGuard | None]:
    """Simulate an expert who aims 5 mm deep into a wall with a device that has a fault.

    Return the magnitude of the force [N], shape (ticks,), and the sample guard. If `guarded` is
    true, the guard checks the device samples. Otherwise, no guard is used, and None is returned
    instead of the guard.
    """
    # the aim is 5 mm deep from the first tick on
    path = waypoints(np.array([0.0, 1e-3]), np.full((2, 3), (0.0, 0.0, -5e-3)))
    # the seed does not matter: four seeds gave the same verdicts
    hand = Hand(hand_parameters("expert"), path, rng=np.random.default_rng(7))
    device = FaultyDevice(SimulatedDevice(OMNI, hand, position_m=(0.0, 0.0, 0.0)), fault)
    guard = SampleGuard(force_limit_N=OMNI.force_limit_N) if guarded else None
    wall = renderer("penalty", OMNI.loop(STIFFNESS_N_M))
    run = press_wall(device, wall, duration_s=seconds, guard=guard)
    return np.linalg.norm(run.force_N, axis=1), guard


def relative_forces(kind: FaultKind, gap_s: float, *, guarded: bool) -> list[float]:
    """Measure three forces during and after a sample fault, relative to the force before the fault.

    The fault lasts `gap_s`. The values are the force in the last tick of the fault, the largest
    force after it, and the largest force change between ticks during it.
    """
    fault = Fault(kind, FAULT_S, FAULT_S + gap_s)
    # 80 ms after the fault, in which the force returns
    size, _ = simulate_press(fault, seconds=fault.end_s + 0.08, guarded=guarded)
    last = round((FAULT_S + gap_s) / TICK_S) - 1
    step = np.abs(np.diff(size[FIRST - 1 : last + 1])).max()
    return (np.array([size[last], size[last + 1 :].max(), step]) / size[FIRST - 1]).tolist()


def over_gap(kind: FaultKind, gaps: Array) -> Table:
    """Compute `relative_forces` with and without guard for each fault duration [s] in `gaps`."""
    guarded = np.array([relative_forces(kind, gap, guarded=True) for gap in gaps.tolist()])
    bare = np.array([relative_forces(kind, gap, guarded=False) for gap in gaps.tolist()])
    # A repeated sample is accepted until it is too old. A late sample is too old immediately. From
    # then on, each tick takes 1/20 of the force.
    young_s = 2.0 * TICK_S if kind == "duplicated" else 0.0
    return {
        "gap_s": gaps,
        "guarded_at_end": guarded[:, 0],
        "guarded_after": guarded[:, 1],
        "guarded_step": guarded[:, 2],
        "bare_at_end": bare[:, 0],
        "bare_step": bare[:, 2],
        "theory_at_end": np.clip(1.0 - (gaps - young_s) / FADE_S, 0.0, 1.0),
    }


class LostSamples(Page):
    """Lost, late or repeated samples, with and without the sample guard.

    Without the guard, the force keeps its last value, or drops to zero in a single tick. With the
    guard, the force fades during the fault and returns after it.
    """

    name = "lost_samples"
    title = "Dropped, late and repeated samples"
    question = (
        "A hand presses a device onto a wall. Its samples are lost, come 5 ms late, or are "
        "repeated. Which force does the hand feel during the fault?"
    )
    source = (
        "Sample guard: samples older than 2.5 ms are missing, a missing one takes 1/20 of the "
        "force; Omni, wall of 1.5 kN/m"
    )

    def measure(self) -> Data:
        """Vary the duration of the fault for every kind of fault."""
        # short of, at and beyond the 20 ms in which the force fades
        gaps = 1e-3 * np.array([1, 2, 5, 8, 12, 16, 20, 30, 60])
        return {kind: over_gap(kind, gaps) for kind in STYLES}

    def judge(self, data: Data) -> Verdict:
        """Compare the forces without the guard with the force that the guard fades out."""
        tables = data.values()
        off = max(np.abs(t["guarded_at_end"] - t["theory_at_end"]).max() for t in tables)
        # 25 ms: the 20 ms of the fade, and the age that a repeated sample may have
        gone = max(t["guarded_at_end"][t["gap_s"] > 0.025].max() for t in tables)
        back = min(t["guarded_after"].min() for t in tables)
        step = max(t["guarded_step"].max() for t in tables)
        stale = data["duplicated"]["bare_at_end"].min()
        jump = data["dropped"]["bare_step"].max()
        return Verdict(
            # measured: stale 1.00, jump 1.00; gone 0, back 1.00, step 0.05 (1/20), off 0
            stale > 0.5 and jump > 0.9,
            gone < 1e-9 and back > 0.5 and step < 0.1 and off < 0.1,
            f"Without a guard repeated samples keep at least {100 * stale:.0f} % of the force as "
            f"long as they last, and dropped samples step it by {100 * jump:.0f} % in a tick. With "
            f"the guard the force decreases in 20 ms to {gone:.0e}, by at most {100 * step:.0f} % "
            f"a tick, as the line predicts to {100 * off:.0f} %. It is back 80 ms after the fault.",
        )

    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the force at fault end against fault duration, with and without guard."""
        panels = chart.subplots(1, 2, sharey=True)
        gap = 1e3 * data["late"]["gap_s"]
        for axes, column, title in (
            (panels[0], "guarded_at_end", "with the sample guard (engine)"),
            (panels[1], "bare_at_end", "every sample accepted"),
        ):
            guarded = column == "guarded_at_end"
            if guarded:
                # 1/20 of the force in each missing tick: zero after 20 ms
                axes.plot([0.0, 20.0, 60.0], [1.0, 0.0, 0.0], color=GREY, label="theory")
            panel(
                axes,
                gap,
                ("length of the gap / ms", "force at its end / force before" if guarded else ""),
                [(kind, data[kind][column], style) for kind, style in STYLES.items()],
                conduct=[(Conduct.FALLS_BACK, 0.0, 60.0)] if guarded else (),
                log="",
                xlim=(0.0, 60.0),
                ylim=(-0.05, 1.25),
                title=title,
            )


def forces_at_jump(jump_m: float, *, guarded: bool) -> tuple[float, float, int]:
    """Measure the forces [N] in the tick before a position jump and in the tick of the jump.

    The jump displaces the sample into the wall by ``jump_m`` [m]. The third result is the number of
    samples that the guard rejected.
    """
    # one sample only: times of ticks are sums with rounding; the run ends right after it
    half = 0.5 * TICK_S
    fault = Fault("jump", FAULT_S - half, FAULT_S + half, jump_m)
    size, guard = simulate_press(fault, seconds=FAULT_S + 3e-3, guarded=guarded)
    return float(size[FIRST - 1]), float(size[FIRST]), 0 if guard is None else guard.bad_ticks


class WildInput(Page):
    """Force after implausible or NaN device samples, with and without the sample guard."""

    name = "wild_input"
    title = "NaN and wild device input"
    question = (
        "One sample of a device that is pressed onto a wall lies 0.1 mm to 1e9 m deeper than the "
        "last, or is NaN. Which force does the loop command?"
    )
    source = "Sample guard: 5 m/s over a tick and 2.5 ms of age; Omni, wall of 1.5 kN/m"

    def measure(self) -> Data:
        """Vary the position jump of a single sample."""
        # just below and above the longest jump that the guard accepts
        near = VALID_M * np.array([0.9, 1.1])
        # a damaged sample may hold any number
        far = 10.0 ** np.array([-1, 0, 2, 4, 6, 9])
        jumps = np.sort(np.concatenate([np.geomspace(1e-4, 1e-2, 6), near, far]))
        bare = np.array([forces_at_jump(jump, guarded=False) for jump in jumps.tolist()])
        guarded = np.array([forces_at_jump(jump, guarded=True) for jump in jumps.tolist()])
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

    def judge(self, data: Data) -> Verdict:
        """Compare the force in the tick of a wrong sample with and without the sample guard."""
        table = data["jump"]
        beyond = table["jump_m"] > VALID_M
        off = error_of(table["bare_N"], table["theory_N"])
        worst = table["guarded_N"].max()
        # a rejected sample takes 1/20 of the force
        bridged = error_of(table["guarded_N"][beyond], 0.95 * table["before_N"][beyond])
        return Verdict(
            # measured: bare up to 1.5e12 N, off below 1e-15; the device limit holds to rounding
            table["bare_N"].max() > 1e6 and off < 0.01,
            (table["not_believed"] == beyond).all()
            and worst <= OMNI.force_limit_N * (1.0 + 1e-12)
            and bridged < 1e-6,
            f"Without a guard one sample commands k·jump, up to {table['bare_N'].max():.1e} N. The "
            f"guard accepts jumps below {1e3 * VALID_M:.1f} mm (5 m/s over a tick and the allowed "
            f"age) and rejects longer ones. It never commands more than {worst:.2f} N, and a "
            "rejected sample takes 5 % of the force.",
        )

    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the commanded force against the size of the jump."""
        table = data["jump"]
        jump = table["jump_m"]
        panel(
            chart.subplots(),
            jump,
            ("jump of one sample into the wall / m", "commanded force / N"),
            [
                ("theory: force before + k·jump", table["theory_N"], THEORY),
                ("every sample accepted", table["bare_N"], FAILING),
                ("with the sample guard (engine)", table["guarded_N"], ENGINE),
                ("limit of the device", OMNI.force_limit_N, (":", GREY)),
            ],
            conduct=[(Conduct.HOLDS, jump[0], VALID_M), (Conduct.FALLS_BACK, VALID_M, jump[-1])],
        )
