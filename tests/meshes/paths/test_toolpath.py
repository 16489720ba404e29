"""Toolpaths from CSV, markups and G-code.

They are equal in either frame, timed, and as deep as a sphere and a box require.
"""

import json

import numpy as np
import pytest
import trimesh

from meshes.base.errors import InputError
from meshes.paths.gcode import ARC_ERROR_MM
from meshes.paths.toolpath import (
    Toolpath,
    arc_length,
    depth_along,
    points_along,
    read_toolpath,
    to_replay,
)
from meshes.surfaces.site import Site
from meshes.surfaces.surface import surface_from_triangles
from tissue.motion.replay import read_replay

PLACES = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, -2.0], [4.0, 3.0, -2.0], [4.0, 3.0, 8.0]])
FLIP = {"LPS": np.ones(3), "RAS": np.array([-1.0, -1.0, 1.0])}
AT_ORIGIN = Site(np.zeros(3), np.eye(3), "as is")


def written(folder, name, text):
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def as_csv(places):
    return "x_mm, y_mm, z_mm\n" + "\n".join(", ".join(map(str, place)) for place in places)


@pytest.mark.parametrize("frame", FLIP)
def test_a_path_is_the_same_from_every_format_and_frame(tmp_path, frame):
    places = PLACES * FLIP[frame]
    moves = "\n".join(
        f"N{10 * n} X{x:.4f} Y{y:.4f} Z{z:.4f} ; move"
        for n, (x, y, z) in enumerate(places.tolist())
    )
    curve = {
        "type": "Curve",
        "coordinateSystem": frame,
        "controlPoints": [{"position": place} for place in places.tolist()],
    }
    files = (
        written(tmp_path, "a.csv", as_csv(places)),
        written(tmp_path, "a.nc", f"%\n(made by hand)\nG21 G90\nG1 F120\n{moves}\n%"),
        written(tmp_path, "a.mrk.json", json.dumps({"markups": [curve]})),
    )
    for file in files:
        assert read_toolpath(file, frame).points_mm == pytest.approx(PLACES)


def test_feeds_and_axes_of_a_table(tmp_path):
    table = "x_mm,y_mm,z_mm,feed_mm_s,axis_x,axis_y,axis_z\n0,0,0,1,0,0,2\n1,0,0,2,3,0,0\n"
    path = read_toolpath(written(tmp_path, "a.csv", table), "RAS")
    assert path.feeds_mm_s.tolist() == [1, 2]
    assert path.axes == pytest.approx(np.array([[0, 0, 1], [-1, 0, 0]]))


def test_gcode_keeps_modes_units_and_feeds(tmp_path):
    plain = read_toolpath(written(tmp_path, "b.ngc", "G0 X0 Y0 Z0\nX1"), "LPS")
    assert plain.notes == ("the program has neither G20 nor G21, so lengths are read in mm",)
    lines = "G20 G0 X1 Y0 Z0\nG1 Z-.1 F6\ng91 g21\nX2\nZ-1 F60\nG90 G0 Z20"
    path = read_toolpath(written(tmp_path, "a.ngc", lines), "LPS")
    expected = [[25.4, 0, 0], [25.4, 0, -2.54], [27.4, 0, -2.54], [27.4, 0, -3.54], [27.4, 0, 20]]
    assert path.points_mm == pytest.approx(np.array(expected))
    assert path.feeds_mm_s == pytest.approx(
        np.array([np.nan, 2.54, 2.54, 1.0, np.nan]), nan_ok=True
    )


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("a.nc", "G0 X0 Y0 Z0 A90", "line 1 of .* has A90, but only the axes"),
        ("a.nc", "G0 X0 Y0 Z0\n#1=5", "line 2 of .* has #=?.*, which is not a letter"),
        ("a.nc", "X0 Y0 Z0", "line 1 of .* moves without G0, G1, G2 or G3"),
        ("a.nc", "G1 X0 Y0 Z0", "line 1 of .* cuts before any feed F"),
        ("a.nc", "G0 X0 Y0", "never states X, Y and Z"),
        ("a.nc", "G0 X0 Y0\nG1 X1 F60", "line 2 of .* cuts before Z is known"),
        ("a.nc", "G91 G0 X0 Y0 Z0", "line 1 of .* moves X by a distance from an unknown place"),
        ("a.nc", "G0 X0 Y0 Z0 F0", "line 1 of .* has a feed F that is not positive"),
        ("a.nc", "G0 X0 X1 Y0 Z0", "line 1 of .* has two words X"),
        ("a.nc", "G0 G1 X0 Y0 Z0", "line 1 of .* has two words of one group"),
        (
            "a.nc",
            "G0 X0 Y0 Z5\nG98 G81 Z-3 R1 F60",
            r"line 2 of .* has G81, which is not supported",
        ),
        ("a.nc", "G41 D1", r"has G41, which is not supported.*without .*cutter compensation"),
        ("a.nc", "G92 X0", r"has G92, which is not supported"),
        ("a.nc", "M98 P100", r"has M98, which is not supported"),
        ("a.nc", "G54\nG55", "uses the work offset G55 after G54"),
        ("a.nc", "G0 X0 Y0 Z0\nG2 X1 F9", "has an arc without its centre. Give I and J"),
        ("a.nc", "G0 X0 Y0 Z0\nG2 X1 I2 F9", "radii of 2 mm at its start and 1 mm at its end"),
        ("a.nc", "G0 X0 Y0 Z0\nG2 R1 F9", "radius 1 mm between points 0 mm apart"),
        ("a.nc", "G0 X0 Y0 Z0\nG2 X2 I1 P3 F9", "an arc of several turns"),
        ("a.nc", "G0 X0 Y0 Z0", "at least two points, got 1"),
        ("a.csv", "x_mm,y_mm\n1,2", "the column z_mm, got the columns x_mm and y_mm in"),
        ("a.csv", "x_mm,y_mm,z_mm,axis_x\n1,2,3,4", "the columns .*axis_y and axis_z"),
        ("a.csv", "x_mm,y_mm,z_mm\n1,2,3\n1,2,", "got an empty cell in the column z_mm in line 3"),
        ("a.csv", "x_mm,y_mm,z_mm\n1,2,3\n1,inf,3", "got inf in the column y_mm in line 3"),
        ("a.csv", "x_mm,y_mm,z_mm\n1,2,3", "at least two points, got 1"),
        (
            "a.csv",
            "x_mm,y_mm,z_mm,feed_mm_s\n1,2,3,1\n1,2,4,0",
            "feed_mm_s must be positive, got 0 at point 2",
        ),
        (
            "a.csv",
            "x_mm,y_mm,z_mm,axis_x,axis_y,axis_z\n1,2,3,0,0,1\n1,2,4,0,0,0",
            "axis must not be zero, .* point 2",
        ),
        ("a.stl", "solid", "path must be a .csv"),
    ],
)
def test_bad_paths_are_refused_by_name_and_line(tmp_path, name, text, sentence):
    with pytest.raises(InputError, match=sentence):
        read_toolpath(written(tmp_path, name, text), "LPS")


