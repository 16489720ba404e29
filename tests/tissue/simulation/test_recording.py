"""Runs as recordings in volumetric_drilling's layout.

The tests cover their content, and equal path and force in a replay.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tissue import load_scene, simulate
from tissue.motion.drilling_recording import EVENTS, POSES
from tissue.simulation.recording import write_recording

h5py = pytest.importorskip("h5py")
COARSE = {"voxels.spacing_mm": 0.5, "motion.points_mm": [[-3, 0, 0.2], [-3, 0, -0.8], [3, 0, -0.8]]}
FAST = COARSE | {"motion.feed_mm_s": 60.0, "duration_s": 0.13}
DRILL, ANATOMY = f"{POSES}/mastoidectomy_drill_pose", f"{POSES}/anatomy_object_name_pose"


@pytest.fixture(scope="module")
def run():
    return simulate(load_scene("milling", FAST))


@pytest.fixture(scope="module")
def written(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "run.hdf5"
    write_recording(run, path)
    return path


def test_it_has_the_names_shapes_and_units_of_the_recorder(run, written):
    found = {}
    with h5py.File(written) as file:
        file.visititems(
            lambda name, each: (
                found.update({name: each.shape}) if isinstance(each, h5py.Dataset) else None
            )
        )
        assert {"metadata_v3", "vision_data", "physics_data"} == set(file)
        assert all(file[name].dtype == np.float64 for name in found if not name.endswith("README"))
        assert file["metadata_v3/voxel_volume"][()] == pytest.approx(0.125)
        assert file["metadata_v3/voxel_volume"].attrs["units"] == "mm^3, millimeters cubed"
        assert file[f"{EVENTS}/burr_change/burr_size"][()].tolist() == [run.scene.tool.diameter_mm]
        pose, wrench = file[f"{DRILL}/pose"][()], file[f"{EVENTS}/drill_force_feedback/wrench"][()]
        still = file[f"{ANATOMY}/pose"][()]
        assert file[f"{DRILL}/time_stamp"][()] == pytest.approx(run.trace["time_s"])
    ticks = len(run.trace.rows)
    assert found[f"{DRILL}/pose"] == found[f"{ANATOMY}/pose"] == (ticks, 7)
    assert found[f"{EVENTS}/drill_force_feedback/wrench"] == (ticks, 6)
    groups, voxels = (
        found[f"{EVENTS}/voxels_removed/{name}"] for name in ("voxel_time_stamp", "voxel_removed")
    )
    assert (
        voxels[1] == 4
        and found[f"{EVENTS}/voxels_removed/voxel_color"] == (voxels[0], 5)
        and groups[0] < voxels[0]
    )
    # An upright tool: the burr's centre lies half its size above the tip, and the drill's x axis
    # points up.
    up = [0.0, 0.0, 0.5 * run.scene.tool.diameter_mm]
    assert 1e3 * pose[:, :3] == pytest.approx(run.trace.vectors("tool", "mm") + up, abs=1e-12)
    axes = Rotation.from_quat(pose[:, 3:]).apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(axes, np.tile([0.0, 0.0, 1.0], (ticks, 1)), atol=1e-14)
    assert wrench[:, :3] == pytest.approx(run.trace.vectors("force", "N"))
    low, high = run.volume.bounds_m
    assert still[0] == pytest.approx([*(0.5 * (low + high)), 0.0, 0.0, 0.0, 1.0])


def test_voxels_fall_when_the_bone_at_that_tick_has_lost_them(run):
    """Voxels fall when the bone at that tick has lost them.

    The bone at a tick is completed, the removals are booked up to 20 um of path later: here within
    2 ticks.
    """
    replay = run.replay()
    places, ticks = replay.removals()
    for tick in (40, 80, 115):
        below = (run.volume.fraction >= 128) & (replay.at(tick) < 128)
        taken, later = np.zeros_like(below), np.zeros_like(below)
        taken[tuple(places[ticks <= tick].T)] = later[tuple(places[ticks <= tick + 2].T)] = True
        assert taken.any() and (below | ~taken).all() and (later | ~below).all()
    # which removals() leaves whole
    np.testing.assert_array_equal(replay.at(len(run.trace.rows)), run.remaining)


def test_a_run_replayed_from_its_recording_takes_the_same_path_under_the_same_force(run, written):
    """A run replayed from its recording takes the same path under the same force.

    Poses lie on the ticks, so that nothing is resampled: only roundings of the turn and of the
    centre differ.
    """
    again = simulate(
        load_scene("milling", FAST | {"motion": {"kind": "replay", "file": str(written)}})
    )
    assert len(again.trace.rows) == len(run.trace.rows)
    assert again.trace.vectors("tool", "mm") == pytest.approx(
        run.trace.vectors("tool", "mm"), abs=1e-12
    )
    force, other = (each.trace.vectors("model_force", "N") for each in (run, again))
    # A path turns or stops at once; poses give the direction of the tick before. Nothing else
    # differs.
    turned = np.flatnonzero(np.diff(run.trace["velocity_x_mm_s"])) + 1
    np.testing.assert_array_equal(turned, [17, 117])
    peak = np.abs(force).max()
    assert peak > 50.0 and set(
        np.flatnonzero(np.abs(other - force).max(axis=1) > 1e-9 * peak)
    ) <= set(turned)
