"""Guidance of a resisting tool by an operator, who corrects visible errors or applies a thrust."""

from dataclasses import dataclass, field
from math import sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.hand.minimum_jerk import Path
from tissue.haptics.proxy.held_tool import HeldTool

__all__ = ["CompensatedPath", "Thrust"]

SHARE = 0.35
"""Share of the visible error that each correction adds, for a tool that follows the hand; assumed.

At 0.5, milling overshoots: the tool is pushed aside as far as it should press.
"""
LEAST_YIELD = 0.6
"""Smallest ratio of tool motion to hand motion that an operator assumes; assumed.

Among values from 1 to 0.2, reaming is nearly finished (0.2 mm are missing instead of 0.5) before
milling overshoots.
"""


@dataclass
class CompensatedPath:
    """Path on which the tool, not the hand, reaches its target.

    A hand that moved only to the target would stop where spring and resistance balance. At every
    correction, this hand moves farther by a share of the visible error of the tool. The share
    increases if the tool has made less of its last motions.

    Attributes
    ----------
    path
        Target position of the tool.
    tool
        Held tool, with its present position.
    lead_s
        Time by which an aim requests its path in advance [s].
    furthest_m
        Largest distance by which the hand moves beyond the path [m].
    """

    path: Path
    tool: HeldTool
    lead_s: float
    furthest_m: float
    beyond_m: Array = field(default_factory=lambda: np.zeros(3))
    _aims_m: list[Array] = field(default_factory=list)
    _tip_m: Array = field(default_factory=lambda: np.zeros(3))
    _yields: float = 1.0

    def __call__(self, time_s: float) -> Array:
        """Return the aim at a time [s]; each call is a correction."""
        if time_s > self.lead_s:
            self._learn()
            self.beyond_m += (
                SHARE / self._yields * (self.path(time_s - self.lead_s) - self.tool.tip_m)
            )
            size = sqrt(self.beyond_m @ self.beyond_m)
            self.beyond_m *= min(self.furthest_m / size, 1.0) if size > 0.0 else 1.0
        aim = self.path(time_s) + self.beyond_m
        self._aims_m = [*self._aims_m[-2:], aim]
        self._tip_m = self.tool.tip_m.copy()
        return aim

    def _learn(self) -> None:
        """Update the ratio of tool motion to hand motion.

        The hand motion was aimed at two corrections ago.
        """
        if len(self._aims_m) == 3:
            went = self.tool.tip_m - self._tip_m
            aimed = self._aims_m[1] - self._aims_m[0]
            square = float(aimed @ aimed)
            if square > 0.0:
                self._yields += 0.5 * (
                    min(max(float(went @ aimed) / square, LEAST_YIELD), 1.0) - self._yields
                )


@dataclass
class Thrust:
    """Push of given size along a line until the tool has completed its path.

    The hand follows the tool.

    Attributes
    ----------
    start_m, path_m
        Start position and path vector of the tool [m], shape (3,).
    tool
        Held tool, with its present position.
    push_N
        Push at the device [N].
    stretch_m
        Lead of the device over the tool under this push [m].
    """

    start_m: Array
    path_m: Array
    tool: HeldTool
    push_N: float
    stretch_m: float

    @property
    def share(self) -> float:
        """Share of the path that the tool has completed, 0 to 1."""
        gone = float((self.tool.tip_m - self.start_m) @ self.path_m) / float(
            self.path_m @ self.path_m
        )
        return min(max(gone, 0.0), 1.0)

    def path(self, time_s: float) -> Array:
        """Return the aim at a time [s]: the position of the device that holds the tool."""
        share = self.share
        if time_s <= 0.0 or share == 1.0:
            return self.start_m + share * self.path_m
        return (
            self.start_m
            + share * self.path_m
            + self.stretch_m * self.path_m / sqrt(self.path_m @ self.path_m)
        )

    def push(self, time_s: float) -> Array:
        """Return the intended force at a time [N]."""
        if self.share == 1.0:
            return np.zeros(3)
        force: Array = self.push_N * self.path_m / sqrt(self.path_m @ self.path_m)
        return force
