"""What a scene's needle meets, from the constants of the scene."""

from typing import TYPE_CHECKING

from tissue.scene.organ import LayersAnatomy
from tissue.scene.registry import NEEDLES
from tissue.scene.scene import Scene

if TYPE_CHECKING:
    from tissue.models.needle.parameters import NeedleTissue

__all__ = ["pierced_tissue"]


def pierced_tissue(scene: Scene) -> "NeedleTissue":
    """The organ as a scene's needle feels it; a needle from outside states its own numbers.

    Raises
    ------
    InputError
        If the vessel's wall does not lie below the capsule.
    """
    assert isinstance(scene.anatomy, LayersAnatomy)
    depth_mm, kind = scene.anatomy.vessel_wall_depth_mm, scene.tool.kind
    depth_m = None if depth_mm is None else 1e-3 * depth_mm
    if kind in NEEDLES.built_in:
        return NEEDLES[kind](vessel_wall_depth_m=depth_m, constants=scene.constants)
    return NEEDLES[kind](vessel_wall_depth_m=depth_m)
