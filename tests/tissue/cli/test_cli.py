"""The `tissue` command: what it prints, and one sentence and exit code 2 for anything a person can mend."""

import errno
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

import tissue
from tissue import SavedRun
from tissue.scene.load import scene_names, scene_text
from tissue.simulation.trace import TraceWriter

COARSE = ("--set", "voxels.spacing_mm=0.4", "--no-pictures")
PARTS = "name, description, seed, duration_s, anatomy, voxels, tool, motion, cutting, output, device, hand, renderer, prediction, perception, coupling, stress, heat, organ, fidelity"
CUTTERS = "ball-burr, pear-bur, cylinder, twist-drill, hemispherical-reamer, flat-reamer, sphere-probe, cylinder-probe, shell-probe, needle"
POINTS = "motion.points_mm must be a list of at least two points [x, y, z], got"


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        (
            "voxels.spacing=0.2",
            "voxels.spacing must be one of spacing_mm, removal, margin_mm, got spacing (did you mean spacing_mm?): "
            "rename or remove it",
        ),
        (
            "voxel.spacing_mm=0.2",
            f"voxel must be one of {PARTS}, got voxel (did you mean voxels?): rename or remove it",
        ),
        ("qqq=1", f"qqq must be one of {PARTS}, got qqq: rename or remove it"),
        ("voxels.spacing_mm=3", "voxels.spacing_mm must be greater than 0 and at most 2, got 3: use 0.1"),
        ("voxels.spacing_mm=0", "voxels.spacing_mm must be greater than 0 and at most 2, got 0: use 0.1"),
        ("voxels.spacing_mm=nan", "voxels.spacing_mm must be greater than 0 and at most 2, got nan: use 0.1"),
        ("voxels.spacing_mm=-inf", "voxels.spacing_mm must be greater than 0 and at most 2, got -inf: use 0.1"),
        (
            "voxels.spacing_mm=fine",
            "voxels.spacing_mm must be a number greater than 0 and at most 2, got fine: use 0.1",
        ),
        ('voxels.spacing_mm="1"', 'voxels.spacing_mm must be a number greater than 0 and at most 2, got "1": use 0.1'),
        (
            "voxels.spacing_mm=true",
            "voxels.spacing_mm must be a number greater than 0 and at most 2, got true: use 0.1",
        ),
        (
            "voxels=5",
            "voxels must be a table with entries such as spacing_mm, removal, margin_mm, got 5: see "
            "`tissue scenes NAME`",
        ),
        (
            "anatomy=5",
            "anatomy must be a table with entries such as file, scale_mm, centre_mm, got 5: see `tissue scenes NAME`",
        ),
        ("seed.low=1", "seed.low must name an entry of a part, got seed, which is a value: see `tissue scenes NAME`"),
        ("seed=-1", "seed must be at least 0 and below 9223372036854775808, got -1: use 0"),
        ("tool.flutes=2.0", "tool.flutes must be a whole number at least 1 and at most 200, got 2.0: use 4"),
        ("tool.flutes=201", "tool.flutes must be at least 1 and at most 200, got 201: use 4"),
        (
            "tool.kind=burr",
            f"tool.kind must be one of {CUTTERS}, got burr (did you mean ball-burr?): choose one of these",
        ),
        (
            "motion.kind=paht",
            "motion.kind must be one of path, thrust, replay, got paht (did you mean path?): choose one of these",
        ),
        ("motion.kind=thrust", "motion.thrust_N must be given, got nothing: add thrust_N = 40"),
        ("motion.kind=replay", 'motion.file must be given, got nothing: add file = "runs/glenoid/trace.csv"'),
        ("motion={}", "motion.kind must be given, got nothing: see `tissue scenes NAME`"),
        ("tool={}", "tool.kind must be given, got nothing: see `tissue scenes NAME`"),
        ("motion.points_mm=[[0,0,1]]", f"{POINTS} [[0, 0, 1]]: use [[0, 0, 0.5], [0, 0, -2]]"),
        ("motion.points_mm=7", f"{POINTS} 7: use [[0, 0, 0.5], [0, 0, -2]]"),
        ("motion.points_mm=[[0,0],[1,1,1]]", f"{POINTS} [[0, 0], [1, 1, 1]]: use [[0, 0, 0.5], [0, 0, -2]]"),
        ("motion.points_mm=[[0,0,nan],[1,1,1]]", f"{POINTS} [[0, 0, nan], [1, 1, 1]]: use [[0, 0, 0.5], [0, 0, -2]]"),
        ('motion.points_mm=[[0,0,"a"],[1,1,1]]', f"{POINTS} [[0, 0, a], [1, 1, 1]]: use [[0, 0, 0.5], [0, 0, -2]]"),
        (
            "motion.points_mm=[[1,1,1],[1,1,1]]",
            "motion.points_mm must hold two different points, got only one: add where the tool goes",
        ),
        ("motion.axis=[0,1]", "motion.axis must be three finite numbers [x, y, z], got [0, 1]: use [0, 0, 1]"),
        ("motion.axis=[0,0,0]", "motion.axis must have a length, got (0, 0, 0): use [0, 0, 1]"),
        (
            "anatomy.size_mm=[0,1,1]",
            "anatomy.size_mm must be three finite numbers [x, y, z], each at least 0.1 "
            "and at most "
            "500, got [0, 1, 1]: use [20, 12, 8]",
        ),
        ("anatomy.normal=5", "anatomy.normal must be three finite numbers [x, y, z], got 5: use [0, 0, 1]"),
        (
            "tool.spin_rpm=0.5",
            "tool.spin_rpm must be at least 1 in size, or 0 for a tool that only touches, got 0.5: use 500",
        ),
        ("name=A b", 'name must be lower-case letters, digits, - and _, got A b: use "glenoid-2"'),
        ("description=5", "description must be text, got 5: put it in quotes"),
        (
            "tool.diameter_mm=0.3",
            "voxels.spacing_mm must be at most a quarter of tool.diameter_mm (0.3), got 0.1: use 0.015",
        ),
        (
            "tool.peg_diameter_mm=2",
            "tool.peg_diameter_mm must be left out for a ball-burr, got 2: set tool.kind = flat-reamer, or remove it",
        ),
        ("spacing", "--set must be key=value, got spacing: use for example voxels.spacing_mm=0.2"),
        ("=1", "--set must be key=value, got =1: use for example voxels.spacing_mm=0.2"),
        (
            "perception=all",
            "perception must be one of none, population, observer:FILE, got all: choose one of these",
        ),
    ],
)
def test_a_bad_entry_is_refused_in_one_sentence(refused, here, override, sentence):
    assert refused("run", "milling", "--set", override) == sentence
    assert not (here / "runs").exists()


