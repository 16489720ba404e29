"""Proxy against closed forms on exact solids.

The cases are planes, edges, corners, thin walls, friction and tilted boxes. ``EXACT`` is the
tolerance of the validation case (case 23: 1e-9). Lengths are in metres, so it stands for a
nanometre.
"""

from itertools import pairwise

import numpy as np
import pytest
from field_distance import half_space
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from tissue.haptics.proxy.proxy import Box, ContactField, Proxy, ToolShell
from tissue.motion.quaternion import turn_between

EXACT = 1e-9
STIFFNESS = 1000.0
PLANE = half_space((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
STILL = np.zeros(3)


def at(*xyz):
    return np.array(xyz, dtype=float)


def point_on(*solids, start, friction=0.0, radius=0.0):
    """A proxy of one ball, placed."""
    proxy = Proxy(ToolShell.ball(radius), ContactField(*solids), friction=friction)
    proxy.place(at(*start))
    return proxy


def walk(proxy, *corners, feed=1e-4, quaternion=None):
    """Move the device along straight lines, a tick every ``feed``."""
    more = () if quaternion is None else (quaternion,)
    result = proxy.result
    for start, end in pairwise(corners):
        ticks = max(int(np.ceil(np.linalg.norm(np.subtract(end, start)) / feed)), 1)
        for tick in range(1, ticks + 1):
            result = proxy.advance(at(*start) + (tick / ticks) * np.subtract(end, start), *more)
    return result


def test_plane_pushes_back_with_stiffness_times_depth():
    """F = K d (case 23), along the normal, for a plane that lies askew."""
    normal = at(1.0, 2.0, 3.0) / np.sqrt(14.0)
    proxy = point_on(
        half_space((0.01, 0.0, 0.0), normal), start=at(0.01, 0.0, 0.0) + 0.002 * normal
    )
    for depth in (1e-5, 1e-3, 7e-3):
        device = at(0.01, 0.0, 0.0) - depth * normal + np.cross(normal, at(1e-3, 2e-3, 0.0))
        result = proxy.advance(device)
        force = STIFFNESS * (result.position_m - device)
        assert force == pytest.approx(STIFFNESS * depth * normal, abs=STIFFNESS * EXACT)
        assert STIFFNESS * result.push_m == pytest.approx(force, abs=STIFFNESS * EXACT)
        assert result.settled and result.contacts


def test_inner_corner_of_two_and_three_planes():
    """The proxy stays in an inner corner of two and three planes.

    In a concave right angle it is the device with each negative coordinate set to 0 (Zilles and
    Salisbury).
    """
    planes = [half_space((0.0, 0.0, 0.0), normal) for normal in np.eye(3)]
    for count in (2, 3):
        proxy = point_on(*planes[:count], start=(1e-3, 2e-3, 1e-3))
        for device in np.random.default_rng(count).uniform(-5e-3, 5e-3, (60, 3)):
            expected = device.copy()
            expected[:count] = np.maximum(device[:count], 0.0)
            result = proxy.advance(device)
            assert result.position_m == pytest.approx(expected, abs=EXACT)


@pytest.mark.parametrize("radius", [0.5e-3, 2e-3])
def test_ball_on_a_convex_edge_and_corner(radius):
    """A ball's proxy on a convex edge or corner lies at its radius from it.

    It lies on the line from there to the device.
    """
    corner = Box((-5e-3, -5e-3, -5e-3), (10e-3, 10e-3, 10e-3))
    proxy = point_on(corner, start=(2 * radius, -2e-3, 2 * radius), radius=radius)
    device = 0.6 * radius * at(np.cos(0.9), 0.0, np.sin(0.9)) + at(0.0, -2e-3, 0.0)
    result = walk(proxy, (2 * radius, -2e-3, 2 * radius), device)
    assert result.position_m == pytest.approx(
        at(0.0, -2e-3, 0.0) + (device + at(0, 2e-3, 0)) / 0.6, abs=EXACT
    )
    direction = at(1.0, 2.0, 2.0) / 3.0
    proxy.place(3.0 * radius * direction)
    result = walk(proxy, 3.0 * radius * direction, 0.7 * radius * direction)
    assert result.position_m == pytest.approx(radius * direction, abs=EXACT)


def test_thin_wall_holds_where_the_nearest_point_pops_through():
    """A thin wall holds where the nearest point jumps through.

    The free point nearest to the device changes sides halfway through a wall; the proxy does not.
    """
    wall = Box((0.0, 0.0, 0.0), (0.1, 0.1, 1e-4))
    proxy = point_on(wall, start=(0.0, 0.0, 1e-3))
    grid = np.arange(-3000, 3001) * 1e-6
    free = grid[np.abs(grid) >= 0.5e-4]
    popped = False
    for depth in np.arange(0.0, 2.5e-3, 1e-5):
        device = at(1e-4, 0.0, 1e-3 - depth)
        nearest = free[np.argmin(np.abs(free - device[2]))]
        popped |= bool(nearest < 0.0)
        assert proxy.advance(device).position_m == pytest.approx(
            at(1e-4, 0.0, max(device[2], 0.5e-4)), abs=EXACT
        )
    assert popped, "the printed rule should fail here"


@pytest.mark.parametrize("speed", [0.1, 2.0, 50.0])
def test_no_speed_gets_through_a_thin_wall(speed):
    """One tick of 1 ms at any speed, from any side."""
    random = np.random.default_rng(5)
    for turn in Rotation.random(40, random_state=6).as_matrix():
        wall = Box(random.uniform(-1e-3, 1e-3, 3), (0.2, 0.2, 2e-5), turn)
        normal = turn[:, 2]
        start = wall.centre_m + 1e-3 * random.uniform(0.02, 1.0) * normal
        proxy = point_on(wall, start=start)
        direction = random.normal(size=3)
        direction *= -np.sign(direction @ normal) * 1e-3 * speed / np.linalg.norm(direction)
        for _ in range(5):
            result = proxy.advance(start + direction)
        height = (result.position_m - wall.centre_m) @ normal
        assert height >= 1e-5 - EXACT
        if (start + direction - wall.centre_m) @ normal < 0.0 and np.linalg.norm(direction) < 0.05:
            assert height == pytest.approx(1e-5, abs=EXACT)


def test_friction_sticks_if_and_only_if_the_pull_is_inside_the_cone():
    """|F_t| <= mu F_n sticks; beyond, the proxy trails by mu times the depth (case 23)."""
    for friction in (0.1, 0.5, 1.2):
        proxy = point_on(PLANE, start=(0.0, 0.0, 1e-3), friction=friction)
        depth = 2e-3
        walk(proxy, (0.0, 0.0, 1e-3), (0.0, 0.0, -depth))
        direction = at(0.6, 0.8, 0.0)
        for share in (0.5, 0.999999):
            result = proxy.advance(share * friction * depth * direction - at(0.0, 0.0, depth))
            assert result.position_m == pytest.approx(STILL, abs=EXACT)
        for pull in (1.000001 * friction * depth, 2.0 * friction * depth, 9e-3):
            result = proxy.advance(pull * direction - at(0.0, 0.0, depth))
            assert result.position_m == pytest.approx(
                (pull - friction * depth) * direction, abs=EXACT
            )
            assert np.linalg.norm(result.push_m[:2]) == pytest.approx(
                friction * result.push_m[2], rel=1e-9
            )


def box_shell(half, *, spacing=1e-3):
    """Points over a box's lower and upper face, and its edges between them."""
    rows = [np.linspace(-h, h, int(np.ceil(2 * h / spacing)) + 1) for h in half]
    grid = np.stack(np.meshgrid(*rows, indexing="ij"), axis=-1).reshape(-1, 3)
    points = grid[(np.abs(grid) > np.asarray(half) - 1e-9).any(axis=1)]
    return ToolShell(points, np.zeros_like(points))


HALF = (6e-3, 4e-3, 2e-3)
LEVER = 0.02


def box_on_plane(device, turn):
    """Settled result of a box whose device was led down to a pose below the plane."""
    proxy = Proxy(box_shell(HALF), ContactField(PLANE), lever_m=LEVER)
    proxy.place(at(0.0, 0.0, 0.02))
    for share in np.linspace(0.0, 1.0, 400):
        pose = Rotation.from_rotvec(share * np.asarray(turn)).as_quat()
        result = proxy.advance(at(0, 0, 0.02) + share * (device - at(0, 0, 0.02)), pose)
    return result, pose


def test_tilted_box_on_its_edge():
    """A box tilted on its edge balances springs and push.

    On one edge the tilt phi obeys l^2 (theta - phi) = push x lever arm of the edge.
    """
    tilt, height = 0.5, 1e-3
    a, c = HALF[0], HALF[2]

    def low(phi):  # depth of the lowest edge below the centre, and its arm
        return a * np.sin(phi) + c * np.cos(phi), a * np.cos(phi) - c * np.sin(phi)

    def balance(phi):
        below, arm = low(phi)
        return LEVER**2 * (tilt - phi) - (below - height) * arm

    phi = brentq(balance, 0.0, tilt, xtol=1e-15)
    result, _ = box_on_plane(at(0.0, 0.0, height), (0.0, tilt, 0.0))
    turned = np.array(turn_between(at(0.0, 0.0, 0.0, 1.0), result.quaternion))
    assert turned == pytest.approx(at(0.0, phi, 0.0), abs=EXACT)
    assert result.position_m[2] == pytest.approx(low(phi)[0], abs=EXACT)
    assert result.push_moment_m2[1] == pytest.approx(
        -(low(phi)[0] - height) * low(phi)[1], abs=1e-12
    )
