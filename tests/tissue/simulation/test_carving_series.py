"""Carving over time as files: their content, compared with the bone itself."""

import numpy as np
import pytest

from tissue import load_scene, simulate
from tissue.motion.replay import read_poses
from tissue.simulation.bone_files import carved_surface, carving_ticks, write_carving
from tissue.simulation.bone_surface import block_means, changed_box

pyvista = pytest.importorskip("pyvista")


@pytest.fixture(scope="module")
def run():
    """A slot milled through the middle of a block."""
    path = {
        "motion.points_mm": [[-5, 0, 0.05], [-5, 0, -0.8], [5, 0, -0.8]],
        "motion.feed_mm_s": 30.0,
    }
    return simulate(load_scene("milling", path | {"voxels.spacing_mm": 0.3, "duration_s": 0.4}))


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    """Folder with the files of the carving."""
    out = tmp_path_factory.mktemp("carving")
    write_carving(run, out)
    return out


def test_paraview_plays_the_bone_from_whole_to_carved(run, folder):
    reader = pyvista.PVDReader(folder / "carving.pvd")
    ticks = carving_ticks(run)
    assert reader.time_values == [run.trace["time_s"][tick] for tick in ticks]
    replay, last = run.replay(), 0.0
    for tick, time in zip(ticks, reader.time_values, strict=True):
        reader.set_active_time_value(time)
        cut, rest = reader.read()
        both = cut.append_polydata(rest).clean(tolerance=1e-4, absolute=True)
        # Both together are closed, and enclose the bone that is left; flying edges take half a
        # voxel's edge off corners.
        assert both.n_open_edges == 0
        left = replay.at(tick).sum(dtype=np.int64) / 255 * 0.3**3
        assert both.volume == pytest.approx(left, rel=6e-3)
        assert (
            cut.point_data["removed_depth_mm"].max() >= last
            and not rest.point_data["removed_depth_mm"].any()
        )
        last = cut.point_data["removed_depth_mm"].max()
    # The last is the surface of the run itself, triangle by triangle.
    whole = carved_surface(run)
    assert both.n_cells == whole.n_cells and both.volume == pytest.approx(whole.volume, rel=1e-6)
    assert last == pytest.approx(
        whole.point_data["removed_depth_mm"].max()
    ) and last == pytest.approx(0.8, abs=0.05)
    poses, origin_m, _ = read_poses(folder / "carving" / "poses.npz")
    np.testing.assert_array_equal(poses, run.poses)
    np.testing.assert_array_equal(origin_m, run.volume.origin_m)


def test_blocks_keep_the_amount_of_bone_and_the_place_of_layers():
    rng = np.random.default_rng(3)
    fraction = rng.integers(0, 256, (7, 10, 4), dtype=np.uint8)
    means = block_means(fraction, 3)
    assert means.shape == (3, 4, 2)
    for place in np.ndindex(means.shape):
        block = fraction[tuple(slice(3 * i, 3 * i + 3) for i in place)]
        assert abs(int(means[place]) - block.sum(dtype=int) / 27) <= 0.5
    assert changed_box(fraction, fraction) is None
    other = fraction.copy()
    other[2, 5, 1] ^= 1
    other[4, 6, 3] ^= 1
    low, high = changed_box(fraction, other)
    assert (low.tolist(), high.tolist()) == ([2, 5, 1], [5, 7, 4])
