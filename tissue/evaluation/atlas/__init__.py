"""Stability atlas: each page shows for which parameter values a numerical method fails."""

from tissue.evaluation.atlas.bone_tooth import Contrast, CutCells, ExplicitCutting
from tissue.evaluation.atlas.held_tool import HeldTool
from tissue.evaluation.atlas.organs import BadTetrahedra, LargeRotation, Locking
from tissue.evaluation.atlas.page import Page
from tissue.evaluation.atlas.prediction import Horizon, TrainedElsewhere
from tissue.evaluation.atlas.samples import LostSamples, WildInput
from tissue.evaluation.atlas.walls import Quantisation, ThinWalls, WallMap

__all__ = ["PAGES"]

PAGES: tuple[Page, ...] = (
    WallMap(),
    Quantisation(),
    ExplicitCutting(),
    ThinWalls(),
    Locking(),
    LargeRotation(),
    BadTetrahedra(),
    CutCells(),
    Contrast(),
    HeldTool(),
    TrainedElsewhere(),
    Horizon(),
    LostSamples(),
    WildInput(),
)
"""Pages in the order of the atlas."""
