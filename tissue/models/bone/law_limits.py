"""Range of validity of the cutting law."""

import numpy as np

from tissue.cutters.cutter import Cutter
from tissue.models.bone.smooth_surface import SmoothSurface
from tissue.models.tissue_model import ToolMotion

THICKEST_M = 1e-4
"""Largest feed per tooth for which the law holds [m].

Cortical bone is sheared at depths of cut of 10 to 50 um and breaks off in pieces above 100 um (Luo
et al. 2022, Chinese Journal of Mechanical Engineering 35).
"""


class LawLimits:
    """Check of the cutting law's limits: feed per tooth, and contact of the smooth surface.

    Parameters
    ----------
    cutter
        The tool.
    smooth
        Part of the tool's surface that does not cut; None if the whole surface cuts.

    Attributes
    ----------
    notices
        Sentences on exceeded limits. A limit adds its sentence when it is first exceeded. The
        simulation loop logs a sentence and then removes it.
    exceeded
        Dictionary with a sentence for each limit that was exceeded. The key names the limit.
    thickest_m
        Largest feed per tooth so far while the tool was in bone [m].
    """

    STATE = ("exceeded", "thickest_m")
    """Names of the attributes on which later ticks depend."""

    def __init__(self, cutter: Cutter, smooth: SmoothSurface | None) -> None:
        self._cutter = cutter
        self._smooth = smooth
        self.notices: list[str] = []
        self.exceeded: dict[str, str] = {}
        self.thickest_m = 0.0

    def restart(self) -> None:
        """Clear the notices and the records of exceeded limits."""
        self.notices.clear()
        self.exceeded.clear()
        self.thickest_m = 0.0

    def check(self, motion: ToolMotion, engaged_m2: float, *, is_new: bool) -> None:
        """Check the limits for the tool's present motion; `engaged_m2` is its area in bone [m2].

        `is_new` is True if the tool or the bone has changed since the last response.
        """
        # A tool at rest cuts no chip and does not move into bone.
        if motion.speed_m_s == 0.0:
            return
        if engaged_m2 > 0.0:
            feed_m_s = motion.speed_m_s * float(np.linalg.norm(motion.heading[0]))
            self.thickest_m = max(self.thickest_m, feed_m_s * self._cutter.chip_per_speed_s)
            if self.thickest_m > THICKEST_M and "chips" not in self.exceeded:
                self._record(
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
            and "smooth surface" not in self.exceeded
            and self._smooth.is_blocked
        ):
            self._record(
                "smooth surface",
                "a smooth part of the tool, such as its peg, is pushed into bone, which it "
                "cannot cut: no force is "
                "computed for it. Drill a pilot hole for the peg, or lead the tool elsewhere",
            )

    def _record(self, about: str, sentence: str) -> None:
        """Record that the limit with the name `about` is exceeded."""
        self.exceeded[about] = sentence
        self.notices.append(sentence)
