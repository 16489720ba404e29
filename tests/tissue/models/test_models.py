"""Laws of every tissue model, over all of them."""

import gc
import tracemalloc

import numpy as np
import pytest

from meshes.base.progress import silent
from meshes.shapes.anatomy import cortical_block
from meshes.voxels.volume import VoxelVolume
from meshes.voxels.voxelise import voxelise
from tissue import load_scene
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.materials.constants import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.incision.model import IncisionModel
from tissue.models.incision.parameters import Blade, incised_tissue
from tissue.models.needle.model import NeedleModel
from tissue.models.needle.parameters import needle_tissue
from tissue.models.tissue_model import Finishes, FreeSpace, HasVoxels, ToolMotion
from tissue.models.tooth.model import ToothModel
from tissue.simulation.simulate import build

RADIUS_M = 3e-3
BLADE = Blade(width_m=6e-3, thickness_m=4e-4, edge_rad=0.8)
RESTING = "test_a_tool_at_rest_changes_nothing_and_feels_nothing"
STEP_S = 1e-3


def finish(model):
    """Complete work that is spread over ticks, where the model has such."""
    if isinstance(model, Finishes):
        model.finish()


def remaining_of(model):
    """Tissue left in every voxel; None of a model without voxels."""
    return model.remaining() if isinstance(model, HasVoxels) else None


def layered_bone(removal="subvoxel", names=("top", "below")):
    """A block in two layers under a ball burr."""
    plain = voxelise(cortical_block(size_mm=(8.0, 8.0, 4.0)), spacing_m=0.4e-3)
    layer = np.ascontiguousarray(np.indices(plain.shape)[2] < 8, dtype=np.uint8)
    volume = VoxelVolume(
        plain.origin_m, plain.spacing_m, plain.fraction, layer, plain.density_kg_m3, names
    )
    return BoneModel(
        volume,
        Cutter(ball_burr(diameter_m=2.0 * RADIUS_M), 6, -1000.0),
        (cutting_coefficients("bone"),) * 2,
        removal=removal,
    )


def pressed_slab():
    """A slab of soft tissue under a ball."""
    ball = {
        "tool.diameter_mm": 6.0,
        "anatomy.size_mm": [16, 16, 8],
        "anatomy.edge_mm": 4.0,
        "organ.order": 1,
    }
    wandering = {
        "motion.points_mm": [[-2, -2, 0.6], [2, 2, -1.2], [2, -2, -1.2], [-2, 2, -1.2]],
        "organ.young_end_kPa": None,
    }
    scene = load_scene(
        "palpation",
        {**ball, **wandering, "anatomy.nodule_diameter_mm": 0.0, "anatomy.touch_edge_mm": 1.5},
    )
    return build(scene, compute="cpu", cores=None, report=silent).tissue


MODELS = {
    "free space": FreeSpace,
    "bone": layered_bone,
    "binary bone": lambda: layered_bone("binary"),
    "tooth": lambda: ToothModel(layered_bone(names=("dentin", "pulp"))),
    "needle": lambda: NeedleModel(needle_tissue(), diameter_m=1.27e-3),
    "incision": lambda: IncisionModel(incised_tissue("skin", BLADE), BLADE),
    "pressed slab": pressed_slab,
}
ELASTIC = ("needle", "incision", "pressed slab")
"""Tissues that push back at rest too, and that fill the space below their surface."""


@pytest.fixture(params=MODELS, ids=list(MODELS))
def model(request):
    """A model with the tool placed above the tissue."""
    law = request.node.name.partition("[")[0]
    if request.param in ELASTIC and law in ("test_nothing_touched_gives_no_force", RESTING):
        pytest.skip(
            "does not hold for a tissue that is elastic at rest and reaches as far down as "
            "it is long"
        )
    made = MODELS[request.param]()
    made.place(at((0, 0, 0.6), speed_m_s=0.0))
    return made


def at(tip_mm, *, heading=(0.0, 0.0, -1.0), speed_m_s=0.02):
    motion = ToolMotion(tip_m=1e-3 * np.array(tip_mm, dtype=float), speed_m_s=speed_m_s)
    motion.heading[0] = heading
    return motion


