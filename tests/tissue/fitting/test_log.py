"""Measured logs: formats, columns of other names and units, and what cannot be a log."""

import csv
import re
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
from scipy.io.matlab import MatlabOpaque

from meshes.base.errors import InputError
from tissue.fitting.log import log_of
from tissue.fitting.log_files import mat_columns, parquet_columns, read_columns
from tissue.simulation.trace import Table, write_table

TIMES_S = np.arange(0.0, 1.0, 0.01)
NAMES = ("time_s", "tool_x_mm", "tool_y_mm", "tool_z_mm", "force_x_N", "force_y_N", "force_z_N")


def read_log(path, columns=()):
    """Return the log in a file."""
    return log_of(path, read_columns(path), columns)


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


def texts(table, time):
    """Return the table as CSV with other times, which are given as texts."""
    rows = [
        ",".join([each, *map(repr, row[1:])])
        for each, row in zip(time, table.rows.tolist(), strict=True)
    ]
    return "\n".join(rows)


HEADER = ",".join(("timestamp", *NAMES[1:]))
START = datetime(2026, 3, 27, 23, 59, 59, 700000, UTC)
MOMENTS = [START + timedelta(seconds=float(time)) for time in TIMES_S]
EAST = timezone(timedelta(hours=5, minutes=30))


@pytest.mark.parametrize(
    "time",
    [
        [each.isoformat() for each in MOMENTS],
        [each.replace(tzinfo=None).isoformat(" ") for each in MOMENTS],
        [each.isoformat().replace("+00:00", "Z") for each in MOMENTS],
        [each.astimezone(EAST).isoformat() for each in MOMENTS],
        [f"{each:%d.%m.%Y %H:%M:%S.%f}" for each in MOMENTS],
        [f"{each:%H:%M:%S.%f}" for each in MOMENTS],
        [f"{each:%m/%d/%Y %I:%M:%S.%f %p}" for each in MOMENTS],
        [repr(each.timestamp()) for each in MOMENTS],
        [f"{1e3 * each.timestamp():.0f}" for each in MOMENTS],
        [f"{1e6 * each.timestamp():.0f}" for each in MOMENTS],
        [f"{1e6 * each.timestamp():.0f}000" for each in MOMENTS],
    ],
)
def test_dates_times_of_day_and_times_since_1970(table, tmp_path, time):
    """Midnight lies within the log. Times since 1970 are in s, ms, us or ns."""
    path = tmp_path / "log.csv"
    path.write_text(f"{HEADER}\n{texts(table, time)}\n")
    log = read_log(path)
    assert np.diff(log.times_s) == pytest.approx(np.diff(TIMES_S), abs=1e-6)
    assert log.tips_m == pytest.approx(1e-3 * table.rows[:, 1:4])


def test_dates_of_a_parquet_file(table, tmp_path):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    frame = pandas.DataFrame(table.rows, columns=NAMES).drop(columns="time_s")
    frame["time"] = MOMENTS
    frame.to_parquet(tmp_path / "log.parquet")
    _, columns = parquet_columns(tmp_path / "log.parquet")
    assert np.diff(columns["time"]) == pytest.approx(np.diff(TIMES_S), abs=1e-6)


def test_samples_of_equal_times_are_averaged(table, tmp_path):
    rows = np.repeat(table.rows, 2, axis=0)
    rows[::2, 4] -= 0.5
    rows[1::2, 4] += 0.5
    write_table(Table(NAMES, rows), tmp_path / "log.csv")
    log = read_log(tmp_path / "log.csv")
    assert log.times_s == pytest.approx(TIMES_S)
    assert log.loads[:, 0] == pytest.approx(table.rows[:, 4])
    assert "100 samples with the time of the previous sample are averaged" in log.notes


