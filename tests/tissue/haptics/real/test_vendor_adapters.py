"""Adapters of Force Dimension and OpenHaptics.

The stand-ins have the functions of their packages.
"""

import threading
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from vendor_doubles import FAILED, TIMEGUARD, ForceDimension, OpenHaptics

from meshes.base.errors import InputError
from tissue.haptics.device.device import DeviceError
from tissue.haptics.real import openhaptics
from tissue.haptics.real.forcedimension import MOST_FAILURES, ForceDimensionAdapter
from tissue.haptics.real.openhaptics import HELD_S, OpenHapticsAdapter
from tissue.scene.coupling import Hardware

FORCE, TORQUE = np.array([1.0, -2.0, 3.0]), np.array([0.01, 0.02, -0.03])


def test_a_device_of_force_dimension_is_read_and_pushed(monkeypatch):
    device = ForceDimension().install(monkeypatch)
    with ForceDimensionAdapter() as adapter:
        sample = adapter.poll()
        adapter.push(FORCE, TORQUE)
    assert sample.position_m == (0.01, -0.02, 0.03) and sample.velocity_m_s == (0.1, 0.2, 0.3)
    assert abs(np.dot(sample.quaternion, device.rotation.as_quat())) == pytest.approx(1.0)
    assert sample.spin_rad_s == (1.0, 2.0, 3.0) and sample.buttons == 5
    # a wrist without motors plays no torque
    assert device.wrenches == [(1.0, -2.0, 3.0, 0.0, 0.0, 0.0), (0.0,) * 6]
    assert device.calls == [
        "open",
        "setMaxForce",
        "enableForce",
        "setForceAndTorque",
        "setForceAndTorque",
        "disableForce",
        "close",
    ]
    assert device.limits == {"force": 12.0} and not device.enabled


def test_what_is_not_new_is_no_sample_and_no_velocity_is_rest(monkeypatch):
    device = ForceDimension().install(monkeypatch)
    with ForceDimensionAdapter() as adapter:
        device.answers["getPositionAndOrientationFrame"] = TIMEGUARD
        assert adapter.poll() is None
        device.answers = {"getLinearVelocity": FAILED, "getAngularVelocityRad": FAILED}
        sample = adapter.poll()
        assert sample.velocity_m_s == sample.spin_rad_s == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("call", ["getPositionAndOrientationFrame", "setForceAndTorque"])
def test_a_device_that_answers_no_more_is_lost_and_left_without_force(monkeypatch, call):
    device = ForceDimension().install(monkeypatch)
    lost = pytest.raises(
        DeviceError, match=r"the device must answer, got the device is in use\. Check"
    )
    with lost, ForceDimensionAdapter() as adapter:
        for count in range(3 * MOST_FAILURES):
            device.answers[call] = 0 if count < MOST_FAILURES and count % 2 else FAILED
            if call.startswith("get"):
                adapter.poll()
            else:
                adapter.push(FORCE, TORQUE)
    assert count >= MOST_FAILURES  # single failures in between are survived
    assert device.calls[-2:] == ["disableForce", "close"]


@pytest.mark.parametrize("call", ["open", "setMaxForce", "enableForce"])
def test_a_device_that_cannot_be_opened_is_refused_and_closed(monkeypatch, call):
    device = ForceDimension().install(monkeypatch)
    device.answers[call] = FAILED
    with (
        pytest.raises(InputError, match="the device must answer, got the device is in use"),
        ForceDimensionAdapter(),
    ):
        pass
    assert not device.enabled and (call == "open" or device.calls[-1] == "close")


def test_close_from_another_thread_switches_the_motors_off_even_where_a_call_fails(monkeypatch):
    device = ForceDimension().install(monkeypatch)
    adapter = ForceDimensionAdapter().__enter__()
    device.answers["setForceAndTorque"] = FAILED
    adapter.close()
    adapter.close()
    assert device.calls[-2:] == ["disableForce", "close"] and device.calls.count("close") == 1


