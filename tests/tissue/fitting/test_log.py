"""Measured logs: formats, columns of other names and units, and what cannot be a log."""

import csv

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.fitting.log import read_log
from tissue.simulation.trace import Table, write_table

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


def test_a_unit_other_than_that_of_the_header_is_noted(table, tmp_path):
    path = tmp_path / "log.csv"
    write_table(Table((*NAMES[:6], "Fz_kN"), table.rows), path)
    log = read_log(path, ["force_z_N=Fz_kN:N", "force_x_N=force_x_N:N"])
    assert log.loads[:, 2] == pytest.approx(table.rows[:, 6])
    notes = [note for note in log.notes if "as asked" in note]
    assert notes == ["Fz_kN is read in N, as asked; its header has kN"]
    log = read_log(path, ["force_z_N=Fz_kN"])
    assert log.loads[:, 2] == pytest.approx(1e3 * table.rows[:, 6])
    assert "Fz_kN is read in kN, the unit of its header" in log.notes


@pytest.mark.parametrize(
    ("columns", "change", "expected"),
    [
        (["force_x_N=gone"], {}, "gone"),
        (["force_x_N=force_x_N:mm"], {}, "force, got mm"),
        (["force_x_N"], {}, "force_x_N"),
        (["force_x_N=tool_y_mm", "force_x_N=tool_x_mm"], {}, "force_x_N"),
        (["insertion_mm=tool_x_mm"], {}, "insertion_mm"),
        (["time_s=force_x_N"], {}, "time_s"),
        ([], {"force_x_N": 1e9}, "force_x_N"),
        ([], {"tool_x_mm": np.nan}, "10 m"),
        ([], {"tool_x_mm": 1e9}, "10 m"),  # carving along such a jump took hours
        ([], {"time_s": 0.3}, "time_s"),
    ],
)
def test_what_cannot_be_a_log_is_refused(table, tmp_path, columns, change, expected):
    for name, value in change.items():
        table.rows[50, NAMES.index(name)] = value
    write_table(table, tmp_path / "log.csv")
    with pytest.raises(InputError, match=expected):
        read_log(tmp_path / "log.csv", columns)


def test_blank_lines_are_skipped_counted_and_lines_keep_their_numbers(table, tmp_path):
    write_table(table, tmp_path / "log.csv")
    lines = (tmp_path / "log.csv").read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join([*lines[:21], "", " ", *lines[21:], ""]))
    log = read_log(tmp_path / "log.csv")
    assert len(log.times_s) == len(TIMES_S)
    assert "2 blank lines between the rows" in log.notes
    lines[30] = lines[30][:-3] + "x"
    (tmp_path / "log.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match="in line 31"):
        read_log(tmp_path / "log.csv")


def test_matlab_7_3_has_structs(table, tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "log.mat", "w", userblock_size=512) as file:
        file["#refs#/a"] = np.arange(3)
        for name, values in zip(NAMES, table.rows.T, strict=True):
            file[f"log/{name}"] = values[None]
    with (tmp_path / "log.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    assert read_log(tmp_path / "log.mat").loads == pytest.approx(table.rows[:, 4:], rel=1e-12)


def test_a_saturated_sensor_is_noted_and_its_samples_left_out(tmp_path):
    """A saturated sensor is noted and its samples are left out.

    The clipping is at 5 N. A peak in steps that is as flat for a moment is not clipped, nor is a
    smooth load at rest.
    """
    times_s = np.arange(0.0, 2.0, 1e-3)
    rng = np.random.default_rng(0)
    smooth = 6.0 * np.sin(np.pi * times_s)
    noisy = smooth + 0.05 * rng.standard_normal(len(times_s))
    rests = 3.0 * np.sin(np.pi * np.minimum(times_s, 0.5))
    full = noisy >= 5.0
    loads = np.column_stack([np.minimum(noisy, 5.0), np.round(smooth / 0.4) * 0.4, rests])
    rows = np.column_stack([times_s, 1e3 * times_s, times_s, times_s, loads])
    write_table(Table(NAMES, rows), tmp_path / "log.npz")
    log = read_log(tmp_path / "log.npz")
    assert np.array_equal(np.isnan(log.loads), np.column_stack([full, 0 * full, 0 * full]))
    (note,) = log.notes
    assert f"{full.sum()} samples of force_x_N" in note


def test_slow_poses_and_noisy_ones_are_noted(tmp_path):
    times_s = np.arange(0.0, 2.0, 1e-3)
    rng = np.random.default_rng(0)
    x = 10.0 - np.abs(20.0 * times_s - 10.0)  # 20 mm/s, back in the middle
    slow = np.repeat(x[::20], 20)
    noisy = x + 0.05 * rng.standard_normal(len(x))
    for moved, noted in ((slow, ["every 20 ms"]), (noisy, ["poses have noise of 0.0"]), (x, [])):
        rows = np.column_stack(
            [times_s, moved, 0.0 * x, 0.0 * x, *rng.standard_normal((3, len(times_s)))]
        )
        write_table(Table(NAMES, rows), tmp_path / "log.npz")
        notes = read_log(tmp_path / "log.npz").notes
        assert len(notes) == len(noted) and all(
            part in note for part, note in zip(noted, notes, strict=True)
        )
