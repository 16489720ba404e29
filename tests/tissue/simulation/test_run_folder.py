"""Files that a run leaves on disk.

A run can be made again from them, and the files after a kill are checked.
"""

import json
import re
import shutil
import sys

import numpy as np
import pytest
from coarse_run import COARSE

from meshes.base.placement import Placement
from tissue import InputError, load_scene, simulate
from tissue.cli.main import main
from tissue.simulation.run_folder import RunFolder, SavedRun, copy_run
from tissue.simulation.scheduling import spin_time_s


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder of a coarse glenoid run by the command."""
    out = tmp_path_factory.mktemp("runs") / "glenoid"
    arguments = [
        "run",
        "glenoid",
        *COARSE,
        "--set",
        "motion.feed_mm_s=5",
        "--duration-s",
        "0.6",
        "--out",
        str(out),
    ]
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
        patch.setattr(sys, "argv", ["tissue", *arguments, "--cores", "1"])
        main()
    assert ended.value.code == 0
    return out


def test_the_folder_holds_every_file(made):
    assert {entry.name for entry in made.iterdir()} == {
        "trace.csv",
        "timing.csv",
        "scene.toml",
        "summary.json",
        "bone.vti",
        "bone.nrrd",
        "bone.stl",
        "bone.vtp",
        "carving",
        "carving.pvd",
        ".tissue.json",
    }
    summary = json.loads((made / "summary.json").read_text())
    assert summary["status"] == "complete" and summary["scene"] == "glenoid"
    assert summary["simulated_s"] == pytest.approx(0.6)
    assert sum(summary["removed_mm3"].values()) > 100.0
    assert summary["scheduling"]["cores"] == 1 and summary["scheduling"]["split_launches"] == 0
    gaps = summary["machine_gaps"]
    assert gaps["spun_s"] >= 2.0 * spin_time_s(0.6)  # before and after; a gap may end it later
    assert gaps["count"] == 0 or gaps["longest_us"] >= gaps["least_us"]
    assert (
        (made / "trace.csv").read_text().count("\n")
        == (made / "timing.csv").read_text().count("\n")
        == 601
    )


@pytest.mark.parametrize("cores", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_run_is_made_again_bit_for_bit_on_any_number_of_cores(
    made, tmp_path, cores, monkeypatch, command
):
    """A run is made again bit for bit on any number of cores.

    Threads are forced to share every launch: few launches of the coarse scene are long enough by
    themselves.
    """
    if cores > 1:
        monkeypatch.setattr("kernels.launcher.SPLIT_ABOVE_S", 0.0)
        monkeypatch.setattr("kernels.launcher.LEAST_GAIN", 0.0)
    arguments = ["run", made / "scene.toml", "--no-pictures", "--out", tmp_path / "again"]
    assert command(*arguments, "--cores", cores)[0] == 0
    scheduling = json.loads((tmp_path / "again" / "summary.json").read_text())["scheduling"]
    assert (scheduling["split_launches"] > 0) == (cores > 1)
    assert (tmp_path / "again" / "trace.csv").read_bytes() == (made / "trace.csv").read_bytes()
    assert (tmp_path / "again" / "scene.toml").read_bytes() == (made / "scene.toml").read_bytes()


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_trace_shorter_than_its_run_is_refused(made, tmp_path, share):
    folder = shutil.copytree(made, tmp_path / "copy")
    table = folder / "trace.csv"
    lines = table.read_text().splitlines(keepends=True)
    table.write_text("".join(lines[: round(share * len(lines))]))
    found = max(round(share * len(lines)) - 1, 0)
    with pytest.raises(InputError, match=rf"trace.csv must have 600 rows, .*, got {found} in"):
        SavedRun(folder)
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps(summary | {"status": "interrupted"}))
    assert len(SavedRun(folder).trace.rows) == found


def test_a_file_of_the_user_is_not_copied_with_the_run(tmp_path):
    folder = simulate(load_scene("wall", {"duration_s": 0.01})).save(
        tmp_path / "run", pictures=False
    )
    (folder / "trace.npz").write_text("of the user", "utf-8")
    copy_run(SavedRun(folder), tmp_path / "copy", pictures=True, overwrite=False)
    assert (tmp_path / "copy/trace.csv").is_file()
    assert not (tmp_path / "copy/trace.npz").exists()


def test_a_folder_that_is_no_run_is_refused_with_its_reason(tmp_path):
    for name in ("p01/attempt-1", "p01/attempt-2", "empty", "killed"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "killed" / ".lock").touch()
    for name in ("attempt-1", "attempt-2"):
        (tmp_path / "p01" / name / "summary.json").touch()
    for name, sentence in (
        ("p1", f"an existing folder, got {tmp_path}/p1 (did you mean p01?). Check the path"),
        ("p01", f"contains 2 runs. Use {tmp_path}/p01/attempt-1"),
        ("empty", "a folder that `tissue run` wrote"),
        ("killed", f"the run in {tmp_path}/killed has not begun"),
    ):
        with pytest.raises(InputError, match=re.escape(sentence)):
            SavedRun(tmp_path / name)


def test_a_run_killed_before_its_first_row_reads_back(tmp_path):
    folder = RunFolder(tmp_path / "run", overwrite=False)
    folder.begin(load_scene("milling"))
    assert SavedRun(folder.path).trace is None
    (folder.path / "trace.csv").touch()
    assert len(SavedRun(folder.path).trace.rows) == 0


@pytest.mark.parametrize("key", ["hand", "prediction", "renderer"])
def test_a_run_with_an_unregistered_part_is_refused_by_folder_and_part(tmp_path, key):
    """The part was registered in the script that made the run."""
    folder = tmp_path / "run"
    simulate(load_scene("wall", {"duration_s": 0.01})).save(folder, pictures=False)
    file = folder / "scene.toml"
    text = file.read_text("utf-8")
    file.write_text(re.sub(rf'(?m)^{key} = ".*"', f'{key} = "anna"', text), "utf-8")
    with pytest.raises(InputError) as refused:
        SavedRun(folder)
    assert str(refused.value) == (
        f"device.{key} = anna of the run in {folder} is not registered here. "
        "Register it in the same script, or install the package that provides it"
    )


@pytest.mark.filterwarnings("ignore::tissue.scene.load.OldSceneWarning")
@pytest.mark.parametrize(
    ("lines", "part"),
    [
        ('device = "robo"\nhand = "expert"', "device.kind = robo"),
        ('device = "touch"\nhand = "anna"', "device.hand = anna"),
    ],
)
def test_a_run_of_version_0_2_with_an_unregistered_part_is_refused(tmp_path, lines, part):
    """These files have the device and its hand at the top level."""
    folder = tmp_path / "run"
    simulate(load_scene("wall", {"duration_s": 0.01})).save(folder, pictures=False)
    file = folder / "scene.toml"
    text = file.read_text("utf-8").partition("[device]")[0]
    file.write_text(f"{lines}\n{text}".replace("format = 2", "format = 1"), "utf-8")
    with pytest.raises(InputError, match=f"{part} of the run in .* is not registered"):
        SavedRun(folder)


@pytest.mark.parametrize(
    ("changes", "are_keys"),
    [
        ({"anatomy.kind": "glenoid", "anatomy.file": "a.stl"}, True),
        ({"anatomy.file": "a.nrrd", "anatomy.centre_mm": [0.0, 0.0, 1.0]}, True),
        ({"anatomy.file": "a.nrrd"}, False),
        ({"anatomy.kind": "molar", "anatomy.file": "a.nrrd"}, False),
        ({"anatomy.kind": "molar", "anatomy.enamel_file": "a.stl"}, False),
    ],
)
def test_the_comment_on_the_pose_is_true_for_the_anatomy(changes, are_keys, tmp_path):
    scene = load_scene("milling", changes)
    folder = RunFolder(tmp_path / "run", overwrite=False)
    folder.begin(scene, Placement(np.array([1.0, 2.0, 3.0]), np.eye(3)))
    folder.interrupt("")
    kept = tmp_path / "run" / "scene.toml"
    text = kept.read_text("utf-8")
    assert ("As keys of [anatomy], the first three fix this pose." in text) == are_keys
    keys = [line[2:] for line in text.splitlines() if re.match("# (centre_mm|normal|along) ", line)]
    assert len(keys) == 3
    stated = re.sub("\ncentre_mm = (?s:.*?)\n\\]", "", text)
    with_keys = stated.replace("[anatomy]\n", "\n".join(["[anatomy]", *keys, ""]), 1)
    kept.write_text(with_keys, "utf-8")
    if are_keys:
        assert load_scene(kept).anatomy.centre_mm == (1.0, 2.0, 3.0)
    elif changes.get("anatomy.kind") == "molar":
        with pytest.raises(InputError, match=r"anatomy\.centre_mm must be left out"):
            load_scene(kept)
