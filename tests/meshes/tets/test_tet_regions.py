"""Regions in which a body is held: planes, directions, parts, and regions without contact."""

import numpy as np
import pytest
from round_bodies import sphere_shell

from meshes.base.errors import InputError
from meshes.tets.regions import (
    nodes_behind_plane,
    nodes_facing,
    nodes_of_part,
    surface_normals,
)
from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh

MESH = box((0.1, 0.1, 0.1), (5, 5, 5))


def test_a_plane_chooses_the_nodes_behind_it() -> None:
    base = nodes_behind_plane(MESH, point_m=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 2.0))
    assert len(base) == 36
    assert (MESH.nodes_m[base, 2] == 0.0).all()
    # Two planes of nodes: the bottom and the rim of the next.
    assert (
        len(nodes_behind_plane(MESH, point_m=(0.0, 0.0, 0.02), normal=(0.0, 0.0, 1.0))) == 36 + 20
    )


def test_a_direction_chooses_the_side_that_faces_it() -> None:
    shell = sphere_shell(0.02, 0.05, (6, 2), octants=8)
    top = nodes_facing(shell, direction=(0.0, 0.0, 1.0), within_deg=30.0)
    unit = shell.nodes_m[top] / np.linalg.norm(shell.nodes_m[top], axis=1, keepdims=True)
    outer = np.linalg.norm(shell.nodes_m[top], axis=1) > 0.03
    # A triangle at 30 degrees reaches one cell of 7.5 degrees further; the inner sphere faces the
    # opposite direction.
    assert unit[outer, 2].min() > np.cos(np.radians(38.0))
    assert unit[~outer, 2].max() < -np.cos(np.radians(38.0))
    assert np.linalg.norm(surface_normals(shell), axis=1) == pytest.approx(1.0)


def test_a_part_chooses_all_its_nodes() -> None:
    part = (MESH.nodes_m[MESH.cells].mean(axis=1)[:, 0] > 0.08).astype(np.uint8)
    mesh = TetMesh(MESH.nodes_m, MESH.cells, part, ("tissue", "vessel", "empty"))
    assert len(nodes_of_part(mesh, "vessel")) == 2 * 36
    with pytest.raises(InputError, match="part must be one of tissue, vessel or empty, got bone"):
        nodes_of_part(mesh, "bone")
    with pytest.raises(
        InputError, match="part must contain cells of the mesh, got empty, which has no cells"
    ):
        nodes_of_part(mesh, "empty")
