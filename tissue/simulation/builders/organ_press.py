"""Press stated by a caller: a point near the surface, a depth, and a direction."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, in_brackets, names_of_caller, require_direction
from meshes.base.progress import Progress, silent
from meshes.tets.regions import place_on_surface
from tissue.models.organ.model import LINEAR_ERROR
from tissue.models.organ.press import PressCurve, press
from tissue.models.organ.probe import ProbeShape, SphereProbe
from tissue.models.organ.soft_organ import SoftOrgan
from tissue.motion.motion import frame_along

__all__ = ["StatedPress", "press_at"]

FAR = 0.1
"""Largest accepted distance of a point from the surface, over the organ's longest side."""
NEAR_M = 1e-4
"""Distance below which a point counts as on the surface [m]."""
TOOL_EDGES = 4.0
"""Number of edges across a tool in scenes."""
FALLS = 0.05
"""Share by which the force may fall with depth, to allow for single steps of the contact."""
LONG = 1.25
"""Ratio of edge length to wanted length above which the edges are noted.

The error of a press is 4 % where edges are twice as long as wanted, and 0.1 % where they are not
longer.
"""
WORDS = {
    "point_m": "at_mm",
    "motion": "at_mm",
    "touch_edge_m": "edges of the mesh",
}
"""Names of the caller's arguments, by the names that the press uses."""


@dataclass(frozen=True, eq=False)
class StatedPress:
    """Press with the surface point and direction that were used.

    Attributes
    ----------
    curve
        Force over depth, and the organ at the end.
    point_m, along
        Point of the surface [m] and direction of the tool's motion, shape (3,) each.
    notes
        Notes on findings and assumptions, by subject.
    """

    curve: PressCurve
    point_m: NDArray[np.float64]
    along: NDArray[np.float64]
    notes: dict[str, str]


def press_at(
    organ: SoftOrgan,
    probe: ProbeShape,
    at_m: NDArray[np.float64],
    along: NDArray[np.float64] | None,
    *,
    depth_m: float,
    speed_m_s: float,
    hold_s: float,
    report: Progress = silent,
) -> StatedPress:
    """Press a tool on the surface point nearest to a given point [m].

    Parameters
    ----------
    organ, probe
        The organ, and the tool.
    at_m
        The given point [m], shape (3,).
    along
        Direction of the tool's motion, shape (3,). None is into the organ, against the mean normal
        under the tool.
    depth_m, speed_m_s, hold_s, report
        As for `tissue.models.organ.press.press`.

    Raises
    ------
    InputError
        If the point is far from the surface, the direction leads out of the organ, or the tool has
        no free path.
    """
    size = float(np.ptp(organ.mesh.nodes_m, axis=0).max())
    point, normal = place_on_surface(organ.mesh, at_m, probe.size_m[0])
    away = float(np.linalg.norm(point - at_m))
    notes = {}
    nearest = in_brackets(np.round(1e3 * point, 3) + 0.0)
    found = f"the nearest point of the surface, {nearest} mm, is {1e3 * away:.3g} mm away"
    if away > FAR * size:
        raise InputError("at_mm", "lie on the surface", in_brackets(1000.0 * at_m, ".4g"), found)
    if away > NEAR_M:
        notes["place"] = found
    direction = -normal if along is None else require_direction("along", along)
    if direction @ normal >= 0.0:
        inward = in_brackets(0.0 - normal, ".2g")
        raise InputError(
            "along", "lead into the organ", in_brackets(direction, ".3g"), f"use {inward}"
        )
    with names_of_caller(WORDS):
        curve = press(
            organ,
            probe,
            point,
            frame_along(tuple(-direction)),
            depth_m=depth_m,
            speed_m_s=speed_m_s,
            hold_s=hold_s,
            report=report,
        )
    _require_growing(curve, relaxes=organ.prony is not None)
    notes |= _resolution(organ, probe, point) | _linear(probe, depth_m)
    other = [each for each in curve.notices if "linear elasticity" not in each]
    if other:
        notes["contact"] = "; ".join(other)
    return StatedPress(curve, point, direction, notes)


def _require_growing(curve: PressCurve, *, relaxes: bool) -> None:
    """Refuse a press whose force falls with depth.

    The surface has then wrapped around the tool, which the linear law does not model.
    """
    size = np.linalg.norm(curve.force_N, axis=1)
    falls = np.flatnonzero(size < (1.0 - FALLS) * np.maximum.accumulate(size))
    if relaxes or not (falls.size or not size.any()):
        return
    most = (
        1e3 * float(curve.depth_m[int(np.argmax(size[: falls[0] + 1]))])
        if falls.size and size.any()
        else 0.0
    )
    remedy = f"press {most:.2g} mm at most" if most else "press less"
    raise InputError(
        "depth_mm",
        "be one to which the force grows",
        f"{1000.0 * curve.depth_m[-1]:.3g} where it falls, as no tissue does",
        f"{remedy}, or refine the organ there",
    )


def _resolution(
    organ: SoftOrgan, probe: ProbeShape, point_m: NDArray[np.float64]
) -> dict[str, str]:
    """Return a note if the edges under the tool are too long for it."""
    corners = organ.mesh.nodes_m[organ.mesh.surface]
    near = np.linalg.norm(corners.mean(axis=1) - point_m, axis=1)
    radius = probe.size_m[0]
    chosen = corners[near <= max(0.5 * radius, float(near.min()))]
    edge = float(np.linalg.norm(chosen - np.roll(chosen, 1, axis=1), axis=2).max())
    wanted = 2.0 * radius / TOOL_EDGES
    if edge <= LONG * wanted:
        return {}
    return {
        "mesh": f"edges of up to {1e3 * edge:.3g} mm under a tool of {2e3 * radius:.3g} mm, which "
        "takes "
        f"{1e3 * wanted:.3g} mm: refine the organ there"
    }


def _linear(probe: ProbeShape, depth_m: float) -> dict[str, str]:
    """Return a note on the depth to which the linear law holds; it is known only for balls."""
    if not isinstance(probe, SphereProbe):
        return {"linear": "from which depth the linear law is off is known of balls alone"}
    limits = [(1e3 * share * probe.radius_m, error) for share, error in LINEAR_ERROR]
    passed = [(depth, error) for depth, error in limits if 1e3 * depth_m > depth]
    if passed:
        depth, error = passed[-1]
        return {
            "linear": f"pressed {1e3 * depth_m:.3g} mm deep: from {depth:.2g} mm on the linear "
            "law is "
            "more than "
            f"{error:.0%} off a hyperelastic force"
        }
    return {
        "linear": (
            f"the linear law is within {limits[0][1]:.0%} of a hyperelastic force to "
            f"{limits[0][0]:.2g} mm"
        )
    }
