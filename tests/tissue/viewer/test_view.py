"""`tissue view`: of whole and of stopped runs, with and without a display."""

import dataclasses
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from fake_fields import block_series
from recording_plotter import RecordingPlotter

from tissue import InputError, load_scene, simulate
from tissue.motion.pose_file import write_poses
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.saved_fields import SavedFields
from tissue.simulation.series import write_fields
from tissue.system.offscreen import display_problem, draw_apart
from tissue.viewer.bone import BoneShown
from tissue.viewer.carving import bone_of, read_voxels
from tissue.viewer.fields import FieldsShown
from tissue.viewer.layers import LayerKeys
from tissue.viewer.view import _about, view


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of a quick run that ended."""
    scene = load_scene("milling", {"voxels.spacing_mm": 0.4, "duration_s": 0.3})
    return simulate(scene).save(tmp_path_factory.mktemp("runs") / "whole", pictures=False)


@pytest.fixture
def stopped(whole, tmp_path):
    """The same run as a kill would have left it: 150 rows and a half, no bone."""
    folder = tmp_path / "stopped"
    folder.mkdir()
    shutil.copy(whole / "scene.toml", folder)
    summary = json.loads((whole / "summary.json").read_text())
    (folder / "summary.json").write_text(
        json.dumps({"format": 1, "status": "running"} | {name: summary[name] for name in ("scene", "layers")})
    )
    lines = (whole / "trace.csv").read_text().splitlines(keepends=True)
    (folder / "trace.csv").write_text("".join(lines[:151]) + lines[151][:40])
    return folder


def _screenshot(folder, picture) -> str:
    """What `view` prints; skips the test where no OpenGL works."""
    try:
        return view(folder, screenshot=picture)
    except InputError as problem:
        if "OpenGL" in str(problem):
            pytest.skip(str(problem))
        raise


def _colours(path) -> int:
    from PIL import Image

    with Image.open(path) as picture:
        assert picture.size == (1400, 950)
        return len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3)[::53], axis=0))


def test_screenshot_of_a_whole_run(whole, tmp_path):
    picture = tmp_path / "view.png"
    picture.write_bytes(b"an older picture")
    report = _screenshot(whole, picture)
    assert report.startswith("milling: 0.3 s, force up to ")
    assert report.endswith(f"screenshot in {picture}")
    assert _colours(picture) > 100


@pytest.fixture(scope="module")
def layered(tmp_path_factory):
    """Folder of a quick run in bone of several layers, with fields."""
    scene = load_scene("glenoid", {"voxels.spacing_mm": 0.5, "motion.feed_mm_s": 5.0, "duration_s": 0.5})
    folder = simulate(scene).save(tmp_path_factory.mktemp("runs") / "layered", pictures=False)
    write_fields(block_series((-8e-3, -8e-3, -8e-3), (8e-3, 8e-3, 0.0), (8, 8, 6)), folder)
    return folder


def carved_bone(folder):
    """The bone of a run's folder over time."""
    saved = SavedRun(folder)
    return bone_of(saved, saved.scene)


def test_a_layer_taken_away_lays_bare_what_lies_under_it(layered):
    pytest.importorskip("pyvista")
    bone, (volume, left) = carved_bone(layered), read_voxels(layered / "bone.vti")
    bone.at(10**6)
    for layer in bone.layers:
        rest, cut = bone.rest({layer}), bone.cut({layer})
        part = cut.append_polydata(rest).clean(tolerance=1e-4, absolute=True)
        # Every layer is a closed body. It is off by the steps at its face, less than a voxel's half on either side.
        assert part.n_open_edges == 0
        held = (left / 255.0)[volume.layer == layer].sum() * 0.5**3
        assert abs(part.volume - held) < 0.25 * part.area
        share = np.bincount(part.cell_data["layer"], minlength=len(volume.layer_names)) / part.n_cells
        assert share[layer] > 0.9
        assert part.point_data["removed_depth_mm"].max() <= bone.deepest_mm + 1e-6
    assert bone.rest(set()).n_cells == bone.cut(set()).n_cells == 0


