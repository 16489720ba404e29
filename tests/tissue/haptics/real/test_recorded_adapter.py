"""A record as a device: the poses of a file, one a tick, and the run that it moves."""

import numpy as np
import pytest

from meshes.paths.toolpath import POSE_COLUMNS
from tissue.haptics.real.adapter import RecordedAdapter
from tissue.objects.simulate import simulate
from tissue.scene.coupling import Hardware
from tissue.scene.load import load_scene

SHORT = f"time_s,{','.join(POSE_COLUMNS)}\n0,1,2,3,0,0,0,1\n0.0004,1,2,3,0,0,0,1\n"
"""Poses that last less than half a tick."""


def table(path, times, heights_mm, quaternion=(0.0, 0.0, 0.0, 1.0)):
    """A file of poses that go up and down."""
    rows = [
        (time, 1.0, 2.0, height, *quaternion)
        for time, height in zip(times, heights_mm, strict=True)
    ]
    np.savetxt(
        path,
        rows,
        delimiter=",",
        header=",".join(("time_s", *POSE_COLUMNS)),
        comments="",
        fmt="%.17g",
    )
    return Hardware(address=str(path))


def test_a_record_gives_a_pose_each_tick_and_none_after_the_last(tmp_path):
    hardware = table(tmp_path / "poses.csv", (5.0, 5.004, 5.01), (0.0, 4.0, -2.0))
    with RecordedAdapter(hardware) as adapter:
        samples = [adapter.poll() for _ in range(11)]
        assert adapter.poll() is None and adapter.poll() is None
        adapter.push(np.ones(3), np.ones(3))
    heights = [1e3 * sample.position_m[2] for sample in samples]
    assert heights == pytest.approx([0, 1, 2, 3, 4, 3, 2, 1, 0, -1, -2], abs=1e-9)
    assert [s.velocity_m_s[2] for s in samples[1:5]] == pytest.approx([1.0] * 4)
    assert [s.velocity_m_s[2] for s in samples[5:]] == pytest.approx([-1.0] * 6)
    with adapter:
        assert adapter.poll() == samples[0]  # entered again it begins anew
        adapter.close()
        assert adapter.poll() is None


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_a_run_by_a_record_starts_at_its_pose_and_turn(tmp_path, scale):
    """The tool starts at the first pose at any scale, turned as it was recorded."""
    times, turn = np.linspace(0.0, 0.2, 5), (0.0, 0.6, 0.0, 0.8)
    hardware = table(tmp_path / "poses.csv", times, 15.0 - 10.0 * times, turn)
    keys = {
        "device": "recorded",
        "hardware.address": hardware.address,
        "coupling.motion_scale": scale,
    }
    run = simulate(load_scene("wall", keys | {"duration_s": 0.2}))
    tool = run.trace.vectors("tool", "mm")
    np.testing.assert_allclose(tool[0], (1.0, 2.0, 15.0), atol=1e-9)
    np.testing.assert_allclose(tool[-1], (1.0, 2.0, 15.0 - 1.99 * scale), atol=1e-3)
    found = np.array([run.trace[f"tool_q{axis}"][-1] for axis in "xyzw"])
    assert abs(found @ turn) == pytest.approx(1.0, abs=1e-9)