@pytest.mark.parametrize(
    ("columns", "head"),
    [
        (["time_s=100:Hz"], ""),
        ([], "Recorder 3\nsampling rate: 100 Hz\n"),
        ([], "Acquisition rate :\t100,0 [Hz]\n"),
    ],
)
def test_a_rate_in_place_of_times(table, tmp_path, columns, head):
    lines = [",".join(map(repr, row[1:])) for row in table.rows.tolist()]
    (tmp_path / "log.csv").write_text(head + "\n".join([",".join(NAMES[1:]), *lines]))
    log = read_log(tmp_path / "log.csv", columns)
    assert log.times_s == pytest.approx(TIMES_S)
    assert "the times follow from the rate of 100 Hz" in log.notes


@pytest.mark.parametrize("name", ["fs", "sample_rate", "samplingFrequency", "rate_Hz", "Rate [Hz]"])
def test_a_number_named_as_a_rate_is_the_rate(table, tmp_path, name):
    columns = dict(zip(NAMES[1:], table.rows.T[1:], strict=True))
    np.savez(tmp_path / "log.npz", **columns, **{name: 100.0})
    assert read_log(tmp_path / "log.npz").times_s == pytest.approx(TIMES_S)
    columns[name] = np.full(len(TIMES_S), 100)
    write_table(Table(tuple(columns), np.column_stack([*columns.values()])), tmp_path / "log.csv")
    assert read_log(tmp_path / "log.csv").times_s == pytest.approx(TIMES_S)


GERMAN = "Messung 12\nZeit;Weg X;Weg Y;Weg Z;Kraft Z\n[ms];[um];[um];[um];[mN]\n"


@pytest.mark.parametrize(
    ("style", "separator"),
    [("1.234,5", ";"), ("1,234.5", "\t"), ("1 234,5", ";"), ("1'234.5", ","), ("1234,5", "\t")],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_decimal_commas_and_thousands(table, tmp_path, style, separator, encoding):
    rows = table.rows[:, [0, 1, 2, 3, 6]] * [1e3, 1e3, 1e3, 1e3, 1e3]

    def shown(value):
        text = f"{value:,.1f}".replace(",", "T").replace(".", "D")
        return text.replace("T", style[1].replace("2", "")).replace("D", style[-2])

    lines = [separator.join(map(shown, row)) for row in rows]
    text = GERMAN.replace(";", separator) + "\n".join(lines) + "\n"
    (tmp_path / "log.txt").write_text(text, encoding)
    columns = [
        *(f"tool_{each}_mm=Weg {each.upper()} (um)" for each in "xyz"),
        "force_z_N=Kraft Z (mN)",
    ]
    log = read_log(tmp_path / "log.txt", columns)
    assert log.times_s == pytest.approx(TIMES_S, abs=5e-5)
    assert log.tips_m == pytest.approx(1e-3 * table.rows[:, 1:4], abs=6e-8)
    assert log.loads[:, 0] == pytest.approx(table.rows[:, 6], abs=6e-5)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (["0,5,1,5,2,0,3,5,4,5"] * 9, "decimal commas, and commas between its columns"),
        (
            ["0.5;1,5;2;3;4"] * 9,
            "with a decimal comma and with a decimal point, for example '1,5' and '0.5'",
        ),
        (
            ["1.234,5;1,234.5;2;3;4"] * 9,
            "with a decimal comma and with a decimal point, for example '1.234,5' and '1,234.5'",
        ),
        (["1,234,5;1;2;3;4"] * 9, "has '1,234,5', which is not a number"),
    ],
)
def test_numbers_in_two_styles_are_refused_by_name(tmp_path, rows, expected):
    header = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,force_z_N"
    header = header.replace(",", ";") if ";" in rows[0] else header
    (tmp_path / "log.csv").write_text("\n".join([header, *rows]))
    with pytest.raises(InputError, match=expected):
        read_log(tmp_path / "log.csv")


