"""Options of commands that have no effect, and what a run reports as left undone."""

from itertools import pairwise

import pytest

from tissue import InputError, load_scene, scene_names, scene_text, simulate


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ("run", "wall", "--cores", "2"),
            "--cores must be left out for a wall, which no kernel computes, got 2: remove it",
        ),
        (
            ("run", "milling", "--allow-unstable"),
            (
                "--allow-unstable must be left out without a device, got it: set device = touch, "
                "or remove it"
            ),
        ),
        (
            ("run", "milling", "--seed", "3"),
            (
                "seed must be left out without a device, for nothing is drawn at random then, "
                "got 3: set device = touch, or remove it"
            ),
        ),
        (
            ("run", "milling", "--fidelity", "force_error=0.1", "--set", "voxels.removal=binary"),
            (
                "voxels.removal must be left out with fidelity, which chooses it, got binary: "
                "leave fidelity out, or remove it"
            ),
        ),
        (
            ("run", "wall", "--fidelity", "force_error=0.1", "--set", "prediction=hold"),
            (
                "device.prediction must be left out with fidelity, which chooses it, got hold: "
                "leave fidelity out, or remove it"
            ),
        ),
        (
            ("run", "liver-press", "--fidelity", "force_error=0.1", "--set", "organ.order=1"),
            (
                "organ.order must be left out with fidelity, which chooses it, got 1: leave "
                "fidelity out, or remove it"
            ),
        ),
        (
            ("run", "wall", "--slicer"),
            (
                "--slicer must be left out without --live, got it: give --live, or open the "
                "files of a run that has ended"
            ),
        ),
        (
            ("run", "wall", "--live", "--slicer-port", "5"),
            (
                "--slicer-port must be left out without --slicer, got 5: give --live --slicer, "
                "or remove it"
            ),
        ),
        (
            ("run", "wall", "--live", "--slicer-drives"),
            (
                "--slicer-drives must be left out without --slicer, got it: give --live "
                "--slicer, or remove it"
            ),
        ),
        (
            ("run", "wall", "--web"),
            (
                "--web must be left out without --live, got it: give --live, or see a run that "
                "has ended by `tissue view DIR --web`"
            ),
        ),
        (
            ("view", "run", "--web", "--screenshot", "a.png"),
            (
                "web must be left out with a screenshot, which is a file, got a.png: leave one "
                "of them out"
            ),
        ),
        (
            ("view", "run", "--web", "--movie", "a.gif"),
            "web must be left out with a movie, which is a file, got a.gif: leave one of them out",
        ),
        (
            ("run", "wall", "--live", "--web", "--band", "20"),
            "--band must be left out with --live, got 20: run the scene without it",
        ),
        (
            ("chart", "wall", "--trials", "5"),
            (
                "--trials must be left out unless predictors are charted, got 5: add prediction "
                "before the scenes, or remove it"
            ),
        ),
        (
            ("chart", "perception", "--quick"),
            "--quick must be left out with perception, got it: remove it",
        ),
        (
            ("calibrate", "--population", "x", "--trials", "5"),
            (
                "--trials must be left out with --population, which fits sessions that are over, "
                "got 5: remove it"
            ),
        ),
        (
            ("study", "run", "--only", "T1-novice-0001", "--workers", "2"),
            (
                "--workers must be left out with --only, which runs one trial here and keeps "
                "nothing, got 2: remove it"
            ),
        ),
        (
            ("assess", "a", "--against", "b", "--overwrite"),
            "--overwrite must be left out without --out, for nothing is written, got it: remove it",
        ),
        (
            ("stability", "wall", "--overwrite"),
            (
                "--overwrite must be left out with a scene and no --out, for nothing is written, "
                "got it: remove it"
            ),
        ),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, tuple) else "",
)
def test_an_option_without_effect_is_refused(refused, here, arguments, sentence):
    assert refused(*arguments) == sentence


@pytest.mark.parametrize("name", scene_names())
def test_a_built_in_scene_holds_no_key_without_effect_and_lasts_as_long_as_its_motion(
    name, tmp_path
):
    scene = load_scene(name)

    if scene.duration_s is not None and scene.motion.kind == "path":
        points = scene.motion.points_mm
        length = sum(
            sum((a - b) ** 2 for a, b in zip(p, q, strict=True)) ** 0.5 for p, q in pairwise(points)
        )
        assert scene.duration_s >= length / scene.motion.feed_mm_s - 1e-9


def test_what_an_override_makes_idle_is_left_out_and_what_a_file_holds_idle_is_refused(tmp_path):
    assert load_scene("wall", {"device": "none"}).device is None
    text = scene_text("wall").replace('kind = "touch" ', "# ")
    (tmp_path / "mine.toml").write_text(
        text.replace("[motion]", "[device.coupling]\nforce_scale = 1.0\n\n[motion]")
    )
    with pytest.raises(InputError, match=r"device must be given for .*coupling\.force_scale = 1"):
        load_scene(tmp_path / "mine.toml")
    assert load_scene(tmp_path / "mine.toml", {"device": "omni"}).held.renderer == "proxy"
    with pytest.raises(InputError, match="force_scale"):
        load_scene(tmp_path / "mine.toml", {"duration_s": 1.0})


MILLING = {"voxels.spacing_mm": 0.5, "voxels.margin_mm": 0.5}


def test_a_run_that_ends_before_its_path_is_reported(tmp_path):
    short = simulate(load_scene("milling", MILLING | {"duration_s": 0.2}))
    assert short.summary["notes"]["path"] == (
        "not finished: the run ends at 0.2 s, the motion at 8.09 s; set duration_s = 8.09 or "
        "leave it out to see all of it"
    )
    rows = [f"{t},0,0,{0.5 - 0.05 * t},0,0,0,1" for t in range(22)]
    head = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw"
    (tmp_path / "poses.csv").write_text("\n".join([head, *rows]) + "\n")
    replay = {
        "motion.kind": "replay",
        "motion.file": str(tmp_path / "poses.csv"),
        "duration_s": 0.1,
    }
    notes = simulate(load_scene("milling", MILLING | replay)).summary["notes"]
    assert "ends at 0.1 s, the motion at 21 s" in notes["path"] and notes["removed"].startswith(
        "nothing: "
    )
    whole = simulate(
        load_scene(
            "milling",
            MILLING | {"motion.points_mm": [[0, 0, 0.1], [0, 0, -0.1]], "duration_s": None},
        )
    )
    assert not {"path", "removed"} & set(whole.summary["notes"])
    stuck = {
        "motion.kind": "thrust",
        "motion.thrust_N": 0.5,
        "motion.start_mm": [0, 0, 0.1],
        "duration_s": 0.1,
    }
    assert (
        "of motion.depth_mm = 2"
        in simulate(load_scene("milling", MILLING | stuck)).summary["notes"]["path"]
    )
