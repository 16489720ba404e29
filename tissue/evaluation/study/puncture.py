"""Simulation of a hand that pushes a needle with a rising force until a membrane punctures.

The needle's tip starts 0.05 mm outside an organ that lies below z = 0. A hand pushes the tip along
-z through a device. The force of the hand rises at ``rate_N_s``
(`tissue.haptics.hand.pushing.PushingHand`). The positions of the hand's aim a, the device s and the
tip z are measured along the push. Hand and device are modelled as one mass, M = m_device + m_hand.
The spring and the damper of the grip connect this mass to the aim, and the motor of the device acts
on the mass. The spring k_c of the coupling connects the tip to the device, and the organ resists
the tip with the force P(z)::

    M s'' = K_0 (a - s) + reflex + b_hand (a' - s') - b_device s' - friction - f,    k_c (s - z) = P(z)

K_0 and b_hand are stiffness and damping of the grip. f is the force k_c (s - z) after prediction,
low-pass filter, latency and lag of the device. The reflex is a fraction of the value that K_0 (a -
s) had one reflex time before. The deflection of the organ is u, and the inserted length of the
needle is z - u. Until the puncture, u = z and P = a1 u + a2 u|u|. The membrane is punctured when P
reaches the puncture force. Then the needle slides, and u follows from a1 u + a2 u|u| = hold + cut +
friction * (z - u). P is then this force plus viscous * (z - u) z', see
`tissue.models.needle.model.Insertion`. The hand notices the puncture by the drop of the force. It
begins to stop one reaction time later. **Excess travel** is the largest z from the puncture on,
minus z at the puncture.

The excess travel has three parts. The first part is the immediate relaxation of the springs. The
tip advances by dF / k_c relative to the device, where dF is the drop of the force P. The device
advances by more than dF / K_0, because of its inertia. No hand can prevent this part. The second
part is the motion of the aim until the hand stops: da/dt times the delay from puncture to stop. The
third part is the response of the aim to the sudden advance of the device. It begins one reaction
time after the puncture and ends when the hand stops.
"""  # noqa: E501 a table

from math import inf

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, require_positive
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

RATE_N_S = 1.0
"""Rate of increase of the pushing force [N/s].

The value is assumed. With this value, a capsule with a puncture force of 2.3 N is punctured after
several seconds, at about 5 mm/s.
"""
AFTER_S = 0.6
"""Time [s] for which a run continues after the hand begins to stop.

In this time, the hand comes to rest and the oscillation of the grip decays.
"""
LONGEST_S = 12.0
"""Largest duration of a run [s]. The membrane must be punctured within this time."""
NOTICED = "the hand notices a puncture"
"""Text of the event that is recorded when the hand notices the puncture.

The hand stops one reaction time later.
"""


def pierce(scene: Scene, *, kappa: float, offset_N: float, rate_N_s: float = RATE_N_S) -> Run:
    """Simulate a hand that pushes the needle of a scene through the first membrane.

    Parameters
    ----------
    scene
        Scene with a needle on a device. The first two points of the scene's path define the start,
        the direction, and the largest depth of the push.
    kappa, offset_N
        Weber fraction and offset [N] of the person's threshold, see `FeltDrop`.
    rate_N_s
        Rate of increase of the pushing force [N/s].

    Raises
    ------
    InputError
        If the scene has no device or no needle.
    """
    if scene.device is None or not isinstance(scene.motion, PathMotion):
        raise InputError(
            "scene",
            "have a device and a motion of kind path",
            "no device" if scene.device is None else "another motion",
            "set device, such as touch, and a motion of kind path",
        )
    require_positive("rate_N_s", rate_N_s, f"use a value such as {RATE_N_S:g}")
    start, end = 1e-3 * np.array(scene.motion.points_mm[:2])
    limits = device_parameters(scene.held.kind, scene.constants)
    integration_s = constants("perception", "force")["integration_s"].value
    # 9 separates this stream from the other users of the scene's seed
    (noise,) = np.random.default_rng([scene.seed, 9]).spawn(1)
    hand = PushingHand(
        hand_parameters(scene.held.hand, scene.constants),
        start_m=start,
        direction=(end - start) / np.linalg.norm(end - start),
        rate_N_s=rate_N_s,
        felt=FeltDrop(kappa, offset_N, integration_s),
        integration_s=integration_s,
        rng=noise,
    )
    x, y, z = start.tolist()
    device = SimulatedDevice(limits, hand, position_m=(x, y, z))
    end_of_run = _EndOfRun(hand, float(np.linalg.norm(end - start)))
    pushed = changed(scene, {"duration_s": LONGEST_S})
    return simulate(pushed, cores=1, device=device, observers=[end_of_run], allow_unstable=True)


class _EndOfRun(RunObserver):
    """Run observer that ends a run after the hand has stopped, or at a limit of the depth."""

    def __init__(self, hand: PushingHand, length_m: float) -> None:
        self.hand = hand
        self._length = length_m

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Check that the tool is a needle."""
        if not isinstance(parts.tissue, NeedleModel):
            raise InputError("scene", "have a needle", "another tool", "use the scene needle")

    def on_tick(self, index: int, row: NDArray[np.float64], times: NDArray[np.float64]) -> bool:
        """Return whether the run continues."""
        hand = self.hand
        return index * TICK_S < hand.stop_s + AFTER_S and hand.advance_m < self._length

    def on_end(self) -> list[tuple[float, str]]:
        """Return the event that the hand noticed the puncture, with its time [s]."""
        return [(self.hand.noticed_s, NOTICED)] if self.hand.noticed_s < inf else []
