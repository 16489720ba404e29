"""Exchange with a service: content and times of frames. The stand-in uses the documented frames."""

import threading
import time

import numpy as np
import pytest
from haply_service import DEVICE, HaplyService

from tissue import InputError
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


def test_a_force_that_is_not_pushed_again_is_taken_off(service):
    with adapter_of(service) as adapter:
        wait_for(
            lambda _: service.commands and service.last_N() == (1.0, 0.0, 0.0),
            adapter,
            (1.0, 0.0, 0.0),
        )
        wait_for(lambda _: service.last_N() == (0.0, 0.0, 0.0))
        assert service.last_N() == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("status", ["calibrated", "power_supply", "ready"])
def test_a_device_that_is_not_ready_is_refused_before_any_force(service, status):
    service.status[status] = False
    with (
        pytest.raises(InputError, match=rf"^haply must .*, got {status} = false for {DEVICE}\. "),
        adapter_of(service),
    ):
        pass
    assert not service.commands
    found = HaplyAdapter.find(service.url)
    assert [each.problem.startswith("haply must ") for each in found] == [True] and found[
        0
    ].limits is not None


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
