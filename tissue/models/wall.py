"""Stiff flat wall that a ball presses.

It is the hardest task of a device, and its force is known in closed form.
"""

from math import pi

import numpy as np

from meshes.base.errors import InputError, require_positive
from tissue.models.tissue_model import Response, ToolMotion

__all__ = ["WallModel"]


class WallModel:
    """Linear unilateral spring along z over the plane z = 0: F = k depth, without friction.

    Its measure is the depth of the ball's deepest point [mm]. ``engaged_m2`` is the area of the
    circle where the plane cuts the ball. The response holds the wall's stiffness, so that a tool on
    a device finds its balance at once.

    Parameters
    ----------
    stiffness_N_m
        Stiffness of the wall [N/m].
    radius_m
        Radius of the ball [m]; its tip is a radius from its centre, against the tool's axis.
    """

    layer_names: tuple[str, ...] = ("wall",)
    measure_names: tuple[str, ...] = ("depth_mm",)

    def __init__(self, stiffness_N_m: float, *, radius_m: float) -> None:
        self.stiffness_N_m = require_positive("stiffness_N_m", stiffness_N_m, "use 1e4")
        self._radius = require_positive("radius_m", radius_m, "use 5e-3")
        self.start_m3 = np.zeros(1)
        self.removed_m3 = np.zeros(1)
        self._free = np.zeros((3, 3))
        self._pressed = np.diag((0.0, 0.0, self.stiffness_N_m))
        self._response = Response.empty(1, 1)
        self._response.normal[2] = 1.0

    def place(self, motion: ToolMotion) -> None:
        """Put the ball at its start.

        Raises
        ------
        InputError
            If that is inside the wall.
        """
        depth = self._depth_m(motion)
        if depth > 0.0:
            raise InputError(
                "motion",
                "start outside the wall",
                f"a ball {1000.0 * depth:g} mm inside",
                "start higher",
            )

    def advance(self, motion: ToolMotion) -> None:
        """Do nothing: a spring has no internal state."""

    def respond(self, motion: ToolMotion) -> Response:
        """Return the force on the ball, and its torque about the tip."""
        response = self._response
        depth = self._depth_m(motion)
        response.gap_m = max(-depth, 0.0)
        depth = max(depth, 0.0)
        force = self.stiffness_N_m * depth
        arm_x, arm_y, _ = self._radius * motion.rotation[:, 2]
        response.wrench[2] = force
        response.wrench[3] = arm_y * force
        response.wrench[4] = -arm_x * force
        response.edge[:] = response.wrench
        response.stiffness_N_m = self._pressed if depth > 0.0 else self._free
        response.engaged_m2[0] = pi * depth * max(2.0 * self._radius - depth, 0.0)
        response.measures[0] = 1e3 * depth
        return response

    def _depth_m(self, motion: ToolMotion) -> float:
        """Return the depth of the ball's lowest point below the plane [m]; negative above it."""
        return float(-motion.tip_m[2] + self._radius * (1.0 - motion.rotation[2, 2]))
