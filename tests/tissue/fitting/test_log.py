"""Measured logs: formats, columns of other names and units, and what cannot be a log."""

import csv

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.fitting.averaged import block_averages
from tissue.fitting.log import read_log
from tissue.simulation.trace import Table
from tissue.simulation.trace_files import write_table

TIMES_S = np.arange(0.0, 1.0, 0.01)
NAMES = ("time_s", "tool_x_mm", "tool_y_mm", "tool_z_mm", "force_x_N", "force_y_N", "force_z_N")


@pytest.fixture
def table():
    rows = np.column_stack([TIMES_S, *(k + np.sin(TIMES_S * k) for k in range(1, 7))])
    return Table(NAMES, rows)


@pytest.mark.parametrize("kind", ["csv", "parquet", "h5", "mat", "npz"])
def test_all_formats_give_the_same(table, tmp_path, kind):
    write_table(table, tmp_path / f"log.{kind}")
    log = read_log(tmp_path / f"log.{kind}")
    assert log.channels == NAMES[4:] and log.quaternions is None
    assert log.times_s == pytest.approx(TIMES_S, abs=1e-15)
    assert log.tips_m == pytest.approx(1e-3 * table.rows[:, 1:4], rel=1e-12)
    assert log.loads == pytest.approx(table.rows[:, 4:], rel=1e-12)


def test_columns_of_other_names_units_and_signs(table, tmp_path):
    path = tmp_path / "log.csv"
    factors = np.array([1e3, 1e-3, 1.0, 1.0, -1e3, 1.0, 1.0])
    with path.open("w", newline="") as file:
        file.write("recorded by hand\nrig 3\n")
        writer = csv.writer(file)
        writer.writerow(["t", "px", *NAMES[2:4], "Fx", *NAMES[5:]])
        writer.writerows((table.rows * factors).tolist())
    log = read_log(path, ["time_s=t:ms", "tool_x_mm=px:m", "force_x_N=-Fx:mN"])
    assert log.times_s == pytest.approx(TIMES_S)
    assert log.tips_m[:, 0] == pytest.approx(1e-3 * table.rows[:, 1])
    assert log.loads[:, 0] == pytest.approx(table.rows[:, 4])


def test_a_recording_of_volumetric_drilling_has_two_clocks(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "log.hdf5", "w") as file:
        poses = file.create_group("physics_data/continuous_data/high_frequency_poses/drill_pose")
        poses["time_stamp"], poses["pose"] = (
            np.arange(0.0, 1.0, 5e-4),
            np.tile([0.1, 0.2, 0.3, 0, 0, 0, 1.0], (2000, 1)),
        )
        wrench = file.create_group("physics_data/intermittent_data/drill_force_feedback")
        wrench["time_stamp"], wrench["wrench"] = np.arange(0.0, 1.0, 1e-2), np.tile(np.arange(6.0), (100, 1))
    log = read_log(tmp_path / "log.hdf5")
    assert len(log.times_s) == 2000 and len(log.load_times_s) == 100
    assert log.tips_m[0] == pytest.approx([0.1, 0.2, 0.3]) and log.loads[5].tolist() == list(range(6))


@pytest.mark.parametrize(
    ("columns", "change", "expected"),
    [
        (["force_x_N=gone"], {}, "got gone: choose one of"),
        (["force_x_N=force_x_N:mm"], {}, "unit of force, got mm"),
        (["force_x_N"], {}, "NAME=COLUMN"),
        (["insertion_mm=tool_x_mm"], {}, "what a fit uses, got insertion_mm"),
        ([], {"force_x_N": 1e9}, "below 100000 in force_x_N"),
        ([], {"tool_x_mm": np.nan}, "finite positions"),
        ([], {"time_s": 0.3}, "times that increase"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(table, tmp_path, columns, change, expected):
    for name, value in change.items():
        table.rows[50, NAMES.index(name)] = value
    write_table(table, tmp_path / "log.csv")
    with pytest.raises(InputError) as refused:
        read_log(tmp_path / "log.csv", columns)
    assert expected in str(refused.value) and "\n" not in str(refused.value)


def test_a_missing_column_is_named_with_those_that_are_there(tmp_path):
    write_table(Table(("time_s", "Fx"), np.column_stack([TIMES_S, TIMES_S])), tmp_path / "log.csv")
    with pytest.raises(InputError, match=r"tool_x_mm.*with time_s, Fx.*--column tool_x_mm="):
        read_log(tmp_path / "log.csv")


def test_means_over_blocks_keep_the_mean_and_fold_no_tone():
    times_s = np.arange(0.0, 2.0, 1e-3)
    tone = np.cos(2.0 * np.pi * 400.0 * times_s)  # two periods a block of 5 ms
    found = block_averages(times_s, np.column_stack([3.0 + tone, times_s]), ("force_x_N", "force_y_N"), 5)
    assert found.values[:, 0] == pytest.approx(3.0, abs=1e-12)
    assert found.values[:, 1] == pytest.approx(found.times_s, abs=1e-12)
