"""Bone in front of the tool's surface, against the exact capsule of an older cut."""

from itertools import pairwise

import numpy as np
import pytest
import warp as wp

from kernels.bricks import Bricks, corner8f
from kernels.mirror import filled
from kernels.older_cuts import SLOTS, bend_below, bone_left
from kernels.revolution import EDGE_BEND, Revolution
from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import half_space
from meshes.voxels.voxelise import voxelise
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.materials.constants import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

RADIUS, SPACING = 1e-3, 1e-4
BONE = Anatomy(
    "half space",
    half_space([0.0, 0.0, 1.0]),
    ("cortical",),
    lambda points, depth: (
        np.zeros(len(points), dtype=np.uint8),
        np.full(len(points), 1800.0, points.dtype),
    ),
)
CORNERS_M = 1e-3 * np.array(
    [[-1.5, 0, -0.3], [1, 0, -0.3], [1, 0, 0.3], [0.03, 0.21, 0.3], [0.03, 0.21, -0.35]]
)
UNSURE = 0.15
"""Share of a voxel by which interpolation may miss the edge of an older cut.

The interpolation is between voxel centres.
"""


@wp.kernel
def ask(
    tool: Revolution,
    pose: wp.array(dtype=wp.vec3d),
    bricks: Bricks,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    bend: float,
    rows: wp.array2d(dtype=wp.int32),
    seen: wp.array2d(dtype=corner8f),
    length_out: wp.array(dtype=float),
):
    i = wp.tid()
    axis = wp.vec3(0.0, 0.0, 1.0)
    length_out[i] = bone_left(
        tool,
        pose,
        axis,
        bricks,
        rows[i, 0],
        rows[i, 1],
        points[i],
        normals[i],
        bend,
        seen,
        i / 100,
    )


def slot_and_plunge():
    """Return a model with a slot along x, 0.3 mm deep.

    Its tool was lifted and now plunges deeper, next to the slot.
    """
    volume = voxelise(
        BONE,
        spacing_m=SPACING,
        region_m=(np.array([-3e-3, -2e-3, -1e-3]), np.array([3e-3, 2e-3, 2.5e-3])),
    )
    model = BoneModel(
        volume,
        Cutter(ball_burr(diameter_m=2 * RADIUS), 6, -1000.0),
        (cutting_coefficients("bone"),),
    )
    motion = ToolMotion(speed_m_s=5e-3)
    motion.tip_m[:] = CORNERS_M[0]
    for index, (start, end) in enumerate(pairwise(CORNERS_M)):
        motion.heading[0] = (end - start) / np.linalg.norm(end - start)
        if index == 0:
            model.place(motion)
        for share in np.linspace(0.0, 1.0, round(np.linalg.norm(end - start) / 1e-5) + 1)[1:]:
            motion.tip_m[:] = start + share * (end - start)
            model.advance(motion)
    return model


def stored_at(store, voxel):
    """Row and column of voxels, shape (n, 3), in the arrays of the store."""
    rows = store.brick_of.numpy()[tuple((voxel >> 3).T)]
    inner = voxel & 7
    column = ((inner[:, 0] >> 1) * 16 + (inner[:, 1] >> 1) * 4 + (inner[:, 2] >> 1)) * 8
    return rows, column + (inner[:, 0] & 1) * 4 + (inner[:, 1] & 1) * 2 + (inner[:, 2] & 1)


