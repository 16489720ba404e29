"""Exchange with a service: content and times of frames. The stand-in uses the documented frames."""

import threading
import time

import numpy as np
import pytest
from haply_service import DEVICE, HaplyService

from tissue import InputError
from tissue.haptics.device.device import DeviceError
from tissue.haptics.real.haply import HaplyAdapter
from tissue.scene.coupling import Hardware

PATIENCE_S = 20.0
"""Longest time to wait for an expected event [s]; no result depends on it."""


@pytest.fixture
def service():
    with HaplyService() as running:
        yield running


def adapter_of(service, device=""):
    return HaplyAdapter(Hardware(address=service.url + device))


def wait_for(condition, adapter=None, force_N=None):
    """Push a force and poll until something holds; the samples that came."""
    until, samples = time.perf_counter() + PATIENCE_S, []
    while not condition(samples):
        assert time.perf_counter() < until, "it did not come"
        if adapter is not None and force_N is not None:
            adapter.push(np.array(force_N), np.zeros(3))
        if adapter is not None and (sample := adapter.poll()) is not None:
            samples.append(sample)
        time.sleep(1e-3)
    return samples


@pytest.mark.parametrize("version", ["3.5.0", "3.1.2"])
def test_a_force_arrives_in_the_spelling_of_the_services_version(version):
    with HaplyService(version) as service, adapter_of(service) as adapter:
        wait_for(
            lambda _: service.commands and service.last_N() == (0.5, -0.25, 1.0),
            adapter,
            (0.5, -0.25, 1.0),
        )
        sent = service.received[-1]["inverse3"][0]["commands"]["set_cursor_force"]
        assert list(sent) == ["vector" if version == "3.5.0" else "values"]
    wait_for(lambda _: service.last_N() == (0.0, 0.0, 0.0))


@pytest.mark.parametrize("version", ["3.5.0", "3.1.2"])
def test_partial_frames_give_whole_samples(version):
    with HaplyService(version) as service:
        service.partial, service.buttons = True, {"a": True, "b": False, "c": False}
        service.orientation = {"w": 0.6, "x": 0.0, "y": 0.8, "z": 0.0}
        with adapter_of(service) as adapter:
            samples = wait_for(lambda samples: len(samples) > 20, adapter, (0.0, 0.0, 0.0))
    assert all(each.buttons == 1 and each.quaternion == (0.0, 0.8, 0.0, 0.6) for each in samples)
    assert all(each.position_m == pytest.approx((0.0, -0.12, 0.15), abs=1e-3) for each in samples)


def test_a_force_that_is_not_pushed_again_is_taken_off(service):
    with adapter_of(service) as adapter:
        wait_for(
            lambda _: service.commands and service.last_N() == (1.0, 0.0, 0.0),
            adapter,
            (1.0, 0.0, 0.0),
        )
        wait_for(lambda _: service.last_N() == (0.0, 0.0, 0.0))


@pytest.mark.parametrize("status", ["calibrated", "power_supply", "ready"])
def test_a_device_that_is_not_ready_is_refused_before_any_force(service, status):
    service.status[status] = False
    with (
        pytest.raises(InputError, match=rf"^haply must .*, got {status} = false of {DEVICE}: "),
        adapter_of(service),
    ):
        pass
    assert not service.commands
    found = HaplyAdapter.find(service.url)
    assert [each.problem.startswith("haply must ") for each in found] == [True] and found[
        0
    ].limits is not None


def test_a_device_that_loses_its_calibration_ends_the_run_without_force(service):
    with (
        pytest.raises(DeviceError, match="haply must be calibrated"),
        adapter_of(service) as adapter,
    ):
        wait_for(
            lambda _: service.commands and service.last_N() == (1.0, 0.0, 0.0),
            adapter,
            (1.0, 0.0, 0.0),
        )
        service.status["calibrated"] = False
        wait_for(lambda _: False, adapter, (1.0, 0.0, 0.0))
    wait_for(lambda _: not service.is_open)
    assert service.last_N() == (0.0, 0.0, 0.0)


def test_a_restart_of_the_service_is_survived_without_force_until_the_loop_pushes_again(service):
    with adapter_of(service) as adapter:
        wait_for(
            lambda _: service.commands and service.last_N() == (1.0, 0.0, 0.0),
            adapter,
            (1.0, 0.0, 0.0),
        )
        service.stop()
        sessions = service.sessions
        wait_for(lambda _: any("closed the connection" in what for what in adapter.happened()))
        service.start()
        wait_for(lambda samples: len(samples) > 3 and service.sessions > sessions, adapter)
        assert next(force for _, number, force in service.commands if number > sessions) == (
            0.0,
            0.0,
            0.0,
        )
        wait_for(lambda _: service.last_N() == (1.0, 0.0, 0.0), adapter, (1.0, 0.0, 0.0))
    wait_for(lambda _: not service.is_open)
    assert service.last_N() == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("fault", [{"late_s": 0.06}, {"dropped": 1.0}, {"broken": "{"}], ids=str)
