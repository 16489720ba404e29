"""The procedural liver against the figures in its docstring, and the block of tissue."""

import numpy as np
import pytest

from meshes.organs.liver import (
    Nodule,
    liver,
    liver_shape,
    slab,
    slab_base,
)
from meshes.tets.tetrahedra import TetMesh, mean_ratio


@pytest.fixture(scope="module")
def organ() -> TetMesh:
    return liver()


def test_the_liver_has_the_size_and_volume_of_an_adult_one(organ: TetMesh) -> None:
    # 200-225 x 100-150 x 105-155 mm and 1.2-1.8 l: memory of the literature, see the module.
    width, depth, height = 1e3 * np.ptp(organ.nodes_m, axis=0)
    assert 200.0 < width < 225.0
    assert 100.0 < depth < 150.0
    assert 105.0 < height < 155.0
    assert 1.2e-3 < organ.volumes_m3.sum() < 1.8e-3
    left = organ.nodes_m[organ.cells].mean(axis=1)[:, 0] > 0.0508
    assert organ.volumes_m3[left].sum() / organ.volumes_m3.sum() == pytest.approx(0.22, abs=0.02)


def test_the_origin_is_on_top_of_the_right_lobe(organ: TetMesh) -> None:
    shape = liver_shape()
    assert abs(shape.distance(np.zeros((1, 3)))[0]) < 1e-9
    step = 1e-5
    slope = np.array(
        [shape.distance(step * e[None])[0] - shape.distance(-step * e[None])[0] for e in np.eye(3)]
    )
    # The surface there is level within a few degrees, so a tool along z presses it squarely.
    assert slope[2] / np.linalg.norm(slope) > np.cos(np.radians(5.0))
    assert organ.nodes_m[:, 2].max() < 0.002


def test_a_nodule_is_a_part_of_its_volume_bounded_by_faces() -> None:
    mesh = liver(nodule=Nodule(0.012, (0.0, 0.0, -0.03)))
    assert mesh.part_names == ("body", "nodule")
    inside = TetMesh(mesh.nodes_m, mesh.cells[mesh.part == 1])
    # The radius is corrected for the chords; nodes lie on one sphere.
    assert inside.volumes_m3.sum() == pytest.approx(4.0 / 3.0 * np.pi * 0.012**3, rel=1e-3)
    away = np.linalg.norm(mesh.nodes_m[inside.surface_nodes] - [0.0, 0.0, -0.03], axis=1)
    assert np.ptp(away) < 1e-5
    assert mean_ratio(mesh.nodes_m, mesh.cells).min() > 0.1


def test_a_slab_is_a_block_finer_at_the_top() -> None:
    mesh = slab()
    assert mesh.volumes_m3.sum() == pytest.approx(0.1 * 0.1 * 0.04, rel=1e-12)
    assert 25_000 < len(mesh.cells) < 32_000
    assert mesh.nodes_m.max(axis=0) == pytest.approx((0.05, 0.05, 0.0))
    assert mesh.nodes_m.min(axis=0) == pytest.approx((-0.05, -0.05, -0.04))
    layers = np.diff(np.unique(mesh.nodes_m[:, 2]))
    assert (np.diff(layers) < 0.0).all()
    base = slab_base(mesh)
    assert len(base) == 25 * 25
    assert (mesh.nodes_m[base, 2] == mesh.nodes_m[:, 2].min()).all()


@pytest.mark.parametrize(("radius", "spacing"), [(0.005, 4.2e-3), (0.009, 8e-3)])
def test_a_slab_takes_a_nodule(radius: float, spacing: float) -> None:
    """A slab takes a nodule.

    The volume of the nodule and the height of its top, by which it is felt, are right for bricks of
    any length.
    """
    mesh = slab(spacing_m=spacing, nodule=Nodule(radius, (0.01, 0.0, -0.018)))
    assert mesh.volumes_m3[mesh.part == 1].sum() == pytest.approx(
        4.0 / 3.0 * np.pi * radius**3, rel=1e-3
    )
    assert mesh.nodes_m[mesh.cells[mesh.part == 1], 2].max() == pytest.approx(
        radius - 0.018, abs=0.03 * radius
    )
    assert mesh.volumes_m3.sum() == pytest.approx(4e-4, rel=1e-9)
    assert mean_ratio(mesh.nodes_m, mesh.cells).min() > 0.1
