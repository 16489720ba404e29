"""Parts of a run: motion, tissue, cutter, voxels and notes."""

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
"""Argument names of the functions that read files of anatomy or tools."""


@dataclass
class Parts:
    """Parts of a run.

    Attributes
    ----------
    motion, tissue
        Motion of the tool, and the tissue that it meets.
    cutter, volume
        The cutter and the voxels that it cuts; None where the tool does not cut.
    placement
        Pose of the scene's frame in the frame of the anatomy's file; None without a file.
    notes
        Notes on assumptions and findings, by subject.
    events
        Events reported from the start of the run: time [s] and a sentence each.
    keep_clear
        Measures the tool's distance from structures that it must not touch; None where the scene
        names no structure.
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
        """Placement as an entry of a run's summary; empty without a placement."""
        return {} if self.placement is None else {"placement": self.placement.to_record()}


class TissueBuilder(Protocol):
    """Function that makes the parts of a run from a scene with one kind of anatomy."""

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
        """Return the parts of a scene in which a motion moves the tool.

        Ticks are `step_s` [s] long; `compute` names the device that computes.
        """
        ...
