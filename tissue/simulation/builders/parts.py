"""What a run is made of."""

from dataclasses import dataclass, field
from typing import Protocol

from meshes.base.placement import Placement
from meshes.base.progress import Progress
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.fem.fields import FieldSeries
from tissue.models.keep_clear import KeepClear
from tissue.models.tissue_model import HasFields, TissueModel
from tissue.motion.motion import Motion
from tissue.scene.scene import Scene

__all__ = ["FILE_WORDS", "Parts", "TissueBuilder"]

FILE_WORDS = ("file", "surface", "vertices", "faces", "triangles", "cells", "nodes", "labels")
"""What functions that read a file of anatomy or of a tool call it or what it holds."""


@dataclass
class Parts:
    """What a run is made of.

    Attributes
    ----------
    motion, tissue
        What moves the tool, and what it meets.
    cutter, volume
        The cutter and the voxels it mills; None where the tool does not cut.
    placement
        Where the scene's frame lies in that of the file that the anatomy came from; None where it
        came from none.
    notes
        What was assumed or found, by what it is about.
    events
        What the run reports from its start on: time [s] and a sentence each.
    keep_clear
        Measures the tool's distance from structures that it must not touch; None where the scene
        names none.
    """

    motion: Motion
    tissue: TissueModel
    cutter: Cutter | None = None
    volume: VoxelVolume | None = None
    placement: Placement | None = None
    notes: dict[str, str] = field(default_factory=dict)
    keep_clear: KeepClear | None = None
    events: list[tuple[float, str]] = field(default_factory=list)

    @property
    def fields(self) -> FieldSeries | None:
        """Displacement and stress over time; None where the tissue or the scene has none."""
        return self.tissue.fields if isinstance(self.tissue, HasFields) else None

    @property
    def placement_record(self) -> dict[str, dict[str, list[float]]]:
        """The placement as an entry of a run's summary; nothing where there is none."""
        return {} if self.placement is None else {"placement": self.placement.to_record()}


class TissueBuilder(Protocol):
    """Makes the parts of a run from a scene whose anatomy is of one kind."""

    def __call__(
        self,
        scene: Scene,
        motion: Motion,
        *,
        step_s: float,
        compute: str,
        cores: int | None,
        report: Progress,
    ) -> Parts:
        """Parts of a scene in which a motion moves the tool, ticks of `step_s` [s] long,
        computed on a device.
        """
        ...
