"""What a run is made of."""

from dataclasses import dataclass, field

from meshes.volume import VoxelVolume
from tissue.cutters import Cutter
from tissue.model import TissueModel
from tissue.motion import Motion

__all__ = ["Parts"]


@dataclass
class Parts:
    """What a run is made of.

    Attributes
    ----------
    motion, tissue
        What moves the tool, and what it meets.
    cutter, volume
        The cutter and the voxels it mills; None where the tool does not cut.
    notes
        What was assumed or found, by what it is about.
    """

    motion: Motion
    tissue: TissueModel
    cutter: Cutter | None = None
    volume: VoxelVolume | None = None
    notes: dict[str, str] = field(default_factory=dict)
