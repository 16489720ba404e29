"""Markups of 3D Slicer.

Points from LPS and RAS are equal, planes have their normals, and bad files are refused.
"""

import json

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.surfaces.markups import read_curve, read_markups, read_site

POINT = [10.0, -20.0, 30.0]
FCSV = """# Markups fiducial file version = 4.11
# CoordinateSystem = {frame}
# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID
1,{points},0,0,0,1,1,1,0,"F, 1",,
"""


def points(*places, kind="Fiducial", frame="LPS", **others):
    listed = [
        {
            "id": str(number),
            "label": f"F-{number}",
            "position": list(place),
            "orientation": [-1.0, -0.0, -0.0, -0.0, -1.0, -0.0, 0.0, 0.0, 1.0],
            "positionStatus": "defined",
        }
        for number, place in enumerate(places, start=1)
    ]
    return {
        "type": kind,
        "coordinateSystem": frame,
        "coordinateUnits": "mm",
        "controlPoints": listed,
        **others,
    }


def written(folder, *markups):
    path = folder / "site.mrk.json"
    path.write_text(
        json.dumps({"@schema": "markups-schema-v1.0.3.json#", "markups": list(markups)}), "utf-8"
    )
    return path


def test_a_point_of_either_frame_is_the_same_in_lps(tmp_path):
    for frame, place in (("LPS", POINT), ("RAS", [-10.0, 20.0, 30.0])):
        centre, normal = read_site(written(tmp_path, points(place, frame=frame)))
        assert centre.tolist() == POINT
        assert normal is None


@pytest.mark.parametrize("frame", ["LPS", "RAS"])
@pytest.mark.parametrize("stated", ["normal", "orientation", "points"])
def test_a_plane_has_its_origin_and_normal(tmp_path, frame, stated):
    flip = np.array([-1.0, -1.0, 1.0]) if frame == "RAS" else np.ones(3)
    turn = np.linalg.qr(np.array([[1.0, 2.0, 0.3], [0.1, -1.0, 2.0], [0.7, 0.2, 1.0]]))[0]
    turn *= np.sign(np.linalg.det(turn))
    inside = flip[:, None] * turn  # axes as the file writes them
    places = [
        (flip * (np.array(POINT) + offset)).tolist()
        for offset in (np.zeros(3), 5 * turn[:, 0], 5 * turn[:, 1])
    ]
    given = {
        "normal": {"normal": inside[:, 2].tolist(), "center": places[0]},
        "orientation": {"orientation": inside.reshape(-1).tolist(), "origin": places[0]},
        "points": {},
    }[stated]
    centre, normal = read_site(
        written(tmp_path, points(*places, kind="Plane", frame=frame, **given))
    )
    assert centre == pytest.approx(POINT)
    assert normal == pytest.approx(turn[:, 2])


def test_a_plane_counts_before_the_points_beside_it(tmp_path):
    plane = points([1, 2, 3], kind="Plane", normal=[0, 0, 2], center=[1, 2, 3])
    centre, normal = read_site(written(tmp_path, points(POINT, POINT), plane))
    assert centre.tolist() == [1, 2, 3]
    assert normal.tolist() == [0, 0, 1]


def test_a_line_leads_from_the_site_inward(tmp_path):
    centre, normal = read_site(written(tmp_path, points([0, 0, 10], [0, 0, -20], kind="Line")))
    assert centre.tolist() == [0, 0, 10]
    assert normal.tolist() == [0, 0, 1]


def test_curves_keep_their_order_and_closed_ones_come_back(tmp_path):
    places = [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    assert read_curve(written(tmp_path, points(*places, kind="Curve"))).tolist() == places
    assert read_curve(written(tmp_path, points(*places, kind="ClosedCurve"))).tolist() == [
        *places,
        places[0],
    ]
    assert read_curve(written(tmp_path, points(*places))).tolist() == places


@pytest.mark.parametrize("frame", ["LPS", "1", "RAS", "0"])
def test_point_lists(tmp_path, frame):
    path = tmp_path / "site.fcsv"
    path.write_text(FCSV.format(frame=frame, points="10,-20,30"), "utf-8")
    expected = POINT if frame in ("LPS", "1") else [-10, 20, 30]
    marked = read_markups(path)[0]
    assert marked.points_mm.tolist() == [expected]
    assert marked.labels == ("F, 1",)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_point_lists_with_a_byte_order_mark(tmp_path, encoding):
    path = tmp_path / "site.fcsv"
    path.write_text(FCSV.format(frame="LPS", points="10,-20,30"), encoding)
    assert read_markups(path)[0].points_mm.tolist() == [POINT]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"coordinateSystem": "IJK"}, "coordinateSystem LPS or RAS, got IJK in"),
        ({"coordinateSystem": None}, "coordinateSystem LPS or RAS, got none in"),
        ({"coordinateUnits": "m"}, "coordinateUnits mm, got m in"),
        (
            {
                "controlPoints": [
                    {"label": "A", "position": [0, 0, 0], "positionStatus": "undefined"}
                ]
            },
            "got the status undefined of A",
        ),
        (
            {"controlPoints": [{"label": "A", "position": [0, 0]}]},
            "three finite coordinates, got .* for A",
        ),
        (
            {"controlPoints": [{"label": "A", "position": [0, 0, float("nan")]}]},
            "three finite coordinates, got .* for A",
        ),
        ({"controlPoints": []}, "one plane, one line from the site inward, or one point, got none"),
        ({"controlPoints": 5}, "got other data"),
        ({"type": "Plane", "controlPoints": []}, "planes with an origin"),
        ({"type": "Plane"}, "planes with a normal"),
        ({"type": "Plane", "normal": [0, 0, 0]}, "non-zero length, got one of length 0"),
        (
            {"type": "Line", "controlPoints": [{"position": [0, 0, 1]}, {"position": [0, 0, 1]}]},
            "non-zero length, got one of length 0",
        ),
        ({"type": "ROI"}, "got none"),
    ],
)
def test_what_marks_no_site_is_refused(tmp_path, change, sentence):
    with pytest.raises(InputError, match=sentence):
        read_site(written(tmp_path, points(POINT) | change))