PROGRAM = """%
O1000 (a part (of steel))
N10 T1 M6
N20 G0 G90 G40 G21 G17 G94 G80
N30 G54 X0 Y0 S500 M3
N40 G43 Z5 H1 M8
N50 G1 Z-1 F120
N60 G3 X10 Y10 I0 J10
N70 G4 P0.5
N80 G2 X12 Y12 R2
N90 G0 Z5
N100 G91 G28 Z0
N110 M30
N120 X99
%
"""


def test_a_program_of_a_cam_system_is_read_with_notes(tmp_path):
    """Words without motion are noted, and moves to the machine's home and after the end left out.

    The first arc is a quarter about (0, 10), whose lines lie within the stated distance.
    """
    path = read_toolpath(written(tmp_path, "a.nc", PROGRAM), "LPS")
    ends = [[0, 0, 5], [0, 0, -1], [10, 10, -1], [12, 12, -1], [12, 12, 5]]
    for end in ends:
        assert np.linalg.norm(path.points_mm - end, axis=1).min() < 1e-12
    assert path.points_mm[[0, -1]] == pytest.approx(np.array(ends)[[0, -1]])
    first = path.points_mm[1 : 1 + np.flatnonzero((path.points_mm == ends[2]).all(axis=1))[0]]
    radius = np.hypot(first[:, 0], first[:, 1] - 10.0)
    middle = 0.5 * (first[1:] + first[:-1])
    assert radius == pytest.approx(10.0, abs=1e-12)
    sagitta = 10.0 - np.hypot(middle[:, 0], middle[:, 1] - 10.0)
    assert 0.5 * ARC_ERROR_MM < sagitta.max() <= ARC_ERROR_MM
    same = read_toolpath(written(tmp_path, "a.txt", PROGRAM), "LPS")
    assert (same.points_mm == path.points_mm).all()
    still, home, arcs = path.notes
    assert all(word in still for word in ("G40", "G43", "G54", "M30", "M6", "N", "O", "S", "T"))
    assert home.endswith("a place of the machine: G28") and arcs == "2 arcs as lines within 0.01 mm"


@pytest.mark.parametrize(
    ("line", "middle", "end"),
    [
        ("G17 G2 X2 Y0 I1 J0", [1, 1, 0], [2, 0, 0]),
        ("G17 G3 X2 Y0 I1", [1, -1, 0], [2, 0, 0]),
        ("G17 G3 X2 R-1", [1, -1, 0], [2, 0, 0]),
        ("G17 G2 X1 Y1 R-1", [-(0.5**0.5), 1 + 0.5**0.5, 0], [1, 1, 0]),
        ("G90.1 G17 G2 X2 I1 J0", [1, 1, 0], [2, 0, 0]),
        ("G17 G2 X2 Z3 I1", [1, 1, 1.5], [2, 0, 3]),
        ("G17 G2 I1 Z1", [2, 0, 0.5], [0, 0, 1]),
        ("G18 G2 Z2 K1", [1, 0, 1], [0, 0, 2]),
        ("G19 G2 Y2 J1", [0, 1, 1], [0, 2, 0]),
        ("G91 G17 G2 X2 I1", [1, 1, 0], [2, 0, 0]),
        ("G20 G2 X0.2 I0.1", [2.54, 2.54, 0], [5.08, 0, 0]),
    ],
)
def test_arcs_in_all_planes_forms_and_units(tmp_path, line, middle, end):
    """Half, three-quarter and full circles, clockwise as seen from the end of the third axis."""
    text = f"G21 G0 X0 Y0 Z0\nF60 {line}"
    points = read_toolpath(written(tmp_path, "a.ngc", text), "LPS").points_mm
    assert points[-1] == pytest.approx(end, abs=1e-12)
    assert points_along(points, 0.5 * arc_length(points)[-1])[0] == pytest.approx(middle, abs=0.02)


