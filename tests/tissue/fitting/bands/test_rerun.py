"""Bands whose samples are runs of their own.

The tests cover their figures, failing runs, and runs that end early.
"""

import os
import re
import signal
from itertools import count

import numpy as np
import pytest
from scene_kinds import kinds, write_files
from scipy.stats import spearmanr

from meshes.base.errors import InputError
from meshes.base.progress import silent
from tissue.fitting.bands import rerun
from tissue.fitting.bands.band import band_of
from tissue.fitting.bands.rerun import NUMBER, intervals, over_time, table_of
from tissue.scene.load import load_scene
from tissue.scene.scene import Scene
from tissue.simulation.simulate import simulate


@pytest.fixture
def pushed(tmp_path):
    """A burr pushed into a block by a given force, whose path depends on its coefficients."""
    return Scene(**kinds(write_files(tmp_path))["block, thrust"])


def test_an_event_that_not_all_samples_have_counts_its_share():
    names, values = table_of(
        [{("events", "it breaks", "time_s"): float(k)} if k % 2 else {} for k in range(10)]
    )
    found = intervals(names, values)["events"]["it breaks"]
    assert found["share"] == 0.5
    assert found["time_s"]["p50"] == 5.0
    assert found["time_s"]["p05"] == pytest.approx(np.quantile([1, 3, 5, 7, 9], 0.05))


def test_beyond_the_end_of_a_sample_a_band_is_that_of_the_others():
    """Beyond the end of a sample the band belongs to the other samples.

    Twenty loads have constant sizes 0 to 19; the two largest end after 5 ticks, the third after 8.
    """
    lengths = np.array([10] * 17 + [8, 5, 5])
    loads = [np.full((count, 8), float(size)) for size, count in enumerate(lengths)]
    quantiles, span = over_time(loads, 1e-3 * np.arange(1, 11))
    assert quantiles[2, :5, 0] == pytest.approx(9.5)
    assert quantiles[2, 5:, 0] == pytest.approx(8.5), "the median of 0 to 17"
    assert span["ticks"] == quantiles.shape[1] == 8, "fewer than nine in ten reach the ninth tick"
    assert span["samples_at_end"] == 18
    assert span["shortest_sample_s"] == pytest.approx(5e-3)
    assert span["run_ends_s"] == pytest.approx(10e-3)
    whole, span = over_time([each[:5] for each in loads], 1e-3 * np.arange(1, 11))
    assert whole.shape[1] == span["ticks"] == 5
    assert span["samples_at_end"] == 20


def test_events_differ_by_their_thresholds_and_not_by_what_was_measured():
    first, second = (
        f"pressed {depth} mm deep: more than {share}% off"
        for depth, share in (("3.0", 5), ("5.7e-1", 10))
    )
    assert NUMBER.sub("…", first) == "pressed … mm deep: more than 5% off"
    assert NUMBER.sub("…", second) == "pressed … mm deep: more than 10% off"


@pytest.mark.slow
def test_runs_of_each_sample_give_temperature_and_stress_a_band():
    """Runs of each sample give temperature and stress a band.

    Both follow the force, so their bands are wider than the pulp's rise and the stress of one
    sample.
    """
    changes = {"voxels.spacing_mm": 0.15, "stress.cell_mm": 0.6, "duration_s": 0.7, "heat": True}
    scene = load_scene("caries", changes)
    band = band_of(scene, 16, each_run=True)
    stress = band.summary["greatest_von_mises_MPa"]
    peak = band.summary["force_N"]["peak"]
    assert 0.0 < stress["p05"] < 0.7 * stress["p95"]
    assert (
        0.0
        < band.summary["greatest_pulp_rise_K"]["p05"]
        < 0.7 * band.summary["greatest_pulp_rise_K"]["p95"]
    )
    assert "without" not in band.summary
    sizes = band.figures[
        :,
        [
            band.figure_names.index(name)
            for name in (("force_N", "peak"), ("greatest_von_mises_MPa",))
        ],
    ]
    assert spearmanr(*sizes.T).statistic > 0.5, "the stress is that of the force"
    reweighed = band_of(scene, 16).summary
    assert set(reweighed["without"]) >= {"stress", "greatest_pulp_rise_K"}
    assert peak["p50"] == pytest.approx(reweighed["force_N"]["peak"]["p50"], rel=0.5), "16 samples"


def failing(monkeypatch, which):
    """Runs of which some end in an error that is none of bad input."""
    runs = count()

    def simulated(scene, **settings):
        if next(runs) in which:
            raise FloatingPointError("the solver broke down")
        return simulate(scene, **settings)

    monkeypatch.setattr(rerun, "simulate", simulated)


@pytest.mark.slow
def test_a_sample_that_breaks_down_is_named_and_left_out(pushed, monkeypatch):
    failing(monkeypatch, {3})
    band = band_of(pushed, 16)
    assert band.summary["samples"] == len(band.figures) == 15
    assert band.summary["failed"] == 1
    assert band.summary["problems"] == {
        "sample_03.toml": "FloatingPointError: the solver broke down"
    }
    assert band.numbers.tolist() == [each for each in range(16) if each != 3]
    removed = band.summary["removed_mm3"]["cortical"]
    assert removed["p05"] < removed["p50"] < removed["p95"], (
        "what is removed depends on the force's law"
    )
    assert len(band.files) == 16, "the file of the one that failed is there to be run"


def test_a_band_of_which_more_than_a_tenth_fails_is_refused(pushed, monkeypatch):
    runs = count()
    monkeypatch.setattr(
        rerun,
        "_outcome",
        lambda *_: "it broke down" if next(runs) in (3, 9) else (np.zeros((30, 8)), {}),
    )
    with pytest.raises(
        InputError,
        match=re.escape("got 2 of 16 (sample_03.toml: it broke down; sample_09.toml: it broke"),
    ):
        band_of(pushed, 16)


def killing(scene, file, compute):
    """A worker that is lost with one sample, and runs all others."""
    if "# lost" in file:
        os.kill(os.getpid(), signal.SIGKILL)
    return file, {}


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")
def test_a_sample_that_kills_its_worker_costs_no_other(pushed, monkeypatch):
    monkeypatch.setattr(rerun, "_outcome", killing)
    files = tuple(f"# lost {k}" if k == 3 else f"{k}" for k in range(16))
    found = dict(rerun.reruns(pushed, files, workers=rerun.Workers(2), report=silent))
    assert sorted(found) == list(range(16))
    assert found.pop(3) == rerun.LOST_WORKER
    assert all(outcome == (str(k), {}) for k, outcome in found.items())


@pytest.mark.slow
def test_a_band_by_a_dask_scheduler_is_that_of_this_machine(pushed):
    distributed = pytest.importorskip("distributed")
    alone = band_of(pushed, 16, cores=1)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        band = band_of(pushed, 16, scheduler=cluster.scheduler_address)
    assert np.array_equal(band.figures, alone.figures, equal_nan=True)
    assert np.array_equal(band.quantiles, alone.quantiles)
    assert band.summary == alone.summary


def test_a_scheduler_that_does_not_answer_is_named(pushed, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(rerun, "PATIENCE_S", 0.2)
    with pytest.raises(
        InputError, match=re.escape("scheduler must answer, got dask://127.0.0.1:9 (")
    ):
        list(
            rerun.reruns(
                pushed, ("",), workers=rerun.Workers(1, "dask://127.0.0.1:9"), report=silent
            )
        )