def test_a_motion_without_end_is_refused(refused, here):
    path = here / "slow.toml"
    path.write_text(scene_text("milling").replace("duration_s = 9.0\n", ""))
    slow = ("--set", "motion.feed_mm_s=1e-5", "--set", "motion.points_mm=[[0,0,0.1],[0,0,-3]]")
    assert refused("run", path, *COARSE, *slow) == (
        "duration_s must be given for a motion of more than 3600 s, got nothing for one of 310000 s: give it, or a "
        "greater feed"
    )


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ("run", "gleniod"),
            "scene must be a built-in name (caries, glenoid, liver-press, milling, molar, needle, palpation, wall) or a TOML file, got gleniod (did "
            "you mean "
            "glenoid?): list them with `tissue scenes`",
        ),
        (
            ("scenes", "mill"),
            "scene must be a built-in name (caries, glenoid, liver-press, milling, molar, needle, palpation, wall) or a TOML file, got mill (did you mean "
            "milling?): list them with `tissue scenes`",
        ),
        (("run", "x.toml"), "scene must be an existing file, got x.toml: check the path or list `tissue scenes`"),
        (("run",), "scene must be given, got nothing: see `tissue run --help`"),
        (("run", "milling", "glenoid"), "tissue run must be given nothing more, got glenoid: see `tissue run --help`"),
        (
            ("ruin", "milling"),
            "command must be one of run, scenes, view, stability, calibrate, assess, train, chart, study, schema, got ruin (did you mean run?): see `tissue --help`",
        ),
        (
            ("run", "milling", "--overwite"),
            "option must be one of --out, --seed, --duration-s, --set, "
            "--fidelity, --compute, --cores, "
            "--format, --pictures, --no-pictures, --live, --overwrite, --allow-unstable, got --overwite (did you mean --overwrite?): see "
            "`tissue run --help`",
        ),
        (("run", "milling", "--duration-s"), "--duration-s must be given, got nothing: see `tissue run --help`"),
        (
            ("run", "milling", "--duration-s", "long"),
            "--duration-s must be a number, got long: see `tissue run --help`",
        ),
        (
            ("run", "milling", "--duration-s", "1e-4"),
            "duration_s must be at least 0.001 and at most 3600, got 0.0001: use 5",
        ),
        (
            ("run", "milling", "--duration-s", "nan"),
            "duration_s must be at least 0.001 and at most 3600, got nan: use 5",
        ),
        (("run", "milling", "--seed", "1.5"), "--seed must be a whole number, got 1.5: see `tissue run --help`"),
        (("run", "milling", "--cores", "0"), "cores must be at least 1, got 0: leave it out to use all"),
        (
            ("run", "milling", "--format", "xlsx"),
            "format must be one of parquet, npz, mat, h5, got xlsx: csv is always written",
        ),
        (("run", "milling", *COARSE, "--compute", "cuda:99"), None),
        (
            ("run", "milling", "--fidelity", "fast"),
            "--fidelity must be key=value, got fast: use for example force_error=0.03",
        ),
        (
            ("calibrate", "--observer", "simulated:x"),
            "observer must be simulated:SEED or simulated:GROUP:SEED with novice, intermediate, expert, got "
            "simulated:x: use simulated:1",
        ),
        (("view", "runs"), "run must be a folder that `tissue run` wrote, got runs: give for example runs/glenoid"),
    ],
)
def test_a_bad_command_line_is_refused_in_one_sentence(refused, here, arguments, sentence):
    if sentence is None:
        import warp as wp

        sentence = f"compute must be one of {', '.join(map(str, wp.get_devices()))}, got cuda:99: use cpu here"
    assert refused(*arguments) == sentence
    assert not list(here.iterdir())


