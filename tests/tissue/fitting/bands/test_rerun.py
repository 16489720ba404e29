"""Bands whose samples are runs of their own.

The tests cover their figures, failing runs, and runs that end early.
"""

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import count
from threading import Barrier

import numpy as np
import pytest
from scene_kinds import kinds, write_files

from meshes.base.errors import InputError
from meshes.base.progress import silent
from tissue.fitting.bands import sample_loads as rerun
from tissue.fitting.bands.band import band_of
from tissue.fitting.bands.sample_loads import (
    LOADS,
    NUMBER,
    figures_of,
    intervals,
    over_time,
    table_of,
)
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
def test_figures_of_a_run_hold_temperature_and_stress_and_reweighed_ones_do_not():
    changes = {"voxels.spacing_mm": 0.2, "stress.cell_mm": 0.8, "duration_s": 0.7, "heat": True}
    scene = load_scene("caries", changes)
    run = simulate(scene, cores=1)
    found = figures_of(run)
    assert found["greatest_pulp_rise_K",] == run.trace["pulp_rise_K"].max() > 0.0
    stresses = [frame.cells["von_mises_MPa"] for frame in run.parts.fields.frames]
    assert found["greatest_von_mises_MPa",] == np.nanmax(stresses) > 0.0
    reweighed = band_of(scene, 16, cores=1).summary
    assert set(reweighed["without"]) >= {"stress", "greatest_pulp_rise_K"}


def outcomes(monkeypatch, which):
    """Let some runs of samples fail, and all others give loads of their own."""
    runs = count()

    def outcome(*_):
        number = next(runs)
        if number in which:
            return "it broke down"
        return np.full((30, 8), float(number)), {name: float(number) for name in LOADS}

    monkeypatch.setattr(rerun, "_outcome", outcome)


def test_a_sample_that_breaks_down_is_named_and_left_out(pushed, monkeypatch):
    outcomes(monkeypatch, {3})
    band = band_of(pushed, 16)
    assert (band.summary["samples"], band.summary["failed"]) == (15, 1)
    assert band.summary["problems"] == {"sample_03.toml": "it broke down"}
    assert band.numbers.tolist() == [each for each in range(16) if each != 3]
    assert band.figures[:, 0].tolist() == band.numbers.tolist()
    assert len(band.files) == 16, "the file of the one that failed is there to be run"


def test_a_band_of_which_more_than_a_tenth_fails_is_refused(pushed, monkeypatch):
    outcomes(monkeypatch, {3, 9})
    with pytest.raises(
        InputError, match=r"got 2 failed samples of 16 .*sample_03.toml: it broke down"
    ):
        band_of(pushed, 16)


def killing(scene, compute, sample):
    """A worker that is lost with one sample, and runs all others."""
    if "# lost" in sample[1]:
        os.kill(os.getpid(), signal.SIGKILL)
    return sample[1], {}


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")
def test_a_sample_that_kills_its_worker_costs_no_other(pushed, monkeypatch):
    monkeypatch.setattr(rerun, "_outcome", killing)
    files = tuple(f"# lost {k}" if k == 3 else f"{k}" for k in range(4))
    found = dict(rerun.reruns(pushed, files, workers=rerun.Workers(2), report=silent))
    assert sorted(found) == list(range(4))
    assert "the worker was lost" in found.pop(3)
    assert all(outcome == (str(k), {}) for k, outcome in found.items())


def test_a_scheduler_gets_all_samples_at_once(pushed, monkeypatch):
    gate = Barrier(8)

    @contextmanager
    def given(workers, scheduler, *, patience_s):
        with ThreadPoolExecutor(8) as pool:
            yield pool

    monkeypatch.setattr("tissue.system.workers.executor", given)
    monkeypatch.setattr(rerun, "_outcome", lambda *_: f"passed {gate.wait(timeout=5.0)}")
    workers = rerun.Workers(scheduler="tcp://node1:8786")
    found = dict(rerun.reruns(pushed, ("",) * 8, workers=workers, report=silent))
    assert sorted(found.values()) == [f"passed {at}" for at in range(8)]


def test_a_scheduler_that_does_not_answer_is_named(pushed, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("tissue.system.workers.PATIENCE_S", 0.2)
    with pytest.raises(
        InputError, match=r"scheduler must answer, got no answer from dask://127\.0\.0\.1:9"
    ):
        list(
            rerun.reruns(
                pushed, ("",), workers=rerun.Workers(1, "dask://127.0.0.1:9"), report=silent
            )
        )