def surface_of(bone, tick):
    """What is drawn of all layers at a tick."""
    bone.at(tick)
    return bone.cut(bone.layers).append_polydata(bone.rest(bone.layers)).clean(tolerance=1e-4, absolute=True)


def test_the_bone_at_a_time_is_that_of_a_run_stopped_there(layered, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    bone = carved_bone(layered)
    last = surface_of(bone, 499)
    stopped = load_scene("glenoid", {"voxels.spacing_mm": 0.5, "motion.feed_mm_s": 5.0, "duration_s": 0.35})
    short = carved_bone(simulate(stopped).save(tmp_path / "short", pictures=False))
    for mine, other in ((surface_of(bone, 349), surface_of(short, 349)), (surface_of(bone, 499), last)):
        assert mine.n_cells == other.n_cells and mine.volume == pytest.approx(other.volume, rel=1e-6)
    whole = pyvista.read(layered / "bone.vtp")
    assert last.n_cells == whole.n_cells and last.volume == pytest.approx(whole.volume, rel=1e-6)
    assert surface_of(bone, 349).volume > last.volume + 1.0
    # Without the poses, as of an earlier version, the trace gives the same within what is cut in 20 µm.
    (layered / "carving" / "poses.npz").rename(tmp_path / "poses.npz")
    try:
        by_trace = surface_of(carved_bone(layered), 349)
    finally:
        (tmp_path / "poses.npz").rename(layered / "carving" / "poses.npz")
    assert by_trace.volume == pytest.approx(surface_of(bone, 349).volume, abs=0.02 * 30.0)


def test_a_stopped_run_shows_its_bone_carved_as_far_as_it_came(stopped):
    pytest.importorskip("pyvista")
    bone = carved_bone(stopped)
    assert surface_of(bone, 149).volume < surface_of(bone, 0).volume


@pytest.mark.parametrize("damage", ["poses", "bone", "another"])
def test_damaged_files_of_the_bone_are_refused(layered, tmp_path, damage):
    folder = tmp_path / "run"
    shutil.copytree(layered, folder)
    if damage == "poses":
        (folder / "carving" / "poses.npz").write_bytes(b"PK")
    elif damage == "another":
        volume, _ = read_voxels(folder / "bone.vti")
        moved = dataclasses.replace(volume, origin_m=volume.origin_m + 1e-3)
        write_poses(folder / "carving" / "poses.npz", np.zeros((1, 13)), moved)
    else:
        shutil.copy(folder / "carving" / "rest.vtp", folder / "bone.vti")
    with pytest.raises(InputError, match=r"^(poses|bone.vti) must be .*, got .*: run the scene again$"):
        carved_bone(folder)


def test_keys_switch_layers_and_colours(layered):
    pytest.importorskip("pyvista")
    plotter = RecordingPlotter()
    bone = BoneShown(plotter, carved_bone(layered))
    cells = lambda: sum(mesh.n_cells for mesh, _, _ in plotter.meshes.values())  # noqa: E731
    keys = LayerKeys(plotter, bone.layers, targets=[bone.hide])
    assert bone.help == "c: removed depth or layer"
    assert keys.help == "  ".join(f"{n}: {name}" for n, name in enumerate(bone.layers, 1)) + " on or off"
    assert list(plotter.scalar_bars) == ["removed depth / mm"] and not plotter.legend
    whole = cells()
    plotter.keys["1"]()
    assert plotter.meshes["bone"][1] == "layer" and cells() != whole
    assert plotter.legend == bone.layers[1:] and not plotter.scalar_bars
    plotter.keys["1"]()
    assert plotter.legend == bone.layers and cells() == whole
    plotter.keys["c"]()
    assert plotter.meshes["bone"][1] == "removed_depth_mm"
    for key in range(1, len(bone.layers) + 1):
        plotter.keys[str(key)]()
    assert not plotter.meshes and not plotter.legend
    bone.show(False)
    assert not plotter.meshes and not plotter.scalar_bars


def test_stress_follows_the_time(layered):
    plotter = RecordingPlotter()
    fields = FieldsShown(plotter, SavedFields(layered), clip=((0.0, -1.0, 0.0), (0.0, 0.5, 0.0)))
    fields.at(0.2)
    assert not plotter.meshes
    fields.show("von_mises_MPa")
    mesh, _, look = plotter.meshes["field"]
    # The last frame up to 0.2 s is the one at 0.1 s, in which the stress is |x| + 1; what lies before the cut is gone.
    assert mesh.cell_data["von_mises_MPa"].min() == pytest.approx(2.0)
    assert mesh.bounds[2] == pytest.approx(0.5, abs=1e-3)
    assert look["log_scale"] and look["clim"][1] == pytest.approx(9.5)
    fields.at(0.3)
    assert plotter.meshes["field"][0].cell_data["von_mises_MPa"].min() == pytest.approx(3.5)
    assert list(plotter.scalar_bars) == ["von Mises / MPa\nat 0.250 s"]
    fields.show("principal_1_MPa")
    look = plotter.meshes["field"][2]
    assert not look["log_scale"] and look["clim"][0] == -look["clim"][1]
    # Displaced by its own place times the time, the mesh is a quarter larger; the plane stays where it is.
    fields.show("displacement_um")
    fields.enlarge(1e3)
    mesh, _, look = plotter.meshes["field"]
    assert mesh.bounds[1] == pytest.approx(8.0 * 1.25, rel=1e-5) and mesh.bounds[2] == pytest.approx(0.5, abs=1e-3)
    assert not look["log_scale"] and look["clim"][0] == 0.0
    fields.show(None)
    assert not plotter.meshes and not plotter.scalar_bars


@pytest.mark.slow
def test_hidden_layers_and_stress_show_in_the_picture(layered, tmp_path):
    from PIL import Image

    green = []
    for index, shown in enumerate(({"hide": ("cortical", "subchondral")}, {"field": "von_mises_MPa"})):
        try:
            view(layered, screenshot=tmp_path / f"{index}.png", **shown)
        except InputError as problem:
            if "OpenGL" in str(problem):
                pytest.skip(str(problem))
            raise
        with Image.open(tmp_path / f"{index}.png") as picture:
            red, of_green, _ = np.moveaxis(np.asarray(picture.convert("RGB"), dtype=int), 2, 0)
        green.append((of_green > red + 40).mean())
    # Trabecular bone is green and all that is left; the scale of the stress holds no green.
    assert green[0] > 0.05 and green[1] < 0.02


@pytest.mark.parametrize(
    ("shown", "message"),
    [
        ({"hide": ("gum",)}, r"hide must name a layer of the run, got gum: use one of .*trabecular"),
        ({"field": "heat"}, r"field must name a field of the run, got heat: use one of von_mises_MPa, principal_1_MPa"),
    ],
)
def test_names_that_a_run_does_not_have_are_refused(layered, tmp_path, shown, message):
    with pytest.raises(InputError, match=message):
        view(layered, screenshot=tmp_path / "view.png", **shown)


def test_a_run_without_fields_is_reported(whole, tmp_path):
    with pytest.raises(InputError, match="got x: this run has none, leave it out"):
        view(whole, screenshot=tmp_path / "view.png", field="x")


def test_a_stopped_run_is_named_so_and_shows_what_it_has(stopped, tmp_path):
    report = _screenshot(stopped, tmp_path / "view.png")
    assert report.splitlines()[0] == "run is incomplete: it was interrupted at 0.149 s of 0.3 s"
    assert _colours(tmp_path / "view.png") > 100


def test_a_run_stopped_while_its_files_were_written_is_reported(whole, tmp_path):
    folder = tmp_path / "stopped"
    shutil.copytree(whole, folder)
    summary = json.loads((folder / "summary.json").read_text("utf-8"))
    (folder / "summary.json").write_text(json.dumps(summary | {"status": "running"}), "utf-8")
    assert _about(SavedRun(folder)).endswith("it was interrupted after its last tick, while its files were written")


@pytest.mark.parametrize("rows", [0, 1])
def test_a_run_stopped_at_once_can_be_seen(stopped, tmp_path, rows):
    lines = (stopped / "trace.csv").read_text().splitlines(keepends=True)
    (stopped / "trace.csv").write_text("".join(lines[: 1 + rows]))
    (stopped / "scene.toml").unlink()
    report = _screenshot(stopped, tmp_path / "view.png")
    assert report.startswith(
        (
            "run is incomplete: it was interrupted before its first tick",
            "run is incomplete: it was interrupted at 0.000 s",
        )[rows]
    )


def test_without_a_display_the_remedy_is_a_screenshot(whole, monkeypatch):
    monkeypatch.setattr("tissue.system.offscreen.sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    assert display_problem() == "there is no display (DISPLAY is not set)"
    with pytest.raises(InputError, match=r"DISPLAY is not set\): pass --screenshot FILE or --movie FILE$"):
        view(whole)


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="run must be a folder that `tissue run` wrote"):
        view(tmp_path, screenshot=tmp_path / "view.png")


@pytest.mark.parametrize(
    ("name", "message"), [("view.jpeg", "must be a .png file"), ("none/view.png", "must lie in an existing folder")]
)
def test_a_screenshot_needs_a_place(whole, tmp_path, name, message):
    with pytest.raises(InputError, match=message):
        view(whole, screenshot=tmp_path / name)


def test_a_screenshot_that_cannot_be_drawn_leaves_no_file(whole, tmp_path, monkeypatch):
    monkeypatch.setattr("tissue.system.offscreen._windows", lambda: iter(()))
    with pytest.raises(InputError, match="screenshot must be drawn in 3D, but this machine has no OpenGL library"):
        view(whole, screenshot=tmp_path / "view.png")
    assert not (tmp_path / "view.png").exists()


@pytest.mark.parametrize(("kind", "name"), [("movie", "run.gif"), ("movie", "run.mp4"), ("screenshot", "run.png")])
@pytest.mark.parametrize("older", [b"an older one", None])
@pytest.mark.parametrize("ends", [KeyboardInterrupt(), "drawing was stopped", InputError("bone.vti must be whole")])
def test_what_is_not_drawn_to_its_end_leaves_no_file_and_keeps_an_older_one(
    whole, tmp_path, monkeypatch, kind, name, older, ends
):
    file = tmp_path / name
    if older is not None:
        file.write_bytes(older)

    def half(module, folder, kind, into, *rest, **options):
        Path(into).write_bytes(b"half of it")
        options["drawn"](0.5)
        if isinstance(ends, str):
            return ends
        raise ends

    reported = []
    monkeypatch.setattr("tissue.viewer.view.draw_apart", half)
    monkeypatch.setattr("tissue.viewer.view.check_movie", lambda path: None)
    monkeypatch.setattr("tissue.viewer.view.require_whole", lambda saved: None)  # it starts a process each time
    with pytest.raises(KeyboardInterrupt if isinstance(ends, KeyboardInterrupt) else InputError):
        view(whole, **{kind: file}, progress=lambda doing, share: reported.append((doing, share)))
    assert reported == [(f"drawing the {kind}", 0.0), (f"drawing the {kind}", 0.5)]
    assert [one.name for one in tmp_path.iterdir()] == ([] if older is None else [name])
    assert older is None or file.read_bytes() == older


def test_a_movie_reports_how_much_of_it_is_drawn(tmp_path, monkeypatch):
    (tmp_path / "drawing.py").write_text(
        "import sys\nsys.stdin.readline()\nprint('VTK warns')\nprint(0.25, flush=True)\nprint('0.', end='', flush=True)\n"
        f"import pathlib, time\nwhile not pathlib.Path({str(tmp_path / 'seen')!r}).exists(): time.sleep(0.01)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr("tissue.system.offscreen.child_command", lambda module: [sys.executable, "-m", module])
    monkeypatch.setattr("tissue.system.offscreen.CHECK_S", 0.05)
    shares = []

    def reported(share):
        shares.append(share)
        if share > 0.0:
            (tmp_path / "seen").touch()

    assert draw_apart("drawing", drawn=reported) is None
    assert set(shares) <= {0.0, 0.25} and shares[-1] == 0.25


def test_what_is_wrong_with_a_run_is_reported_by_its_renderer(layered, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(layered, folder)
    (folder / "carving" / "poses.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"^poses must be a whole file that a run wrote, got .*: run the scene again$"):
        _screenshot(folder, tmp_path / "view.png")
    assert not (tmp_path / "view.png").exists()