@pytest.mark.parametrize(("kind", "writer"), [("parquet", "pyarrow"), ("h5", "h5py")])
def test_a_format_without_its_extra_names_what_to_install(refused, here, monkeypatch, kind, writer):
    monkeypatch.setitem(sys.modules, writer, None)
    assert refused("run", "milling", "--format", kind) == (
        f"format {kind} must have its writer installed, got no {writer}: pip install 'tissue-sim[{kind}]'"
    )


@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        (
            "[[100,0,-1],[110,0,-1]]",
            "motion must bring the tool to the bone, got one that with the tool and a margin "
            "reaches from (94, -5.995, -4) to (116, 5.998, 8) mm: move it to the bone between (-10, -6, -6) and "
            "(10, 6, 0) mm",
        ),
        (
            "[[-2,0,1],[2,0,1]]",
            "motion must bring the tool to the bone, got a tool that never touches it: move it to "
            "the bone between (-9.6, -6, -3.2) and (9.6, 6, 0) mm",
        ),
    ],
    ids=["beside", "above"],
)
def test_a_tool_that_never_touches_is_refused(refused, here, points, sentence):
    assert refused("run", "milling", *COARSE, "--set", f"motion.points_mm={points}") == sentence
    assert not (here / "runs").exists()


def test_voxels_that_do_not_fit_the_memory_are_refused_with_what_would_fit(refused, command, here, monkeypatch):
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=1e9))
    assert refused("run", "milling", "--set", "voxels.spacing_mm=0.02", "--no-pictures") == (
        "voxels.spacing_mm must leave the bone within the free memory of 1.0 GB, got 0.02 which needs 2.0 GB: use 0.03"
    )
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=2e6))
    fits = refused("run", "milling", "--set", "voxels.spacing_mm=0.1", "--no-pictures").rsplit(" ", 1)[1]
    code, _, error = command(
        "run", "milling", "--set", f"voxels.spacing_mm={fits}", "--no-pictures", "--duration-s", 0.01
    )
    assert (code, error) == (0, "")


def test_a_folder_with_another_run_is_kept_without_force(refused, command, here):
    quick = ("run", "milling", *COARSE, "--duration-s", 0.02)
    assert command(*quick, "--out", "first", "--format", "npz")[0] == 0
    (here / "first" / "trace.txt").write_text("notes of a person")
    before = {path: path.read_bytes() for path in (here / "first").rglob("*") if path.is_file()}
    assert refused(*quick, "--out", "first") == (
        "out must not hold another run, got first: pass --overwrite to replace it or choose another --out"
    )
    assert {path: path.read_bytes() for path in (here / "first").rglob("*") if path.is_file()} == before
    assert command("run", "milling", *COARSE, "--duration-s", 0.03, "--out", "first", "--overwrite")[0] == 0
    after = {path: path.read_bytes() for path in (here / "first").rglob("*") if path.is_file()}
    assert set(before) - set(after) == {here / "first" / "trace.npz"}
    assert after[here / "first" / "trace.txt"] == b"notes of a person"
    assert after[here / "first" / "trace.csv"].count(b"\n") == 31


@pytest.mark.parametrize("arguments", [(), ("--overwrite",)], ids=["plain", "overwrite"])
def test_files_of_other_origin_are_always_kept(refused, here, arguments):
    (here / "mine").mkdir()
    (here / "mine" / "trace.csv").write_text("my own")
    assert refused("run", "milling", *COARSE, "--out", "mine", *arguments) == (
        "out must not hold files of other origin, got mine with trace.csv: choose another --out"
    )
    assert (here / "mine" / "trace.csv").read_text() == "my own"
    assert len(list((here / "mine").iterdir())) == 1


