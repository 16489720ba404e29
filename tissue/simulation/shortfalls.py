"""Shortfalls of a run: an unfinished path, and bone or a lesion that was not removed."""

import numpy as np

from tissue.motion.motion import frame_along
from tissue.scene.anatomy import MolarAnatomy, Tooth
from tissue.scene.organ import LayersAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import ThrustMotion
from tissue.simulation.builders.parts import Parts
from tissue.simulation.trace import Table

__all__ = ["shortfalls"]

MOSTLY = 0.5
"""Share of a tooth's caries within reach below which the removal counts as missed."""
TOLERANCE_MM = 0.05
"""Tolerance for the depth of a thrust, below which a shortfall is not noted [mm]."""


def shortfalls(scene: Scene, parts: Parts, trace: Table, *, path_s: float) -> dict[str, str]:
    """Return notes on targets that a finished run did not reach or remove, by subject.

    ``path_s`` is the requested duration [s]. A run that is shorter than its scripted motion is
    noted.
    """
    found = {}
    wanted_s = parts.motion.duration_s - parts.motion.after_s
    if isinstance(scene.motion, ThrustMotion):
        heading = -frame_along(scene.motion.axis)[:, 2]
        wanted = scene.motion.depth_mm
        came = float((trace.vectors("tool", "mm") @ heading).max())
        if came < wanted - TOLERANCE_MM:
            found["path"] = (
                f"not finished: the tool came to {came:.3g} of motion.depth_mm = {wanted:g}; "
                "raise motion.thrust_N or "
                "duration_s"
            )
    elif wanted_s >= path_s + 5e-4:
        found["path"] = (
            f"not finished: the run ends at {path_s:g} s, the motion at {wanted_s:.6g} s; "
            "set duration_s = "
            f"{wanted_s:.6g} or leave it out to see all of it"
        )
    membranes = scene.anatomy.membranes if isinstance(scene.anatomy, LayersAnatomy) else []
    if beyond := [
        (name, depth) for name, depth in membranes if trace["insertion_mm"].max() < depth
    ]:
        found["membranes"] = (
            f"never reached: the needle went {trace['insertion_mm'].max():.3g} mm in, beyond lies "
            f"{', '.join(f'the {name} at {depth:g} mm' for name, depth in beyond)}; see "
            "anatomy.membrane_depths_mm"
        )
    if parts.cutter is None or parts.cutter.spin_rad_s == 0.0:
        return found
    if not np.any(parts.tissue.removed_m3):
        found["removed"] = (
            "nothing: the tool cut no tissue; move it deeper, or let the run last longer"
        )
    elif isinstance(tooth := scene.anatomy, Tooth) and _has_lesion(tooth, parts):
        missed = _missed_caries(parts)
        found |= {"removed": missed + _to_the_lesion(tooth, parts)} if missed else {}
    return found


def _has_lesion(anatomy: Tooth, parts: Parts) -> bool:
    """Return whether the tooth has a lesion, within the tool's reach or not."""
    if isinstance(anatomy, MolarAnatomy):
        return anatomy.caries_depth_mm > 0.0
    return "caries" in anatomy.layer_files or "lesion" in parts.notes


def _missed_caries(parts: Parts) -> str:
    """Return a note on caries that the tool left; empty if the removal is sufficient.

    It is noted if none was removed or, in a tooth from files, if most of the caries within reach is
    left.
    """
    removed_m3 = dict(zip(parts.tissue.layer_names, parts.tissue.removed_m3, strict=True)).get(
        "caries", 0.0
    )
    if removed_m3 == 0.0:
        return "nothing of the caries: the tool never met the lesion"
    if parts.placement is None:
        return ""
    there_m3 = float(parts.tissue.start_m3[parts.tissue.layer_names.index("caries")])
    if removed_m3 >= MOSTLY * there_m3:
        return ""
    return f"only {1e9 * removed_m3:.3g} of {1e9 * there_m3:.3g} mm3 of the caries within reach"


def _to_the_lesion(anatomy: Tooth, parts: Parts) -> str:
    """Return text on the extent of the caries, if known, and how to bring the tool to it."""
    at = parts.notes.get("lesion")
    aimed = getattr(anatomy, "site", "") == "caries" or parts.placement is None
    how = (
        "move motion.points_mm to it"
        if aimed
        else "set anatomy.site = caries, or move motion.points_mm to it"
    )
    return (f" ({at})" if at else "") + f"; {how}"