def test_points_of_a_slot_are_taken_and_points_outside_are_not():
    model = slot_and_plunge()
    store, volume = model.store, model.store.volume
    random = np.random.default_rng(3)
    tip = CORNERS_M[-1]
    out = random.normal(size=(4000, 3))
    out = out[out[:, 2] < 0.0] / np.linalg.norm(out[out[:, 2] < 0.0], axis=1)[:, None]
    points_m = tip + [0.0, 0.0, RADIUS] + RADIUS * out
    out, points_m = out[points_m[:, 2] < -SPACING], points_m[points_m[:, 2] < -SPACING]
    centre = np.array([0.0, 0.0, RADIUS - 3e-4])
    along = np.clip(points_m[:, 0], -1.5e-3, 1.0e-3)
    gap = np.linalg.norm(points_m - centre - np.outer(along, [1.0, 0.0, 0.0]), axis=1) - RADIUS
    points = (points_m - volume.origin_m) / SPACING
    voxel = np.floor(points).astype(int)
    rows, column = stored_at(store, voxel)
    pose = np.zeros((4, 6))
    pose[0, :3], pose[0, 5] = (tip - volume.origin_m) / SPACING, 1.0
    length = wp.zeros(len(points), dtype=float, device="cpu")
    wp.launch(
        ask,
        dim=len(points),
        inputs=[
            model.carver.tool,
            wp.array(pose[:, :3].copy(), dtype=wp.vec3d, device="cpu"),
            store.on_device,
            wp.array(points, dtype=wp.vec3, device="cpu"),
            wp.array(out, dtype=wp.vec3, device="cpu"),
            SPACING / RADIUS / 3.0,
            wp.array(np.column_stack([rows, column]), dtype=wp.int32, device="cpu"),
        ],
        outputs=[
            wp.zeros((len(points) // 100 + 1, SLOTS + 1), dtype=corner8f, device="cpu"),
            length,
        ],
        device="cpu",
    )
    sure = np.abs(gap) > UNSURE * SPACING
    found, wanted = length.numpy() < 0.0, gap < 0.0
    assert sure.sum() > 300 and 0.1 < wanted[sure].mean() < 0.9
    assert (found == wanted)[sure].all()


@wp.kernel
def evaluate_bend(
    bend: float, outward: wp.vec3, part: wp.array(dtype=wp.vec3), below_out: wp.array(dtype=float)
):
    i = wp.tid()
    below_out[i] = bend_below(bend, outward, part[i])


@pytest.mark.parametrize("bend", [0.02, 0.2, float(EDGE_BEND)])
def test_parabolas_lie_below_their_interpolation_by_the_bend_on_average(bend):
    """Parabolas lie below their interpolation by the bend, on average over their directions.

    Each has a curvature of 3 bend along one direction in the tangent plane, between eight voxel
    centres. An edge has no curvature.
    """
    random = np.random.default_rng(4)
    outward = np.array([0.48, -0.6, 0.64])
    first = np.cross(outward, [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(outward, first)
    parts = random.random((50, 3))
    corners = np.array(list(np.ndindex(2, 2, 2)), dtype=float)
    weights = np.prod(np.where(corners[None] > 0.0, parts[:, None], 1.0 - parts[:, None]), axis=2)
    each = []
    for turn in np.arange(8) * np.pi / 8:
        along = np.cos(turn) * first + np.sin(turn) * second
        height = 1.5 * bend * (corners @ along) ** 2
        each.append(weights @ height - 1.5 * bend * (parts @ along) ** 2)
    wanted = np.mean(each, axis=0)
    out = wp.zeros(len(parts), dtype=float, device="cpu")
    inputs = [bend, wp.vec3(*outward), wp.array(parts, dtype=wp.vec3, device="cpu")]
    wp.launch(evaluate_bend, dim=len(parts), inputs=inputs, outputs=[out], device="cpu")
    assert np.min(each) >= 0.0 and (np.max(each, axis=0) <= 2.0 * wanted + 1e-12).all()
    is_edge = bend == float(EDGE_BEND)
    assert out.numpy() == pytest.approx(np.zeros(50) if is_edge else wanted, abs=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("deeper", "short"), [(0.1, 0.3), (0.3, 0.3), (0.3, 0.1), (1.5, 0.3)])
def test_an_older_cut_between_voxel_centres_is_interpolated(axis, deeper, short):
    """An older cut between voxel centres is interpolated.

    The older cut is deeper than the tool at every other voxel, and short of it at those between.
    Between a deeper voxel and the next one the length is linear, and so the sign changes at the
    share deeper / (deeper + short) of the path. Before that point the bone is taken.
    """
    end = deeper / (deeper + short)
    model = slot_and_plunge()
    store, volume = model.store, model.store.volume
    tip = CORNERS_M[-1]
    centre = (np.add(tip, [0.0, 0.0, RADIUS]) - volume.origin_m) / SPACING
    grid = np.array(list(np.ndindex(volume.shape)))
    near = np.abs(np.linalg.norm(grid + 0.5 - centre, axis=1) - RADIUS / SPACING) < 3.0
    grid = grid[near]
    difference = np.where(grid[:, axis] % 2 == 1, -deeper, short)
    kept = np.linalg.norm(grid + 0.5 - centre, axis=1) - RADIUS / SPACING + difference
    older = np.full(store.older.shape, 65535, dtype=np.uint16)
    rows, columns = stored_at(store, grid)
    stored = rows >= 0
    older[rows[stored], columns[stored]] = (32768.5 + 4096.0 * kept[stored]).astype(np.uint16)
    out = np.random.default_rng(5).normal(size=(20000, 3))
    out /= np.linalg.norm(out, axis=1)[:, None]
    points = centre + RADIUS / SPACING * out
    part = (points[:, axis] - 0.5) % 2.0 - 1.0  # from an odd voxel's centre on towards the next one
    inside = ((points > 2.0) & (points < np.array(volume.shape) - 2.0)).all(axis=1) & (
        points[:, 2] < 15.0
    )  # bricks are stored up to voxel 15
    # Where a voxel's centre lies farther off, its kept distance alone decides.
    gap = np.linalg.norm(np.floor(points) + 0.5 - centre, axis=1) - RADIUS / SPACING
    inside &= np.abs(gap) < 0.55
    off = np.abs(part - end)
    chosen = inside & (part > 0.0) & (part < 1.0) & (off > 0.06) & (off < 0.2)
    points, out, part = points[chosen], out[chosen], part[chosen]
    rows, columns = stored_at(store, np.floor(points).astype(int))
    there = rows >= 0
    points, out, part, rows, columns = (
        points[there],
        out[there],
        part[there],
        rows[there],
        columns[there],
    )
    pose = np.zeros((4, 6))
    pose[0, :3], pose[0, 5] = (tip - volume.origin_m) / SPACING, 1.0
    length = wp.zeros(len(points), dtype=float, device="cpu")
    inputs = [
        model.carver.tool,
        wp.array(pose[:, :3].copy(), dtype=wp.vec3d, device="cpu"),
        filled(Bricks, "cpu", brick_of=store.brick_of, older=older),
        wp.array(points, dtype=wp.vec3, device="cpu"),
        wp.array(out, dtype=wp.vec3, device="cpu"),
        SPACING / RADIUS / 3.0,
        wp.array(np.column_stack([rows, columns]), dtype=wp.int32, device="cpu"),
    ]
    seen = wp.zeros((len(points) // 100 + 1, SLOTS + 1), dtype=corner8f, device="cpu")
    wp.launch(ask, dim=len(points), inputs=inputs, outputs=[seen, length], device="cpu")
    wanted = part < end
    assert 50 < wanted.sum() < len(wanted) - 50
    assert ((length.numpy() < 0.0) == wanted).mean() > 0.99
