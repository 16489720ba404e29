"""The stability atlas: every method taken to where it fails and past it, a page each."""

from tissue.evaluation.atlas import (
    bad_tetrahedra,
    contrast,
    cut_cells,
    damper_sign,
    explicit_cutting,
    force_command,
    horizon,
    index_weights,
    large_rotation,
    locking,
    lost_samples,
    low_pass,
    nearest_point,
    one_step_order,
    pade,
    powers,
    quantisation,
    recursive_variance,
    relaxation,
    sampled_wall,
    smoothness,
    thin_walls,
    trained_elsewhere,
    two_maxima,
    wall_map,
    weber_law,
    wild_input,
)
from tissue.evaluation.atlas.page import Page

__all__ = ["PAGES"]

PAGES: tuple[Page, ...] = (
    one_step_order.PAGE, powers.PAGE, low_pass.PAGE, pade.PAGE, force_command.PAGE, weber_law.PAGE,
    two_maxima.PAGE, recursive_variance.PAGE, damper_sign.PAGE, sampled_wall.PAGE, relaxation.PAGE,
    nearest_point.PAGE, smoothness.PAGE, index_weights.PAGE, wall_map.PAGE, quantisation.PAGE,
    explicit_cutting.PAGE, thin_walls.PAGE, locking.PAGE, large_rotation.PAGE, bad_tetrahedra.PAGE,
    cut_cells.PAGE, contrast.PAGE, trained_elsewhere.PAGE, horizon.PAGE, lost_samples.PAGE, wild_input.PAGE,
)  # fmt: skip
"""In the order of the atlas: published statements that fail, E1 to E14, then methods at their limits."""
