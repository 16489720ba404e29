"""`tissue view`: of whole and of stopped runs, with and without a display."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from fake_fields import block_series

from tissue import InputError, load_scene, simulate
from tissue.offscreen import display_problem
from tissue.series import write_fields
from tissue.view import view
from tissue.viewer_bone import BoneShown, read_voxels, surface_of_layers
from tissue.viewer_fields import FieldsShown
from tissue.viewer_frames import SavedFields
from tissue.viewer_layers import LayerKeys


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
    """What `view` says; skips the test where no OpenGL works."""
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
    said = _screenshot(whole, picture)
    assert said.startswith("milling: 0.3 s, force up to ")
    assert said.endswith(f"screenshot in {picture}")
    assert _colours(picture) > 100


@pytest.fixture(scope="module")
def layered(tmp_path_factory):
    """Folder of a quick run in bone of several layers, with fields."""
    scene = load_scene("glenoid", {"voxels.spacing_mm": 0.5, "motion.feed_mm_s": 5.0, "duration_s": 0.5})
    folder = simulate(scene).save(tmp_path_factory.mktemp("runs") / "layered", pictures=False)
    write_fields(block_series((-8e-3, -8e-3, -8e-3), (8e-3, 8e-3, 0.0), (8, 8, 6)), folder)
    return folder


def test_a_layer_taken_away_lays_bare_what_lies_under_it(layered):
    pyvista = pytest.importorskip("pyvista")
    surface, voxels = pyvista.read(layered / "bone.vtp"), read_voxels(layered / "bone.vti")
    present = np.unique(voxels.layer[voxels.fraction > 0]).tolist()
    for layer in present:
        part = surface_of_layers(surface, voxels, {layer})
        # Every layer is a closed body. It is off by the steps at its face, less than a voxel's half on either side.
        assert part.n_open_edges == 0
        held = (voxels.fraction / 255.0)[voxels.layer == layer].sum() * 0.5**3
        assert abs(part.volume - held) < 0.25 * part.area
        share = np.bincount(part.cell_data["layer"], minlength=len(voxels.layer_names)) / part.n_cells
        assert share[layer] > 0.9
        assert part.point_data["removed_depth_mm"].max() <= surface.point_data["removed_depth_mm"].max() + 1e-6
    assert surface_of_layers(surface, voxels, set()).n_cells == 0
    # Without voxels the bone's own surface is all there is.
    counts = np.bincount(surface.cell_data["layer"])
    for layer in np.flatnonzero(counts):
        assert surface_of_layers(surface, None, {int(layer)}).n_cells == counts[layer]
    assert surface_of_layers(surface, None, set(present)) is surface


class Seen:
    """A plotter that draws nothing and keeps what it was given."""

    def __init__(self):
        self.keys, self.meshes, self.scalar_bars, self.legend = {}, {}, {}, []

    def add_key_event(self, key, call):
        self.keys[key] = call

    def add_mesh(self, mesh, *, name, scalars, **look):
        self.meshes[name] = mesh, scalars, look
        return SimpleNamespace(mapper=None)

    def remove_actor(self, name, **_):
        self.meshes.pop(name, None)

    def add_scalar_bar(self, title, **_):
        self.scalar_bars[title] = True

    def remove_scalar_bar(self, title, **_):
        del self.scalar_bars[title]

    def add_legend(self, entries, **_):
        self.legend = [name for name, colour in entries if colour != "lightgray"]

    def remove_legend(self, **_):
        self.legend = []

    def render(self):
        pass


def test_keys_switch_layers_and_colours(layered):
    pyvista = pytest.importorskip("pyvista")
    plotter = Seen()
    bone = BoneShown(plotter, pyvista.read(layered / "bone.vtp"), read_voxels(layered / "bone.vti"))
    keys = LayerKeys(plotter, bone.layers, targets=[bone.hide])
    assert bone.help == "c: removed depth or layer"
    assert keys.help == "  ".join(f"{n}: {name}" for n, name in enumerate(bone.layers, 1)) + " on or off"
    assert list(plotter.scalar_bars) == ["removed depth / mm"] and not plotter.legend
    whole = plotter.meshes["bone"][0].n_cells
    plotter.keys["1"]()
    assert plotter.meshes["bone"][1] == "layer" and plotter.meshes["bone"][0].n_cells != whole
    assert plotter.legend == bone.layers[1:] and not plotter.scalar_bars
    plotter.keys["1"]()
    assert plotter.legend == bone.layers and plotter.meshes["bone"][0].n_cells == whole
    plotter.keys["c"]()
    assert plotter.meshes["bone"][1] == "removed_depth_mm"
    for key in range(1, len(bone.layers) + 1):
        plotter.keys[str(key)]()
    assert not plotter.meshes and not plotter.legend
    bone.show(False)
    assert not plotter.meshes and not plotter.scalar_bars


def test_stress_follows_the_time(layered):
    plotter = Seen()
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


def test_a_run_without_fields_says_so(whole, tmp_path):
    with pytest.raises(InputError, match="got x: this run has none, leave it out"):
        view(whole, screenshot=tmp_path / "view.png", field="x")


def test_a_stopped_run_says_so_and_shows_what_it_has(stopped, tmp_path):
    said = _screenshot(stopped, tmp_path / "view.png")
    assert said.splitlines()[0] == "run is incomplete: it stopped at 0.149 s of 0.3 s"
    assert _colours(tmp_path / "view.png") > 100


@pytest.mark.parametrize("rows", [0, 1])
def test_a_run_stopped_at_once_can_be_seen(stopped, tmp_path, rows):
    lines = (stopped / "trace.csv").read_text().splitlines(keepends=True)
    (stopped / "trace.csv").write_text("".join(lines[: 1 + rows]))
    (stopped / "scene.toml").unlink()
    said = _screenshot(stopped, tmp_path / "view.png")
    assert said.startswith(
        ("run is incomplete: it stopped before its first tick was written", "run is incomplete: it stopped at 0.000 s")[
            rows
        ]
    )


def test_without_a_display_the_remedy_is_a_screenshot(whole, monkeypatch):
    monkeypatch.setattr("tissue.offscreen.sys.platform", "linux")
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
    monkeypatch.setattr("tissue.offscreen._windows", lambda: iter(()))
    with pytest.raises(InputError, match="screenshot must be drawn in 3D, but this machine has no OpenGL library"):
        view(whole, screenshot=tmp_path / "view.png")
    assert not (tmp_path / "view.png").exists()
