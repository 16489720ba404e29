"""Triangles near a tool and those it enters against brute force, and what they bring with them."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from kernels.contact_search import find_near, join_touching, start_over
from kernels.contact_state import (
    LARGEST,
    NEARBY,
    RESULTS,
    SPHERE,
    WORKING,
    Body,
    Lists,
    Points,
    pose_of,
)
from kernels.near_compliance import LOADED, SLOTS, Patch
from tissue.models.organ.contact import SurfaceContact
from tissue.models.organ.probe import SphereProbe

ROUNDING = 1e-12
"""Of the largest value: sums of nine blocks, and forces of a few dozen points."""
PROBE = SphereProbe(0.006)
REACH_M = 1e-3


@wp.kernel
def join(
    body: Body,
    points: Points,
    lists: Lists,
    patch: Patch,
    size: wp.vec2d,
    rows: wp.array(dtype=wp.vec3d),
    afresh: int,
    count_out: wp.array(dtype=wp.int32),  # joined
):
    """Let entered triangles join, or begin afresh from the points' forces."""
    pose = pose_of(rows, SPHERE, size)
    if afresh == 0:
        count_out[0] = join_touching(body, points, lists, patch, pose)
    else:
        start_over(body, points, lists, patch, pose)


class Scene:
    """Rough sheet with a full compliance, a ball pressed into it, and the contact search."""

    def __init__(self, seed, cells=14, edge_m=0.03):
        random = np.random.default_rng(seed)
        at = np.linspace(-0.5 * edge_m, 0.5 * edge_m, cells + 1)
        self.nodes = np.stack(np.meshgrid(at, at, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
        self.nodes += random.normal(size=self.nodes.shape) * 2e-4
        number = np.arange(len(self.nodes)).reshape(cells + 1, cells + 1)
        a, b, c, d = (
            n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
        )
        self.faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
        self.compliance = random.normal(size=(3 * len(self.nodes),) * 2)
        contact = SurfaceContact(self.nodes, self.faces, self.compliance, PROBE)
        self.body, self.points, self.lists, self.patch = (
            contact._body,
            contact._points,
            contact._lists,
            contact._patch,
        )
        self.tip, self.turn = (
            np.array([*random.uniform(-3e-3, 3e-3, 2), -8e-4]),
            Rotation.random(random_state=seed),
        )
        self.tip += 6e-3 * (
            np.array([0.0, 0.0, 1.0]) - self.turn.as_matrix()[:, 2]
        )  # the ball's centre above the sheet
        turn = self.turn.as_matrix()
        self.rows = wp.array(np.vstack([self.tip, turn] * 2), dtype=wp.vec3d, device="cpu")
        self.size = wp.vec2d(*PROBE.size_m)
        corners = self.nodes[self.faces]
        self.centres = corners.mean(axis=1)
        self.radii = np.linalg.norm(corners - self.centres[:, None], axis=2).max(axis=1)

    def distance(self, points_m):
        return PROBE.distance((points_m - self.tip) @ self.turn.as_matrix())

    def find(self, largest_m):
        results = np.zeros(RESULTS)
        results[LARGEST] = largest_m
        inputs = [
            wp.array(self.centres, dtype=wp.vec3d, device="cpu"),
            wp.array(self.radii, dtype=wp.float64, device="cpu"),
            PROBE.kind,
            self.size,
            self.rows,
            REACH_M,
            wp.array(results, dtype=wp.float64, device="cpu"),
        ]
        wp.launch(
            find_near,
            dim=1,
            inputs=inputs,
            outputs=[self.body, self.lists, self.patch],
            device="cpu",
        )

    def run(self, afresh):
        out = wp.zeros(1, dtype=wp.int32, device="cpu")
        inputs = [self.body, self.points, self.lists, self.patch, self.size, self.rows, afresh]
        wp.launch(join, dim=1, inputs=inputs, outputs=[out], device="cpu")
        return int(out.numpy()[0])

    def working(self):
        return self.lists.working.numpy()[: self.lists.count.numpy()[WORKING]]


@pytest.mark.parametrize("seed", range(3))
def test_near_triangles_are_those_within_reach(seed):
    """Within reach plus the largest displacement; their nodes have slots."""
    scene = Scene(seed)
    for largest in (0.0, 2e-3, 5e-4):
        scene.find(largest)
        near = scene.lists.near.numpy()[: scene.lists.count.numpy()[NEARBY]]
        right = np.flatnonzero(scene.distance(scene.centres) < scene.radii + REACH_M + largest)
        np.testing.assert_array_equal(near, right)
        slots = scene.patch.count.numpy()[SLOTS]
        np.testing.assert_array_equal(
            np.sort(scene.patch.node.numpy()[:slots]), np.unique(scene.faces[right])
        )
    assert 10 < len(right) < len(scene.faces)


@pytest.mark.parametrize("seed", range(3))
def test_entered_triangles_join_with_the_responses_of_their_points(seed):
    """Entered triangles join with the responses of their points.

    W of a point is sum w_a w_b W_ab. In a fresh search, forces of points give the forces of nodes,
    and only the triangles of loaded points are active.
    """
    scene = Scene(seed)
    scene.find(0.0)
    joined = scene.run(0), scene.run(0)
    weight, first, following = (
        getattr(scene.points, each).numpy() for each in ("weight", "first", "following")
    )
    triangle = np.full(len(weight), -1)
    for face, point in enumerate(first):
        while point >= 0:
            triangle[point] = face
            point = following[point]
    place = np.einsum("pa,pax->px", weight, scene.nodes[scene.faces[triangle]])
    entered = np.unique(triangle[scene.distance(place) < 0.0])
    np.testing.assert_array_equal(np.sort(scene.working()), entered)
    assert joined == (len(entered), 0)
    blocks = scene.compliance.reshape(len(scene.nodes), 3, -1, 3)
    response = scene.points.response.numpy()
    for point in np.flatnonzero(np.isin(triangle, entered)):
        nodes = scene.faces[triangle[point]]
        to_nodes = np.einsum("b,aibj->aij", weight[point], blocks[nodes][:, :, nodes])
        scale = ROUNDING * np.abs(to_nodes).max()
        assert response[point, :3] == pytest.approx(to_nodes, abs=scale)
        assert response[point, 3] == pytest.approx(
            np.einsum("a,aij->ij", weight[point], to_nodes), abs=scale
        )
    random = np.random.default_rng(seed)
    carrying = random.choice(entered, len(entered) // 2, replace=False)
    force = random.normal(size=(len(weight), 3)) * np.isin(triangle, carrying)[:, None]
    scene.points.force.assign(force)
    scene.find(0.0)
    assert scene.run(1) == 0
    np.testing.assert_array_equal(np.sort(scene.working()), np.sort(carrying))
    nodal = np.zeros_like(scene.nodes)
    for point in np.flatnonzero(force.any(axis=1)):
        nodal[scene.faces[triangle[point]]] += weight[point][:, None] * force[point]
    assert scene.body.force.numpy() == pytest.approx(nodal, abs=ROUNDING * np.abs(nodal).max())
    loaded = scene.patch.node.numpy()[: scene.patch.count.numpy()[LOADED]]
    np.testing.assert_array_equal(np.sort(loaded), np.unique(scene.faces[carrying]))
