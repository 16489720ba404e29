"""A loop that a program moves: forces of the scene, snapshots bit for bit, steps of several ticks."""

import pickle

import numpy as np
import pytest
import pyvista

import tissue
from tissue.cutters import ball_burr
from tissue.models.organ.model import OrganModel
from tissue.models.state import fingerprint
from tissue.objects.bone import constants_of

COARSE = {
    "milling": {"voxels.spacing_mm": 0.3},
    "molar": {"voxels.spacing_mm": 0.1, "stress.cell_mm": 0.4},
    "liver-press": {"anatomy.edge_mm": 20.0, "anatomy.touch_edge_mm": 10.0, "organ.order": 1},
}
PATHS = {
    "milling": [[-3, 0, 1.5], [-3, 0, -1], [0, 0, -1.2]],
    "needle": [[0, 0, 5], [0, 0, -45], [0, 0, 5]],
    "liver-press": [[0, 0, 3], [0, 0, -6], [15, 0, -6]],
    "molar": [[0, 0, 0.6], [0, 0, -0.8], [0.2, 0, -0.8]],
    "incision": [[0, 0, 1], [0, 0, -8], [10, 0, -8]],
}


def along(points, count):
    """Tips on straight lines between points [mm], shape (count (points - 1), 3)."""
    share = np.arange(1, count + 1)[:, None] / count
    lines = zip(np.array(points[:-1], float), np.array(points[1:], float), strict=True)
    return np.concatenate([start + share * (end - start) for start, end in lines])


def made(name, **options):
    scene = tissue.load_scene(name, COARSE.get(name, {}))
    return tissue.Loop(scene, **({"reach_mm": 0.0} | options))


def moved(loop, tips):
    return np.array([loop.step(tip) for tip in tips])


@pytest.mark.parametrize("name", PATHS)
def test_a_restored_loop_continues_bit_for_bit(name):
    loop = made(name)
    tips = along(PATHS[name], 60)
    loop.reset(PATHS[name][0])
    before = moved(loop, tips[:70])
    snapshot = loop.snapshot()
    sent = pickle.dumps(snapshot)
    after = moved(loop, tips[70:])
    assert np.abs(after).max() > 0.01
    last = dict(loop.row)
    loop.restore(snapshot)
    assert loop.ticks == 70 and snapshot.time_s == pytest.approx(0.07)
    np.testing.assert_array_equal(moved(loop, tips[70:]), after)
    assert dict(loop.row) == last
    other = made(name)
    other.restore(pickle.loads(sent))
    np.testing.assert_array_equal(moved(other, tips[70:]), after)
    loop.reset(PATHS[name][0])
    assert loop.ticks == 0
    np.testing.assert_array_equal(moved(loop, tips), np.concatenate([before, after]))


def test_the_forces_are_those_of_a_run_of_the_scene():
    scene = tissue.load_scene("needle", {"duration_s": 1.2})
    trace = tissue.simulate(scene).trace
    loop = tissue.Loop(scene)
    wrenches = moved(loop, trace.vectors("tool", "mm"))
    names = [f"model_force_{c}_N" for c in "xyz"]
    wanted = np.array([trace[name] for name in names]).T
    assert np.abs(wanted).max() > 1.0
    # The first tick of a run rests at its start, and positions of a trace are rounded to mm.
    np.testing.assert_allclose(wrenches[:, :3], wanted, atol=1e-9 * np.abs(wanted).max())


def test_bone_that_was_made_later_is_restored_too():
    loop = tissue.Loop(
        tissue.Bone.block((12, 8, 5), spacing_mm=0.25), start_mm=(-4, 0, 1), reach_mm=1
    )
    tips = along([[-4, 0, 1], [-4, 0, -0.8], [3, 0, -0.8]], 120)
    first = moved(loop, tips)
    cut = loop.row["removed_mm3"]
    assert cut > 1.0
    loop.reset()
    assert loop.row["removed_mm3"] == 0.0
    np.testing.assert_array_equal(moved(loop, tips), first)
    assert loop.row["removed_mm3"] == cut


def test_a_step_of_several_ticks_ends_where_its_ticks_would():
    tips = along(PATHS["needle"], 400)
    every, fourth = made("needle"), made("needle", step_ms=4)
    np.testing.assert_allclose(
        moved(fourth, tips[3::4]), moved(every, tips)[3::4], rtol=1e-9, atol=1e-9
    )
    assert every.ticks == fourth.ticks == 800


