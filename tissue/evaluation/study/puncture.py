"""Excess travel of a needle after a puncture, for a hand that pushes with a rising force.

The hand stops after its reaction time.

The needle's tip starts 0.05 mm outside an organ that lies below z = 0. A hand pushes the tip along
-z through a device. The force of the hand rises at ``rate_N_s``
(`tissue.haptics.hand.pushing.PushingHand`). The positions of the hand's aim a, the device s and the
tip z are measured along the push. Hand and device are one mass, M = m_device + m_hand, between the
grip's spring and damper on one side and the motor on the other. The coupling's spring k_c connects
the tip to the device, and the organ pulls the tip with P(z)::

    M s'' = K_0 (a - s) + reflex + b_hand (a' - s') - b_device s' - friction - f,    k_c (s - z) = P(z)

f is the force k_c (s - z) after prediction, low-pass, latency and the device's lag. The reflex is a
share of K_0 (a - s) one reflex time ago. P is a1 u + a2 u|u| with u = z until P reaches the
puncture force. From then on the needle slides, and u follows from a1 u + a2 u|u| = hold + cut +
friction * (z - u). P adds viscous * (z - u) z' to this force, see
`tissue.models.needle.model.Insertion`. The stop begins one reaction time after the hand has noticed
the puncture. It notices the puncture by the force alone, or by force or sight, whichever is first.
By sight, it notices the puncture in the first video frame that shows the tip `VISIBLE_M` beyond the
membrane. A frame shows the state one frame earlier. **Excess travel** = largest z from the puncture
on - z at the puncture.

The excess travel has three parts. The first part is the release of the springs without any delay.
It is dF / k_c for the tip, and dF / K_0 and more for the device because of its inertia, where dF is
the drop of P. No hand can prevent this part. The second part is the motion of the aim until the
stop, da/dt times the delay. The third part is the response of the aim to the sudden advance of the
device. It occurs in the part of the delay beyond the reaction time."""  # noqa: E501 a table

from dataclasses import dataclass
from math import inf, nan
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, require_positive
from tissue.evaluation.statistics.metrics import excess_travel_mm
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import hand_parameters
from tissue.haptics.hand.pushing import FeltDrop, PushingHand
from tissue.materials.constants import constants
from tissue.models.needle.model import NeedleModel
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion
from tissue.simulation.builders.parts import Parts
from tissue.simulation.run import Run
from tissue.simulation.simulate import TICK_S, RunObserver, simulate

__all__ = ["NOTICED", "RATE_N_S", "Notice", "Pierced", "pierce"]

Notice = Literal["force", "sight", "at once"]
"""Cue by which a puncture is noticed.

The cue "force" is the felt force. The cue "sight" is the felt force or the sight of the tip. The
cue "at once" is an ideal detection without delay, which no person can achieve.
"""
RATE_N_S = 1.0
"""Rise of the pushing force [N/s].

The value is assumed: a capsule of 2.3 N is punctured after some seconds, at about 5 mm/s.
"""
FRAME_S = 1.0 / 60.0
"""Time between two video frames."""
VISIBLE_M = 0.5e-3
"""Distance beyond a membrane from which on a tip is visible as beyond it [m].

The value is assumed: several pixels of a display.
"""
CUE_SHARE = 0.85
"""Share of the puncture force at which a cue is given to the hand.

The value is assumed: at 1 N/s, the cue is given more than a reaction time before the puncture.
"""
AFTER_S = 0.6
"""Duration of a run after the stop [s]. It covers a submovement and the ringing of the grip."""
LONGEST_S = 12.0
"""Time within which a push must have punctured the membrane [s]."""
NOTICED = "the hand notices a puncture"
"""Event of a run at the time when the hand notices the puncture.

The hand stops one reaction time later.
"""


@dataclass(frozen=True, eq=False)
class Pierced:
    """Result of a push of a needle.

    Attributes
    ----------
    run
        Run with its trace.
    puncture_s, noticed_s, stop_s
        Times at which the membrane broke, the puncture was noticed and the hand stopped [s].
        Infinite if this did not happen.
    felt_N
        Force of the hand along the push, by tick [N].
    aim_mm
        Advance of the aim, by tick [mm].
    """

    run: Run
    puncture_s: float
    noticed_s: float
    stop_s: float
    felt_N: NDArray[np.float64]
    aim_mm: NDArray[np.float64]

    @property
    def early(self) -> bool:
        """True if the hand stopped before the membrane broke."""
        return self.noticed_s < self.puncture_s

    @property
    def excess_mm(self) -> float:
        """Excess travel of the tip [mm]. NaN if the hand stopped early or did not stop."""
        if self.early or self.stop_s == inf:
            return nan
        return excess_travel_mm(
            -self.run.trace["tool_z_mm"], puncture_tick=round(self.puncture_s / TICK_S)
        )


