"""Bed of springs that supports a tooth, against closed forms.

The closed forms depend neither on the voxels nor on the frame.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tooth_bodies import block

from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import (
    HexGrid,
    NodeSupports,
    ParticleSet,
    PointSprings,
    bed_springs,
    bed_stiffness,
)
from tissue.models.tooth.recovery import support_compliance

MM = 1e-3
ACROSS, ALONG = 11e9, 1e9  # [N/m3], their ratio that of a Poisson's ratio of 0.45
RIGID_PA = 1e16


def test_stiffness_of_a_bonded_layer():
    """Confined modulus lambda + 2 mu across, mu along, over the thickness."""
    modulus, ratio, thickness = 0.7e6, 0.45, 0.22 * MM
    mu = modulus / (2.0 * (1.0 + ratio))
    first = modulus * ratio / ((1.0 + ratio) * (1.0 - 2.0 * ratio))
    assert bed_stiffness(modulus, ratio, thickness) == pytest.approx(
        ((first + 2.0 * mu) / thickness, mu / thickness), rel=1e-12
    )


def springs_on(tooth, bed, *, spacing_m, origin_m=(0.0, 0.0, 0.0)):
    return bed_springs(
        tooth,
        bed,
        origin_m=np.array(origin_m),
        spacing_m=spacing_m,
        across_N_m3=ACROSS,
        along_N_m3=ALONG,
    )


def test_flat_bed():
    """The springs of a flat bed sum to area times stiffness.

    Only rounding is left, since no face of the border leans.
    """
    tooth, bed = np.zeros((2, 12, 8, 8), dtype=bool)
    tooth[:, :, 2:], bed[:, :, :2] = True, True
    springs, area = springs_on(tooth, bed, spacing_m=0.5 * MM)
    assert area == pytest.approx(6 * MM * 4 * MM, rel=1e-6)
    wanted = area * np.diag([ALONG, ALONG, ACROSS])
    assert springs.stiffness_N_m.sum(axis=0) == pytest.approx(
        wanted, rel=1e-5, abs=1e-5 * wanted.max()
    )


def rigid(solid, bed, *, edge_m, spacing_m, origin_m):
    """Return the support compliance of a rigid body of voxels in a bed, its springs and their area.

    The compliance is taken about the frame's origin.
    """
    springs, area = springs_on(solid, bed, spacing_m=spacing_m, origin_m=origin_m)
    position = origin_m + spacing_m * (np.argwhere(solid) + 0.5)
    particles = ParticleSet.uniform(
        position, volume_m3=spacing_m**3, modulus_Pa=RIGID_PA, poisson_ratio=0.3
    )
    grid = HexGrid.around(position, edge_m=edge_m)
    body = ParticleBody(particles, grid, NodeSupports.of(grid.node_count), springs=springs)
    weights = np.zeros(grid.node_count)
    np.add.at(weights, grid.cell_nodes, body.cells.fill[:, None])
    found = support_compliance(body, weights=weights, reference_m=np.zeros(3), tolerance=1e-6)
    assert found.converged
    return found, springs, area


def test_rigid_sphere_in_its_bed():
    """A rigid sphere in its bed has the compliance of the closed form.

    Along every axis it moves by 1 / (A (k_n + 2 k_t) / 3), and only the bed's shear resists its
    rotation, by 2/3 A R^2 k_t. The springs act half a voxel below the surface, which is 2 % of the
    radius and twice that of the rotation's stiffness. With the diagonal of each spring alone it
    would be 1 + (k_n / k_t - 1) / 5 = 3 times too stiff.
    """
    count, spacing = 56, 0.1 * MM
    radius = 22.3 * spacing
    origin = np.full(3, -0.5 * count * spacing)
    away = spacing * np.linalg.norm(np.indices((count,) * 3) + 0.5 - count / 2, axis=0)
    found, springs, area = rigid(
        away < radius, away >= radius, edge_m=0.5 * MM, spacing_m=spacing, origin_m=origin
    )
    give = np.diag(found.matrix)
    print(
        "\nsphere: rotation's stiffness over the closed form",
        1.0 / give[3:] / (2.0 / 3.0 * area * radius**2 * ALONG),
    )
    assert area == pytest.approx(4.0 * np.pi * radius**2, rel=0.01)
    assert give[:3] == pytest.approx(np.full(3, 3.0 / (area * (ACROSS + 2.0 * ALONG))), rel=0.01)
    assert 1.0 / give[3:] == pytest.approx(
        np.full(3, 2.0 / 3.0 * area * radius**2 * ALONG), rel=0.05
    )
    assert springs.stiffness_N_m.sum(axis=0) == pytest.approx(
        area * (ACROSS + 2.0 * ALONG) / 3.0 * np.eye(3), rel=1e-3, abs=1e-3 * area * ACROSS
    )


@pytest.mark.parametrize("turn_deg", [20.0, 45.0])
def test_tilted_plate(turn_deg):
    """A tilted plate has the stiffness A (k_t I + (k_n - k_t) n n^T).

    The bed is flat across n, at any angle in the voxels. The normals of the voxels' smooth surface
    err by less than a degree, which turns 0.016 of the stiffness across.
    """
    count, spacing = 64, 0.1 * MM
    normal = Rotation.from_euler("xz", [turn_deg, 0.6 * turn_deg], degrees=True).as_matrix()[:, 2]
    centres = spacing * (np.stack(np.indices((count,) * 3), axis=-1) + 0.5 - count / 2)
    height = centres @ normal
    side = np.linalg.norm(centres - height[..., None] * normal, axis=-1) < 2.0 * MM
    springs, area = springs_on(height > 0.0, (height <= 0.0) & side, spacing_m=spacing)
    wanted = ALONG * np.eye(3) + (ACROSS - ALONG) * np.outer(normal, normal)
    assert area == pytest.approx(np.pi * (2.0 * MM) ** 2, rel=0.02)
    assert springs.stiffness_N_m.sum(axis=0) / area == pytest.approx(wanted, abs=0.016 * ACROSS)


def test_a_turned_frame_gives_the_same_compliance_turned():
    """A turned frame gives the same compliance, turned.

    A rigid root, an ellipsoid held below its middle, is placed in one frame and in another, turned
    about all axes. The matrices differ by the voxels' staircase alone, 3 % of the geometric means
    of the diagonal.
    """
    count, spacing = 60, 0.1 * MM
    origin = np.full(3, -0.5 * count * spacing)
    centres = origin + spacing * (np.stack(np.indices((count,) * 3), axis=-1) + 0.5)

    def compliance(turn):
        turned = centres @ turn
        inside = np.linalg.norm(turned / (MM * np.array([1.4, 1.0, 2.4])), axis=-1) < 1.0
        held = ~inside & (turned[..., 2] < 0.5 * MM)
        return rigid(inside, held, edge_m=0.4 * MM, spacing_m=spacing, origin_m=origin)[0].matrix

    turn = Rotation.from_euler("xyz", [45.0, 30.0, 45.0], degrees=True).as_matrix()
    both = np.kron(np.eye(2), turn)
    straight = both @ compliance(np.eye(3)) @ both.T
    size = np.sqrt(np.outer(np.diag(straight), np.diag(straight)))
    worst = np.abs((compliance(turn) - straight) / size).max()
    print("\nturned frame: largest difference", worst)
    assert worst < 0.03


EDGE = 1e-3


STIFF = 1e15  # [Pa], a million times what the supports are: the block moves as a rigid one to 1e-6


def test_stiff_block_on_springs():
    """A stiff block on springs has the exact stiffness.

    With springs S in any direction at random points it is K = sum R^T S R over them, about a point
    above, where the motions couple.
    """
    particles, grid = block((4, 4, 4), EDGE, modulus_Pa=STIFF)
    random = np.random.default_rng(3)
    points = EDGE * random.uniform(0.0, 4.0, (25, 3)) * [1.0, 1.0, 0.3]
    half = 100.0 * random.normal(size=(25, 3, 3))
    springs = PointSprings(points, half @ half.transpose(0, 2, 1))
    body = ParticleBody(particles, grid, NodeSupports.of(grid.node_count), springs=springs)
    reference = np.array([1e-3, 2e-3, 5e-3])
    found = support_compliance(
        body, weights=np.ones(grid.node_count), reference_m=reference, tolerance=1e-8
    )
    assert found.converged
    motions = np.zeros((len(points), 3, 6))
    motions[:, :, :3] = np.eye(3)
    arms = (points - reference)[:, None, :]
    motions[:, :, 3:] = np.cross(np.eye(3)[None], arms).transpose(0, 2, 1)
    wanted = np.linalg.inv(np.einsum("nik,nij,njl->kl", motions, springs.stiffness_N_m, motions))
    size = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert np.abs((found.matrix - wanted) / size).max() <= 1e-4
    assert np.array_equal(found.matrix, found.matrix.T)
    moved = np.array([solution.displacement_m for solution in found.solutions])
    raw = np.einsum("kni,lni->kl", np.array(found.loads_N), moved)
    assert np.abs((raw - raw.T) / size).max() <= 1e-6