def test_a_velocity_of_its_own_scales_a_cutting_force():
    loop = tissue.Loop(tissue.Bone.block((12, 8, 5), spacing_mm=0.25), start_mm=(-4, 0, 1))
    moved(loop, along([[-4, 0, 1], [-4, 0, -0.8]], 200))
    tip = [-3.99, 0.0, -0.8]
    snapshot = loop.snapshot()
    wrenches = []
    for speed in (None, 10.0, 20.0, 0.0):
        loop.restore(snapshot)
        wrenches.append(loop.step(tip, None if speed is None else [speed, 0, 0]))
    np.testing.assert_allclose(wrenches[0], wrenches[1], rtol=1e-6)
    assert wrenches[2][0] < 1.05 * wrenches[1][0] < 0.0 and not wrenches[3].any()


def test_a_turn_about_the_tip_gives_a_wrench_and_ends_at_the_pose():
    loop = tissue.Loop(
        tissue.Bone.block((12, 8, 5), spacing_mm=0.25), start_mm=(0, 0, 1), step_ms=5
    )
    moved(loop, along([[0, 0, 1], [0, 0, -0.8]], 40))
    half = np.radians(0.5 * np.arange(1, 11))
    for angle in half:
        wrench = loop.step([0, 0, -0.8, np.sin(angle / 2), 0, 0, np.cos(angle / 2)])
    assert np.abs(wrench[:3]).max() > 0.01
    assert loop.row["tool_qx"] == pytest.approx(np.sin(half[-1] / 2), abs=1e-12)
    assert loop.row["angular_velocity_x_rad_s"] == pytest.approx(np.radians(0.5) / 0.005, rel=1e-6)


def test_a_tool_that_leaves_the_prepared_region_is_reported():
    loop = made("needle")
    loop.reset([0, 0, 5])
    moved(loop, along([[0, 0, 5], [0, 0, -5], [0, 0, 5]], 20))
    inside = loop.snapshot()
    for _ in range(2):  # a restored loop reports it again
        assert not any("left the region" in what for _, what in loop.events)
        moved(loop, along([[0, 0, 5], [1, 0, 5]], 20))
        assert sum("left the region" in what for _, what in loop.events) == 1
        loop.restore(inside)


def test_tables_that_a_loop_does_not_use_are_noted():
    loop = tissue.Loop(tissue.load_scene("needle", {"device": "touch"}))
    assert loop.notes["not used"].startswith("device of the scene, because a program moves")
    plain = tissue.Loop("needle")
    assert "not used" not in plain.notes
    assert "also valid outside this region" in plain.notes["reach"]


def test_a_tip_that_is_rounded_to_six_digits_stays_in_the_prepared_region():
    loop = made("needle", reach_mm=0.0)
    loop.reset([0, 0, 5])
    for tip in ([1e-6, 0.0, 5.0], [0.0, 1.1e-3, 5.0]):
        moved(loop, [tip])
        outside = any("left the region" in what for _, what in loop.events)
        assert outside is (tip[1] > 1e-3)


def test_the_first_pose_has_the_time_zero():
    loop = made("needle")
    moved(loop, [[0, 0, 5], [0, 0, 4.98]])
    np.testing.assert_array_equal(loop.trace["time_s"], [0.0, 1e-3])


def test_a_device_for_a_scene_is_refused_with_the_function_that_takes_one():
    with pytest.raises(tissue.InputError, match=r"tissue\.simulate\(scene, device=\.\.\.\)"):
        tissue.Loop("needle", device=object())


def test_the_remedy_for_a_tool_outside_the_prepared_region_depends_on_the_side():
    deeper = "give the motion of the scene a deeper path, because reach_mm adds no depth"
    wider = "use a larger reach_mm"
    # A larger reach adds no depth.
    loop = made("needle", reach_mm=2.0)
    assert loop._session._region.remedies(1e-3 * np.array([3.0, 0.0, -70.0])) == [wider, deeper]
    for end, remedy in (([0, 0, -70], deeper), ([3, 0, 5], wider)):
        loop.reset([0, 0, 5])
        moved(loop, along([[0, 0, 5], end], 60))
        (event,) = [what for _, what in loop.events if "left the region" in what]
        assert event.endswith(f"is prepared: {remedy}")


