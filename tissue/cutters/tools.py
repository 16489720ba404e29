"""Rotating cutters defined in millimetres, flutes and turns per minute, as in catalogues."""

from collections.abc import Callable
from functools import partial
from math import pi, radians, tan

from meshes.base.errors import InputError, require_positive, require_range, require_ranges
from meshes.base.hints import suggests_arguments
from tissue.cutters import profile
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import Profile

FASTEST_RPM = 1e6
"""Highest allowed spin [turns per minute]; an air turbine has 400,000."""


@suggests_arguments
def ball_burr(*, diameter_mm: float, flutes: int, spin_rpm: float) -> Cutter:
    """Return a ball burr, which cuts with its whole surface.

    Parameters
    ----------
    diameter_mm
        Diameter [mm], 0.1 to 200.
    flutes
        Number of cutting edges, 1 to 200.
    spin_rpm
        Turns per minute, clockwise as seen from the shank; negative for anticlockwise.

    Raises
    ------
    InputError
        If a number is not finite or out of range.
    """
    return _cutter(profile.ball_burr, flutes, spin_rpm, diameter_mm=diameter_mm)


@suggests_arguments
def pear_bur(*, diameter_mm: float, length_mm: float, flutes: int, spin_rpm: float) -> Cutter:
    """Return a dental pear bur: a ball at the tip and a taper to the neck.

    `length_mm` [mm] is the height of the neck above the tip. For the other parameters see
    `ball_burr`.
    """
    _require_longer(length_mm, 0.5 * diameter_mm, "the radius of its ball")
    return _cutter(profile.pear_bur, flutes, spin_rpm, diameter_mm=diameter_mm, length_mm=length_mm)


@suggests_arguments
def cylinder(*, diameter_mm: float, length_mm: float, flutes: int, spin_rpm: float) -> Cutter:
    """Return a flat end mill with the length `length_mm` [mm] that cuts with its face and side.

    For the other parameters see `ball_burr`.
    """
    return _cutter(profile.cylinder, flutes, spin_rpm, diameter_mm=diameter_mm, length_mm=length_mm)


@suggests_arguments
def twist_drill(
    *,
    diameter_mm: float,
    length_mm: float,
    point_angle_deg: float = 118.0,
    web_mm: float | None = None,
    helix_deg: float = 30.0,
    flutes: int = 2,
    spin_rpm: float,
) -> Cutter:
    """Return a twist drill with a given length and point angle.

    `length_mm` is the length [mm], and `point_angle_deg` is the point angle, 60 to 170 degrees.
    `web_mm` is the thickness of the web [mm], at most half the diameter. The web forms a chisel
    edge. The default of `web_mm` is 18 % of the diameter. With a web of 0, the lips reach the axis
    and have a constant rake. `helix_deg` is the helix angle of the flutes, 0 to 60 degrees. For the
    other parameters see `ball_burr`.
    """
    angle = radians(
        require_range("point_angle_deg", point_angle_deg, 60.0, 170.0, "use a value such as 118")
    )
    helix = radians(require_range("helix_deg", helix_deg, 0.0, 60.0, "use a value such as 30"))
    if web_mm is not None:
        require_range("web_mm", web_mm, 0.0, 0.5 * diameter_mm, "use 18 % of the diameter")
    _require_longer(length_mm, 0.5 * diameter_mm / tan(0.5 * angle), "the height of its point")
    make = partial(
        profile.twist_drill,
        point_angle_rad=angle,
        web_m=None if web_mm is None else 1e-3 * web_mm,
        helix_rad=helix,
    )
    return _cutter(make, flutes, spin_rpm, diameter_mm=diameter_mm, length_mm=length_mm)


@suggests_arguments
def hemispherical_reamer(
    *,
    diameter_mm: float,
    peg_diameter_mm: float = 0.0,
    peg_length_mm: float = 0.0,
    flutes: int,
    spin_rpm: float,
) -> Cutter:
    """Return a reamer shaped as half a ball, which cuts with its round face.

    The reamer has a smooth peg at its front if the diameter and length of the peg [mm] are given.
    """
    peg = _peg(peg_diameter_mm, peg_length_mm, diameter_mm)
    return _cutter(
        partial(profile.hemispherical_reamer, **peg), flutes, spin_rpm, diameter_mm=diameter_mm
    )


@suggests_arguments
def flat_reamer(
    *,
    diameter_mm: float,
    length_mm: float,
    peg_diameter_mm: float = 0.0,
    peg_length_mm: float = 0.0,
    flutes: int,
    spin_rpm: float,
) -> Cutter:
    """Return a disc with the height `length_mm` [mm] that cuts with its face and rim.

    The disc has a smooth peg if the diameter and length of the peg [mm] are given.
    """
    make = partial(profile.flat_reamer, **_peg(peg_diameter_mm, peg_length_mm, diameter_mm))
    return _cutter(make, flutes, spin_rpm, diameter_mm=diameter_mm, length_mm=length_mm)


@suggests_arguments
def of_profile(shape: Profile, *, flutes: int, spin_rpm: float) -> Cutter:
    """Return a cutter with any half section, see `tissue.cutters.profile.Profile`.

    For the parameters `flutes` and `spin_rpm` see `ball_burr`.
    """
    if isinstance(flutes, bool) or not isinstance(flutes, int) or not 1 <= flutes <= 200:
        raise InputError(
            "flutes", "be a whole number from 1 to 200", f"{flutes!r}", "count the cutting edges"
        )
    (rpm,) = require_ranges(
        ("spin_rpm", spin_rpm, -FASTEST_RPM, FASTEST_RPM, "use 500 for a reamer, 20000 for a burr")
    )
    if rpm == 0.0:
        raise InputError(
            "spin_rpm",
            "not be 0 for a tool that cuts",
            "0",
            "use 500 for a reamer, 20000 for a burr",
        )
    # A clockwise spin as seen from the shank is negative about the axis.
    return Cutter(shape, flutes, -rpm * 2.0 * pi / 60.0)


def _cutter(
    make: Callable[..., Profile], flutes: int, spin_rpm: float, **lengths_mm: float
) -> Cutter:
    """Make a cutter from a function that returns its profile, with lengths in millimetres."""
    lengths_m = {
        name.removesuffix("_mm") + "_m": 1e-3
        * require_range(name, length, 0.1, 200.0, "give it in millimetres")
        for name, length in lengths_mm.items()
    }
    return of_profile(make(**lengths_m), flutes=flutes, spin_rpm=spin_rpm)


def _require_longer(length_mm: float, least_mm: float, what: str) -> None:
    if length_mm <= least_mm:
        raise InputError(
            "length_mm",
            f"be above {what} ({least_mm:.4g})",
            f"{length_mm:g}",
            "use a larger length_mm",
        )


def _peg(diameter_mm: float, length_mm: float, tool_mm: float) -> dict[str, float]:
    """Return the arguments of a profile for a peg, in metres; empty without a peg."""
    if diameter_mm == 0.0 and length_mm == 0.0:
        return {}
    require_positive("peg_diameter_mm", diameter_mm, "give both sizes of the peg, or neither")
    require_positive("peg_length_mm", length_mm, "give both sizes of the peg, or neither")
    if diameter_mm >= tool_mm:
        raise InputError(
            "peg_diameter_mm",
            f"be below diameter_mm ({tool_mm:g})",
            f"{diameter_mm:g}",
            "use a thinner peg",
        )
    return {"peg_diameter_m": 1e-3 * diameter_mm, "peg_length_m": 1e-3 * length_mm}
