"""Laws of the proxy over voxels: random blocks, walls one voxel thick, planes and corners."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from field_distance import distance_to
from proxy_scenes import BURR, SPACING, bumpy_store, surface_of, volume_of, wander

from meshes.voxels.distances import cube_fraction
from tissue.haptics.proxy.proxy import ContactField, Proxy, ToolShell
from tissue.models.bone.bricks import BrickStore

VOXEL_TOLERANCE_M = 0.05 * SPACING
"""Depth [m] at which a step next to voxels is taken back: a tenth of half a voxel."""


@cache
def slab_store(normal, offset, thickness=1.0):
    """Return a wall of `thickness` voxels across the middle of a cube of 64 voxels."""
    count = 64
    centres = np.stack(np.meshgrid(*[np.arange(count) + 0.5] * 3, indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    height = (centres - 0.5 * count) @ normal - offset
    normals = np.broadcast_to(normal, centres.shape)
    part = cube_fraction(height - 0.5 * thickness, normals) - cube_fraction(
        height + 0.5 * thickness, normals
    )
    return BrickStore.from_volume(
        volume_of(np.rint(255 * part).astype(np.uint8).reshape((count,) * 3)), device="cpu"
    )


@pytest.mark.parametrize(("seed", "lever"), [(0, None), (1, 2e-3), (2, None)])
def test_never_inside_voxels_and_pushed_out_of_them(seed, lever):
    store = bumpy_store(seed)
    field = ContactField(store=store)
    proxy = Proxy(BURR, field, lever_m=lever, friction=0.2 * seed)
    start = np.array([4e-3, 4e-3, 6.5e-3])
    proxy.place(start)
    sunk = ToolShell(BURR.points_m - field.sink_m * BURR.normals, BURR.normals)
    settled = 0
    for position, turn in wander(seed + 10, ticks=1200, low=2e-3, high=6.5e-3, start=start):
        result = proxy.advance(position, turn)
        assert distance_to(field, surface_of(sunk, result))[0].min() >= -VOXEL_TOLERANCE_M
        if result.settled and result.contacts:
            settled += 1
            if seed == 0:
                assert result.push_m @ (result.position_m - position) > 0.0
                # out of a block that lies below, but for its steepest bumps
                assert result.push_m[2] > -1e-4
    assert settled > 200


def push_through(normal, offset, shell, speed_m_s, random):
    """Send the device 5 mm through a wall one voxel thick.

    Returns the shell's lowest height over the wall's middle [m], and whether the proxy ends against
    the wall, or has passed around its rim.
    """
    centre, normal = np.full(3, 32 * SPACING), normal / np.linalg.norm(normal)
    proxy = Proxy(shell, ContactField(store=slab_store(tuple(normal), offset)))
    device = centre + (1.2e-3 + shell.reach_m) * normal
    proxy.place(device)
    step = random.normal(size=3) * 0.4
    step -= normal * (step @ normal + 1.0)
    step *= speed_m_s * 1e-3 / np.linalg.norm(step)
    lowest, going = np.inf, max(int(5e-3 / np.linalg.norm(step)), 4)
    for tick in range(going + 40):
        device = device + step * (tick < going)
        result = proxy.advance(device)
        lowest = min(lowest, ((surface_of(shell, result) - centre) @ normal).min())
    around = np.abs(result.position_m - centre).max() >= 26 * SPACING
    return lowest, around or (result.settled and result.contacts)


@pytest.mark.parametrize("speed_m_s", [0.05, 0.5, 2.0])
def test_no_path_through_a_wall_one_voxel_thick(speed_m_s):
    """No path leads through a wall one voxel thick.

    Walls are random, the worst place between voxels among them, and paths are random; the tools are
    a point and a burr.
    """
    random = np.random.default_rng(7)
    for number, normal in enumerate(
        [np.eye(3)[2], np.array([0.0, 0.6, 0.8]), *random.normal(size=(3, 3))]
    ):
        for shell in (ToolShell.ball(), BURR):
            lowest, stopped = push_through(
                normal, (0.0, 0.5, 0.25)[number % 3], shell, speed_m_s, random
            )
            assert lowest > -SPACING and stopped


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_pushing_in_and_out_slowly_gains_no_energy(friction):
    """Pushing in and out slowly gains no energy.

    Work on the device along closed paths in a bumpy block is not negative; the trapezoid rule
    leaves 1e-3 of the work put in.
    """
    for seed in range(2):
        proxy = Proxy(BURR, ContactField(store=bumpy_store(seed)), friction=friction)
        random = np.random.default_rng(seed)
        start = np.array([4e-3, 4e-3, 6.5e-3])
        proxy.place(start)
        corners = [
            start,
            *(random.uniform((2.5e-3, 2.5e-3, 2.5e-3), (5.5e-3, 5.5e-3, 4.5e-3), (4, 3))),
            start,
        ]
        gained = put_in = 0.0
        last, force = start, np.zeros(3)
        for a, b in pairwise(corners):
            for share in np.linspace(0.0, 1.0, 600)[1:]:
                device = a + share * (b - a)
                result = proxy.advance(device)
                new = 1e3 * (result.position_m - device)
                work = 0.5 * float((force + new) @ (device - last))
                gained += work
                put_in += max(-work, 0.0)
                last, force = device, new
        assert put_in > 1e-4
        assert gained <= 1e-3 * put_in
        if friction:
            assert gained < -1e-2 * put_in


def test_removed_bone_lets_the_proxy_in_at_once():
    """The voxels are read in place: what is carved is free in the same tick."""
    fraction = np.zeros((32, 32, 32), np.uint8)
    fraction[:, :, :20] = 255
    store = BrickStore.from_volume(volume_of(fraction), device="cpu")
    proxy = Proxy(ToolShell.ball(), ContactField(store=store))
    device = np.array([3e-3, 3e-3, 1e-3])
    proxy.place(np.array([3e-3, 3e-3, 6e-3]))
    for _ in range(5):
        result = proxy.advance(device)
    assert result.position_m[2] == pytest.approx(20.25 * SPACING, abs=2e-3 * SPACING)
    store.remaining.numpy()[store.places[:, 2] == 2] = 0  # the upper bricks: voxels 16 and higher
    for _ in range(5):
        result = proxy.advance(device)
    assert result.position_m[2] == pytest.approx(16.25 * SPACING, abs=2e-3 * SPACING)