def test_a_larger_reach_helps_below_a_loop_of_an_organ():
    loop = pressed()
    moved(loop, along([[0, 0, 1], [0, 0, -3]], 40))
    (event,) = [what for _, what in loop.events if "left the region" in what]
    assert event.endswith("is prepared: use a larger reach_mm")


@pytest.mark.parametrize("length", [2.0, 0.98, 0.0])
def test_a_quaternion_of_another_length_is_refused(length):
    loop = made("needle")
    with pytest.raises(tissue.InputError, match=f"of length {length:.4g}\\. Divide"):
        loop.step([0, 0, 5, 0, 0, 0, length])


def test_a_quaternion_with_rounding_is_normalised():
    loop = made("needle")
    loop.reset([0, 0, 5])
    loop.step([0, 0, 5, 0, 0, 0, 1.005])
    assert loop.row["tool_qw"] == pytest.approx(1.0, abs=1e-12)


def test_a_snapshot_of_another_resolution_is_refused_and_changes_nothing():
    name = "milling"
    loop = made(name)
    finer = tissue.Loop(tissue.load_scene(name, {"voxels.spacing_mm": 0.4}), reach_mm=0.0)
    tips = along(PATHS[name], 30)
    for each in (loop, finer):
        each.reset(PATHS[name][0])
        moved(each, tips[:40])
    before = loop.snapshot()
    moved(finer, tips[40:50])
    with pytest.raises(ValueError, match="equal arguments"):
        loop.restore(finer.snapshot())
    assert loop.ticks == 40
    after = moved(loop, tips[40:])
    loop.restore(before)
    np.testing.assert_array_equal(moved(loop, tips[40:]), after)


def test_a_loop_does_not_restore_bone_that_a_later_tool_has_cut():
    bone = tissue.Bone.block((8, 8, 4), spacing_mm=0.25)
    first = tissue.Loop(bone, start_mm=(0, 0, 1))
    snapshot = first.snapshot()
    later = tissue.Loop(bone, start_mm=(0, 0, 1))
    moved(later, along([[0, 0, 1], [0, 0, -0.5]], 100))
    for call in (first.reset, first.snapshot, lambda: first.restore(snapshot)):
        with pytest.raises(ValueError, match="later tool"):
            call()
    later.reset()
    assert bone.removed.volume_mm3 == 0.0


def test_the_surface_shrinks_by_the_removed_volume():
    loop = made("milling")
    loop.reset(PATHS["milling"][0])
    before_mm3 = loop.surface().volume
    moved(loop, along(PATHS["milling"], 100))
    removed_mm3 = loop.row["removed_mm3"]
    assert removed_mm3 > 1.0
    # measured: 0.7, 0.4, 0.16 and 0.06 % less with voxels of 0.4, 0.3, 0.2 and 0.15 mm
    assert before_mm3 - loop.surface().volume == pytest.approx(removed_mm3, rel=0.006)


def test_an_organ_has_no_surface_of_voxels():
    with pytest.raises(tissue.InputError, match="voxels"):
        made("wall").surface()


def test_the_newest_ticks_are_in_order_once_all_rows_are_used():
    loop = tissue.Loop("wall", longest_s=0.01)
    loop.reset([0, 0, 1])
    moved(loop, along([[0, 0, 1], [0, 0, -1]], 13))
    times = loop._loop.timing["tick_us"]
    np.testing.assert_allclose(loop.trace["time_s"], 1e-3 * np.arange(3, 13), atol=1e-12)
    np.testing.assert_array_equal(loop.tick_us, times[[*range(3, 10), *range(3)]])


def test_a_limit_is_warned_of_after_a_reset_that_cleared_another():
    loop = tissue.Loop(tissue.Bone.block((12, 8, 5), spacing_mm=0.25), start_mm=(-4, 0, 1))
    for about in ("chips", "smooth surface"):
        loop._limits.exceeded[about] = f"the limit of {about}"
        with pytest.warns(UserWarning, match=about) as warned:
            loop.step([-4, 0, 1])
        assert warned[0].filename == __file__
        loop.reset()
        assert not loop._limits.exceeded


def test_an_organ_is_pressed_and_reset():
    organ = tissue.Organ.block((60, 60, 30), edge_mm=8, modulus_kPa=10.0, poisson_ratio=0.45)
    loop = tissue.Loop(organ, tissue.ball(diameter_mm=20), start_mm=(0, 0, 1), reach_mm=4)
    down = along([[0, 0, 1], [0, 0, -2]], 50)
    first = moved(loop, down)
    assert isinstance(loop._loop.parts.tissue, OrganModel) and first[-1, 2] > 0.05
    loop.reset()
    np.testing.assert_array_equal(moved(loop, down), first)