def test_late_dropped_and_broken_answers_take_the_force_off(service, fault):
    """Late, dropped and broken answers take the force off.

    The exchange itself handles late and dropped ones; broken ones give no sample, so that the
    watchdog acts.
    """
    with adapter_of(service) as adapter:
        wait_for(
            lambda _: service.commands and service.last_N() == (1.0, 0.0, 0.0),
            adapter,
            (1.0, 0.0, 0.0),
        )
        for name, value in fault.items():
            setattr(service, name, value)
        if "broken" in fault:
            wait_for(
                lambda _: service.received and adapter.poll() is None and adapter.poll() is None
            )
        wait_for(lambda _: service.last_N() == (0.0, 0.0, 0.0))
        for name in fault:
            setattr(service, name, type(fault[name])())
        wait_for(lambda samples: len(samples) > 10, adapter, (0.0, 0.0, 0.0))
    wait_for(lambda _: not service.is_open)
    assert service.last_N() == (0.0, 0.0, 0.0)


def test_late_answers_are_never_taken_for_new_samples(service):
    """Late answers are never taken for new samples.

    Each answer comes 60 ms late: every polled sample was measured before the answers became late.
    """
    with adapter_of(service) as adapter:
        wait_for(len, adapter, (0.0, 0.0, 0.0))
        service.late_s = 0.06
        wait_for(
            lambda _: any("did not answer within" in what for what in adapter.happened()), adapter
        )
        adapter.poll()
        service.arm.aim = lambda time_s: (0.02, 0.0, 0.0)
        until = time.perf_counter() + 0.5
        while time.perf_counter() < until:
            adapter.push(np.ones(3), np.zeros(3))
            assert adapter.poll() is None
            time.sleep(1e-3)


def test_what_is_found_where_no_service_is():
    with HaplyService() as service:
        url = service.url
        found = HaplyAdapter.find(url)
        assert (found[0].name, found[0].where, found[0].problem) == ("haply", f"{url}#{DEVICE}", "")
        assert "049D, firmware 7.4, right-handed, service 3.5" in found[0].detail
        service.devices = ()
        assert HaplyAdapter.find(url)[0].problem.startswith("haply must list an Inverse3, got none")
    (none,) = HaplyAdapter.find(url)
    assert none.limits is None and none.problem.startswith(f"haply must be reached at {url}, got ")
    assert "start the Inverse Service" in none.problem
    assert "hardware.address must be ws://" in HaplyAdapter.find("usb")[0].problem


def test_closing_ends_with_zero_from_any_thread_and_twice(service):
    with adapter_of(service) as adapter:
        wait_for(
            lambda _: service.commands and service.last_N() == (1.0, 0.0, 0.0),
            adapter,
            (1.0, 0.0, 0.0),
        )
        adapter.close()
        wait_for(lambda _: service.last_N() == (0.0, 0.0, 0.0))
        count = len(service.commands)
        adapter.push(np.ones(3), np.zeros(3))
        adapter.close()
    assert len(service.commands) == count


def test_entering_again_while_the_service_is_away_leaves_one_thread_that_sends(service):
    """Entering again leaves one thread that sends.

    The thread of the first session still reconnects when the adapter is entered again. It ends with
    its own session, and its connection carries no force.
    """
    adapter = adapter_of(service)
    resume = threading.Event()
    with adapter:
        session = adapter._session
        connect = session.connect

        def slow_connect():
            assert resume.wait(PATIENCE_S)
            connect()

        session.connect = slow_connect
        service.stop()
        wait_for(lambda _: any("closed the connection" in what for what in adapter.happened()))
        time.sleep(0.2)
    service.start()
    sessions = service.sessions
    with adapter:
        resume.set()
        session._thread.join(PATIENCE_S)
        assert not session._thread.is_alive()
        start = len(service.commands)
        wait_for(
            lambda _: len(service.commands) > start + 50 and service.last_N() == (1.0, 0.0, 0.0),
            adapter,
            (1.0, 0.0, 0.0),
        )
        pushing = {number for _, number, force in list(service.commands) if any(force)}
        assert len({number for number in pushing if number > sessions}) == 1
    wait_for(lambda _: not service.is_open)
    assert service.last_N() == (0.0, 0.0, 0.0)