def test_constants_and_columns_by_name_in_other_units(table, tmp_path):
    rows = table.rows[:, [0, 3, 6]] * [1e6, 1e3, 1e6]
    write_table(Table(("Time [us]", "tool_z (um)", "Fz / µN"), rows), tmp_path / "log.csv")
    columns = ["tool_x_mm=2", "tool_y_mm=0", "force_z_N=-Fz / µN"]
    log = read_log(tmp_path / "log.csv", columns)
    assert log.times_s == pytest.approx(TIMES_S)
    assert log.tips_m[:, 2] == pytest.approx(1e-3 * table.rows[:, 3])
    assert (log.tips_m[:, :2] == [0.002, 0.0]).all()
    assert log.loads[:, 0] == pytest.approx(-table.rows[:, 6])


def test_positions_in_metres_under_a_name_in_millimetres_ask_for_the_unit(table, tmp_path):
    table.rows[:, 1:4] *= 1e-3
    write_table(table, tmp_path / "log.csv")
    with pytest.raises(InputError, match=r"may be in metres.*'tool_x_mm=tool_x_mm:m'") as caught:
        read_log(tmp_path / "log.csv")
    flags = re.findall(r"--column '([^']*)'", str(caught.value))
    assert np.ptp(read_log(tmp_path / "log.csv", flags).tips_m) == pytest.approx(
        np.ptp(table.rows[:, 1:4])
    )
    read_log(tmp_path / "log.csv", [each.replace(":m", ":mm") for each in flags])


def test_missing_columns_are_suggested_by_their_headers(table, tmp_path):
    names = ("t [s]", "pos x [mm]", "py", "Z", "wrench.force.x", "Fy [N]", "Fz")
    write_table(Table(names, table.rows), tmp_path / "log.csv")
    with pytest.raises(InputError, match="measured must have the columns tool_x_mm") as caught:
        read_log(tmp_path / "log.csv")
    flags = re.findall(r"--column '([^']*)'", str(caught.value))
    assert read_log(tmp_path / "log.csv", flags).loads == pytest.approx(table.rows[:, 4:])


def test_a_machine_of_one_axis_gets_its_depth_as_the_height_of_the_tool(table, tmp_path):
    names = ("Time (s)", "Pd (µm)", "Fn (µN)")
    rows = table.rows[:, [0, 3, 6]] * [1.0, 1e3, 1e6]
    write_table(Table(names, rows), tmp_path / "log.csv")
    with pytest.raises(InputError, match=r"'tool_z_mm=-Pd \(µm\)'") as caught:
        read_log(tmp_path / "log.csv")
    flags = re.findall(r"--column '(tool[^']*)'", str(caught.value))
    log = read_log(tmp_path / "log.csv", [*flags, "force_z_N=Fn (µN)"])
    assert log.tips_m[:, 2] == pytest.approx(-1e-3 * table.rows[:, 3])
    assert not log.tips_m[:, :2].any()
    assert log.loads[:, 0] == pytest.approx(table.rows[:, 6])


def test_objects_of_matlab_are_named(tmp_path):
    """An object of a class, which SciPy returns as opaque data, and one of MATLAB 7.3."""
    opaque = np.zeros(1, dtype=[("s0", "O"), ("s1", "O"), ("s2", "O"), ("arr", "O")])
    opaque[0] = (b"log", b"MCOS", b"timetable", np.zeros(1))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scipy.io.loadmat", lambda *_, **__: {"None": MatlabOpaque(opaque)})
        with pytest.raises(InputError, match=r"an object of the MATLAB class timetable in a\.mat"):
            mat_columns(tmp_path / "a.mat")
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "b.mat", "w", userblock_size=512) as file:
        file["log"] = np.zeros((1, 6), dtype=np.uint32)
        file["log"].attrs["MATLAB_class"] = np.bytes_("timetable")
        file["log"].attrs["MATLAB_object_decode"] = np.int32(3)
    with (tmp_path / "b.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    with pytest.raises(InputError, match=r"timetable in b\.mat. In MATLAB, write it as CSV"):
        read_log(tmp_path / "b.mat")


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