def pierce(
    scene: Scene,
    *,
    kappa: float,
    offset_N: float,
    notice: Notice = "force",
    cue: bool = False,
    rate_N_s: float = RATE_N_S,
) -> Pierced:
    """Push a scene's needle through its first membrane.

    Parameters
    ----------
    scene
        Scene with a needle on a device. Its path gives the start, the direction, and the depth at
        which a push without a stop ends. Its hand, device, latency, predictor and seed are used.
    kappa, offset_N
        Threshold of the person for forces, see `FeltDrop`.
    notice
        Cue by which the puncture is noticed.
    cue
        If true, a cue is given at `CUE_SHARE` of the puncture force. It reaches the hand after the
        scene's latency.
    rate_N_s
        Rise of the force [N/s].

    Raises
    ------
    InputError
        If the scene has no device or no needle.
    """
    if scene.device is None or not isinstance(scene.motion, PathMotion):
        raise InputError(
            "scene", "have a device and a motion of kind path", "none", "set device, such as touch"
        )
    require_positive("rate_N_s", rate_N_s, f"use {RATE_N_S:g}")
    start, end = 1e-3 * np.array(scene.motion.points_mm[:2])
    limits = device_parameters(scene.held.kind, scene.constants)
    integration_s = constants("perception", "force")["integration_s"].value
    # 9 separates these streams from the other users of the scene's seed
    noise, frames = np.random.default_rng([scene.seed, 9]).spawn(2)
    hand = PushingHand(
        hand_parameters(scene.held.hand, scene.constants),
        start_m=start,
        direction=(end - start) / np.linalg.norm(end - start),
        rate_N_s=rate_N_s,
        felt=FeltDrop(kappa, offset_N, integration_s) if notice != "at once" else None,
        integration_s=integration_s,
        rng=noise,
    )
    x, y, z = start.tolist()
    device = SimulatedDevice(limits, hand, position_m=(x, y, z))
    cue_after_s = 1e-3 * scene.held.coupling.delay_ms if cue else inf
    # the display is not synchronised with the push
    frame_s = float(frames.uniform(0.0, FRAME_S))
    length_m = float(np.linalg.norm(end - start))
    bystander = _Bystander(
        hand, notice, cue_after_s=cue_after_s, frame_s=frame_s, length_m=length_m
    )
    pushed = changed(scene, {"duration_s": LONGEST_S})
    run = simulate(pushed, cores=1, device=device, observer=bystander, allow_unstable=True)
    felt_N, aim_mm = np.array(bystander.rows).T
    return Pierced(run, bystander.puncture_s, hand.noticed_s, hand.stop_s, felt_N, aim_mm)


class _Bystander(RunObserver):
    """Observer of a run that shows the tip to the hand, gives its cue, and ends the run."""

    def __init__(
        self,
        hand: PushingHand,
        notice: Notice,
        *,
        cue_after_s: float,
        frame_s: float,
        length_m: float,
    ) -> None:
        self._hand = hand
        self._notice = notice
        self._length = length_m
        self._cue_after = cue_after_s
        self._frame = frame_s
        self._cued = False
        self.puncture_s = inf
        self.rows: list[tuple[float, float]] = []

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Find the needle."""
        if not isinstance(parts.tissue, NeedleModel):
            raise InputError("scene", "have a needle", "another tool", "use the scene needle")
        self._needle = parts.tissue

    def on_tick(self, index: int, row: NDArray[np.float64], times: NDArray[np.float64]) -> bool:
        """Show the tip and give the cue when due; return whether the run continues."""
        now = index * TICK_S
        hand = self._hand
        insertion = self._needle.insertion
        self.rows.append((hand.felt_N, 1e3 * hand.aim_m))
        if insertion.punctured and self.puncture_s == inf:
            self.puncture_s = now
            # without a reaction time, as a bound for the other two cues
            if self._notice == "at once":
                hand.stop(now)
        if now >= self._frame:
            self._frame += FRAME_S
            if self._notice == "sight" and insertion.punctured and insertion.inserted_m > VISIBLE_M:
                # a display shows the state of the frame before
                hand.see(now + FRAME_S)
        if (
            not self._cued
            and insertion.pull_N >= CUE_SHARE * self._needle.tissue.membranes[0].puncture_N
        ):
            self._cued = True
            hand.cue(now + self._cue_after)
        return now < hand.stop_s + AFTER_S and hand.advance_m < self._length

    def on_end(self) -> list[tuple[float, str]]:
        """Return the time at which the hand noticed the puncture."""
        return [(self._hand.noticed_s, NOTICED)] if self._hand.noticed_s < inf else []
