"""A simulated device: a pen on a spring. A class for real hardware has the same methods."""

import numpy as np
from numpy.typing import NDArray

from tissue import register
from tissue.haptics.device.device import ComputedDevice, DeviceParameters, Sample

PEN = DeviceParameters(
    mass_kg=0.05,
    damping_N_s_m=0.5,
    encoder_step_m=2e-5,
    force_limit_N=4.0,
    stiffness_limit_N_m=1500.0,
    workspace_width_m=0.2,
    workspace_height_m=0.2,
    workspace_depth_m=0.2,
)
"""Constants of the pen for the stability check of its loop, invented for this example."""
SPRING_N_M = 80.0
DAMPER_N_S_M = 4.0
"""Stiffness and damping of the spring that pulls the pen towards a sinking point."""
SINK_M_S = 0.05
DEPTH_M = 0.03
"""Speed at which the point sinks, and the depth at which the point stops."""


@register.device("toy-pen", PEN)
class ToyPen(ComputedDevice):
    """Mass on a spring whose other end sinks. The commanded force pushes the mass back.

    Parameters
    ----------
    start_m
        Position of the tool at the start of the scene [m].
    """

    def __init__(self, start_m: tuple[float, float, float]) -> None:
        self.start_m = np.array(start_m)
        self.position_m = np.array(start_m)
        self.velocity_m_s = np.zeros(3)
        self.force_N = np.zeros(3)
        self.time_s = 0.0

    def read(self, time_s: float) -> Sample:
        """Move the mass up to a time by semi-implicit Euler steps and return its pose.

        The pose is rounded to the steps of the encoders.
        """
        step_s, self.time_s = time_s - self.time_s, time_s
        aim_m = self.start_m - np.array([0.0, 0.0, min(SINK_M_S * time_s, DEPTH_M)])
        pull_N = (
            SPRING_N_M * (aim_m - self.position_m)
            - (DAMPER_N_S_M + PEN.damping_N_s_m) * self.velocity_m_s
        )
        self.velocity_m_s += step_s / PEN.mass_kg * (pull_N + self.force_N)
        self.position_m += step_s * self.velocity_m_s
        seen_m = PEN.encoder_step_m * np.round(self.position_m / PEN.encoder_step_m)
        x, y, z = seen_m.tolist()
        u, v, w = self.velocity_m_s.tolist()
        return Sample(time_s, (x, y, z), (u, v, w))

    def command(self, force_N: NDArray[np.float64], torque_Nm: NDArray[np.float64]) -> None:
        """Set the force that pushes the pen until the next command.

        The pen has no motors for torque.
        """
        self.force_N = np.array(force_N)
