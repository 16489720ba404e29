"""Numbers with underscores and columns that are there twice are refused by every reader of text."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.images.text_headers import numbers
from meshes.paths.toolpath import read_toolpath
from meshes.surfaces.markups import read_markups
from meshes.surfaces.surface import read_surface
from tissue.fitting.log import read_log
from tissue.motion.replay import read_replay
from tissue.simulation.trace import read_table

POSES = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw"
LOG = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,force_x_N,force_y_N,force_z_N"


def replayed(path):
    return np.array(read_replay(path, step_s=1e-3).duration_s)


def logged(path):
    return read_log(path).loads


def tabled(path):
    return read_table(path, ()).rows


def travelled(path):
    return read_toolpath(path, "LPS").points_mm


def rows_of(header):
    """Return sixty rows of a table: the time, zeros, and 1 in the last column.

    The last column belongs to a unit quaternion or is a force.
    """
    count = header.count(",")
    return [[f"{0.01 * row:.2f}", *["0"] * (count - 1), "1"] for row in range(60)]


TABLES = {
    "poses": (replayed, POSES),
    "log": (logged, LOG),
    "trace": (tabled, LOG),
    "path": (travelled, "x_mm,y_mm,z_mm"),
}


def written(path, header, rows):
    path.write_text("\n".join([header, *(",".join(row) for row in rows)]) + "\n", "utf-8")
    return path


@pytest.mark.parametrize("kind", TABLES)
def test_a_table_with_a_column_twice_is_refused(tmp_path, kind):
    read, header = TABLES[kind]
    assert np.isfinite(read(written(tmp_path / "whole.csv", header, rows_of(header)))).all()
    last = header.rpartition(",")[2]
    rows = [[*row, "5"] for row in rows_of(header)]
    with pytest.raises(InputError, match=last):
        read(written(tmp_path / "twice.csv", f"{header},{last}", rows))


def test_headers_meshes_and_markups_are_read_alike(tmp_path):
    with pytest.raises(InputError, match="1_0"):
        numbers({"spacing": "1 1_0 1"}, "spacing", tmp_path / "image.mha")
    for line in ("v 0 0 1_0\n", "v 0 0 1\nv 1 0 0\nv 0 1 0\nf 1 2 0_3\n"):
        (tmp_path / "bone.obj").write_text(line, "utf-8")
        with pytest.raises(InputError, match="_"):
            read_surface(tmp_path / "bone.obj", scale_mm=1.0)
    head = "# CoordinateSystem = LPS\n# columns = id,x,y,z,label\n"
    (tmp_path / "points.fcsv").write_text(f"{head}a,1,2_0,3,tip\n", "utf-8")
    with pytest.raises(InputError, match="tip"):
        read_markups(tmp_path / "points.fcsv")
