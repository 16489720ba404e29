"""Build the object that reports when a tool leaves the simulated region."""

from tissue.models.bone.region_end import RegionEnd
from tissue.models.tissue_model import StopsReporting
from tissue.scene.anatomy import BlockImage
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import Parts
from tissue.simulation.builders.voxels import is_procedural, solid_of

__all__ = ["region_end"]


def region_end(scene: Scene, parts: Parts) -> RegionEnd | None:
    """Return an object that reports when the tool leaves the simulated region.

    The result is None if the tool cannot leave this region.
    """
    whole = isinstance(scene.anatomy, BlockImage) and scene.anatomy.is_whole
    # The region contains all of a scripted motion, and all of an image that is not cut out.
    if scene.device is None or whole:
        return None
    assert parts.volume is not None
    assert parts.cutter is not None
    tissue = None
    if is_procedural(scene.bone):
        anatomy, hole = solid_of(scene, parts.motion)
        tissue = anatomy.shape if hole is None else anatomy.shape - hole
    reporters = (parts.tissue, parts.keep_clear)
    return RegionEnd(
        parts.volume,
        parts.cutter,
        margin_mm=scene.voxels.margin_mm,
        tissue=tissue,
        reporters=tuple(each for each in reporters if isinstance(each, StopsReporting)),
    )
