"""The trace: columns with units, and a file that reads back to the same bits."""

import numpy as np
import pytest

from tissue.simulation.trace import Table, TraceLayout, TraceWriter, read_table

LAYERS = ("plate", "vault")


def filled(row_count):
    """A table of numbers that are hard to print."""
    columns = TraceLayout.of(LAYERS).columns
    random = np.random.default_rng(3)
    rows = random.normal(size=(row_count, len(columns))) * 10.0 ** random.integers(
        -300, 300, (row_count, len(columns))
    )
    rows[:, -1] = random.integers(-1, len(LAYERS), row_count)
    return Table(columns, rows, LAYERS)


def test_a_file_reads_back_to_the_same_bits(tmp_path):
    table = filled(50)
    writer = TraceWriter(tmp_path / "trace.csv", table)
    for count in (1, 20, 50):
        writer.flush(count, force=True)
    writer.close()
    back = read_table(tmp_path / "trace.csv", LAYERS)
    assert back.columns == table.columns
    np.testing.assert_array_equal(back.rows, table.rows)
    np.testing.assert_array_equal(back["layer"], table["layer"])


@pytest.mark.parametrize("kept", [0, 1, 40])
def test_a_line_cut_short_is_left_out(tmp_path, kept):
    table = filled(3)
    writer = TraceWriter(tmp_path / "trace.csv", table)
    writer.flush(3, force=True)
    writer.close()
    lines = (tmp_path / "trace.csv").read_text().splitlines(keepends=True)
    (tmp_path / "trace.csv").write_text("".join(lines[:3]) + lines[3][:kept])
    np.testing.assert_array_equal(read_table(tmp_path / "trace.csv", LAYERS).rows, table.rows[:2])


@pytest.mark.parametrize(
    "text", ["", "time_s,tool_x", "time_s,layer\n"], ids=["empty", "half a head", "head"]
)
def test_a_file_without_a_whole_row_has_none(tmp_path, text):
    (tmp_path / "trace.csv").write_text(text)
    assert len(read_table(tmp_path / "trace.csv", LAYERS).rows) == 0


def test_ctrl_c_just_after_rows_came_to_disk_does_not_write_them_twice(tmp_path, monkeypatch):
    table = filled(6)
    writer = TraceWriter(tmp_path / "trace.csv", table)
    write = writer._write

    def interrupted(text):
        write(text)
        raise KeyboardInterrupt

    monkeypatch.setattr(writer, "_write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        writer.flush(4, force=True)
    monkeypatch.setattr(writer, "_write", write)
    writer.flush(6, force=True)
    writer.close()
    assert np.array_equal(read_table(tmp_path / "trace.csv", LAYERS).rows, table.rows)