def cuts(seed, count=200):
    """A wandering tool that dips into the block and leaves it again."""
    random = np.random.default_rng(seed)
    tip = np.array([0.0, 0.0, 0.6])
    for _ in range(count):
        step = random.normal(size=3) * (0.05, 0.05, 0.02) - (0.0, 0.0, 0.004)
        before = tip
        tip = np.clip(tip + step, (-2, -2, -1.2), (2, 2, 1))
        moved = 1e-3 * (tip - before)
        length = float(np.linalg.norm(moved))
        yield at(tip, heading=moved / length if length else (0, 0, -1), speed_m_s=length / STEP_S)


@pytest.mark.parametrize("seed", range(2))
def test_removed_never_decreases_and_never_exceeds_the_start(model, seed):
    before = model.removed_m3.copy()
    for motion in cuts(seed):
        model.advance(motion)
        assert (model.removed_m3 >= before).all()
        before = model.removed_m3.copy()
    finish(model)
    assert (model.removed_m3 >= before).all()
    assert (model.removed_m3 <= model.start_m3).all()


def test_removed_and_remaining_make_up_the_start(model):
    for motion in cuts(7):
        model.advance(motion)
    finish(model)
    remaining = remaining_of(model)
    if remaining is None:
        assert not model.removed_m3.any()
        return
    bone = getattr(model, "milling", model)
    assert (bone.removed_steps > 0).any()
    np.testing.assert_array_equal(
        bone.removed_steps + bone.store.steps_by_layer(), bone.store.start_steps
    )
    # The voxels hold what remains in 255 steps, to the nearest: a cut one is off by half a step at
    # most.
    volume = bone.store.volume
    from_voxels = (
        np.array([remaining[volume.layer == k].sum(dtype=np.int64) for k in range(2)])
        / 255
        * volume.voxel_volume_m3
    )
    cut = np.count_nonzero(remaining < volume.fraction)
    rounding = 0.5 * cut / 255 * volume.voxel_volume_m3
    np.testing.assert_allclose(
        from_voxels, model.start_m3 - model.removed_m3, atol=rounding, rtol=1e-12
    )


def test_a_tool_at_rest_changes_nothing_and_feels_nothing(model):
    for motion in cuts(1):
        model.advance(motion)
    finish(model)
    removed = model.removed_m3.copy()
    motion.speed_m_s = 0.0
    for _ in range(20):
        model.advance(motion)
        response = model.respond(motion)
        assert not response.wrench.any()
        assert response.removal_rate_m3_s == 0.0
    finish(model)
    np.testing.assert_array_equal(model.removed_m3, removed)


def test_a_tick_leaves_no_memory_behind(model):
    """A tick frees the memory that it allocates: 400 further ticks add less than a kilobyte."""
    motions = list(cuts(4, count=100))

    def run():
        for motion in motions:
            model.advance(motion)
            model.respond(motion)

    run()
    tracemalloc.start()
    run()
    gc.collect()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(4):
        run()
    gc.collect()
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 1024


def test_force_grows_with_speed_as_its_two_parts_predict(model):
    """wrench = resistance x speed + edge, for whatever speed, at one pose."""
    for motion in cuts(5):
        model.advance(motion)
    for speed in (1e-4, 1e-3, 0.1):
        motion.speed_m_s = speed
        response = model.respond(motion)
        expected = response.resistance * speed + response.edge
        np.testing.assert_allclose(response.wrench, expected, rtol=1e-12, atol=1e-15)


def test_a_slow_tool_receives_the_tangent_at_the_speed_that_it_asks_for():
    """Without it, the edge force of a resting tool is zero and its derivative is steep."""
    bone = layered_bone()
    bone.place(at((0, 0, -0.3), speed_m_s=0.0))
    slow = at((0.01, 0.0, -0.31), heading=(0.6, 0.0, -0.8), speed_m_s=0.0)
    tangents = []
    for speed, tangent in ((0.0, None), (0.0, 1e-3), (5e-4, 1e-3), (1e-3, None)):
        slow.speed_m_s = speed
        slow.tangent_m_s = tangent
        response = bone.respond(slow)
        tangents.append((response.edge.copy(), response.resistance.copy()))
        expected = response.resistance * speed + response.edge * (speed > 0.0)
        np.testing.assert_allclose(response.wrench, expected, rtol=1e-12, atol=1e-15)
    (resting, steep), *asked = tangents
    assert not resting.any()
    edge, resistance = asked[-1]
    assert np.linalg.norm(steep[:3]) > 10.0 * np.linalg.norm(resistance[:3])
    for found in asked[:-1]:
        np.testing.assert_array_equal(found, (edge, resistance))