def pressed(*, edge_mm=10, modulus_kPa=10.0, diameter_mm=20.0, **options):
    """Loop of a coarse block under a ball."""
    organ = tissue.Organ.block(
        (40, 40, 20), edge_mm=edge_mm, modulus_kPa=modulus_kPa, poisson_ratio=0.45, **options
    )
    ball = tissue.ball(diameter_mm=diameter_mm)
    return tissue.Loop(organ, ball, start_mm=(0, 0, 1), reach_mm=3)


def test_a_needle_for_an_organ_is_refused_with_the_scene_that_takes_one():
    organ = tissue.Organ.block((40, 40, 20), edge_mm=10, modulus_kPa=10.0, poisson_ratio=0.45)
    with pytest.raises(tissue.InputError, match=r"tissue\.Loop\('needle'\)"):
        tissue.Loop(organ, "needle")


def test_an_organ_with_a_law_that_relaxes_is_restored():
    loop = pressed(law="neo-hookean", relaxation=[(0.4, 0.05)])
    tips = along([[0, 0, 1], [0, 0, -5], [2, 0, -4]], 100)
    before = moved(loop, tips[:90])
    windows = loop._loop.parts.tissue._law.windows
    assert windows.now.follower.factor is not windows.now.follower.at_rest
    snapshot = loop.snapshot()
    after = moved(loop, tips[90:])
    assert after[-1, 2] > 0.05
    for kept in (snapshot, pickle.loads(pickle.dumps(snapshot))):
        loop.restore(kept)
        np.testing.assert_array_equal(moved(loop, tips[90:]), after)
    loop.reset()
    assert windows.now.follower.factor is windows.now.follower.at_rest
    np.testing.assert_array_equal(moved(loop, tips), np.concatenate([before, after]))


@pytest.mark.parametrize(
    "other",
    [
        {},
        {"law": "neo-hookean", "relaxation": [(0.4, 0.05)]},
        {"law": "neo-hookean", "edge_mm": 12},
    ],
)
def test_a_snapshot_of_another_law_or_mesh_is_refused(other):
    with pytest.raises(ValueError, match="equal arguments"):
        pressed(law="neo-hookean").restore(pressed(**other).snapshot())


@pytest.mark.parametrize(
    ("changes", "options"),
    [
        ({"materials": "stiff.toml"}, {}),
        ({"anatomy.membrane_depths_mm": {"vessel wall": 12.0}}, {}),
        ({"tool.diameter_mm": 2.0}, {}),
        ({"motion.points_mm": [[1, 0, 5], [1, 0, -40]]}, {}),
        ({}, {"reach_mm": 1.0}),
        ({}, {"step_ms": 5}),
    ],
)
def test_a_snapshot_of_other_constants_tool_or_step_is_refused(tmp_path, changes, options):
    stiff = "value = 0.5\nrange = [0.4, 0.6]\nsource = 'own test'\nconfidence = 'M'\n"
    (tmp_path / "stiff.toml").write_text(f"[needle.liver.linear_N_mm]\n{stiff}")
    if "materials" in changes:
        changes = {"materials": str(tmp_path / changes["materials"])}
    loop = made("needle")
    before = moved(loop, along([[0, 0, 5], [0, 0, -5]], 20))
    other = tissue.Loop(tissue.load_scene("needle", changes), **{"reach_mm": 0.0} | options)
    with pytest.raises(ValueError, match=r"same constants.*equal arguments"):
        loop.restore(other.snapshot())
    assert loop.ticks == len(before)


def test_a_snapshot_fits_a_loop_whose_scene_and_constants_lie_elsewhere(tmp_path):
    stiff = "value = 0.5\nrange = [0.4, 0.6]\nsource = 'own test'\nconfidence = 'M'\n"
    loops = []
    for name in ("here", "there"):
        path = tmp_path / f"{name}.toml"
        path.write_text(f"[needle.liver.linear_N_mm]\n{stiff}")
        changes = {"materials": str(path), "anatomy.interval_ms": 100.0}
        loops.append(tissue.Loop(tissue.load_scene("needle", changes), reach_mm=0.0))
    path = along([[0, 0, 5], [0, 0, -5]], 20)
    moved(loops[0], path)
    loops[1].restore(pickle.loads(pickle.dumps(loops[0].snapshot())))
    deeper = along([[0, 0, -5], [0, 0, -7]], 20)
    np.testing.assert_array_equal(moved(loops[1], deeper), moved(loops[0], deeper))


