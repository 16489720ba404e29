"""The stability atlas: every method taken to where it fails and past it, a page each."""

from tissue.atlas.atlas import chosen_pages, make_page, write_atlas
from tissue.atlas.bad_tetrahedra import BAD_TETRAHEDRA
from tissue.atlas.contrast import CONTRAST
from tissue.atlas.cut_cells import CUT_CELLS
from tissue.atlas.damper_sign import DAMPER_SIGN
from tissue.atlas.explicit_cutting import EXPLICIT_CUTTING
from tissue.atlas.force_command import FORCE_COMMAND
from tissue.atlas.horizon import HORIZON
from tissue.atlas.index_weights import INDEX_WEIGHTS
from tissue.atlas.large_rotation import LARGE_ROTATION
from tissue.atlas.locking import LOCKING
from tissue.atlas.lost_samples import LOST_SAMPLES
from tissue.atlas.low_pass import LOW_PASS
from tissue.atlas.nearest_point import NEAREST_POINT
from tissue.atlas.one_step_order import ONE_STEP_ORDER
from tissue.atlas.pade import PADE
from tissue.atlas.page import Answer, Conduct, Page, Verdict
from tissue.atlas.powers import POWERS
from tissue.atlas.quantisation import QUANTISATION
from tissue.atlas.recursive_variance import RECURSIVE_VARIANCE
from tissue.atlas.relaxation import RELAXATION
from tissue.atlas.sampled_wall import SAMPLED_WALL
from tissue.atlas.smoothness import SMOOTHNESS
from tissue.atlas.thin_walls import THIN_WALLS
from tissue.atlas.trained_elsewhere import TRAINED_ELSEWHERE
from tissue.atlas.two_maxima import TWO_MAXIMA
from tissue.atlas.wall_map import WALL_MAP
from tissue.atlas.weber_law import WEBER_LAW
from tissue.atlas.wild_input import WILD_INPUT

__all__ = ["PAGES", "Answer", "Conduct", "Page", "Verdict", "chosen_pages", "make_page", "write_atlas"]

PAGES = (
    ONE_STEP_ORDER, POWERS, LOW_PASS, PADE, FORCE_COMMAND, WEBER_LAW, TWO_MAXIMA, RECURSIVE_VARIANCE, DAMPER_SIGN,
    SAMPLED_WALL, RELAXATION, NEAREST_POINT, SMOOTHNESS, INDEX_WEIGHTS,
    WALL_MAP, QUANTISATION, EXPLICIT_CUTTING, THIN_WALLS, LOCKING, LARGE_ROTATION, BAD_TETRAHEDRA, CUT_CELLS, CONTRAST,
    TRAINED_ELSEWHERE, HORIZON, LOST_SAMPLES, WILD_INPUT,
)  # fmt: skip
"""In the order of the atlas: published statements that fail, E1 to E14, then methods at their limits."""