@pytest.mark.parametrize(
    "text",
    [
        "X [m];Y [m];Z [m]\n0,001;0;0,005\n0,002;0,001;-0,0025\n",
        "\ufeffNr\tx_in\ty_in\tz_in\n1\t0.0393700787\t0\t0.1968503937\n"
        "2\t0.0787401575\t0.0393700787\t-0.0984251969\n",
        "plan 7\nx,y,z\nmm,mm,mm\n1,0,5\n2,1,-2.5\n",
        "x,y,z\n1,0,5\n2,1,-2.5\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le"])
def test_tables_in_other_units_separators_and_encodings(tmp_path, text, encoding):
    file = tmp_path / "a.csv"
    file.write_text(text, encoding)
    path = read_toolpath(file, "LPS")
    assert path.points_mm == pytest.approx(np.array([[1, 0, 5], [2, 1, -2.5]]), abs=1e-8)
    assert any("is read in" in each or "the units of line" in each for each in path.notes)


def test_feeds_in_other_units(tmp_path):
    text = "x_mm,y_mm,z_mm,feed [mm/min]\n0,0,0,60\n1,0,0,120\n"
    path = read_toolpath(written(tmp_path, "a.csv", text), "LPS")
    assert path.feeds_mm_s == pytest.approx(np.array([1.0, 2.0]))


def test_a_replay_goes_at_the_feed_in_the_frame_of_the_site(tmp_path):
    turn = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    site = Site(np.array([0.01, 0.02, 0.03]), turn, "given")
    there = np.array([10.0, 20.0, 30.0]) + PLACES @ turn.T
    table = to_replay(Toolpath(there), site, feed_mm_s=2.0, clearance_mm=5.0)
    assert table.tips_mm == pytest.approx(np.vstack([[0, 0, 10], PLACES]))
    assert table.times_s == pytest.approx([0.0, 0.25, 3.75, 6.25, 11.25])
    assert table.quaternions == pytest.approx(np.tile([0, 0, 0, 1], (5, 1)))
    table.write(tmp_path / "path.csv")
    played = read_replay(tmp_path / "path.csv")
    assert played.duration_s == pytest.approx(11.25)
    assert 1e3 * played.sweep_m()[3750] == pytest.approx(PLACES[1], abs=1e-6)


def test_a_replay_turns_the_tool_to_its_axes():
    axes = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.0, -1.0]])
    path = Toolpath(
        np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 10]]), np.array([1.0, 1.0, np.nan]), axes
    )
    table = to_replay(path, AT_ORIGIN, feed_mm_s=1.0)
    from scipy.spatial.transform import Rotation

    assert Rotation.from_quat(table.quaternions).apply([0, 0, 1]) == pytest.approx(axes)
    # the tool turns by pi in all, which takes longer than its rapid move
    assert table.times_s == pytest.approx([0.0, np.arctan2(0.6, 0.8) / (np.pi / 2), 2.0])


def test_depth_below_a_sphere_and_a_box():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=20.0)
    surface = surface_from_triangles(
        np.add(ball.vertices, (100, 0, 0)), np.array(ball.faces), scale_mm=1
    )
    found = depth_along(Toolpath(np.array([[100.0, 0, 30], [100, 0, 0], [112, 0, 0]])), surface)
    exact = 20.0 - np.linalg.norm(found.points_mm - [100, 0, 0], axis=1)
    # the facets' sagitta: (0.7 mm)^2 / (8 x 20 mm) is 0.003 mm
    assert np.abs(found.depth_mm - exact).max() < 0.01
    assert found.deepest_mm == pytest.approx(20.0, abs=0.01)
    assert np.linalg.norm(np.diff(found.points_mm, axis=0), axis=1).max() <= 0.5 + 1e-9
    box = trimesh.creation.box((40, 30, 20))
    surface = surface_from_triangles(np.array(box.vertices), np.array(box.faces), scale_mm=1)
    found = depth_along(Toolpath(np.array([[1.0, 2.0, 15.0], [1.0, 2.0, 5.0]])), surface)
    assert found.depth_mm == pytest.approx(10.0 - found.points_mm[:, 2])
    assert found.share_inside == pytest.approx(0.5, abs=0.05)