def test_a_snapshot_of_another_tool_or_modulus_is_refused():
    snapshot = pressed().snapshot()
    pressed().restore(snapshot)
    for other in (pressed(modulus_kPa=15.0), pressed(diameter_mm=21.0), pressed(friction=0.1)):
        with pytest.raises(ValueError, match="equal arguments"):
            other.restore(snapshot)


def test_a_snapshot_of_another_cutter_or_density_is_refused():
    def over(diameter_mm=4, **bone):
        block = tissue.Bone.block((8, 8, 4), spacing_mm=0.25, **bone)
        burr = ball_burr(diameter_mm=diameter_mm, flutes=6, spin_rpm=20_000)
        return tissue.Loop(block, burr, start_mm=(0, 0, 1))

    snapshot = over().snapshot()
    over(4.0, density_kg_m3=1800).restore(snapshot)
    for other in (over(3), over(density_kg_m3=1200.0), over(cutting={"radial_chip_N_mm2": 99.0})):
        with pytest.raises(ValueError, match="equal arguments"):
            other.restore(snapshot)


def test_bone_from_another_file_or_of_another_density_has_another_fingerprint(tmp_path):
    def constants(height_mm=4.0, **bone):
        file = tmp_path / f"{height_mm}.stl"
        pyvista.Box((-4, 4, -4, 4, -height_mm, 0)).triangulate().save(file)
        return fingerprint(*constants_of(tissue.Bone.from_file(file, spacing_mm=0.5, **bone)))

    first = constants()
    assert constants() == first
    assert first not in (constants(3.9), constants(cortical_density_kg_m3=1200.0))


def test_a_snapshot_of_a_bone_with_other_filled_fractions_is_refused(tmp_path):
    """Coarse voxels of both images have equal densities, but one of them is filled to 7/8."""

    def over(name, grey_of_a_voxel):
        grey = np.full((32, 32, 32), 1000.0)
        grey[0, 0, 0] = grey_of_a_voxel
        image = pyvista.ImageData(dimensions=(33, 33, 33), spacing=(0.25, 0.25, 0.25))
        image.cell_data["grey"] = grey.ravel(order="F")
        image.save(tmp_path / f"{name}.vti")
        bone = tissue.Bone.from_image(tmp_path / f"{name}.vti", threshold=500, spacing_mm=0.5)
        burr = ball_burr(diameter_mm=4, flutes=6, spin_rpm=20_000)
        return tissue.Loop(bone, burr, start_mm=(4, 4, 11))

    snapshot = over("full", 1000.0).snapshot()
    over("equal", 1000.0).restore(snapshot)
    with pytest.raises(ValueError, match="equal arguments"):
        over("hollow", 0.0).restore(snapshot)


@pytest.mark.parametrize(
    "call",
    [
        lambda loop: loop.step([0, 0]),
        lambda loop: loop.step([0, 0, np.nan]),
        lambda loop: loop.step([0, 0, 5, 0, 0, 0, 0]),
        lambda loop: loop.step([0, 0, 5, 1, 0, 0, 0]),
        lambda loop: loop.step([0, 0, 5000]),
        lambda loop: loop.step(np.diag([2.0, 2.0, 2.0, 1.0])),
        lambda loop: loop.step(np.eye(4) + 5.0 * (np.arange(16) == 14).reshape(4, 4)),
        lambda loop: loop.step([0, 0, 5], [1, 2]),
        lambda loop: loop.step(),
        lambda loop: loop.run(1.0),
        lambda loop: loop.restore(made("wall").snapshot()),
        lambda loop: tissue.Loop("needle", tool=tissue.ball(diameter_mm=5)),
        lambda loop: tissue.Loop("needle", step_ms=0),
        lambda loop: tissue.Loop("needle", step_ms=1.5),
        lambda loop: tissue.Loop("needle", hand="expert"),
        lambda loop: tissue.Loop(tissue.Bone.block((4, 4, 2), spacing_mm=0.5), cores=1),
        lambda loop: tissue.Loop(3),
    ],
)
def test_what_cannot_be_used_is_refused(call):
    with pytest.raises(ValueError):
        call(made("needle"))
