"""The spring and damper between a device and its proxy, in three and six degrees of freedom.

The damper acts on the difference of both velocities. A published form with ``+ b v_device`` alone pushes a moving
device along: it creates the energy b v^2 every second (E9 of the project's list of errors).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, require_positive, require_range
from tissue.motion.quaternion import turn_between

__all__ = ["VirtualCoupling", "series_stiffness_N_m"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class VirtualCoupling:
    """Spring-damper from the proxy to the device (Colgate, Stanley and Brown 1995).

    Attributes
    ----------
    stiffness_N_m, damping_N_s_m
        In translation.
    rotational_stiffness_Nm_rad, rotational_damping_Nms_rad
        In rotation; both 0 in three degrees of freedom.

    Raises
    ------
    InputError
        If a number is not finite or negative, or rotation is damped without a spring.
    """

    stiffness_N_m: float
    damping_N_s_m: float = 0.0
    rotational_stiffness_Nm_rad: float = 0.0
    rotational_damping_Nms_rad: float = 0.0

    def __post_init__(self) -> None:
        require_positive("stiffness_N_m", self.stiffness_N_m, "use what the device can hold, about 500")
        for name in ("damping_N_s_m", "rotational_stiffness_Nm_rad", "rotational_damping_Nms_rad"):
            require_range(name, getattr(self, name), 0.0, 1e12, "use 0 for none")
        if self.rotational_damping_Nms_rad > 0.0 and self.rotational_stiffness_Nm_rad == 0.0:
            raise InputError(
                "rotational_stiffness_Nm_rad must be positive where rotation is damped, got 0: use about 0.3"
            )

    @property
    def lever_m(self) -> float | None:
        """Length [m] that weighs turns against shifts in the proxy, None in three degrees of freedom."""
        if self.rotational_stiffness_Nm_rad == 0.0:
            return None
        return float((self.rotational_stiffness_Nm_rad / self.stiffness_N_m) ** 0.5)

    def force_N(self, proxy_m: Array, device_m: Array, proxy_velocity_m_s: Array, device_velocity_m_s: Array) -> Array:
        """Force on the device [N], shape (3,): k (p_proxy - p_device) + b (v_proxy - v_device)."""
        return self.stiffness_N_m * (proxy_m - device_m) + self.damping_N_s_m * (
            proxy_velocity_m_s - device_velocity_m_s
        )

    def torque_Nm(
        self, proxy: Array, device: Array, proxy_velocity_rad_s: Array, device_velocity_rad_s: Array
    ) -> Array:
        """Torque on the device [N m], shape (3,), from both quaternions (x, y, z, w) and angular velocities.

        The spring acts along the rotation vector of ``q_proxy q_device^-1``, in the world's axes.
        """
        return self.rotational_stiffness_Nm_rad * turn_between(device, proxy) + self.rotational_damping_Nms_rad * (
            proxy_velocity_rad_s - device_velocity_rad_s
        )

    def energy_J(self, proxy_m: Array, device_m: Array, proxy: Array, device: Array) -> float:
        """Energy held in both springs [J]."""
        stretch, turn = proxy_m - device_m, turn_between(device, proxy)
        return 0.5 * float(self.stiffness_N_m * (stretch @ stretch) + self.rotational_stiffness_Nm_rad * (turn @ turn))


def series_stiffness_N_m(coupling_N_m: float, environment_N_m: float) -> float:
    """Stiffness [N/m] felt through a coupling: 1/K = 1/K_coupling + 1/K_environment."""
    require_positive("coupling_N_m", coupling_N_m, "use about 1200")
    require_positive("environment_N_m", environment_N_m, "use about 1e4")
    return 1.0 / (1.0 / coupling_N_m + 1.0 / environment_N_m)
