"""Tissue that a scene's needle pierces, from the constants of the scene."""

from typing import TYPE_CHECKING

from tissue.scene.organ import LayersAnatomy
from tissue.scene.registry import NEEDLES
from tissue.scene.scene import Scene

if TYPE_CHECKING:
    from tissue.models.needle.parameters import NeedleTissue

__all__ = ["pierced_tissue"]


def pierced_tissue(scene: Scene) -> "NeedleTissue":
    """Return the tissue of a scene's needle; a registered needle states its own values."""
    from tissue.models.needle.parameters import needle_tissue, vessel_wall

    anatomy = scene.anatomy
    kind = scene.tool.kind
    assert isinstance(anatomy, LayersAnatomy)
    punctures_N = anatomy.membrane_punctures_N or {}
    holds_N = anatomy.membrane_holds_N or {}
    walls = tuple(
        vessel_wall(
            1e-3 * depth_mm,
            name=name,
            puncture_N=punctures_N.get(name),
            hold_N=holds_N.get(name),
            constants=scene.constants,
        )
        for name, depth_mm in anatomy.membranes
    )
    outside = NEEDLES[kind]
    if outside is None:
        return needle_tissue(walls=walls, constants=scene.constants)
    found: NeedleTissue = outside(walls=walls)
    return found
