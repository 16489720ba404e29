"""`tissue view` of a soft organ.

The window runs under a virtual display, driven as by a hand; pictures are made without one.
"""

import numpy as np
import pytest
from fake_fields import pressed_run

from tissue import InputError
from tissue.scene.tool import Blade, Needle, probe_part
from tissue.show.figures.tool_mesh import tool_surface
from tissue.show.viewer.run_scene import Choice
from tissue.show.viewer.view import view

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    """Folder of a run that pressed a soft box by 6 mm within a second."""
    return pressed_run(tmp_path_factory.mktemp("runs") / "press")


@pytest.fixture(scope="module")
def driven(pressed, drive, tmp_path_factory):
    """Return the results of the window and the folder of its pictures."""
    out = tmp_path_factory.mktemp("window")
    return drive("window_driver.py", pressed, out), out


def test_the_clip_plane_is_switched_and_pushed_along_its_normal(driven):
    found, _ = driven
    assert found["clipped"][2] == pytest.approx(0.0, abs=1e-3)
    normal, origin = map(np.array, found["at"])
    step = 0.02 * np.linalg.norm((40.0, 40.0, 20.0)) * normal
    np.testing.assert_allclose(found["pushed"][1], origin + 3.0 * step, atol=1e-4)
    np.testing.assert_allclose(found["back"][1], origin + 2.0 * step, atol=1e-4)
    assert found["closed"][2] == pytest.approx(-20.0, abs=0.1)


def test_a_key_shows_field_after_field(driven):
    assert driven[0]["listed"] == [
        "principal_1_kPa",
        "max_principal_strain_percent",
        "displacement_mm",
        "reaction_N",
        "von_mises_kPa",
    ]


def test_a_part_is_switched_off_on_the_field_too(driven):
    before, after, hidden = driven[0]["hidden"]
    assert hidden == ["capsule"]
    assert after == pytest.approx(before * 7 / 8)  # one layer of eight is the capsule


def test_a_movie_shows_the_first_and_the_last_moment(driven):
    (high, wide, colours), apart = driven[0]["movie"]
    assert (high, wide, colours) == (950, 1400, 3) and apart > 0.02


def test_time_plays_pauses_and_ends(driven):
    found, _ = driven
    assert found["playing"] and 0.5 < found["played_to"] < 1.0
    assert found["paused_at"] == found["played_to"]
    assert found["end"] == [1.0, False]


@pytest.mark.parametrize(
    ("tool", "box"),
    [
        (probe_part(kind="sphere-probe", diameter_mm=10.0), (-5.0, 5.0, -5.0, 5.0, 0.0, 10.0)),
        (
            probe_part(kind="cylinder-probe", diameter_mm=8.0, length_mm=30.0),
            (-4.0, 4.0, -4.0, 4.0, 0.0, 30.0),
        ),
        (Needle(diameter_mm=2.0), (-1.0, 1.0, -1.0, 1.0, 0.0, 80.0)),
        (Blade(edge_deg=45.0), (0.0, 6.0, -0.2, 0.2, 0.0, 46.0)),
    ],
)
def test_a_tool_has_its_tip_at_the_origin(tool, box):
    pytest.importorskip("pyvista")
    assert tuple(tool_surface(tool).bounds) == pytest.approx(box, abs=0.01)


@pytest.mark.parametrize(
    ("options", "refused"),
    [
        ({"field": "heat"}, "field .*got heat"),
        ({"hide": ("gum",)}, "hide .*got gum"),
        ({"time_s": 9.0}, "time_s .*got 9.*. Use a time such as 1$"),
        ({"time_s": -1.0}, "time_s .*got -1.*. Use a time such as 0$"),
        ({"time_s": float("nan")}, "time_s .*got nan"),
        ({"scale": -2.0}, "scale .*got -2"),
        ({"scale": float("nan")}, "scale .*got nan"),
    ],
)
def test_what_a_run_does_not_have_is_refused(pressed, tmp_path, monkeypatch, options, refused):
    # it starts a process each time
    monkeypatch.setattr("tissue.show.viewer.view.require_whole", lambda saved: None)
    with pytest.raises(InputError, match=refused):
        view(pressed, Choice(**options), screenshot=tmp_path / "view.png")
    assert not (tmp_path / "view.png").exists()
