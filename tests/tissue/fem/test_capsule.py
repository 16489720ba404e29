"""Energy of a capsule in a uniform strain, against plane stress written out face by face."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tet_bodies import distorted

from meshes.tets.tetrahedra import TetMesh
from tissue.fem.assembly import capsule_stiffness
from tissue.fem.space import Space

YOUNG = 8e6
POISSON = 0.3


def turned_cube(order):
    mesh = distorted(2)
    turn = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    return Space(TetMesh(mesh.nodes_m @ turn.T, mesh.cells), order)


def plane_stress_J(space, faces, thickness_m, gradient):
    """Return the membrane energy of plane stress [J].

    It is the sum over faces of A h E / (2 (1 - nu^2)) ((1 - nu) e : e + nu (tr e)^2), with e the
    strain within the face.
    """
    total = 0.0
    for nodes, thickness in zip(faces, thickness_m, strict=True):
        a, b, c = space.nodes_m[nodes[:3]]
        normal = np.cross(b - a, c - a)
        area = 0.5 * np.linalg.norm(normal)
        normal /= np.linalg.norm(normal)
        within = np.eye(3) - np.outer(normal, normal)
        strain = within @ (0.5 * (gradient + gradient.T)) @ within
        density = (1.0 - POISSON) * np.sum(strain**2) + POISSON * np.trace(strain) ** 2
        total += area * thickness * 0.5 * YOUNG / (1.0 - POISSON**2) * density
    return total


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("some", [False, True])
def test_a_uniform_strain_has_the_energy_of_plane_stress(order, some):
    space = turned_cube(order)
    rng = np.random.default_rng(0)
    faces = space.faces[::3] if some else space.faces
    thickness = rng.uniform(0.5, 2.0, len(faces)) * 1e-4
    options = {"faces": faces} if some else {}
    matrix = capsule_stiffness(
        space, thickness_m=thickness, young_Pa=YOUNG, poisson_ratio=POISSON, **options
    )
    for _ in range(3):
        gradient = rng.normal(size=(3, 3))
        moved = (space.nodes_m @ gradient.T + rng.normal(size=3)).ravel()
        wanted = plane_stress_J(space, faces, thickness, gradient)
        assert 0.5 * moved @ (matrix @ moved) == pytest.approx(wanted, rel=1e-9)
    spin = np.cross([1.0, -2.0, 0.5], space.nodes_m).ravel()
    assert abs(spin @ (matrix @ spin)) < 1e-9 * wanted
