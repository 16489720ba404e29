"""Every built-in scene works with every command, in the quickest form of each."""

import json
from contextlib import nullcontext

import pytest

from tissue.evaluation.charts import frontier, measure, settings
from tissue.scene.load import load_scene, scene_names

SHORT_S = "0.04"
"""Length of the runs [s]: beyond the start of every part of a run."""
CHARTED = {"milling": 0.2, "palpation": 0.1, "wall": 0.2}
"""Scenes of bone, organ and wall, and the time after its first contact on the coarsest grid [s]."""
pytestmark = [pytest.mark.slow]


def finished(command, *arguments):
    """Run a command that must succeed; return what it printed."""
    code, out, error = command(*arguments)
    assert code == 0, f"{' '.join(map(str, arguments))}\n{out}\n{error}"
    return out


def fast(scene):
    """Changes that make a scene quick to set up."""
    if scene == "palpation":
        return ("--set", "organ.order=1")
    return ()


@pytest.mark.parametrize("scene", scene_names())
def test_a_scene_works_with_the_commands_of_runs(command, tmp_path, scene):
    script, hand, picture = tmp_path / "script", tmp_path / "hand", tmp_path / "view.png"
    run = ("run", scene, "--duration-s", SHORT_S, *fast(scene))
    held = ("device=touch", "prediction=koopman", "perception=population")
    finished(command, *run, "--out", script)
    by_hand = [word for change in held for word in ("--set", change)]
    finished(command, *run, *by_hand, "--no-pictures", "--out", hand)
    assert json.loads((hand / "summary.json").read_text())["status"] == "complete"
    finished(command, "report", script)
    finished(command, "view", script, "--screenshot", picture)
    finished(command, "stability", scene, "--set", "device=touch")
    assert load_scene(scene).name in finished(command, "scenes", scene)
    assert picture.stat().st_size > 1000


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
    assert len(rows) >= 2 and rows[1].split(",")[1] == scene
