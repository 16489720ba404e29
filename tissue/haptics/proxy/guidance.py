"""Where a person leads a tool that resists: farther than it shall go, by what is seen and by
what is meant to push.
"""

from dataclasses import dataclass, field
from math import sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.hand.minimum_jerk import Path
from tissue.haptics.proxy.held_tool import HeldTool

__all__ = ["CompensatedPath", "Thrust"]

SHARE = 0.35
"""Share of what is seen missing that is added in every correction, where the tool goes as far as
the hand; assumed. At
0.5 one that mills overshoots: it is pushed aside by as much as it is to press."""
LEAST_YIELD = 0.6
"""Least motion of a tool for each of the hand that a person reckons with; assumed. Of 1 to 0.2 it
is where reaming is nearly finished (0.2 mm are missing instead of 0.5) before milling
overshoots."""


@dataclass
class CompensatedPath:
    """A path on which the tool, not the hand, is brought to where it shall be.

    A hand that only went where the tool shall be would stop where spring and resistance balance. At
    every correction this one goes farther by a share of what the tool is seen to lack, and by the
    more the less of its last motions the tool has made.

    Attributes
    ----------
    path
        Where the tool shall be.
    tool
        Where it is.
    lead_s
        How far ahead of the present an aim asks for its path [s].
    furthest_m
        Farthest that the hand is led beyond the path [m].
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
        """Where to aim at a time [s]; each call is a correction."""
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
        """Take the tool's last motion for each of the hand's, which was aimed at two corrections
        ago.
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
    """A push of given size along a line until the tool has gone its path; the hand goes with the
    tool.

    Attributes
    ----------
    start_m, path_m
        Where the tool starts and how it shall go [m], shape (3,).
    tool
        Where it is.
    push_N
        At the device [N].
    stretch_m
        How far the device is ahead of the tool while that pushes [m].
    """

    start_m: Array
    path_m: Array
    tool: HeldTool
    push_N: float
    stretch_m: float

    @property
    def share(self) -> float:
        """Share of the path that the tool has gone, 0 to 1."""
        gone = float((self.tool.tip_m - self.start_m) @ self.path_m) / float(
            self.path_m @ self.path_m
        )
        return min(max(gone, 0.0), 1.0)

    def path(self, time_s: float) -> Array:
        """Where to aim at a time [s]: at the device that the tool hangs on."""
        share = self.share
        if time_s <= 0.0 or share == 1.0:
            return self.start_m + share * self.path_m
        return (
            self.start_m
            + share * self.path_m
            + self.stretch_m * self.path_m / sqrt(self.path_m @ self.path_m)
        )

    def push(self, time_s: float) -> Array:
        """Intended force at a time [N]."""
        if self.share == 1.0:
            return np.zeros(3)
        force: Array = self.push_N * self.path_m / sqrt(self.path_m @ self.path_m)
        return force
