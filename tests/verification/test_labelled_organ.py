"""`tissue.Organ.from_labels` against known results.

They are organs of known surfaces, springs in series and Eshelby's inclusion.
"""

import numpy as np
import pytest
import pyvista
from labelled_organs import RADII_MM, organ_labels

import tissue
from meshes.ct.labels import Labels
from meshes.images.frame import Image

pytestmark = pytest.mark.slow
MODULUS_KPA = 5.0
BALL_MM = 9.0
TOP_MM = np.array([0.0, 0.0, RADII_MM[2]])
PUNCH = tissue.flat_punch(diameter_mm=80)


def over_the_ball_N(organ, turn):
    """Force of a ball of 16 mm, 2 mm deep, at the end of the shortest half axis."""
    place = turn @ TOP_MM
    near = organ.refined(edge_mm=2.5, near_mm=place)
    press = near.press(tissue.ball(diameter_mm=16), depth_mm=2, at_mm=place, along=-turn[:, 2])
    return press.force_magnitude_N


@pytest.mark.parametrize("part_kPa", [40.0, 1.0])
def test_labels_give_the_force_of_the_surfaces_that_they_were_made_of(part_kPa):
    """Labels give the force of the surfaces from which they were made.

    The organ is an ellipsoid of 72 x 52 x 44 mm with a ball of 18 mm, 4 mm under the pressed place;
    the ball is stiff as a tumour, or soft. With edges of 2.5 mm under the ball, fillings of one
    surface differ by 2 %, with 3.5 mm by 5 %. No two runs of the mesher are alike, so the bands are
    wider by that. With slices of 5 mm there are 3.6 to the tumour, and less than one over it.
    """
    made = {
        "modulus_kPa": MODULUS_KPA,
        "poisson_ratio": 0.45,
        "edge_mm": 6,
        "parts": {"tumour": part_kPa},
    }
    _, turn = organ_labels((3, 3, 3), 0)
    outer = (
        pyvista.ParametricEllipsoid(*RADII_MM, u_res=120, v_res=120, w_res=120)
        .triangulate()
        .clean()
    )
    outer.points = outer.points @ turn.T
    inner = pyvista.Sphere(
        radius=BALL_MM, center=turn @ (0, 0, 9), theta_resolution=60, phi_resolution=60
    )
    exact = over_the_ball_N(
        tissue.Organ.from_surface(outer, inclusions={"tumour": inner}, **made), turn
    )
    bands = {
        (1, 1, 1): 0.04,
        (2, 2, 2): 0.04,
        (3, 3, 3): 0.07,
        (0.8, 0.8, 3): 0.05,
        (0.7, 0.7, 5): 0.08,
    }
    for spacing, band in bands.items():
        labels, _ = organ_labels(spacing, 0, {"tumour": ((0, 0, 9), BALL_MM)})
        force = over_the_ball_N(tissue.Organ.from_labels(labels, organ="organ", **made), turn)
        print(
            f"{part_kPa:g} kPa, {spacing} mm: {force:.4f} of {exact:.4f} N, "
            f"{force / exact - 1:+.1%}"
        )
        assert force == pytest.approx(exact, rel=band), spacing


def block_labels(part):
    """Return labels of a block of 48 mm in voxels of 1.5 mm.

    `part` decides by the centres of the voxels [mm] where a part is.
    """
    values = np.zeros((38, 38, 38), dtype=np.uint8)
    values[3:35, 3:35, 3:35] = 1
    at = np.stack(np.meshgrid(*[1.5 * np.arange(38) - 27.75] * 3, indexing="ij"), axis=-1)
    values[(values == 1) & part(at)] = 2
    return Labels(Image(values, (1.5,) * 3, "block", (), (-27.75,) * 3), {1: "block", 2: "part"})


def squeezed(labels, part_kPa, edge_mm=6.0):
    """A block under a punch wider than it, without Poisson's ratio: straight columns."""
    organ = tissue.Organ.from_labels(
        labels,
        organ="block",
        modulus_kPa=MODULUS_KPA,
        poisson_ratio=0.0,
        parts={"part": part_kPa},
        edge_mm=edge_mm,
        friction=0.0,
    )
    return organ.press(PUNCH, depth_mm=3, at_mm=(0, 0, 24), along=(0, 0, -1))


def test_a_block_of_two_labels_is_two_springs_in_series():
    """A block of two labels acts as two springs in series.

    The part is the lower half and reaches the surface on five sides. Its edges are rounded like
    those of the labels. Slopes are taken at the end of the press: at first the punch touches the
    highest nodes only, over a few tenths of a millimetre.
    """
    labels = block_labels(lambda at: at[..., 2] < 0.0)
    even, halves = (
        squeezed(labels, modulus).stiffness_N_mm for modulus in (MODULUS_KPA, 8.0 * MODULUS_KPA)
    )
    print(f"halves over even: {halves / even:.4f}, springs {2.0 / (1.0 + 1.0 / 8.0):.4f}")
    assert halves / even == pytest.approx(2.0 / (1.0 + 1.0 / 8.0), rel=0.02)


def mean_strain(press):
    """Mean of the strain along z in the part, from the corners' displacement."""
    mesh = press.mesh
    cells = mesh.cells_dict[pyvista.CellType.TETRA][np.asarray(mesh["part"]) == 1]
    corners, moved = mesh.points[cells], np.asarray(mesh["displacement_mm"])[cells]
    edges, changes = corners[:, 1:] - corners[:, :1], moved[:, 1:] - moved[:, :1]
    gradient = np.linalg.solve(edges, changes[:, :, 2:])[:, 2, 0]
    return np.average(gradient, weights=np.linalg.det(edges))


@pytest.mark.parametrize("ratio", [8.0, 0.2])
def test_a_ball_of_labels_is_strained_as_eshelbys(ratio):
    """A ball of 9.6 mm in a block of 48 mm under a uniform strain (Eshelby 1957, Proc. R. Soc. A
    241:376), nu = 0.

    Its strain over that of the same ball as stiff as the block; 1.5 % of the block's volume is no
    infinite one.
    """
    labels = block_labels(lambda at: (at**2).sum(axis=-1) < 7.2**2)
    found = mean_strain(squeezed(labels, ratio * MODULUS_KPA)) / mean_strain(
        squeezed(labels, MODULUS_KPA)
    )
    volume, shape = 1.0 / 3.0, 8.0 / 15.0
    exact = 1.0 / 3.0 / (1.0 + volume * (ratio - 1.0)) + 2.0 / 3.0 / (1.0 + shape * (ratio - 1.0))
    print(
        f"modulus x {ratio:g}: strain x {found:.4f}, Eshelby {exact:.4f}, {found / exact - 1:+.1%}"
    )
    assert found == pytest.approx(exact, rel=0.05)
