"""Recordings of volumetric_drilling, made like its recorder's files, and invalid recordings."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.base.errors import InputError
from tissue.fitting.log import log_of
from tissue.fitting.log_files import read_columns
from tissue.motion.drilling_recording import read_drilling
from tissue.motion.replay import read_replay

h5py = pytest.importorskip("h5py")
EPOCH_S = 1_700_000_000.0
"""Its clock is that of ROS, seconds since 1970."""
POSES, EVENTS = (
    "physics_data/continuous_data/high_frequency_poses",
    "physics_data/intermittent_data",
)
SHAFT = Rotation.from_rotvec([0.0, -0.5 * np.pi, 0.0])
"""A drill that stands upright: its x axis, tip to shank, points up."""
CAMERA = Rotation.from_rotvec([0.0, 0.0, 0.5 * np.pi])
"""A camera whose x axis is the world's y axis."""
RATE_S = 5e-4
TIMES_S = RATE_S * np.arange(2001)


def read_log(path, columns=()):
    """Return the log in a file."""
    return log_of(path, read_columns(path), columns)


def recorded(
    path, *, poses=POSES, events=EVENTS, drill="mastoidectomy_drill_pose", burr=(4,), camera=True
):
    """Write a drill that moves down 10 mm/s for a second under a growing force.

    Each pose is recorded twice, two of them swapped.
    """
    centre = np.column_stack([np.full(2001, 0.1), np.full(2001, -0.2), 0.3 - 0.01 * TIMES_S])
    pose = np.repeat(np.hstack([centre, np.tile(SHAFT.as_quat(), (2001, 1))]), 2, axis=0)
    times = np.repeat(EPOCH_S + TIMES_S, 2)
    times[[1000, 1002]], pose[[1000, 1002]] = times[[1002, 1000]], pose[[1002, 1000]]
    with h5py.File(path, "w") as file:
        held = file.create_group(f"{poses}/{drill}")
        held.create_dataset("time_stamp", data=times, compression="gzip")
        held.create_dataset("pose", data=pose, compression="gzip")
        if camera:
            seen = file.create_group(f"{poses}/main_camera_pose")
            seen["time_stamp"], seen["pose"] = (
                EPOCH_S + TIMES_S[::10],
                np.tile([0, 0, 0, *CAMERA.as_quat()], (201, 1)),
            )
        still = file.create_group(f"{poses}/anatomy_object_name_pose")
        still["time_stamp"], still["pose"] = (
            EPOCH_S + TIMES_S[::10],
            np.tile([0, 0, 0, 0, 0, 0, 1.0], (201, 1)),
        )
        wrench = np.column_stack([TIMES_S[::20], 0.0 * TIMES_S[::20], 2.0 * TIMES_S[::20]])
        force = file.create_group(f"{events}/drill_force_feedback")
        force["time_stamp"], force["wrench"] = EPOCH_S + TIMES_S[::20], np.hstack([wrench, wrench])
        if burr:
            change = file.create_group(f"{events}/burr_change")
            change["time_stamp"], change["burr_size"] = (
                EPOCH_S + 0.1 * np.arange(len(burr)),
                np.array(burr),
            )
    return path


def test_a_file_of_the_recorder_gives_tip_axis_and_force_in_the_world(tmp_path):
    """A file of the recorder gives tip, axis and force in the world frame.

    The tip is 2 mm below the centre of a burr of 4 mm, axis up; a force along the camera's x lies
    along the world's y.
    """
    held = read_drilling(recorded(tmp_path / "log.hdf5"), argument="motion.file")
    # seconds since 1970 are known to 2.4e-7 s
    assert held.times_s == pytest.approx(TIMES_S, abs=1e-6)
    assert held.tips_m[0] == pytest.approx([0.1, -0.2, 0.298], abs=1e-15)
    assert held.tips_m[-1] == pytest.approx([0.1, -0.2, 0.288], abs=1e-15)
    axes = Rotation.from_quat(held.quaternions).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(axes, np.tile([0.0, 0.0, 1.0], (2001, 1)), atol=1e-15)
    assert held.loads[-1] == pytest.approx([0.0, 1.0, 2.0], abs=1e-15)
    assert held.loads.shape == (101, 3) and any("copy of the forces" in note for note in held.notes)


def test_it_is_replayed_at_its_speed_and_fitted_as_a_log(tmp_path):
    path = recorded(tmp_path / "log.hdf5")
    motion = read_replay(path)
    assert motion.duration_s == pytest.approx(1.0, abs=1e-6)
    down = np.column_stack(
        [np.full(1001, 0.1), np.full(1001, -0.2), 0.298 - 1e-5 * np.arange(1001)]
    )
    # 10 mm/s times the clock's 2.4e-7 s
    np.testing.assert_allclose(motion.sweep_m(), down, atol=1e-8)
    log = read_log(path)
    assert log.channels == ("force_x_N", "force_y_N", "force_z_N") and len(log.load_times_s) == 101
    assert log.tips_m[:, 2] == pytest.approx(0.298 - 0.01 * TIMES_S, abs=1e-8)


def test_without_burr_and_camera_the_point_and_the_axes_stay(tmp_path):
    held = read_drilling(recorded(tmp_path / "log.h5", burr=(), camera=False), argument="measured")
    assert held.tips_m[0] == pytest.approx([0.1, -0.2, 0.3], abs=1e-15)
    assert held.loads[-1] == pytest.approx([1.0, 0.0, 2.0])
    assert any("counts as its tip" in note for note in held.notes)


