"""Points of a shell on a rough surface against all triangles at once in NumPy, and their chains."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from kernels.contact_state import NEARBY, Body, Lists, Points
from kernels.shell_projection import link_points, project_shell

ROUNDING = 1e-9
"""Of barycentric weights: points up to a grazing angle of 6 degrees."""
GRAZING = 0.1
COUNT = 300


def put(values, dtype):
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device="cpu")


def surface(random, cells=10, edge_m=0.02):
    """Return nodes and triangles of two rough sheets, one 0.8 mm above the other.

    Their outward side is up, and they are in random order.
    """
    at = np.linspace(-0.5 * edge_m, 0.5 * edge_m, cells + 1)
    nodes = np.stack(np.meshgrid([0.0, -8e-4], at, at, indexing="ij"), axis=-1).reshape(-1, 3)[
        :, [1, 2, 0]
    ]
    nodes[:, 2] += random.normal(size=len(nodes)) * 4e-4
    number = np.arange(len(nodes)).reshape(2, cells + 1, cells + 1)
    a, b, c, d = (
        n.ravel()
        for n in (number[:, :-1, :-1], number[:, 1:, :-1], number[:, 1:, 1:], number[:, :-1, 1:])
    )
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return nodes, random.permutation(faces)


def expected(place, direction, corners, near, limit):
    """Nearest triangle along each point's line that faces it, -1 for none, and the weights there.

    ``(b - a) v + (c - a) w - t n = p - a``, solved for all points and triangles at once.
    """
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    outward = np.cross(ab, ac)
    faces = -direction @ (outward / np.linalg.norm(outward, axis=1)[:, None]).T > GRAZING
    shape = (len(place), len(a), 3)
    columns = [np.broadcast_to(each, shape) for each in (ab, ac, -direction[:, None])]
    v, w, t = np.moveaxis(
        np.linalg.solve(np.stack(columns, axis=-1), (place[:, None] - a)[..., None])[..., 0], -1, 0
    )
    there = faces & near & (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0) & (np.abs(t) < limit[:, None])
    away = np.where(there, np.abs(t), np.inf)
    found = np.where(there.any(axis=1), away.argmin(axis=1), -1)
    row = np.arange(len(place))
    weight = np.stack([1.0 - v - w, v, w], axis=-1)[row, found]
    return found, np.where(found[:, None] >= 0, weight, 0.0)


@pytest.mark.parametrize("seed", range(3))
def test_points_lie_on_the_nearest_triangle_along_their_normals(seed):
    random = np.random.default_rng(seed)
    nodes, faces = surface(random)
    moved = random.normal(size=nodes.shape) * 5e-5
    corners = (nodes + moved)[faces]
    reach = np.linalg.norm(nodes[faces] - nodes[faces].mean(axis=1)[:, None], axis=2).max()
    points = random.uniform([-0.01, -0.01, -1e-3], [0.01, 0.01, 3e-3], (COUNT, 3))
    normals = random.normal(loc=(0.0, 0.0, -1.5), size=(COUNT, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    turns = [Rotation.from_rotvec(0.1 * random.normal(size=3)).as_matrix() for _ in range(2)]
    tips = random.normal(size=(2, 3)) * 2e-4
    pose = np.vstack([tips[0], turns[0], tips[1], turns[1]])
    near = np.flatnonzero(random.uniform(size=len(faces)) > 0.2)
    body, lists, shell = Body(), Lists(), Points()
    body.free, body.moved, body.corners = (
        put(nodes, wp.vec3d),
        put(moved, wp.vec3d),
        put(faces, wp.int32),
    )
    lists.count, lists.near = (
        put(np.eye(1, 3, NEARBY)[0] * len(near), wp.int32),
        put(near, wp.int32),
    )
    for name in ("tool_point", "tool_normal", "weight"):
        setattr(shell, name, wp.zeros(COUNT, dtype=wp.vec3d, device="cpu"))
    shell.ready = wp.full(COUNT, 1, dtype=wp.int32, device="cpu")
    shell.force = put(np.ones((COUNT, 3)), wp.vec3d)
    shell.first = wp.full(len(faces), -5, dtype=wp.int32, device="cpu")
    shell.following = wp.full(COUNT, -5, dtype=wp.int32, device="cpu")
    home = wp.zeros(COUNT, dtype=wp.int32, device="cpu")
    inputs = [
        put(points, wp.vec3d),
        put(normals, wp.vec3d),
        put(pose, wp.vec3d),
        reach,
        body,
        lists,
        0,
    ]
    wp.launch(project_shell, dim=COUNT, inputs=inputs, outputs=[shell, home], device="cpu")
    place, direction = tips[0] + points @ turns[0].T, normals @ turns[0].T
    limit = reach + np.linalg.norm(place - tips[1] - points @ turns[1].T, axis=1)
    found, weight = expected(place, direction, corners, np.isin(np.arange(len(faces)), near), limit)
    np.testing.assert_array_equal(home.numpy(), found)
    assert shell.weight.numpy() == pytest.approx(weight, abs=ROUNDING)
    assert shell.tool_point.numpy() == pytest.approx(place, abs=1e-15)
    assert shell.tool_normal.numpy() == pytest.approx(direction, abs=1e-14)
    assert not shell.ready.numpy().any()
    assert 50 < (found >= 0).sum() < COUNT - 20

    wp.launch(link_points, dim=1, inputs=[home, lists], outputs=[shell], device="cpu")
    first, following = shell.first.numpy(), shell.following.numpy()
    for triangle in near:
        chain, point = [], first[triangle]
        while point >= 0:
            chain.append(point)
            point = following[point]
        assert sorted(chain) == np.flatnonzero(found == triangle).tolist()
    np.testing.assert_array_equal(shell.force.numpy().any(axis=1), found >= 0)
    assert (np.delete(first, near) == -5).all()
