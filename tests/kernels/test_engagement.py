"""Loads of the elements for one unit of each coefficient, against closed forms."""

import numpy as np
import pytest

from meshes.voxels.volume import density_volume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr, cylinder
from tissue.materials.constants import CuttingCoefficients
from tissue.models.bone.engagement import LINEAR_CHIPS_M, EngagedBone
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

RADIUS_M, FLUTES, SPIN, FEED_M_S = 1.5e-3, 5, 700.0, 2e-3
NOTHING = CuttingCoefficients(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1000.0, 1.0)


def engaged(profile, *, speed_m_s=FEED_M_S, pressed=0.0):
    """A tool held all in bone of 1000 kg/m3, moving down its axis.

    Returns the loads of a unit of each coefficient of the linear law, shape (6, 6).
    """
    volume = density_volume(
        np.full((48,) * 3, 1000.0), spacing_mm=0.1, origin_mm=(-2.4, -2.4, -2.4)
    )
    cutter = Cutter(profile, FLUTES, SPIN)
    model = BoneModel(volume, cutter, (NOTHING,), shell_spacing_m=3e-5)
    bone = EngagedBone(model, LINEAR_CHIPS_M)
    motion = ToolMotion(speed_m_s=speed_m_s, pressed=pressed)
    motion.tip_m[:], motion.heading[0] = (0.0, 0.0, -1.5e-3), (0.0, 0.0, -1.0)
    response = bone.respond(motion)
    at_zero, at_thickest = bone.unit_loads[0][0].reshape(2, 3, 6)
    return np.vstack([LINEAR_CHIPS_M[1] * at_thickest, at_zero + at_thickest]), response


def test_each_coefficient_of_a_ball_that_plunges():
    """Each coefficient of a plunging ball gives the force of the closed form.

    Over the lower half of a ball, theta from its tip: dF = N / (2 pi) R dtheta dphi, h = v
    cos(theta) 2 pi / N w.
    """
    loads, response = engaged(ball_burr(diameter_m=2.0 * RADIUS_M))
    chip = FEED_M_S * 2.0 * np.pi / (FLUTES * SPIN)
    along, around = FLUTES * RADIUS_M, -FLUTES * RADIUS_M**2
    # tangential, radial and axial chip, then edge; force and torque about the tip
    want = np.zeros((6, 6))
    want[0, 5], want[3, 5] = 0.5 * around * chip, around
    want[1, 2], want[4, 2] = 0.25 * np.pi * along * chip, along
    want[2, 2], want[5, 2] = -along * chip, -0.5 * np.pi * along
    # 20,000 elements: 1e-3 of the largest component of each coefficient's load, sideways too,
    # where loads cancel.
    for coefficient in range(6):
        size = np.abs(want[coefficient]).max()
        arm = np.array([1.0, 1.0, 1.0, RADIUS_M, RADIUS_M, RADIUS_M])
        most = size if want[coefficient, 5] == 0.0 else size / RADIUS_M
        assert loads[coefficient] / arm == pytest.approx(want[coefficient] / arm, abs=4e-3 * most)
    assert response.engaged_m2[0] == pytest.approx(2.0 * np.pi * RADIUS_M**2, rel=1e-3)
    assert response.removal_rate_m3_s == pytest.approx(np.pi * RADIUS_M**2 * FEED_M_S, rel=1e-3)


def test_chip_and_edge_of_a_cylinder_that_plunges_are_in_one_ratio():
    """Chip and edge forces of a plunging cylinder have one ratio.

    Only its flat end advances, by one chip thickness, so no log at one feed separates the two.
    """
    loads, _ = engaged(cylinder(diameter_m=2.0 * RADIUS_M, length_m=2e-3))
    chip = FEED_M_S * 2.0 * np.pi / (FLUTES * SPIN)
    assert np.abs(loads[3:]).max() > 0.0
    assert loads[:3] == pytest.approx(chip * loads[3:], abs=1e-6 * chip * np.abs(loads[3:]).max())


def test_a_tool_at_rest_feels_the_pressed_share_of_the_edge_force_and_no_chip():
    """A pressed tool at rest has the pressed share of the edge force and no chip force.

    The edge force of the lower half of a ball is N R along its axis; 0.3 of it holds a tool that is
    pressed so.
    """
    for pressed in (0.0, 0.3, 1.0):
        loads, response = engaged(
            ball_burr(diameter_m=2.0 * RADIUS_M), speed_m_s=0.0, pressed=pressed
        )
        edge = pressed * FLUTES * RADIUS_M
        assert not loads[:3].any() and response.removal_rate_m3_s == 0.0
        assert loads[4, 2] == pytest.approx(edge, rel=4e-3)
        assert loads[5, 2] == pytest.approx(-0.5 * np.pi * edge, rel=4e-3)
        assert loads[3, 5] == pytest.approx(-edge * RADIUS_M, rel=4e-3)
    moving, _ = engaged(ball_burr(diameter_m=2.0 * RADIUS_M), pressed=0.3)
    assert moving[4, 2] == pytest.approx(FLUTES * RADIUS_M, rel=4e-3)
