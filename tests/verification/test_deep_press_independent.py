"""Deep presses against an independent analyst, who knew only the geometry and the energy.

The analyst did not know this code, and the method shares nothing with ours. It uses axial symmetry
with nine-node cells and three fields (displacement, pressure, volume), which do not lock. It has
augmented Lagrangian contact at points of faces, and edges of 1, 0.5 and 0.25 mm at the ball. The
difference between a square and a round base is computed by cells of 27 nodes in three dimensions.
The analyst puts the error of these figures at 0.05 %, and at 0.1 % for the smallest depth. The
volumetric energy is kappa / 4 (J^2 - 1 - 2 ln J), as ours.
"""

import numpy as np
import pytest
from pressed_block import our_presses, quarter
from pressed_deep import DEPTHS_M, TURN, by_newton, moving_N, scene_of

from tissue.simulation.simulate import simulate

SLAB_N = np.array([0.0506, 0.1441, 0.2637, 0.4009])
"""Ball of 16 mm in a slab of 80 x 80 x 40 mm, 5 kPa, nu = 0.45, at the depths of `DEPTHS_M` [N]."""
BLOCK_N = {4e-3: 0.1414, 8e-3: 0.3916}
"""Ball of 20 mm in the same block, shear modulus 1 kPa, nu = 0.49, by depth [m] [N]."""


@pytest.mark.slow
def test_a_run_under_a_law_has_the_independent_force(capsys):
    """A run under a law has the independent force.

    At rest it is within 1.5 %, moving within 4 %; most of this is the first depth, where few nodes
    touch.
    """
    run = simulate(scene_of(law="neo-hookean", poisson_ratio=0.45), cores=1)
    moving, rest = moving_N(run) / SLAB_N - 1.0, run.trace["force_z_N"][-1] / SLAB_N[-1] - 1.0
    newton = by_newton(scene_of(law="neo-hookean", poisson_ratio=0.45)).force_N / SLAB_N - 1.0
    linear = (
        simulate(scene_of(poisson_ratio=0.45), cores=1).trace["force_z_N"][-1] / SLAB_N[-1] - 1.0
    )
    with capsys.disabled():
        depths = ", ".join(f"{1e3 * depth:g}" for depth in DEPTHS_M)
        print(
            f"\noff the independent force by % at {depths} mm: moving "
            f"{np.round(100 * moving, 1)}, Newton's method on "
            f"the scene's mesh {np.round(100 * newton, 1)}; at rest {rest:+.1%}, linear law "
            f"{linear:+.1%}"
        )
    assert abs(rest) < 0.015 and np.abs(moving).max() < 0.045 and np.abs(newton).max() < 0.03
    assert len(run.trace.rows) > TURN and linear < -0.15, "what the linear law misses"


@pytest.mark.slow
def test_quadratic_cells_approach_the_independent_force(capsys):
    """Quadratic cells approach the independent force.

    At nu = 0.49 cells of 5 mm are 14 % too stiff at half the depth and 4 % at the whole: only their
    nodes touch.
    """
    forces = 4.0 * our_presses(*quarter(2, 5e-3, 1.5), np.array(list(BLOCK_N)))[0]
    off = forces / np.array(list(BLOCK_N.values())) - 1.0
    with capsys.disabled():
        print(f"\ncells of 5 mm: {np.round(forces, 4)} N, off by {np.round(100 * off, 1)} %")
    assert (off > 0.0).all() and off[0] < 0.16 and off[1] < 0.05
