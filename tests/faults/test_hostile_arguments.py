"""Arguments, streams and places that no command can use.

They end in one sentence, never in a traceback.
"""

import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from meshes.base.text_tables import DEEPEST, read_json, read_toml
from tissue import InputError, load_scene, scene_names, scene_text
from tissue.scene.load import changed

MAIN = [sys.executable, "-c", "from tissue.cli.main import main; main()"]
WALL = ("run", "wall", "--set", "duration_s=0.05", "--no-pictures")
ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])}
DEEP = 5000
DIGITS = 400 * "9"


def nested(depth, opening="[", closing="]", inner=""):
    """Brackets within each other."""
    return depth * opening + inner + depth * closing


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """Working directory with links that lead nowhere."""
    monkeypatch.chdir(tmp_path)
    os.symlink("nothing", "dangling")
    os.symlink("loop", "loop")
    return tmp_path


@pytest.mark.parametrize(
    "value", [nested(DEEP), nested(DEEP, "{a=", "}", "1"), DIGITS, 15 * DIGITS, nested(40)]
)
@pytest.mark.parametrize(
    "key", ["hand", "seed", "motion.points_mm", "coupling.stiffness_N_m", "keep_clear.files"]
)
def test_a_value_that_is_nested_or_long_is_refused(refused, tmp_path, key, value):
    message = refused("run", "wall", "--set", f"{key}={value}", "--out", tmp_path / "out")
    assert key in message and len(message) < 1000
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("option", ["--band", "--cores", "--seed", "--duration-s"])
def test_an_option_of_hundreds_of_digits_is_refused(refused, tmp_path, option):
    assert refused("run", "milling", option, DIGITS, "--out", tmp_path / "out")


def test_a_whole_number_of_hundreds_of_digits_in_a_file_is_infinite():
    assert read_json(f'{{"missed_deadlines": {DIGITS}}}') == {"missed_deadlines": float("inf")}
    assert read_json('{"missed_deadlines": 12}') == {"missed_deadlines": 12}


def test_a_key_of_thousands_of_parts_is_refused(refused, tmp_path):
    assert "dots" in refused(
        "run", "wall", "--set", f"{'.'.join(DEEP * ['a'])}=1", "--out", tmp_path / "out"
    )


@pytest.mark.parametrize(
    "text", [f"a = {nested(DEEP)}", f"[{'.'.join(DEEP * ['a'])}]", f"a = {15 * DIGITS}"]
)
def test_a_scene_that_is_nested_or_long_is_refused(refused, tmp_path, text):
    (tmp_path / "deep.toml").write_text(f'name = "x"\n{text}\n')
    assert "scene must be valid TOML" in refused(
        "run", tmp_path / "deep.toml", "--out", tmp_path / "out"
    )


def test_tables_are_read_to_a_stated_depth():
    """One level less than the bound is read, one level more is not."""
    for depth, is_read in ((DEEPEST, True), (DEEPEST + 1, False)):
        text = nested(depth)
        for read in (lambda text: read_toml(f"a = {text[1:-1]}"), read_json):
            if is_read:
                assert read(text)
                continue
            with pytest.raises(ValueError, match="within each other"):
                read(text)


@pytest.mark.parametrize(
    ("file", "arguments"),
    [
        ("out/summary.json", ("view", "out", "--screenshot", "x.png")),
        ("out/summary.json", ("report", "out")),
        ("out/study.json", ("study", "report", "out")),
        ("x.json", (*WALL, "--set", "perception=observer:x.json", "--out", "out")),
        ("x.trials.jsonl", ("calibrate", "--observer", "simulated:1", "--out", "x.json")),
        ("m.toml", (*WALL, "--set", "materials=m.toml", "--out", "out")),
    ],
)
@pytest.mark.parametrize(
    "text",
    [nested(DEEP), '{"a": ' + nested(DEEP) + "}", nested(DEEP, '{"a":', "}", "1"), 15 * DIGITS],
)
def test_a_file_that_is_nested_or_long_is_refused(
    refused, tmp_path, monkeypatch, file, arguments, text
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / file).write_text(f"a = {text}\n" if file.endswith(".toml") else f"{text}\n")
    assert refused(*arguments)


def test_the_character_nul_is_refused(refused, tmp_path):
    for change in (
        'materials="a\\u0000b"',
        'perception="observer:a\\u0000b"',
        'coupling.predictor_file="a\\u0000b"',
    ):
        assert "without the character NUL" in refused(
            "run", "wall", "--set", change, "--out", tmp_path / "out"
        )
    scene = load_scene("glenoid")
    with pytest.raises(InputError, match=r"anatomy\.file must be text without the character NUL"):
        changed(scene, {"anatomy.file": "a\0b.stl"})
    (tmp_path / "x.toml").write_text(
        'name = "x"\n[anatomy]\nkind = "glenoid"\nfile = "a\\u0000b.stl"\n'
    )
    assert "without the character NUL" in refused(
        "run", tmp_path / "x.toml", "--out", tmp_path / "out"
    )


