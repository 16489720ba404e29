"""Laws of the proxy over random scenes: solids and voxels, three and six degrees of freedom."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from meshes.base.errors import InputError
from meshes.shapes.plane_cube import cube_fraction
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.haptics.proxy.proxy import Proxy, ProxyOutcome
from tissue.haptics.proxy.tool_shell import ToolShell
from tissue.haptics.proxy.voxmap import Ball, Box, ContactField, HalfSpace
from tissue.models.bone.bricks import BrickStore
from tissue.motion.motion import matrix_of
from tissue.motion.quaternion import turn_between

SPACING = 2e-4
SOLID_TOLERANCE_M = 2.5e-5
"""How deep a step beside solids may end before it is taken back: a tenth of 0.25 mm; a settled proxy keeps 1e-9."""
VOXEL_TOLERANCE_M = 0.05 * SPACING
"""The same beside voxels: a tenth of half a voxel."""
STILL = np.zeros(3)
BURR = ToolShell.of_cutter(Cutter(ball_burr(diameter_m=2e-3), 6, 1000.0), point_count=250)


def volume_of(fraction):
    return VoxelVolume(
        np.zeros(3), SPACING, fraction, np.zeros_like(fraction), np.full(fraction.shape, 1800, np.uint16), ("bone",)
    )


def bumpy_store(seed):
    """A block 8 mm wide with a rough top about 4 mm high."""
    random = np.random.default_rng(seed)
    height = 20.0 + 40.0 * gaussian_filter(random.normal(size=(40, 40)), 2.5, mode="wrap")
    fraction = np.clip(height[:, :, None] - np.arange(40), 0.0, 1.0)
    return BrickStore.from_volume(volume_of(np.rint(255 * fraction).astype(np.uint8)), device="cpu")


@cache
def slab_store(normal, offset, thickness=1.0):
    """A wall of so many voxels across the middle of a cube of 64 voxels."""
    count = 64
    centres = np.stack(np.meshgrid(*[np.arange(count) + 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    height = (centres - 0.5 * count) @ normal - offset
    normals = np.broadcast_to(normal, centres.shape)
    part = cube_fraction(height - 0.5 * thickness, normals) - cube_fraction(height + 0.5 * thickness, normals)
    return BrickStore.from_volume(volume_of(np.rint(255 * part).astype(np.uint8).reshape((count,) * 3)), device="cpu")


def solids_scene(seed):
    """A plane, a box askew and a ball."""
    random = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    return ContactField(
        HalfSpace((0.0, 0.0, 0.0), random.normal(size=3) * [0.2, 0.2, 0.0] + [0.0, 0.0, 1.0]),
        Box((4e-3, 0.0, 1e-3), (4e-3, 3e-3, 2e-3), turn),
        Ball((-4e-3, 1e-3, 0.0), 3e-3),
    )


def wander(seed, *, ticks, low, high, start):
    """A jerky path of a device [m] and its quaternions; some ticks jump."""
    random = np.random.default_rng(seed)
    position, turn = np.array(start, dtype=float), Rotation.identity()
    velocity = np.zeros(3)
    for _ in range(ticks):
        velocity = 0.95 * velocity + random.normal(size=3) * 2e-5
        jump = random.normal(size=3) * 2e-3 * (random.uniform() < 0.02)
        position = np.clip(position + velocity + jump, low, high)
        turn = Rotation.from_rotvec(random.normal(size=3) * 0.02) * turn
        yield position.copy(), turn.as_quat()


def surface_of(shell, result):
    """World positions of the shell's points."""
    return result.position_m + shell.points_m @ matrix_of(result.quaternion).T


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("seed", range(4))
def test_never_inside_solids(seed, friction):
    field = solids_scene(seed)
    half = np.array([1e-3, 0.7e-3, 0.5e-3])
    corners = half * np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z])
    shell = ToolShell(corners, np.zeros_like(corners), 0.2e-3)
    proxy = Proxy(shell, field, lever_m=3e-3, friction=friction)
    proxy.place(np.array([0.0, 0.0, 8e-3]))
    touched = 0
    for position, turn in wander(seed, ticks=1500, low=-8e-3, high=9e-3, start=(0.0, 0.0, 8e-3)):
        result = proxy.advance(position, turn)
        depth = shell.radius_m - field.distance(surface_of(shell, result))[0].min()
        assert depth <= SOLID_TOLERANCE_M
        if result.outcome is ProxyOutcome.CONTACT:
            assert depth <= 1e-9
            # The coupling pulls exactly what the contacts push.
            assert result.push_m == pytest.approx(result.position_m - position, abs=1e-9)
            moment = proxy_moment(result, turn)
            assert result.push_moment_m2 == pytest.approx(moment, abs=1e-11)
            touched += 1
    assert touched > 50


def proxy_moment(result, device):
    """Rotational spring's moment over the stiffness, for a lever of 3 mm [m2]."""
    return 9e-6 * np.array(turn_between(device, result.quaternion))


