"""Live run on topics of ROS 2.

The packages of ROS 2 are a stand-in on the path of both processes: nothing else depends on it.
"""

import json
import os
import sys

import numpy as np
import pytest
from ros2_stand_in import LOG, write_packages

from tissue import load_scene, simulate
from tissue.simulation.live.run import LiveSettings
from tissue.simulation.live.run import live as run_live

SCENE = {"duration_s": 0.4, "device": "none"}
TOPICS = ["/tissue/measured_cp", "/tissue/measured_cv", "/tissue/measured_cf"]
STAND_INS = ("rclpy", "geometry_msgs", "crtk_msgs", "stand_in_messages")


@pytest.fixture
def no_display(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("tissue.simulation.live.run.display_problem", lambda: "there is no display")


def install(tmp_path, monkeypatch, **options):
    """Put the stand-in on the path here and in started processes.

    Returns the file that takes the published messages.
    """
    folder = write_packages(tmp_path / "packages", **options)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    )
    monkeypatch.setenv(LOG, str(tmp_path / "log"))
    (tmp_path / "log").touch()
    return tmp_path / "log"


@pytest.fixture(autouse=True)
def forgotten():
    yield
    for name in [name for name in sys.modules if name.split(".")[0] in STAND_INS]:
        del sys.modules[name]


def published(log):
    """Messages by topic."""
    found = {}
    for line in log.read_text().splitlines():
        entry = json.loads(line)
        found.setdefault(entry.pop("topic"), []).append(entry)
    return found


def values(entry):
    """Return the numbers of a message without its header, in their order."""
    return [
        x
        for name, part in entry.items()
        if name != "header"
        for each in part.values()
        for x in each.values()
    ]


def test_a_run_is_on_the_topics_tick_for_tick_in_si(tmp_path, monkeypatch, no_display):
    log = install(tmp_path, monkeypatch)
    run = run_live(load_scene("wall", SCENE), LiveSettings(ros2=True))
    found, trace = published(log), run.trace
    np.testing.assert_array_equal(trace.rows, simulate(load_scene("wall", SCENE)).trace.rows)
    shown = trace.rows[::8]
    columns = list(trace.columns)
    scales = {
        "measured_cp": ["tool_x_mm", "tool_qw"],
        "measured_cv": ["velocity_x_mm_s", "angular_velocity_z_rad_s"],
        "measured_cf": ["model_force_x_N", "model_torque_z_Nm"],
    }
    for topic, (first, last) in scales.items():
        rows = shown[:, columns.index(first) : columns.index(last) + 1].copy()
        if topic != "measured_cf":
            rows[:, :3] *= 1e-3
        entries = found[f"/tissue/{topic}"]
        assert len(entries) > 5
        places = [
            np.flatnonzero((np.abs(rows - values(entry)) < 1e-15).all(axis=1)) for entry in entries
        ]
        assert all(len(place) for place in places), f"{topic} gave what no tick had"
        assert all(entry["header"]["frame_id"] == "tissue_scene" for entry in entries)
        stamps = [
            1e9 * entry["header"]["stamp"]["sec"] + entry["header"]["stamp"]["nanosec"]
            for entry in entries
        ]
        assert np.all(np.diff(stamps) > 0.0)
    states = [entry["state"] for entry in found["/tissue/operating_state"]]
    assert states[0] == "ENABLED" and states[-1] == "DISABLED" and len(found["shutdown"]) == 1
    count = len(found["/tissue/measured_cp"])
    assert (
        run.parts.notes["ros2"]
        == f"published {count} times as {', '.join(TOPICS)}, /tissue/operating_state"
    )
