"""The stability atlas: every method taken to where it fails and past it, a page each."""

from tissue.evaluation.atlas.bad_tetrahedra import BAD_TETRAHEDRA
from tissue.evaluation.atlas.contrast import CONTRAST
from tissue.evaluation.atlas.cut_cells import CUT_CELLS
from tissue.evaluation.atlas.damper_sign import DAMPER_SIGN
from tissue.evaluation.atlas.explicit_cutting import EXPLICIT_CUTTING
from tissue.evaluation.atlas.force_command import FORCE_COMMAND
from tissue.evaluation.atlas.horizon import HORIZON
from tissue.evaluation.atlas.index_weights import INDEX_WEIGHTS
from tissue.evaluation.atlas.large_rotation import LARGE_ROTATION
from tissue.evaluation.atlas.locking import LOCKING
from tissue.evaluation.atlas.lost_samples import LOST_SAMPLES
from tissue.evaluation.atlas.low_pass import LOW_PASS
from tissue.evaluation.atlas.nearest_point import NEAREST_POINT
from tissue.evaluation.atlas.one_step_order import ONE_STEP_ORDER
from tissue.evaluation.atlas.pade import PADE
from tissue.evaluation.atlas.page import Page
from tissue.evaluation.atlas.powers import POWERS
from tissue.evaluation.atlas.quantisation import QUANTISATION
from tissue.evaluation.atlas.recursive_variance import RECURSIVE_VARIANCE
from tissue.evaluation.atlas.relaxation import RELAXATION
from tissue.evaluation.atlas.sampled_wall import SAMPLED_WALL
from tissue.evaluation.atlas.smoothness import SMOOTHNESS
from tissue.evaluation.atlas.thin_walls import THIN_WALLS
from tissue.evaluation.atlas.trained_elsewhere import TRAINED_ELSEWHERE
from tissue.evaluation.atlas.two_maxima import TWO_MAXIMA
from tissue.evaluation.atlas.wall_map import WALL_MAP
from tissue.evaluation.atlas.weber_law import WEBER_LAW
from tissue.evaluation.atlas.wild_input import WILD_INPUT

__all__ = ["PAGES"]

PAGES: tuple[Page, ...] = (
    ONE_STEP_ORDER, POWERS, LOW_PASS, PADE, FORCE_COMMAND, WEBER_LAW, TWO_MAXIMA, RECURSIVE_VARIANCE, DAMPER_SIGN,
    SAMPLED_WALL, RELAXATION, NEAREST_POINT, SMOOTHNESS, INDEX_WEIGHTS,
    WALL_MAP, QUANTISATION, EXPLICIT_CUTTING, THIN_WALLS, LOCKING, LARGE_ROTATION, BAD_TETRAHEDRA, CUT_CELLS, CONTRAST,
    TRAINED_ELSEWHERE, HORIZON, LOST_SAMPLES, WILD_INPUT,
)  # fmt: skip
"""In the order of the atlas: published statements that fail, E1 to E14, then methods at their limits."""