@pytest.mark.parametrize("lever", [None, 2e-3])
@pytest.mark.parametrize("seed", range(3))
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
        assert field.distance(surface_of(sunk, result))[0].min() >= -VOXEL_TOLERANCE_M
        if result.outcome is ProxyOutcome.CONTACT:
            settled += 1
            if seed == 0:
                assert result.push_m @ (result.position_m - position) > 0.0
                assert result.push_m[2] > -1e-4  # out of a block that lies below, but for its steepest bumps
    assert settled > 200


def test_in_free_space_the_proxy_is_the_device():
    """Bit for bit, in three and six degrees of freedom, near and far, on solids and voxels."""
    store = bumpy_store(0)
    for field in (ContactField(HalfSpace((0, 0, 0), (0, 0, 1))), ContactField(store=store)):
        for lever in (None, 0.01):
            proxy = Proxy(BURR, field, lever_m=lever)
            proxy.place(np.array([0.0, 0.0, 8e-3]))
            for position, turn in wander(1, ticks=200, low=(0, 0, 6.6e-3), high=(8e-3, 8e-3, 2e-2), start=(0, 0, 8e-3)):
                result = proxy.advance(position, turn)
                if result.outcome is ProxyOutcome.FREE:
                    assert (result.position_m == position).all()
                    assert (result.push_m == 0.0).all()
                    assert (result.quaternion == (turn if lever else [0.0, 0.0, 0.0, 1.0])).all()
            for _ in range(10):
                result = proxy.advance(np.array([0.0, 0.0, 1.5e-2]))
            assert result.outcome is ProxyOutcome.FREE
            assert (result.position_m == [0, 0, 1.5e-2]).all()


def push_through(normal, offset, shell, speed_m_s, random):
    """Send the device 5 mm through a wall one voxel thick: the shell's lowest height over the wall's middle [m], and
    whether the proxy ends against the wall, or has gone around its rim."""
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
    return lowest, around or result.outcome is ProxyOutcome.CONTACT


@pytest.mark.parametrize("speed_m_s", [0.05, 0.5, 2.0])
def test_no_path_through_a_wall_one_voxel_thick(speed_m_s):
    """Random walls, the worst place between voxels among them, and random paths; a point and a burr."""
    random = np.random.default_rng(7)
    for number, normal in enumerate([np.eye(3)[2], np.array([0.0, 0.6, 0.8]), *random.normal(size=(6, 3))]):
        for shell in (ToolShell.ball(), BURR):
            lowest, stopped = push_through(normal, (0.0, 0.5, 0.25)[number % 3], shell, speed_m_s, random)
            assert lowest > -SPACING and stopped


@pytest.mark.slow
def test_no_path_through_many_walls():
    """The same for forty walls at 2 m/s."""
    random = np.random.default_rng(8)
    for normal in random.normal(size=(40, 3)):
        for shell in (ToolShell.ball(), BURR):
            lowest, stopped = push_through(normal, random.uniform(-0.5, 0.5), shell, 2.0, random)
            assert lowest > -SPACING and stopped


def test_burr_rests_on_a_plane_of_voxels_within_half_a_voxel():
    """Planes at random angles; case 23 asks for sqrt(3)/2 voxel, the level's own error is -0.02 to 0.27."""
    random = np.random.default_rng(9)
    radius, errors = 1e-3, []
    for normal in [np.eye(3)[2], *random.normal(size=(12, 3))]:
        normal = normal / np.linalg.norm(normal)
        offset = random.uniform(-0.5, 0.5)
        field = ContactField(store=slab_store(tuple(normal), offset - 8.0, 16.0))
        plane = np.full(3, 32 * SPACING) + offset * SPACING * normal
        proxy = Proxy(ToolShell(BURR.points_m - radius * np.eye(3)[2], BURR.normals), field)
        proxy.place(plane + 2.0 * radius * normal)
        for share in np.linspace(0.0, 1.0, 100):
            result = proxy.advance(plane + (2.0 - 1.5 * share) * radius * normal)
        errors.append(((result.position_m - plane) @ normal - radius) / SPACING)
    assert min(errors) > -0.15
    assert max(errors) < 0.3


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_pushing_in_and_out_slowly_gains_no_energy(friction):
    """Work on the device along closed paths in a bumpy block; the trapezoid rule leaves 1e-3 of the work put in."""
    for seed in range(4):
        proxy = Proxy(BURR, ContactField(store=bumpy_store(seed)), friction=friction)
        random = np.random.default_rng(seed)
        start = np.array([4e-3, 4e-3, 6.5e-3])
        proxy.place(start)
        corners = [start, *(random.uniform((2.5e-3, 2.5e-3, 2.5e-3), (5.5e-3, 5.5e-3, 4.5e-3), (4, 3))), start]
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


