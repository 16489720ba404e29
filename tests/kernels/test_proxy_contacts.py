"""Planes that a shell must stay above, against closed forms.

The shell lies next to exact solids and at an inner corner of voxels.
"""

import numpy as np
import pytest
import warp as wp
from field_distance import half_space
from scipy.spatial.transform import Rotation

from kernels.proxy_contacts import Contacts, Shell, collect, keep_plane
from kernels.voxmap import SURFACE, Field
from meshes.voxels.volume import VoxelVolume
from tissue.haptics.proxy.proxy import Box, ContactField, Proxy, ToolShell
from tissue.models.bone.bricks import BrickStore

ROUNDING_M = 1e-15
"""Places of a few mm in float64."""
STEP_M, RADIUS_M, AHEAD = 5e-4, 1e-3, 4.0


@wp.kernel
def collect_once(
    field: Field,
    shell: Shell,
    pose: wp.transformd,
    travel: wp.float64,
    wanted: wp.float64,
    step: wp.float64,
    contacts_out: Contacts,
    found_out: wp.array(dtype=wp.float64),
):
    turn = wp.quat_to_matrix(wp.transform_get_rotation(pose))
    count, gap, clear = collect(
        field, shell, contacts_out, wp.transform_get_translation(pose), turn, travel, wanted, step
    )
    found_out[0] = wp.float64(count)
    found_out[1] = gap
    found_out[2] = clear


@wp.kernel
def keep_once(contacts_out: Contacts, point: int):
    keep_plane(contacts_out, point, 3 * point)


class Looker:
    """A shell that looks at a field from poses."""

    def __init__(self, points_m, field, *, radius_m=0.0):
        normals = np.zeros_like(points_m)
        self.field, self.contacts = (
            field,
            Proxy(ToolShell(points_m, normals, radius_m), field)._contacts,
        )
        self.shell = Shell()
        self.shell.point = wp.array(points_m, dtype=wp.vec3d, device="cpu")
        self.shell.radius, self.shell.reach = (
            radius_m,
            np.linalg.norm(points_m, axis=1).max() + radius_m,
        )

    def look(self, position_m, *, turn=None, travel_m=0.0, wanted_m=0.0, step_m=STEP_M):
        """Return the number of candidates, the smallest gap and the free path length."""
        found = wp.zeros(3, dtype=wp.float64, device="cpu")
        quaternion = (turn or Rotation.identity()).as_quat()
        inputs = [
            self.field.arrays,
            self.shell,
            wp.transformd(position_m, quaternion),
            travel_m,
            wanted_m,
            step_m,
        ]
        wp.launch(collect_once, dim=1, inputs=inputs, outputs=[self.contacts, found], device="cpu")
        count, gap, clear = found.numpy()
        return int(count), gap, clear

    def read(self, name, count=None):
        return getattr(self.contacts, name).numpy()[:count]


def solids(random):
    """Return a slanted plane and a box, with their distances and normals by formula.

    The shape is (points, 2).
    """
    normal, low = (
        np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0]),
        np.array([0.0, 0.0, -2e-3]),
    )
    centre, half = np.array([4e-3, 0.0, 1e-3]), np.array([1e-3, 2e-3, 1.5e-3])

    def distance(at):
        beyond = np.abs(at - centre) - half
        outside = np.maximum(beyond, 0.0)
        to_box = np.linalg.norm(outside, axis=1)
        inner = np.eye(3)[beyond.argmax(axis=1)]
        with np.errstate(invalid="ignore"):
            from_box = np.sign(at - centre) * np.where(
                to_box[:, None] > 0.0, outside / to_box[:, None], inner
            )
        to_box = np.where(to_box > 0.0, to_box, beyond.max(axis=1))
        away = np.stack([(at - low) @ normal, to_box], axis=1)
        return away, np.stack([np.broadcast_to(normal, at.shape), from_box], axis=1)

    return ContactField(half_space(low, normal), Box(centre, 2.0 * half)), distance


@pytest.mark.parametrize("seed", range(3))
def test_candidates_beside_solids_and_points_that_sleep(seed):
    """Candidates next to solids have exact gaps, and far points sleep.

    A gap is the distance less the ball's radius; a point sleeps for the distance beyond a step.
    """
    random = np.random.default_rng(seed)
    points = random.normal(size=(60, 3)) * 2e-3
    field, distance = solids(random)
    looker = Looker(points, field, radius_m=RADIUS_M)
    turn, position = Rotation.random(random_state=seed), random.normal(size=3) * 1e-3
    count, gap, clear = looker.look(position, turn=turn)
    arms = turn.apply(points)
    away, normals = distance(position + arms)
    gaps = away - RADIUS_M
    point, solid = np.nonzero(gaps < STEP_M)
    assert count == len(point) > 10
    np.testing.assert_array_equal(looker.read("slot", count), 2 * point + solid)
    arm = arms[point] - RADIUS_M * normals[point, solid]
    assert looker.read("gap", count) == pytest.approx(gaps[point, solid], abs=ROUNDING_M)
    assert looker.read("normal", count) == pytest.approx(normals[point, solid], abs=1e-12)
    assert looker.read("arm", count) == pytest.approx(arm, abs=ROUNDING_M)
    assert looker.read("moment", count) == pytest.approx(
        np.cross(arm, normals[point, solid]), abs=ROUNDING_M
    )
    bound = gaps.min(axis=1)
    assert gap == pytest.approx(bound.min(), abs=ROUNDING_M)
    assert clear == pytest.approx(np.maximum(bound, STEP_M).min(), abs=ROUNDING_M)
    check_travel = np.where(bound > STEP_M, bound - STEP_M, 0.0)
    assert looker.read("check_travel") == pytest.approx(check_travel, abs=ROUNDING_M)
    for wanted, early in ((0.0, 0.0), (STEP_M, STEP_M), (1.0, AHEAD * STEP_M)):
        awake = check_travel - 3e-4 <= early
        looker.contacts.check_travel.assign(check_travel)
        count, _, clear = looker.look(position, turn=turn, travel_m=3e-4, wanted_m=wanted)
        assert count == (gaps[awake] < STEP_M).sum()
        seen = np.where(awake, np.maximum(bound, STEP_M), check_travel - 3e-4 + STEP_M)
        assert clear == pytest.approx(seen.min(), abs=ROUNDING_M)
        woken = np.where(awake & (bound > STEP_M), 3e-4 + bound - STEP_M, check_travel)
        assert looker.read("check_travel") == pytest.approx(woken, abs=ROUNDING_M)


