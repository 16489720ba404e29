"""A tool: the half section that turns around its axis, from the tip to the top."""

from itertools import pairwise

from tissue import register
from tissue.cutters.profile import Line, Profile


@register.tool("step-drill", keys=("length_mm",))
def step_drill(diameter_m: float, length_m: float) -> Profile:
    """Return the profile of a drill with a pilot of half its diameter and a third of its length.

    A scene gives diameter and length in mm.
    """
    wide = 0.5 * diameter_m
    # radii: half and a quarter of the diameter
    narrow = 0.25 * diameter_m
    step = length_m / 3.0
    corners = [
        (0.0, 0.0),
        (narrow, 0.0),
        (narrow, step),
        (wide, step),
        (wide, length_m),
        (0.0, length_m),
    ]
    # the top does not cut
    pieces = [Line(start, end, cutting=end != corners[-1]) for start, end in pairwise(corners)]
    return Profile(tuple(pieces), convex=False)
