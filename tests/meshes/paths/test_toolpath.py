"""Toolpaths from CSV, markups and G-code.

They are equal in either frame, timed, and as deep as a sphere and a box require.
"""

import json

import numpy as np
import pytest
import trimesh

from meshes.base.errors import InputError
from meshes.paths.toolpath import Toolpath, depth_along, read_toolpath, to_replay
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
        ("a.nc", "G0 X0 Y0 Z0\nG2 X1 I1", "got G2 in line 2 of"),
        ("a.nc", "G0 X0 Y0 Z0\nM3 S1000", "got M3 in line 2 of"),
        ("a.nc", "G0 X0 Y0 Z0 A90", "got A90 in line 1 of"),
        ("a.nc", "G0 X0 Y0 Z0\n#1=5", "got #1=5? in line 2|a letter and a number.*line 2"),
        ("a.nc", "X0 Y0 Z0", "G0 or G1 before the first move, got none in line 1"),
        ("a.nc", "G1 X0 Y0 Z0", "F before the first G1, got none in line 1"),
        ("a.nc", "G0 X0 Y0", "X, Y and Z in the first move, got none of Z in line 1"),
        ("a.nc", "G91 G0 X0 Y0 Z0", "a first point in G90 before G91"),
        ("a.nc", "G0 X0 Y0 Z0 F0", "a positive F, got F0 in line 1"),
        ("a.nc", "G0 X0 X1 Y0 Z0", "one X a line, got two in line 1"),
        ("a.nc", "G0 X0 Y0 Z0", "at least two points, got 1"),
        ("a.csv", "x_mm,y_mm\n1,2", "the columns .*z_mm.*, got x_mm, y_mm"),
        ("a.csv", "x_mm,y_mm,z_mm,force_N\n1,2,3,4", "no others but .*force_N"),
        ("a.csv", "x_mm,y_mm,z_mm,axis_x\n1,2,3,4", "the columns .*axis_y, axis_z"),
        ("a.csv", "x_mm,y_mm,z_mm\n1,2,3\n1,2,", "got nothing for z_mm in line 3"),
        ("a.csv", "x_mm,y_mm,z_mm\n1,2,3\n1,inf,3", "got inf for y_mm in line 3"),
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


def test_a_replay_goes_at_the_feed_in_the_frame_of_the_site(tmp_path):
    turn = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    site = Site(np.array([0.01, 0.02, 0.03]), turn, "given")
    there = np.array([10.0, 20.0, 30.0]) + PLACES @ turn.T
    table = to_replay(Toolpath(there), site, feed_mm_s=2.0, clearance_mm=5.0)
    assert table.tips_mm == pytest.approx(np.vstack([[0, 0, 10], PLACES]))
    assert table.times_s == pytest.approx([0.0, 0.25, 3.75, 6.25, 11.25])
    assert table.quaternions == pytest.approx(np.tile([0, 0, 0, 1], (5, 1)))
    table.write(tmp_path / "path.csv")
    played = read_replay(tmp_path / "path.csv", step_s=1e-3)
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
