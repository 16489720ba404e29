"""The bone in `tissue view`: carved as far as the time shown."""

import numpy as np
import pytest

from tissue import load_scene, simulate
from tissue.show.viewer.saved_surfaces import bone_of
from tissue.simulation.bone_files import read_voxels
from tissue.simulation.run_folder import SavedRun


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
        # Every layer is a closed body. It is off by the steps at its face, less than a voxel's half
        # on either side.
        assert part.n_open_edges == 0
        held = (left / 255.0)[volume.layer == layer].sum() * 0.5**3
        assert abs(part.volume - held) < 0.25 * part.area
        share = (
            np.bincount(part.cell_data["layer"], minlength=len(volume.layer_names)) / part.n_cells
        )
        assert share[layer] > 0.9
        assert part.point_data["removed_depth_mm"].max() <= bone.deepest_mm + 1e-6
    assert bone.rest(set()).n_cells == bone.cut(set()).n_cells == 0


def surface_of(bone, tick):
    """Return the surface that is drawn for all layers at a tick."""
    bone.at(tick)
    return (
        bone.cut(bone.layers)
        .append_polydata(bone.rest(bone.layers))
        .clean(tolerance=1e-4, absolute=True)
    )


@pytest.mark.slow
def test_the_bone_at_a_time_is_that_of_a_run_stopped_there(layered, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    bone = carved_bone(layered)
    last = surface_of(bone, 499)
    stopped = load_scene(
        "glenoid", {"voxels.spacing_mm": 0.5, "motion.feed_mm_s": 5.0, "duration_s": 0.35}
    )
    short = carved_bone(simulate(stopped).save(tmp_path / "short", pictures=False))
    for mine, other in (
        (surface_of(bone, 349), surface_of(short, 349)),
        (surface_of(bone, 499), last),
    ):
        assert mine.n_cells == other.n_cells and mine.volume == pytest.approx(
            other.volume, rel=1e-6
        )
    whole = pyvista.read(layered / "bone.vtp")
    assert last.n_cells == whole.n_cells and last.volume == pytest.approx(whole.volume, rel=1e-6)
    assert surface_of(bone, 349).volume > last.volume + 1.0
    # Without the poses, as of an earlier version, the trace gives the same within what is cut in 20
    # µm.
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