def test_a_touch_is_read_and_pushed_in_the_vendors_thread_alone(monkeypatch, capsys):
    device = OpenHaptics().install(monkeypatch)
    with OpenHapticsAdapter() as adapter:
        assert adapter.poll() is None and device.forces == []
        adapter.push(FORCE, TORQUE)
        assert device.forces == []  # nothing outside the vendor's thread
        device.step()
        sample = adapter.poll()
        assert adapter.poll() is None
        adapter.push(FORCE, TORQUE)
        ending = threading.Thread(target=adapter.close)
        ending.start()
        while not adapter._ended:
            time.sleep(1e-3)
        device.step()  # the vendor's thread plays zero before it is stopped
        ending.join()
        adapter.push(FORCE, TORQUE)
        device.step()
    assert sample.position_m == pytest.approx((0.01, -0.02, 0.03)) and sample.buttons == 2
    assert abs(np.dot(sample.quaternion, device.rotation.as_quat())) == pytest.approx(1.0)
    assert device.forces == [(1.0, -2.0, 3.0), (0.0, 0.0, 0.0)]
    assert device.calls == ["init Default Device", "force", "start", "stop", "close 0"]
    assert capsys.readouterr().out == ""  # what the package prints is not shown


def test_a_second_touch_is_refused_and_the_first_is_left_running(monkeypatch):
    device = OpenHaptics().install(monkeypatch)
    with OpenHapticsAdapter(Hardware(address="left")) as left:
        assert OpenHapticsAdapter.find("left")[0].detail == "in use by this program"
        with pytest.raises(InputError, match=r"got right as a second device\. Close left first"):
            OpenHapticsAdapter(Hardware(address="right")).__enter__()
        device.step()
        assert left.poll() is not None
    with OpenHapticsAdapter(Hardware(address="right")):
        device.step()
    assert device.calls.count("start") == device.calls.count("stop") == 2


def test_velocities_of_a_touch_are_taken_over_ten_calls(monkeypatch):
    device, clock = OpenHaptics().install(monkeypatch), [10.0]
    monkeypatch.setattr(openhaptics, "perf_counter", lambda: clock[0])
    with OpenHapticsAdapter() as adapter:
        device.step()
        assert adapter.poll().velocity_m_s == (0.0, 0.0, 0.0)
        for _ in range(20):
            clock[0] += 1e-3
            device.position_mm = device.position_mm + np.array([0.1, 0.0, -0.2])
            device.rotation = Rotation.from_rotvec([0.0, 0.002, 0.0]) * device.rotation
            device.step()
        sample = adapter.poll()
    assert sample.velocity_m_s == pytest.approx((0.1, 0.0, -0.2), abs=1e-12)
    assert sample.spin_rad_s == pytest.approx((0.0, 2.0, 0.0), abs=1e-9)


def test_a_force_that_is_not_pushed_again_ends(monkeypatch):
    device, clock = OpenHaptics().install(monkeypatch), [10.0]
    monkeypatch.setattr(openhaptics, "perf_counter", lambda: clock[0])
    with OpenHapticsAdapter() as adapter:
        adapter.push(FORCE, TORQUE)
        for later in (0.5 * HELD_S, 0.99 * HELD_S, 1.01 * HELD_S):
            clock[0] = 10.0 + later
            device.step()
    assert device.forces == [tuple(FORCE), tuple(FORCE), (0.0, 0.0, 0.0)]


def test_a_touch_that_fails_is_lost_and_not_called_again(monkeypatch):
    device = OpenHaptics().install(monkeypatch)
    with OpenHapticsAdapter() as adapter:
        monkeypatch.setattr(device, "position_mm", None)
        device.step()
        with pytest.raises(
            DeviceError, match=r"the device must answer, got AttributeError \(.*\. Check its cable"
        ):
            adapter.poll()
    assert device.calls[-2:] == ["stop", "close 0"]
    adapter._serve()  # one more call of a thread that ends late
    assert device.forces == []
