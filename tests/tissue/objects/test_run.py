"""A run has one interface, whether it was simulated just now or read back from its folder."""

import numpy as np
import pytest

import tissue
from tissue import InputError


def test_a_run_and_its_folder_hold_the_same(run, back):
    assert isinstance(run, tissue.Run) and isinstance(back, tissue.Run)
    assert back.scene == run.scene and back.summary == run.summary and back.events == run.events
    assert (
        np.array_equal(back.trace.rows, run.trace.rows) and back.trace.columns == run.trace.columns
    )
    assert np.array_equal(back.timing.rows, run.timing.rows)
    assert np.array_equal(back.remaining, run.remaining) and np.array_equal(back.poses, run.poses)
    assert np.array_equal(back.replay().at(150), run.replay().at(150))
    assert (back.status, back.problem) == (run.status, run.problem) == ("complete", "")
    for name in ("dataset", "surface"):
        mine, other = getattr(run, name)(), getattr(back, name)()
        assert mine.bounds == pytest.approx(other.bounds) and mine.array_names == other.array_names


def test_a_copy_of_a_saved_run_is_that_run(back, tmp_path):
    options = {"formats": ["npz"], "pictures": False}
    copy = tissue.open_run(tissue.open_run(back.path).save(tmp_path / "copy", **options))
    assert copy.summary == back.summary and np.array_equal(copy.remaining, back.remaining)
    assert (tmp_path / "copy/trace.npz").is_file() and not (back.path / "trace.npz").exists()
    with pytest.raises(InputError, match="must not contain another run"):
        tissue.open_run(back.path).save(tmp_path / "copy")
    again = tissue.open_run(tmp_path / "copy")
    again.save(tmp_path / "copy", formats=["mat"], pictures=False)
    assert (tmp_path / "copy/trace.mat").is_file()
