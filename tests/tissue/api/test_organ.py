"""A soft organ in the hand: what it is made from, what a press gives, and what is refused."""

import numpy as np
import pytest
import pyvista

import tissue
from meshes.base.errors import InputError
from meshes.tets.structured import box

STIFF = {"modulus_kPa": 8.0, "poisson_ratio": 0.45}
BALL = tissue.ball(diameter_mm=12)


def cube(cells=(6, 6, 4), size_mm=(48.0, 48.0, 24.0)):
    """Points [mm] and cells of a block with the middle of its top face at the origin."""
    mesh = box(tuple(1e-3 * side for side in size_mm), cells)
    return 1e3 * mesh.nodes_m - [0.5 * size_mm[0], 0.5 * size_mm[1], size_mm[2]], mesh.cells


def grid_of(points, cells, **arrays):
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: cells}, points)
    for name, values in arrays.items():
        grid.cell_data[name] = values
    return grid


@pytest.fixture(scope="module")
def organ():
    return tissue.Organ.from_tetrahedra(cube(), **STIFF)


@pytest.fixture(scope="module")
def press(organ):
    return organ.refined(edge_mm=3, near_mm=(0, 0, 0)).press(BALL, depth_mm=2.0, at_mm=(0, 0, 0))


def test_a_press_gives_force_over_depth_and_the_organ_under_it(press):
    assert press.force_N[2] == press.forces_N[-1, 2] > 0.05
    assert (np.diff(press.depth_mm) > 0.0).all() and press.depth_mm[-1] == pytest.approx(2.0)
    assert not press.forces_N[0].any() and press.forces_N[1:, 2].min() >= 0.0
    assert press.stiffness_N_mm > press.force_magnitude_N / 2.0  # stiffens as a ball sinks in
    mesh = press.mesh
    under = np.linalg.norm(mesh.points, axis=1).argmin()
    assert mesh["displacement_mm"][under, 2] == pytest.approx(-2.0, abs=0.2)
    assert mesh["von_mises_kPa"].max() > 0.1
    np.testing.assert_allclose(mesh["reaction_N"].sum(axis=0), press.force_N, atol=1e-4)


def test_a_table_has_units_in_its_names(press):
    table = press.to_pandas()
    assert list(table) == ["time_s", "depth_mm", "force_x_N", "force_y_N", "force_z_N", "force_N", "area_mm2"]
    assert len(table) == len(press.depth_mm)
    assert table["force_N"].iloc[-1] == pytest.approx(press.force_magnitude_N)


def test_parts_are_known_by_name_by_number_and_by_array():
    points, cells = cube()
    deep = points[cells].mean(axis=1)[:, 2] < -12.0
    labels, names = np.where(deep, 7, 3), np.where(deep, "cyst", "kidney")
    soft = tissue.Organ.from_tetrahedra((points, cells), **STIFF)
    organs = [
        tissue.Organ.from_tetrahedra(grid_of(points, cells, part=labels), parts={7: 80}, **STIFF),
        tissue.Organ.from_tetrahedra(
            grid_of(points, cells, region=labels), part_names={7: "cyst"}, parts={"cyst": 80}, **STIFF
        ),
        tissue.Organ.from_tetrahedra(grid_of(points, cells, part=names), parts={"cyst": 80}, **STIFF),
    ]
    assert organs[1].moduli_kPa == {"part 3": 8.0, "cyst": 80.0}
    forces = [each.press(BALL, depth_mm=2, at_mm=(0, 0, 0)).force_magnitude_N for each in (soft, *organs)]
    assert forces[1] > 1.05 * forces[0]
    assert forces[1:] == pytest.approx([forces[1]] * 3, rel=1e-9)
    with pytest.raises(InputError, match="parts must name parts of the mesh, got 'tumour': it has cyst, kidney"):
        tissue.Organ.from_tetrahedra(grid_of(points, cells, part=names), parts={"tumour": 80}, **STIFF)


def test_reprs_are_plain(organ, press):
    assert repr(BALL) == "ball(diameter_mm=12)"
    assert repr(organ) == (
        "Organ(48 x 48 x 24 mm, 55.3 ml, 864 tetrahedra of order 2; body 8 kPa; Poisson's ratio 0.45; held: the surface "
        "that faces bottom)"
    )
    assert repr(press).startswith("Press(ball(diameter_mm=12) at (0, 0, 0) mm: 0.")
