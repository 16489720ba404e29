"""Every built-in scene works with every command, in the quickest form of each."""

import json
from contextlib import nullcontext
from functools import partial

import pytest

from tissue.evaluation import stability_report
from tissue.evaluation.charts import frontier, measure, settings
from tissue.haptics.loop import stability_map
from tissue.scene.load import load_scene, scene_names

SHORT_S = "0.04"
"""Length of the runs [s]: beyond the start of every part of a run."""
VIEWED = ("incision", "liver-press", "milling", "molar", "needle", "wall")
"""One scene of each kind of tissue, whose run is drawn, reported and judged."""
CHARTED = {"milling": 0.2, "palpation": 0.1, "wall": 0.2}
"""Scenes of bone, organ and wall, and the time after its first contact on the coarsest grid [s]."""
pytestmark = [pytest.mark.slow]


def finished(command, *arguments):
    """Run a command that must succeed; return what it printed."""
    code, out, error = command(*arguments)
    assert code == 0, f"{' '.join(map(str, arguments))}\n{out}\n{error}"
    return out


TOOTH = ("voxels.spacing_mm=0.2", "stress.cell_mm=0.8")
COARSE = {
    "palpation": ("organ.order=1",),
    "milling": ("voxels.spacing_mm=0.4",),
    "glenoid": ("voxels.spacing_mm=0.4",),
    "pedicle": ("voxels.spacing_mm=0.4",),
    "molar": TOOTH,
    "caries": TOOTH,
}
"""Changes that make a scene quick to set up."""


def fast(scene):
    """Return the options of a run that make a scene quick to set up."""
    return [word for change in COARSE.get(scene, ()) for word in ("--set", change)]


@pytest.fixture
def small_map(monkeypatch):
    """Stability maps of two delays and short runs.

    `test_stability_command.py` makes whole maps.
    """
    monkeypatch.setattr(
        stability_report, "stability_map", partial(stability_map.stability_map, rows=4, columns=7)
    )
    monkeypatch.setattr(
        stability_map,
        "measured_critical_N_m",
        partial(stability_map.measured_critical_N_m, ticks=400),
    )


@pytest.mark.parametrize("scene", scene_names())
def test_a_scene_works_with_the_commands_of_runs(command, small_map, tmp_path, scene):
    script, hand, picture = tmp_path / "script", tmp_path / "hand", tmp_path / "view.png"
    run = ("run", scene, "--duration-s", SHORT_S, *fast(scene))
    held = ("device=touch", "prediction=koopman", "perception=population")
    by_hand = [word for change in held for word in ("--set", change)]
    finished(command, *run, *by_hand, "--no-pictures", "--out", hand)
    assert json.loads((hand / "summary.json").read_text())["status"] == "complete"
    if scene in VIEWED:
        finished(command, *run, "--out", script)
        finished(command, "report", script)
        finished(command, "stability", scene, "--set", "device=touch")
        finished(command, "view", script, "--screenshot", picture)
        assert picture.stat().st_size > 1000
    assert load_scene(scene).name in finished(command, "scenes", scene)


def coarsest_and_finest(scene, *, quick):
    """Return the two ends of a scene's settings."""
    every = settings.settings_of(scene, quick=quick)
    return [every[0], *every[1:][-1:]]


@pytest.mark.parametrize("scene", CHARTED)
def test_a_scene_can_be_charted(command, tmp_path, scene, monkeypatch):
    """A scene can be charted at two settings, at one place, on coarser voxels.

    No other processes are used: `test_charts.py` covers them.
    """
    monkeypatch.setattr(measure, "EXCERPT_S", {True: CHARTED[scene]})
    monkeypatch.setattr(settings, "PLACES", settings.PLACES[:1])
    monkeypatch.setitem(settings.VOXEL_SHARES, True, (2.0, 1.4, 1.0))
    for module in (frontier, measure):
        monkeypatch.setattr(module, "settings_of", coarsest_and_finest)
    monkeypatch.setattr("tissue.system.workers.worker_pool", lambda workers: nullcontext(None))
    out = finished(command, "chart", scene, "--quick", "--out", tmp_path / "charts")
    assert scene in out
    rows = (tmp_path / "charts" / f"{scene}.csv").read_text("utf-8").splitlines()
    assert len(rows) >= 2 and rows[1].split(",")[0] == scene
