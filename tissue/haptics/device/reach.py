"""Bound on the positions of a device from its workspace, which detects positions in millimetres."""

from math import dist, isfinite

import numpy as np

from tissue.haptics.device.device import DeviceError, DeviceParameters
from tissue.motion.quaternion import Triple

__all__ = ["Reach", "reach_of"]

FURTHER = 3.0
"""Reach of an arm relative to the diagonal of its stated workspace.

The Touch has a stated workspace of 160 x 120 x 70 mm, and its arm moves in 431 x 348 x 165 mm.
Positions in millimetres exceed this reach after 0.6 mm.
"""
UNSTATED_M = 3.0
"""Reach of a device without a stated workspace [m]."""
MOST_WRONG = 20
"""Number of consecutive samples beyond the reach that counts as an error of the device."""


class Reach:
    """Check that a device stays within the reach of its arm.

    Parameters
    ----------
    limits
        Device parameters with the workspace.

    Attributes
    ----------
    limit_m
        Largest distance from the first position [m].
    """

    def __init__(self, limits: DeviceParameters) -> None:
        self._edges_m = limits.workspace_m
        diagonal_m = float(np.linalg.norm(self._edges_m))
        self.limit_m = FURTHER * diagonal_m if isfinite(diagonal_m) else UNSTATED_M
        self._first: Triple | None = None
        self._wrong = 0

    def restart(self) -> None:
        """Use the next position as the first one."""
        self._first = None
        self._wrong = 0

    def require(self, position_m: Triple, *, samples: int = MOST_WRONG) -> None:
        """Check a position [m], and refuse a device that stays beyond its reach.

        ``samples`` is the number of consecutive positions beyond the reach at which it is refused.

        Raises
        ------
        DeviceError
            If the device is out of its reach.
        """
        if not isfinite(sum(position_m)):
            return
        first = self._first = self._first or position_m
        away_m = dist(position_m, first)
        self._wrong = self._wrong + 1 if away_m > self.limit_m else 0
        if self._wrong < samples:
            return
        stated = "no workspace is stated"
        if isfinite(self._edges_m[-1]):
            stated = (
                "its workspace is "
                f"{' x '.join(f'{1e3 * edge:.3g}' for edge in self._edges_m[::-1])} mm"
            )
        raise DeviceError(
            f"the device reports a position {1e3 * away_m:.4g} mm from its first one, but "
            f"{stated}. If it reports "
            "millimetres, give metres; if it does reach so far, state workspace_width_m, "
            "workspace_height_m and "
            "workspace_depth_m in its constants"
        )


def reach_of(device: object, limits: DeviceParameters) -> Reach | None:
    """Return the reach of a device; None if it bounds its positions itself or has no arm."""
    return None if getattr(device, "bounds_itself", False) else Reach(limits)
