"""Numbers with underscores and columns that are there twice are refused by every reader of text."""

import pytest

from meshes.base.errors import InputError
from meshes.images.text_headers import numbers
from meshes.surfaces.markups import read_markups
from meshes.surfaces.surface import read_surface


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