def test_turning_everything_turns_the_proxy():
    """Solids, device and first pose turned and shifted together: so is the answer."""
    turn, shift = Rotation.random(random_state=3), np.array([0.2, -0.1, 0.3])
    box = Rotation.random(random_state=4).as_matrix()

    def scene(rotation, move):
        place = lambda p: rotation.apply(p) + move  # noqa: E731
        return ContactField(
            HalfSpace(place([0, 0, 0]), rotation.apply([0, 0, 1])),
            Box(place([2e-3, 0, 1e-3]), (4e-3, 3e-3, 2e-3), rotation.as_matrix() @ box),
        )

    plain = Proxy(BURR, scene(Rotation.identity(), np.zeros(3)), lever_m=4e-3, friction=0.3)
    moved = Proxy(BURR, scene(turn, shift), lever_m=4e-3, friction=0.3)
    start = np.array([0.0, 0.0, 6e-3])
    plain.place(start)
    moved.place(turn.apply(start) + shift, turn.as_quat())
    touched = 0
    for position, pose in wander(5, ticks=1500, low=(-3e-3, -3e-3, -1e-3), high=(3e-3, 3e-3, 4e-3), start=start):
        one = plain.advance(position, pose)
        two = moved.advance(turn.apply(position) + shift, (turn * Rotation.from_quat(pose)).as_quat())
        if ProxyOutcome.BEHIND in (one.outcome, two.outcome):
            break
        assert turn.apply(one.position_m) + shift == pytest.approx(two.position_m, abs=1e-7)
        assert turn.apply(one.push_m) == pytest.approx(two.push_m, abs=1e-7)
        touched += one.contacts > 0
    assert touched > 50


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


def test_inner_corner_of_voxels():
    """Two walls of voxels: the proxy rests in the corner within half a voxel and does not swing."""
    fraction = np.zeros((40, 40, 40), np.uint8)
    fraction[:20], fraction[:, :, :20] = 255, 255
    proxy = Proxy(ToolShell.ball(), ContactField(store=BrickStore.from_volume(volume_of(fraction), device="cpu")))
    proxy.place(np.array([6e-3, 4e-3, 6e-3]))
    rest = []
    for share in np.linspace(0.0, 1.0, 400):
        result = proxy.advance(np.array([6e-3, 4e-3, 6e-3]) - share * np.array([5e-3, 0.0, 4.5e-3]))
    for _ in range(20):
        result = proxy.advance(np.array([1e-3, 4e-3, 1.5e-3]))
        rest.append(result.position_m.copy())
    assert result.position_m == pytest.approx([20 * SPACING, 4e-3, 20 * SPACING], abs=0.5 * SPACING)
    assert np.ptp(rest, axis=0).max() < 1e-2 * SPACING


def test_work_of_a_tick_is_bounded_and_goes_on_in_the_next():
    """A jump along a plane needs more steps than a tick has; the next ticks finish it."""
    proxy = Proxy(ToolShell.ball(), ContactField(HalfSpace((0, 0, 0), (0, 0, 1))), step_limit=10)
    proxy.place(np.array([0.0, 0.0, 1e-3]))
    device = np.array([6e-3, 0.0, -1e-3])
    ticks = 0
    while proxy.advance(device).outcome is ProxyOutcome.BEHIND:
        ticks += 1
        assert proxy.result.steps <= 10
    assert 1 < ticks < 10
    assert proxy.result.position_m == pytest.approx([6e-3, 0.0, 0.0], abs=1e-9)


def test_a_wild_device_ends_in_a_finite_pose():
    """1e9 m away, and a turn of half a circle, beside a wall."""
    proxy = Proxy(BURR, ContactField(HalfSpace((0, 0, 0), (0, 0, 1))), lever_m=0.01)
    proxy.place(np.array([0.0, 0.0, 1e-3]))
    for device in (np.array([0.0, 0.0, -1e9]), np.array([1e9, 1e9, -1e9])):
        result = proxy.advance(device, np.array([1.0, 0.0, 0.0, 0.0]))
        assert np.isfinite(result.position_m).all()
        assert surface_of(BURR, result)[:, 2].min() > -SOLID_TOLERANCE_M
    home = np.array([0.0, 0.0, 0.1])
    assert any((proxy.advance(home).position_m == home).all() for _ in range(20))


def test_not_a_number_is_refused_and_changes_nothing():
    proxy = Proxy(ToolShell.ball(), ContactField(HalfSpace((0, 0, 0), (0, 0, 1))))
    proxy.place(np.array([0.0, 0.0, 1e-3]))
    with pytest.raises(InputError, match="finite"):
        proxy.advance(np.array([0.0, np.nan, 0.0]))
    with pytest.raises(InputError, match="finite"):
        proxy.advance(np.zeros(3), np.array([0.0, 0.0, np.inf, 1.0]))
    assert (proxy.result.position_m == [0.0, 0.0, 1e-3]).all()
    with pytest.raises(InputError, match=r"outside everything, got .* where it lies about 1 mm deep"):
        proxy.place(np.array([0.0, 0.0, -1e-3]))


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"friction": -0.1}, "friction"),
        ({"friction": np.nan}, "friction"),
        ({"lever_m": 0.0}, "lever_m"),
    ],
)
def test_unusable_numbers_are_refused(arguments, name):
    with pytest.raises(InputError, match=name):
        Proxy(ToolShell.ball(), ContactField(HalfSpace((0, 0, 0), (0, 0, 1))), **arguments)


def test_a_shell_of_balls_on_voxels_is_refused():
    with pytest.raises(InputError, match="radius_m"):
        Proxy(ToolShell.ball(1e-3), ContactField(store=bumpy_store(0)))
