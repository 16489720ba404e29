"""The `tissue` command: its output, and unusable command lines.

Each of these gives one sentence and exit code 2.
"""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from coarse_run import COARSE

import tissue
from meshes.base.extras import install_command
from tissue.cli.main import app
from tissue.scene.load import scene_names


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ("run", "gleniod"),
            "scene must be a built-in name (caries, glenoid, incision, liver-press, milling, molar, "
            "needle, palpation, pedicle, wall) or a TOML file, got gleniod (did "
            "you mean "
            "glenoid?). List the names with `tissue scenes`",
        ),
        (
            ("scenes", "mill"),
            "scene must be a built-in name (caries, glenoid, incision, liver-press, milling, molar, "
            "needle, palpation, pedicle, wall) or a TOML file, got mill (did you mean "
            "milling?). List the names with `tissue scenes`",
        ),
        (
            ("run", "x.toml"),
            "scene must be an existing file, got x.toml. Check the path, or see the built-in scenes by `tissue scenes`",
        ),
        (("run",), "the argument SCENE is missing. See `tissue run --help`"),
        (
            ("run", "milling", "glenoid"),
            "tissue run takes no further argument, got glenoid. See `tissue run --help`",
        ),
        (
            ("ruin", "milling"),
            (
                "command must be run, import, scenes, view, report, fit, sweep, compare, "
                "stability, devices, serve, calibrate, assess, train, chart, study or schema, got ruin "
                "(did you mean run?). See `tissue --help`"
            ),
        ),
        (
            ("run", "milling", "--overwite"),
            "option must be --out, --format, --pictures, --no-pictures, --seed, "
            "--duration-s, --set, "
            "--fidelity, --compute, --cores, --max-memory-GB, --overwrite, --allow-unstable, "
            "--band, --workers, "
            "--scheduler, --each-run, --live, --web, --slicer, --slicer-port, "
            "--slicer-drives or --ros2, "
            "got --overwite (did you mean --overwrite?). See "
            "`tissue run --help`",
        ),
        (
            ("run", "milling", "--duration-s"),
            "--duration-s is missing or has no value. See `tissue run --help`",
        ),
        (
            ("run", "milling", "--duration-s", "long"),
            "--duration-s must be a number, got long. See `tissue run --help`",
        ),
        (
            ("run", "milling", "--duration-s", "1e-4"),
            "duration_s must be at least 0.001 and at most 3600, got 0.0001. Use a value in this "
            "range, such as 5",
        ),
        (
            ("run", "milling", "--duration-s", "nan"),
            "duration_s must be at least 0.001 and at most 3600, got nan. Use a value such as 5",
        ),
        (
            ("run", "milling", "--seed", "1.5"),
            "--seed must be a whole number, got 1.5. See `tissue run --help`",
        ),
        (
            ("run", "milling", "--cores", "0"),
            "cores must be from 1 to 4096, got 0. Leave it out to use all cores",
        ),
        (
            ("run", "milling", "--format", "xlsx"),
            (
                "format must be one of parquet, npz, mat, h5, recording, got xlsx. CSV is always "
                "written"
            ),
        ),
        (
            ("run", "milling", "--pictures", "jpeg"),
            "pictures must be one of png, svg, pdf, got jpeg. Choose one of these",
        ),
        (("run", "milling", *COARSE, "--compute", "cuda:99"), None),
        (
            ("run", "milling", "--fidelity", "fast"),
            "--fidelity must have the form key=value, got fast. Use for example force_error=0.03",
        ),
        (
            ("calibrate", "--observer", "simulated:x"),
            "observer must be simulated:SEED or simulated:GROUP:SEED with the group novice, "
            "intermediate or expert, got simulated:x. Use simulated:1",
        ),
        (
            ("view", "runs"),
            "run must be an existing folder, got runs. Check the path",
        ),
    ],
)
def test_a_bad_command_line_is_refused_in_one_sentence(refused, here, arguments, sentence):
    if sentence is None:
        import warp as wp

        sentence = (
            f"compute must be one of {', '.join(map(str, wp.get_devices()))}, got cuda:99. Use "
            "cpu here"
        )
    assert refused(*arguments) == sentence
    assert not list(here.iterdir())


@pytest.mark.parametrize(("kind", "writer"), [("parquet", "pyarrow"), ("h5", "h5py")])
def test_a_format_without_its_extra_names_what_to_install(refused, here, monkeypatch, kind, writer):
    monkeypatch.setitem(sys.modules, writer, None)
    assert refused("run", "milling", "--format", kind) == (
        f"format {kind} must have the package {writer} installed. Run {install_command(kind)}"
    )
    assert install_command(kind).startswith(f'pip install "{writer}>=')


def test_a_run_prints_its_figures_and_where_they_are(command, here):
    code, output, error = command("run", "milling", *COARSE, "--duration-s", 0.03)
    assert (code, error) == (0, "")
    for word in (
        "removed cortical",
        "force, peak / mean",
        "torque, peak / mean",
        "tick, median / 99 % / max",
        "missed 1 ms deadlines",
        "files in runs/milling",
    ):
        assert word in output
    # rows about scheduling are printed for a run in real time
    assert "scheduling" not in output and "kernel launches" not in output
    assert "Warp" not in output


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_scene_is_written_to_a_file_and_read_in_the_encodings_of_editors(command, here, encoding):
    assert command("scenes", "wall", "--out", "mine.toml")[0] == 0
    code, _, error = command("scenes", "wall", "--out", "mine.toml")
    assert code == 2 and "--overwrite" in error
    assert command("scenes", "--out", "all.toml")[0] == 2
    text = (here / "mine.toml").read_text("utf-8")
    (here / "mine.toml").write_text(text, encoding)
    assert tissue.load_scene(here / "mine.toml") == tissue.load_scene("wall")


def test_scenes_are_listed_and_printed(command, here):
    code, output, _ = command("scenes")
    assert code == 0
    assert [line.split()[0] for line in output.splitlines()] == scene_names()
    code, output, _ = command("scenes", scene_names()[0])
    assert code == 0 and f'name = "{scene_names()[0]}"' in output


def test_the_version_is_that_of_the_project(command):
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text("utf-8"))[
        "project"
    ]
    assert command("--version") == (0, f"{project['version']}\n", "")
    assert tissue.__version__ == project["version"]


def test_the_command_line_starts_without_numpy_and_a_bone_without_warp():
    code = (
        "import sys, tissue.cli.main; print('numpy' in sys.modules); "
        "tissue.Bone; print('warp' in sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "False\nFalse\n"


def test_a_list_that_begins_with_a_minus_is_the_value_of_its_option():
    given = ["import", "ct", "--site", "-8,-13,0", "--crop", "-1e1,.5,-3,4,5,6", "--out", "x"]
    _, bound, _ = app.parse_args(given, exit_on_error=False)
    options = bound.arguments
    assert options["scene"].site == "-8,-13,0" and options["image"].crop == "-1e1,.5,-3,4,5,6"
