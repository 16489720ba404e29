"""Open edges of two parts joined: closed, wound outward, with the volume of the whole."""

import numpy as np
import trimesh

from meshes.surfaces.repair import close_seams, open_loops


def half_ball(upward, sections):
    """Half of a ball of radius 1 without its cut face, a gap of 0.02 wide left at the equator."""
    polar, around = (
        np.linspace(0.02, 0.5 * np.pi, 24),
        np.arange(sections) * (2.0 * np.pi / sections),
    )
    height, radius = np.sin(polar), np.cos(polar)
    rings = [
        np.column_stack([r * np.cos(around), r * np.sin(around), np.full(sections, z)])
        for r, z in zip(radius[:-1], height[:-1], strict=True)
    ]
    points = np.concatenate([*rings, [[0.0, 0.0, 1.0]]])
    faces = []
    for ring in range(len(rings) - 1):
        for k in range(sections):
            a, b = ring * sections + k, ring * sections + (k + 1) % sections
            faces += [(a, b, b + sections), (a, b + sections, a + sections)]
    last = (len(rings) - 1) * sections
    faces += [(last + k, last + (k + 1) % sections, len(points) - 1) for k in range(sections)]
    faces = np.array(faces)
    return (points, faces) if upward else (points * [1, 1, -1], faces[:, ::-1])


def test_two_halves_with_other_points_are_joined():
    (upper, above), (lower, below) = half_ball(True, 60), half_ball(False, 37)
    points = np.concatenate([upper, lower])
    faces = np.concatenate([above, below + len(upper)])
    assert len(open_loops(faces)) == 2
    vertices, triangles = close_seams(points, faces, first_part=len(upper), within=0.1)
    whole = trimesh.Trimesh(vertices, triangles, process=False)
    assert len(vertices) == len(points) and len(triangles) == len(faces) + 60 + 37
    assert whole.is_watertight and whole.is_winding_consistent
    assert whole.volume > 0.99 * 4.0 / 3.0 * np.pi
