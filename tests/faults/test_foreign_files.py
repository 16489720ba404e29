"""Files of the user, which no command changes.

Each command is run over folders and files that it did not write.
"""

import hashlib
import os
import shutil

import pytest
from coarse_run import COARSE

from tissue.simulation.run import Run
from tissue.system.owned_folder import MARKER, OwnedFolder

WALL = ("wall", "--set", "duration_s=0.05")
FOLDERS = {
    "run": (
        ("run", *WALL, "--no-pictures"),
        "trace.csv summary.json bone.stl pictures/section.png carving/rest.vtp",
    ),
    "sweep": (
        ("sweep", "wall", "--set", "duration_s=0.05,0.06"),
        "sweep.csv sweep.png compare.png",
    ),
    "compare": (("compare", "a", "b"), "compare.csv compare.png"),
    "assess": (("assess", "a", "--against", "b"), "assessment.json assessment.png"),
    "import": (("import", "ct.nrrd"), "scene.toml import.json"),
    "fit": (("fit", "wall", "--measured", "log.csv"), "fitted.toml report.html loads.csv"),
    "stability": (("stability", "wall"), "stability.png"),
    "atlas": (
        ("stability", "--only", "wild_input"),
        "index.html wild_input.png wild_input_jump.csv",
    ),
    "chart": (("chart", "wall", "--quick"), "wall.csv wall.png frontier.png machine.txt"),
    "prediction": (
        ("chart", "prediction", "wall"),
        "errors.csv prediction_wall.png prediction_tasks.png",
    ),
    "study": (("study", "run", "--trials", 1), "plan.toml study.json"),
    "study plan": (("study", "plan", "--trials", 1), "plan.toml trials.csv"),
}
"""Command and names of files that it would write, for commands that write folders."""
FILES = {
    "schema": (("schema",), "--out", "x.json"),
    "train": (("train", "wall"), "--out", "x.npz"),
    "calibrate": (("calibrate", "--observer", "simulated:1"), "--out", "x.json"),
    "population": (("calibrate", "--population", "."), "--out", "x.json"),
    "report": (("report", "made"), "--out", "x.html"),
    "screenshot": (("view", "made"), "--screenshot", "x.png"),
    "movie": (("view", "made"), "--movie", "x.gif"),
    "devices": (("devices", "--test", "network"), "--out", "x.toml"),
}
"""Command, option and file for commands that write single files."""


def content(folder):
    """Hash and kind of all that lies in a folder."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        plain = path.is_file() and not path.is_symlink()
        found[name] = (
            hashlib.sha256(path.read_bytes()).hexdigest() if plain else os.lstat(path).st_mode
        )
    return found


def put(folder, names):
    """Write files of a user."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"the user's {name}")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder of a short run of a wall."""
    import tissue

    folder = tmp_path_factory.mktemp("made") / "made"
    return tissue.simulate(tissue.load_scene("wall", {"duration_s": 0.05})).save(
        folder, pictures=False
    )


@pytest.mark.parametrize("option", [(), ("--overwrite",)], ids=["plain", "overwrite"])
@pytest.mark.parametrize("name", FOLDERS)
def test_files_of_other_origin_are_never_replaced(refused, tmp_path, monkeypatch, name, option):
    monkeypatch.chdir(tmp_path)
    arguments, files = FOLDERS[name]
    if "study" in name and option:
        pytest.skip("it has no such option")
    for number, each in enumerate(files.split()):
        folder = tmp_path / f"mine-{number}"
        put(folder, [each, "notes.txt", "pictures/mine.png"])
        before = content(folder)
        message = refused(*arguments, "--out", folder, *option)
        assert message.startswith(("out must ", "study must ")), message
        assert content(folder) == before


