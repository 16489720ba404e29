"""Check of whether a cutting tool stays within the range of validity of its cutting law."""

from math import pi
from typing import Any

import numpy as np
import warp as wp

from kernels.bricks import corner8f
from kernels.cutting import AREA, DENSITIES, Coefficients, cutting_forces
from kernels.elements import CHUNK, lever16
from kernels.launcher import SplitLaunch
from kernels.mirror import Mirror
from kernels.older_cuts import SLOTS
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import Line
from tissue.models.bone.bricks import BrickStore
from tissue.models.bone.elements import elements_of
from tissue.models.tissue_model import ToolMotion

__all__ = ["THICKEST_M", "LawLimits", "SmoothSurface"]

THICKEST_M = 1e-4
"""Largest feed per tooth for which the law holds [m].

Cortical bone is sheared at depths of cut of 10 to 50 um and breaks off in pieces above 100 um (Luo
et al. 2022, Chinese Journal of Mechanical Engineering 35).
"""
SMOOTH_ELEMENTS = 500
"""Number of elements over the surface that does not cut."""
BLOCKED = 0.25
"""Share of the smooth end's area in contact with bone above which it is reported.

A peg touches the rim of its pilot hole.
"""


class SmoothSurface:
    """Area of a tool's non-cutting surface that is pushed into bone.

    Parameters
    ----------
    cutter, store
        Tool and bone.
    revolution
        The tool's distance table on the device.
    motion
        Device array of the motion, as the force kernel reads it.
    device
        Warp device name.
    """

    def __init__(
        self, cutter: Cutter, store: BrickStore, revolution: Any, motion: Any, *, device: str
    ) -> None:
        pieces = [piece for piece in cutter.profile.pieces if not piece.cutting]
        total_m2 = sum(piece.area_m2 for piece in pieces)
        shell = cutter.smooth_shell(spacing_m=(total_m2 / SMOOTH_ELEMENTS) ** 0.5)
        chunks = -(-len(shell.areas_m2) // CHUNK)
        layers = len(store.grid.layer_names)
        ends = [
            piece for piece in pieces if isinstance(piece, Line) and piece.start[1] == piece.end[1]
        ]
        radii = [max(piece.start[0], piece.end[0]) for piece in ends]
        self.blocked_m2 = BLOCKED * min([total_m2, *(pi * radius**2 for radius in radii)])
        self._sums = Mirror((chunks, AREA + layers), dtype=wp.float64, device=device)
        self._store = store
        self._device = device
        self._tool = revolution
        self._motion = motion
        self._elements = elements_of(shell, cutter, spacing_m=store.grid.spacing_m, device=device)
        self._scratch = wp.zeros((chunks, SLOTS + 1), dtype=corner8f, device=device)
        self._coefficients = _no_force(layers, device=device)
        self.record()

    def record(self) -> None:
        """Record the launch on the present arrays of the store."""
        store = self._store
        self._launch = SplitLaunch(
            cutting_forces,
            dim=len(self._sums.host),
            inputs=[
                self._tool,
                self._elements,
                self._coefficients,
                self._motion,
                0.0,
                store.grid.spacing_m,
                0,
                store.brick_of,
                store.material,
                store.nearby,
                store.older,
                store.alive,
            ],
            outputs=[self._scratch, self._sums.device],
            offset_index=6,
            device=self._device,
            cores=1,
        )

    @property
    def is_blocked(self) -> bool:
        """True if too much of the surface is pushed into bone, so that a force is missing."""
        self._launch()
        self._sums.pull()
        return float(self._sums.host[:, AREA:].sum()) > self.blocked_m2


class LawLimits:
    """Check of the feed per tooth and of the smooth surface of a tool in bone, at every answer.

    Parameters
    ----------
    cutter
        The tool.
    smooth
        Its surface that does not cut; None without such a surface.

    Attributes
    ----------
    notices
        A sentence at the first time that each limit is passed; the loop removes them as it logs
        them.
    passed
        All these sentences, by subject.
    thickest_m
        Largest feed per tooth in bone so far [m].
    """

    def __init__(self, cutter: Cutter, smooth: SmoothSurface | None) -> None:
        self._cutter = cutter
        self._smooth = smooth
        self.notices: list[str] = []
        self.passed: dict[str, str] = {}
        self.thickest_m = 0.0

    def restart(self) -> None:
        """Reset the limits that were passed."""
        self.notices.clear()
        self.passed.clear()
        self.thickest_m = 0.0

    def record(self) -> None:
        """Record launches anew, after the store's arrays have grown."""
        if self._smooth is not None:
            self._smooth.record()

    def check(self, motion: ToolMotion, engaged_m2: float, *, is_new: bool) -> None:
        """Check one answer.

        `is_new` is True if the tool or the bone has changed since the last answer.
        """
        if motion.speed_m_s == 0.0:
            return
        if engaged_m2 > 0.0:
            feed_m_s = motion.speed_m_s * float(np.linalg.norm(motion.heading[0]))
            self.thickest_m = max(self.thickest_m, feed_m_s * self._cutter.chip_per_speed_s)
            if self.thickest_m > THICKEST_M and "chips" not in self.passed:
                self._pass(
                    "chips",
                    f"the feed of {1e3 * feed_m_s:.3g} mm/s is {1e3 * self.thickest_m:.2g} "
                    "mm per tooth, but the "
                    f"cutting law holds up to {1e3 * THICKEST_M:g} mm: forces are "
                    "extrapolated. Use a slower feed or "
                    "a higher speed of the tool",
                )
        if (
            is_new
            and self._smooth is not None
            and "smooth surface" not in self.passed
            and self._smooth.is_blocked
        ):
            self._pass(
                "smooth surface",
                "a smooth part of the tool, such as its peg, is pushed into bone, which it "
                "cannot cut: no force is "
                "computed for it. Drill a pilot hole for the peg, or lead the tool elsewhere",
            )

    def _pass(self, about: str, sentence: str) -> None:
        """Record a limit that is passed."""
        self.passed[about] = sentence
        self.notices.append(sentence)


def _no_force(layers: int, *, device: str) -> Coefficients:
    """Return cutting coefficients of 0 for each layer."""
    arrays = Coefficients()
    arrays.chip = wp.zeros(layers, dtype=lever16, device=device)
    arrays.edge = wp.zeros(layers, dtype=lever16, device=device)
    arrays.strength = wp.zeros((layers, DENSITIES), dtype=wp.float32, device=device)
    return arrays
