"""The profiles of the cutters that scenes describe: millimetres become metres, degrees radians."""

from math import radians

from tissue import cutters
from tissue.cutters.profile import Profile
from tissue.scene.tool import Tool

__all__ = ["ball_burr", "cylinder", "flat_reamer", "hemispherical_reamer", "pear_bur", "twist_drill"]


def ball_burr(tool: Tool) -> Profile:
    """A ball on a shank."""
    return cutters.ball_burr(diameter_m=tool.diameter_mm * 1e-3)


def pear_bur(tool: Tool) -> Profile:
    """A pear."""
    return cutters.pear_bur(diameter_m=tool.diameter_mm * 1e-3, length_m=tool.length_mm * 1e-3)


def cylinder(tool: Tool) -> Profile:
    """A cylinder that cuts at its flat end and its side."""
    return cutters.cylinder(diameter_m=tool.diameter_mm * 1e-3, length_m=tool.length_mm * 1e-3)


def twist_drill(tool: Tool) -> Profile:
    """A twist drill."""
    return cutters.twist_drill(
        diameter_m=tool.diameter_mm * 1e-3,
        length_m=tool.length_mm * 1e-3,
        point_angle_rad=radians(tool.point_angle_deg),
    )


def hemispherical_reamer(tool: Tool) -> Profile:
    """Half a ball, with a guide peg where the scene gives one."""
    return cutters.hemispherical_reamer(
        diameter_m=tool.diameter_mm * 1e-3,
        peg_diameter_m=tool.peg_diameter_mm * 1e-3,
        peg_length_m=tool.peg_length_mm * 1e-3,
    )


def flat_reamer(tool: Tool) -> Profile:
    """A disc, with a guide peg where the scene gives one."""
    return cutters.flat_reamer(
        diameter_m=tool.diameter_mm * 1e-3,
        thickness_m=tool.length_mm * 1e-3,
        peg_diameter_m=tool.peg_diameter_mm * 1e-3,
        peg_length_m=tool.peg_length_mm * 1e-3,
    )