@pytest.mark.parametrize("name", FILES)
def test_single_files_are_replaced_on_request_and_only_where_they_are_regular(
    refused, made, tmp_path, monkeypatch, name
):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(made, "made")
    arguments, option, file = FILES[name]
    put(tmp_path, [file, "target"])
    before = content(tmp_path)
    assert "must not exist yet" in refused(*arguments, option, file)
    assert content(tmp_path) == before
    os.unlink(file)
    for make in (
        os.mkfifo,
        lambda path: os.symlink("target", path),
        lambda path: os.symlink("nowhere", path),
        os.mkdir,
    ):
        make(file)
        before = content(tmp_path)
        assert " must " in refused(*arguments, option, file, "--overwrite")
        assert content(tmp_path) == before
        os.rmdir(file) if os.path.isdir(file) else os.unlink(file)
    if "calibrate" not in arguments:  # which makes the folder
        assert "must lie in a folder that exists" in refused(*arguments, option, f"no/such/{file}")


def test_a_run_of_version_0_2_is_read_and_copied_and_never_replaced(refused, made, tmp_path):
    """Its folder has no marker."""
    folder = shutil.copytree(made, tmp_path / "old")
    (folder / MARKER).unlink()
    put(folder, ["notes.txt", "pictures/mine.png"])
    before = content(folder)
    message = refused("run", *WALL, "--no-pictures", "--out", folder, "--overwrite")
    assert message.startswith("out must not contain files of other origin")
    assert content(folder) == before
    copied = content(Run.load(folder).save(tmp_path / "copy"))
    assert {"trace.csv", "timing.csv", "scene.toml", "summary.json"} <= set(copied)
    assert "notes.txt" not in copied and "pictures/mine.png" not in copied


def test_a_lock_of_the_user_is_kept(refused, tmp_path):
    folder, target = tmp_path / "out", tmp_path / "target"
    put(tmp_path, ["out/.lock", "target"])
    before = content(tmp_path)
    assert "file .lock of other origin" in refused("run", *WALL, "--out", folder)
    assert content(tmp_path) == before
    (folder / ".lock").unlink()
    (folder / ".lock").symlink_to(target)
    before = content(tmp_path)
    assert "file .lock of other origin" in refused("run", *WALL, "--out", folder)
    assert content(tmp_path) == before
    (folder / ".lock").unlink()
    (folder / ".lock").write_text("12345\n")  # as a process leaves it that was killed
    OwnedFolder(folder, "run", []).release()
    assert not (folder / ".lock").exists()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_no_command_touches_what_it_did_not_write(command, tmp_path, monkeypatch):
    """Foreign files lie in every folder, on every level; each command writes twice."""
    monkeypatch.chdir(tmp_path)
    others = [
        "notes.txt",
        "pictures/mine.png",
        "carving/mine.txt",
        "fields/mine.txt",
        "band/mine.toml",
        "data/trace.csv",
    ]
    run = ("run", "milling", *COARSE[:2], "--set", "motion.feed_mm_s=50", "--duration-s", 0.15)
    assert command(*run, "--no-pictures", "--out", "reference")[0] == 0
    writing = {
        "made": (*run, "--format", "npz", "--band", 16),
        "swept": ("sweep", *WALL, "--set", "seed=1,2", "--workers", 1),
        "compared": ("compare", "made", "reference"),
        "assessed": ("assess", "made", "--against", "reference"),
    }
    mine = {}
    for folder, arguments in writing.items():
        put(tmp_path / folder, others)
        mine |= {
            f"{folder}/{name}": hashlib.sha256(f"the user's {name}".encode()).hexdigest()
            for name in others
        }
        for option in ((), ("--overwrite",)):
            code, _, error = command(*arguments, "--out", folder, *option)
            assert code == 0, error
            found = content(tmp_path)
            assert {name: found.get(name) for name in mine} == mine
    assert command("report", "made")[0] == 0
    assert command("view", "made", "--screenshot", "made/pictures/shown.png")[0] == 0
    put(tmp_path, ["made/pictures/shown.png"])
    assert command("view", "made", "--screenshot", "made/pictures/shown.png")[0] == 2
    assert command(*run, "--no-pictures", "--out", "made", "--overwrite")[0] == 0
    found = content(tmp_path)
    assert {name: found.get(name) for name in mine} == mine
    assert (
        tmp_path / "made/pictures/shown.png"
    ).read_text() == "the user's made/pictures/shown.png"
    left = {each.name for each in (tmp_path / "made/pictures").iterdir()}
    assert left == {"mine.png", "shown.png"} and not (tmp_path / "made" / "report.html").exists()