def test_a_point_keeps_the_plane_that_it_met_while_it_goes_up_a_wall():
    """A point keeps the first plane that it touched while it moves up a wall.

    At an inner corner this plane stays with its force, until the point has left it or the voxels.
    """
    spacing, count = 2e-4, 32
    corner = np.indices((count,) * 3)
    fraction = np.where((corner[0] < 10) | (corner[2] < 10), 255, 0).astype(np.uint8)
    volume = VoxelVolume(
        np.zeros(3),
        spacing,
        fraction,
        np.zeros_like(fraction),
        np.full(fraction.shape, 1800, np.uint16),
        ("bone",),
    )
    looker = Looker(
        np.zeros((1, 3)), ContactField(store=BrickStore.from_volume(volume, device="cpu"))
    )
    edge, far, step, force = 10 * spacing, 20 * spacing, 0.5 * spacing, 1e-4
    shift = (0.5 - SURFACE) * spacing  # the surface lies that far outside the voxels' faces
    found, gap, clear = looker.look((far, far, edge + 0.3 * spacing), step_m=step)
    assert (found, gap, clear) == (
        1,
        pytest.approx(0.3 * spacing - shift, abs=1e-12),
        pytest.approx(step),
    )
    assert looker.read("normal", 1) == pytest.approx(np.array([[0.0, 0.0, 1.0]]), abs=1e-12)
    looker.contacts.normal_force.assign([force, 0.0, 0.0])
    assert (
        looker.look((far, far + spacing, edge + 0.3 * spacing), step_m=step)[0] == 1
    )  # same plane
    found, _, _ = looker.look((edge + 0.3 * spacing, far, edge + 0.6 * spacing), step_m=step)
    slots, gaps, normals = (looker.read(name, found) for name in ("slot", "gap", "normal"))
    assert found == 2 and slots[0] == 0
    assert gaps == pytest.approx(np.array([0.3 * spacing, 0.6 * spacing]) - shift, abs=1e-12)
    assert normals == pytest.approx(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), abs=1e-12)
    assert looker.read("normal_force")[[0, slots[1]]].tolist() == [0.0, force]
    found, _, _ = looker.look((edge + 0.3 * spacing, far, edge + 0.9 * spacing), step_m=step)
    assert found == 1 and not looker.read("normal_force").any()
    looker.contacts.normal_force.assign([force, force, 0.0])
    found, _, clear = looker.look((far, far, far), step_m=step)
    assert found == 0 and clear > step
    assert not looker.read("normal_force").any() and not looker.read("plane_normal").any()


@pytest.mark.parametrize(
    ("normal_force", "place"), [((5.0, 1.0, 3.0), 1), ((5.0, 3.0, 1.0), 2), ((5.0, 0.0, 0.0), 1)]
)
def test_a_plane_that_is_kept_takes_the_place_of_the_weaker_of_the_older_two(normal_force, place):
    """A kept plane replaces the weaker of the two older planes.

    For the second of two points, its present plane and force move; the other kept plane and the
    first point stay.
    """
    looker = Looker(
        np.zeros((2, 3)), ContactField(half_space(np.zeros(3), np.array([0.0, 0.0, 1.0])))
    )
    contacts = looker.contacts
    normals, offsets = np.random.default_rng(0).normal(size=(2, 3, 3)), np.arange(6.0).reshape(2, 3)
    contacts.plane_normal = wp.array(normals, dtype=wp.vec3d, device="cpu")
    contacts.plane_offset = wp.array(offsets, dtype=wp.float64, device="cpu")
    contacts.normal_force = wp.array([7.0, 8.0, 9.0, *normal_force], dtype=wp.float64, device="cpu")
    wp.launch(keep_once, dim=1, inputs=[], outputs=[contacts, 1], device="cpu")
    wanted = np.array(normal_force)
    wanted[0], wanted[place] = 0.0, normal_force[0]
    assert looker.read("normal_force").tolist() == [7.0, 8.0, 9.0, *wanted]
    normals[1, place], offsets[1, place] = normals[1, 0], offsets[1, 0]
    np.testing.assert_array_equal(looker.read("plane_normal"), normals)
    np.testing.assert_array_equal(looker.read("plane_offset"), offsets)