def test_the_older_layout_is_read(tmp_path):
    old = recorded(
        tmp_path / "old.hdf5", poses="high_frequency_poses", events=".", drill="drill_pose"
    )
    new = recorded(tmp_path / "new.hdf5")
    one, other = (read_drilling(path, argument="motion.file") for path in (old, new))
    np.testing.assert_array_equal(one.tips_m, other.tips_m)
    np.testing.assert_array_equal(one.loads, other.loads)
    assert read_log(old).loads.shape == (101, 3)


def test_the_layout_of_2022_to_2025_is_read(tmp_path):
    """Its poses are datasets in the group data, on one clock, and its events lie at the root."""
    new = recorded(tmp_path / "new.hdf5")
    held = read_drilling(new, argument="motion.file")
    with h5py.File(new) as source, h5py.File(tmp_path / "log.hdf5", "w") as file:
        for name in ("drill_force_feedback", "burr_change"):
            source.copy(f"{EVENTS}/{name}", file)
        count = len(held.times_s)
        file["data/time"] = EPOCH_S + held.times_s
        pose = source[f"{POSES}/mastoidectomy_drill_pose/pose"][()]
        file["data/pose_mastoidectomy_drill"] = pose[
            np.unique(
                source[f"{POSES}/mastoidectomy_drill_pose/time_stamp"][()], return_index=True
            )[1]
        ]
        file["data/pose_main_camera"] = np.tile([0, 0, 0, *CAMERA.as_quat()], (count, 1))
        # its recorder stores whole numbers for an object at rest
        file["data/pose_mastoidectomy_volume"] = np.tile([0, 0, 0, 0, 0, 0, 1], (count, 1))
        file["data/l_img"] = np.zeros((3, 2, 2))
    other = read_drilling(tmp_path / "log.hdf5", argument="motion.file")
    np.testing.assert_allclose(other.tips_m, held.tips_m, atol=1e-15)
    np.testing.assert_allclose(other.loads, held.loads, atol=1e-12)
    assert other.notes == held.notes
    log = read_log(tmp_path / "log.hdf5")
    assert log.loads.shape == (101, 3) and "camera" in " ".join(log.notes)
    assert len(read_replay(tmp_path / "log.hdf5").sweep_m()) == 1001


def test_another_file_with_a_group_named_data_is_no_recording(tmp_path):
    columns = ("time_s", "tool_x_mm", "tool_y_mm", "tool_z_mm", "force_z_N")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name in columns:
            file[f"data/{name}"] = np.arange(1000.0)
    with pytest.raises(InputError, match="be a recording of volumetric_drilling"):
        read_replay(tmp_path / "log.h5")
    flags = [f"{name}=data/{name}" for name in columns]
    for columns in (flags, ()):
        assert len(read_log(tmp_path / "log.h5", columns).times_s) == 1000


def spoil(name, values):
    """Replace a dataset, or remove it."""

    def change(path):
        with h5py.File(path, "r+") as file:
            del file[name]
            if values is not None:
                file[name] = values

    return change


DRILL = f"{POSES}/mastoidectomy_drill_pose"


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (spoil(POSES, None), "be a recording of volumetric_drilling, got no physics_data"),
        (
            spoil(DRILL, None),
            "drill in its name, got anatomy_object_name_pose and main_camera_pose",
        ),
        (spoil(f"{DRILL}/pose", None), "contain numbers in .*pose, got none"),
        (spoil(f"{DRILL}/pose", [b"a", b"b"]), "contain numbers in .*pose, got none"),
        (
            spoil(f"{DRILL}/pose", np.zeros((5, 7))),
            r"contain 7 values .* got shapes \(5, 7\) and \(4002,\)",
        ),
        (spoil(f"{DRILL}/pose", np.zeros((4002, 6))), r"got shapes \(4002, 6\)"),
        (
            spoil(f"{DRILL}/pose", np.zeros((4002, 7))),
            "contain unit quaternions, got one of length 0",
        ),
        (
            spoil(f"{DRILL}/pose", np.full((4002, 7), np.nan)),
            "contain only finite numbers, got NaN",
        ),
        (spoil(f"{DRILL}/time_stamp", np.zeros(4002)), "at least two poses, got 1"),
        (spoil(f"{DRILL}/time_stamp", np.arange(4002.0)), "must last at most"),
        (
            spoil(f"{EVENTS}/burr_change/burr_size", [0]),
            r"one burr of positive size, got sizes \[0.0\] mm",
        ),
        (lambda path: recorded(path, burr=(4, 6)), r"use one burr .*, got sizes \[4.0, 6.0\] mm"),
        (lambda path: path.write_bytes(path.read_bytes()[:3000]), "must be a complete HDF5 file"),
        (lambda path: path.write_bytes(b"no"), "must be a complete HDF5 file"),
    ],
)
def test_what_is_no_recording_is_refused_in_a_sentence(tmp_path, change, expected):
    path = recorded(tmp_path / "log.hdf5")
    change(path)
    with pytest.raises(InputError, match=expected) as caught:
        read_replay(path)
    assert str(caught.value).startswith("motion.file must ") and "\n" not in str(caught.value)


def test_forces_on_another_clock_are_refused_for_a_fit(tmp_path):
    path = recorded(tmp_path / "log.hdf5")
    spoil(f"{EVENTS}/drill_force_feedback/time_stamp", TIMES_S[::20])(path)
    read_replay(path)  # which needs none
    with pytest.raises(
        InputError, match=r"measured must have forces in the time span of the poses.*the same clock"
    ):
        read_log(path)


def test_without_what_reads_it_the_extra_is_named(tmp_path, monkeypatch):
    path = recorded(tmp_path / "log.hdf5")
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    with pytest.raises(InputError, match=r'got a file that needs h5py. Run pip install "h5py>='):
        read_replay(path)