def test_a_file_in_the_place_of_the_folder_is_refused(refused, here):
    (here / "taken").touch()
    assert refused("run", "milling", "--out", "taken") == (
        "out must be a folder, got the file taken: choose another --out"
    )
    assert refused("run", "milling", "--out", "taken/below/it") == (
        f"out must lie in a folder, got taken/below/it under the file {here / 'taken'}: choose another --out"
    )


def test_a_folder_that_cannot_be_written_is_refused(refused, here, monkeypatch):
    (here / "shut").mkdir()
    monkeypatch.setattr("tissue.simulation.run_folder.os.access", lambda path, mode: Path(path) != here / "shut")
    assert refused("run", "milling", "--out", "shut/run") == (
        f"out must be writable, got permission denied at {here / 'shut'}: choose another --out"
    )
    monkeypatch.setattr("tissue.simulation.run_folder.os.access", lambda path, mode: True)

    def read_only(self, *_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(self))

    monkeypatch.setattr(Path, "mkdir", read_only)
    assert refused("run", "milling", *COARSE, "--out", "shut/run") == (
        f"out must be writable, got read-only file system at {here / 'shut' / 'run'}: choose another --out"
    )


class FullDisk:
    """A file that takes nothing more."""

    def __init__(self, file):
        self.close = file.close

    def write(self, text):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_is_refused_and_the_run_is_incomplete(refused, here, monkeypatch):
    start = TraceWriter.__init__

    def full(self, path, table):
        start(self, path, table)
        self._file = FullDisk(self._file)

    monkeypatch.setattr(TraceWriter, "__init__", full)
    assert refused("run", "milling", *COARSE, "--duration-s", 0.1) == (
        "out must have space, got no space left on device at runs/milling/trace.csv: free some space or choose another "
        "--out"
    )
    saved = SavedRun("runs/milling")
    assert not saved.complete and len(saved.trace.rows) == 0


@pytest.fixture
def tiny_disk(tmp_path):
    """A file system of 300 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = (
        subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", str(place)], capture_output=True, check=False
        )
        if sys.platform == "linux" and os.geteuid() == 0
        else None
    )
    if mounted is None or mounted.returncode != 0:
        pytest.skip("only a superuser may mount a small file system")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_a_truly_full_disk_is_refused(tiny_disk):
    arguments = ["run", "milling", *COARSE, "--duration-s", "3", "--out", str(tiny_disk / "run")]
    ended = subprocess.run(
        [sys.executable, "-c", "from tissue.cli.main import main; main()", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2
    assert ended.stderr in {  # whichever of the two is flushed when the space ends
        f"error: out must have space, got no space left on device at {tiny_disk / 'run' / name}.csv: free some space "
        "or choose another --out\n"
        for name in ("trace", "timing")
    }


def test_a_run_prints_its_figures_and_where_they_are(command, here):
    code, output, error = command("run", "milling", *COARSE, "--duration-s", 0.1)
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
    assert "Warp" not in output


def test_scenes_are_listed_and_printed(command, here):
    code, output, _ = command("scenes")
    assert code == 0
    assert [line.split()[0] for line in output.splitlines()] == scene_names()
    for name in scene_names():
        code, output, _ = command("scenes", name)
        assert code == 0 and f'name = "{name}"' in output


def test_the_version_is_that_of_the_project(command):
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text("utf-8"))["project"]
    assert command("--version") == (0, f"{project['version']}\n", "")
    assert tissue.__version__ == project["version"]


def test_help_lists_every_option(command):
    code, output, _ = command("run", "--help")
    assert code == 0
    for option in (
        "--out",
        "--seed",
        "--duration-s",
        "--set",
        "--compute",
        "--cores",
        "--format",
        "--no-pictures",
        "--overwrite",
        "--allow-unstable",
    ):
        assert option in output


def test_a_peg_that_fits_neither_tool_nor_hole_is_refused(refused):
    loose = refused("run", "glenoid", "--set", "tool.peg_diameter_mm=12")
    wide = refused("run", "glenoid", "--set", "tool.peg_diameter_mm=12", "--set", "tool.diameter_mm=10")
    assert wide.startswith("tool.peg_diameter_mm must be below tool.diameter_mm (10), got 12")
    assert loose.startswith("tool.peg_diameter_mm must fit the guide hole (")
    assert "widen or deepen it by anatomy.guide_hole_diameter_mm and anatomy.guide_hole_depth_mm" in loose