@pytest.mark.parametrize(
    "place", ["dangling", "loop", "dangling/below", "loop/below", "x\udcff", "nul\0"]
)
@pytest.mark.parametrize(
    "arguments",
    [
        WALL,
        ("sweep", "wall", "--set", "seed=1,2"),
        ("stability", "wall"),
        ("compare", "a", "b"),
        ("chart", "wall", "--quick"),
        ("study", "plan"),
        ("fit", "wall", "--measured", "x.csv"),
        ("import", "x.nrrd"),
        ("schema",),
        ("train", "wall"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_place_that_cannot_be_used_is_refused_before_anything_is_computed(
    refused, nowhere, place, arguments
):
    before = sorted(os.listdir(nowhere))
    assert refused(*arguments, "--out", place).startswith("out must ")
    assert sorted(os.listdir(nowhere)) == before


def ended(command, **options):
    """Exit code, standard output and standard error of a process."""
    options = {"env": ENVIRONMENT, "capture_output": True, "text": True} | options
    process = subprocess.run([sys.executable, "-c", *command], check=False, timeout=300, **options)
    return process.returncode, process.stdout, process.stderr


@pytest.mark.slow
def test_a_working_directory_that_is_gone_is_named(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    remove = f"import os; os.rmdir({str(gone)!r}); os.execv({sys.executable!r}, {[*MAIN, *WALL]!r})"
    code, _, error = ended([remove], cwd=gone)
    assert code == 2 and error.count("\n") == 1 and "the working directory was removed" in error


@pytest.mark.slow
def test_streams_that_are_closed_are_no_place_for_files(tmp_path):
    """A library's output to a closed stream does not go into the file that was opened first."""
    out = tmp_path / "out"
    close = (
        "import os; [os.close(number) for number in (0, 1, 2)]; from tissue.cli.main import "
        "main; main()"
    )
    command = [close, *WALL, "--out", str(out)]
    assert ended(command, capture_output=False)[0] == 0
    held = json.loads((out / "summary.json").read_text())
    lines = (out / "trace.csv").read_text().splitlines()
    assert held["status"] == "complete" and len(lines) == 51 and lines[0].startswith("time_s,")
    assert ended(command, capture_output=False)[0] == 2  # the folder holds a run now


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
            "--cores must be left out for a wall, which needs no kernels. Remove it",
        ),
        (
            ("run", "milling", "--allow-unstable"),
            (
                "--allow-unstable must be left out without a device. Set device = touch, "
                "or remove this option"
            ),
        ),
        (
            ("run", "milling", "--seed", "3"),
            (
                "seed must be left out without a device, because the run then has no random numbers. "
                "Set device = touch, or remove seed"
            ),
        ),
        (
            ("run", "milling", "--fidelity", "force_error=0.1", "--set", "voxels.removal=binary"),
            (
                "voxels.removal must be left out with fidelity, which chooses it. "
                "Leave fidelity out, or remove voxels.removal"
            ),
        ),
        (
            ("run", "wall", "--fidelity", "force_error=0.1", "--set", "prediction=hold"),
            (
                "device.prediction must be left out with fidelity, which chooses it. "
                "Leave fidelity out, or remove device.prediction"
            ),
        ),
        (
            ("run", "liver-press", "--fidelity", "force_error=0.1", "--set", "organ.order=1"),
            (
                "organ.order must be left out with fidelity, which chooses it. Leave "
                "fidelity out, or remove organ.order"
            ),
        ),
        (
            ("run", "wall", "--slicer"),
            (
                "--slicer must be left out without --live. Give --live, or open the "
                "files of a finished run"
            ),
        ),
        (
            ("run", "wall", "--live", "--slicer-port", "5"),
            (
                "--slicer-port must be left out without --slicer. Give --live --slicer, or remove this option"
            ),
        ),
        (
            ("run", "wall", "--live", "--slicer-drives"),
            (
                "--slicer-drives must be left out without --slicer. Give --live "
                "--slicer, or remove this option"
            ),
        ),
        (
            ("run", "wall", "--web"),
            (
                "--web must be left out without --live. Give --live, or show a finished run "
                "by `tissue view DIR --web`"
            ),
        ),
        (
            ("view", "run", "--web", "--screenshot", "a.png"),
            "web must be left out with a screenshot or a movie. Leave it out",
        ),
        (
            ("view", "run", "--web", "--movie", "a.gif"),
            "web must be left out with a screenshot or a movie. Leave it out",
        ),
        (
            ("run", "wall", "--live", "--web", "--band", "20"),
            "--band must be left out with --live. Run the scene without --live",
        ),
        (
            ("chart", "wall", "--trials", "5"),
            (
                "--trials must be left out unless predictors are charted. Add prediction "
                "before the scenes, or remove this option"
            ),
        ),
        (
            ("chart", "prediction", "--quick"),
            "--quick must be left out with prediction. Remove it",
        ),
        (
            ("calibrate", "--population", "x", "--trials", "5"),
            (
                "--trials must be left out with --population, which uses sessions that have ended. "
                "Remove it"
            ),
        ),
        (
            ("study", "run", "--only", "T1-novice-0001", "--workers", "2"),
            (
                "--workers must be left out with --only, which runs one trial here and writes "
                "no files. Remove it"
            ),
        ),
        (
            ("assess", "a", "--against", "b", "--overwrite"),
            "--overwrite must be left out without --out, because no file is written. Remove it",
        ),
        (
            ("stability", "wall", "--overwrite"),
            (
                "--overwrite must be left out with a scene and no --out, because no file is written. "
                "Remove it"
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
