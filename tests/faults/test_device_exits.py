"""Whatever ends a run, a device is left without force: every exit, for every kind of device."""

import os
import signal
import threading
import time

import numpy as np
import pytest
from device_doubles import PRESSED_S, Computed, Managed, Recording, block

from meshes.base.errors import InputError
from tissue import load_scene, simulate
from tissue.haptics.device.device import DeviceError, device_parameters
from tissue.haptics.device.safe_device import RAMP_S, SafeDevice
from tissue.haptics.hand_motion import HandMotion
from tissue.models.tissue_model import TICK_S
from tissue.simulation.run_folder import SavedRun
from tissue.system.stopping import STOPS, Terminated

KINDS = (Recording, Managed, Computed)
SECONDS = 0.4
PUSHING_N = 1.0
"""Force at the time of a fault: the wall is pressed by some millimetres."""


def pressed(device, *, seconds=SECONDS, **options):
    return simulate(load_scene("wall", {"duration_s": seconds}), device=device, **options)


def raising(error):
    def fault(device):
        raise error

    return fault


def assert_left_alone(device, *, pushed=True):
    """It was pushing, and its last command is zero."""
    assert not pushed or device.sizes_N.max() > PUSHING_N
    assert not any(device.commands[-1])
    if isinstance(device, Managed):
        assert device.entered == 1 and (device.left or device.closed)


@pytest.mark.parametrize("kind", KINDS)
def test_a_normal_end_ramps_the_force_off(kind):
    device = kind()
    run = pressed(device)
    assert_left_alone(device)
    ticks = round(SECONDS / TICK_S)
    assert len(run.trace.rows) == ticks
    if kind is Computed:  # what follows the wall clock is as even as the machine's load lets it be
        played = np.array(device.commands)[:ticks, :3]
        np.testing.assert_allclose(
            run.trace.vectors("device_force", "N"), played, rtol=0.0, atol=1e-12
        )
        ramp = device.sizes_N[ticks - 1 :]
        assert ramp[0] > PUSHING_N and len(ramp) <= RAMP_S / TICK_S + 2
        np.testing.assert_allclose(np.diff(ramp)[:-1], -ramp[0] * TICK_S / RAMP_S, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "error"),
    [
        (Recording, OSError("the cable is out")),
        (Recording, KeyboardInterrupt()),
        (Managed, ValueError()),
        (Managed, SystemExit(3)),
        (Computed, OSError("the cable is out")),
        (Computed, KeyboardInterrupt()),
    ],
)
def test_an_exception_in_read_ends_at_zero_and_raises_one_sentence(kind, error, tmp_path):
    device, is_error = kind(raising(error)), isinstance(error, Exception)
    with pytest.raises(DeviceError if is_error else type(error)) as raised:
        pressed(device, out=tmp_path / "run")
    assert_left_alone(device)
    saved = SavedRun(tmp_path / "run")
    assert len(saved.trace.rows) == round(PRESSED_S / TICK_S)
    assert saved.status == ("interrupted" if isinstance(error, KeyboardInterrupt) else "failed")
    if is_error:
        message = str(raised.value)
        assert (
            message.startswith(f"device.read must not fail, got {type(error).__name__}")
            and "\n" not in message
        )
        assert "at 0.300 s. Check the device" in message and saved.problem == message


@pytest.mark.parametrize(
    ("device", "words"),
    [
        (Computed, r"device must be an object, got the class Computed. Give Computed\(\)"),
        (
            lambda time_s: None,
            "device must have the methods read and command, got function without read",
        ),
    ],
)
def test_class_or_function_as_device_is_refused(device, words):
    with pytest.raises(InputError, match=words):
        pressed(device)


@pytest.mark.parametrize("kind", KINDS)
def test_an_exception_in_command_ends_at_zero(kind):
    device = kind(raising(OSError("no answer")), where="command")
    with pytest.raises(
        DeviceError, match=r"device\.command must not fail, got OSError \(no answer\) at 0\.300 s"
    ):
        pressed(device)
    assert_left_alone(device)


def test_a_command_that_fails_for_good_closes_the_device():
    device = Managed()
    device.command = lambda force_N, torque_Nm: raising(OSError("dead"))(device)
    with pytest.raises(DeviceError, match=r"device\.command must not fail"):
        SafeDevice(device).play(np.ones(3), np.zeros(3))
    with pytest.raises(DeviceError, match="got OSError"), SafeDevice(device):
        pass
    assert device.closed == 1


@pytest.mark.parametrize("kind", KINDS)
def test_an_exception_elsewhere_in_the_run_ends_at_zero(kind, monkeypatch):
    device, play = kind(), HandMotion.play

    def fails(motion, response):
        if device.time_s >= PRESSED_S:
            raise RuntimeError("the process that solves the stress ended")
        play(motion, response)

    monkeypatch.setattr(HandMotion, "play", fails)
    with pytest.raises(RuntimeError, match="solves the stress"):
        pressed(device)
    assert_left_alone(device)


@pytest.mark.parametrize(
    ("kind", "where"),
    [
        (Recording, "command"),
        (Managed, "read"),
        pytest.param(Recording, "read", marks=pytest.mark.slow),
        pytest.param(Managed, "command", marks=pytest.mark.slow),
    ],
)
def test_a_call_that_never_returns_is_given_up(kind, where, tmp_path):
    """A call that never returns is abandoned and the run ends while it still blocks.

    Zero is sent from another thread, or the device is closed.
    """
    device = kind(block, where=where)
    with pytest.raises(
        DeviceError, match=rf"device\.{where} must .*, got no answer for .* s. Check the device"
    ):
        pressed(device, out=tmp_path / "run")
    assert device.blocked.is_set() and not device.freed.is_set()
    saved = SavedRun(tmp_path / "run")
    assert saved.status == "failed" and len(saved.trace.rows) >= round(PRESSED_S / TICK_S) - 1
    if where == "read" or kind is Managed:
        assert_left_alone(device)
    else:
        assert "it has no method close and may still push: switch it off" in saved.problem
    count = len(device.commands)
    device.freed.set()
    for thread in threading.enumerate():
        if thread.name in ("ticks", "device"):
            thread.join(10.0)
    late = device.sizes_N[count:]
    assert np.count_nonzero(late) <= (where == "command"), (
        "the run that was given up commands again"
    )
    assert not any(device.commands[-1])


def test_a_loop_that_hangs_lets_the_device_go_and_takes_it_up_again(monkeypatch):
    """A loop that hangs in the tissue releases the device and resumes it later.

    Zero is sent within a tenth of a second, and the force comes back gradually.
    """
    device, play, stood = Recording(), HandMotion.play, []

    def slow(motion, response):
        if device.time_s >= PRESSED_S and not stood:
            before = len(device.commands)
            until = time.perf_counter() + 5.0
            while len(device.commands) == before and time.perf_counter() < until:
                time.sleep(0.005)
            stood.append((before, device.commands[-1]))
        play(motion, response)

    monkeypatch.setattr(HandMotion, "play", slow)
    pressed(device)
    before, commanded = stood[0]
    assert not any(commanded) and device.sizes_N[before - 1] > PUSHING_N
    slew = device_parameters("touch").force_slew_N_ms
    back = device.sizes_N[before : before + 100]
    assert np.diff(back).max() <= slew * (1 + 1e-9) and back.max() > PUSHING_N
    assert_left_alone(device)


@pytest.mark.skipif(os.name == "nt", reason="Windows delivers none of these signals to a process")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"])
def test_a_signal_ends_at_zero(name, tmp_path):
    number = getattr(signal, name)
    sent = []

    def signalled(device):
        if not sent:
            sent.append(name)
            os.kill(os.getpid(), number)

    device = Managed(signalled)
    # In the background of a shell, some of these signals are ignored.
    ours = signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
    before = signal.signal(number, ours)
    try:
        with pytest.raises(KeyboardInterrupt) as raised:
            pressed(device, seconds=60.0, out=tmp_path / "run")
    finally:
        signal.signal(number, before)
    assert_left_alone(device)
    saved = SavedRun(tmp_path / "run")
    assert saved.status == "interrupted"
    assert saved.problem == ("Ctrl-C" if name == "SIGINT" else name)
    assert isinstance(raised.value, Terminated) == (name != "SIGINT")


class Port(Managed):
    """A port that cannot be opened twice."""

    def __enter__(self):
        if self.entered > self.left:
            raise RuntimeError("port already open")
        return super().__enter__()


def test_a_device_that_is_held_is_opened_once_for_many_runs(tmp_path):
    device = Port()
    with SafeDevice(device) as held:
        pressed(held, out=str(tmp_path / "run"))
        assert not any(device.commands[-1]) and (device.entered, device.left) == (1, 0)
        pressed(held)
        assert not any(device.commands[-1]) and device.left == 0
    assert device.left == 1 and (tmp_path / "run" / "trace.csv").is_file()
    assert_left_alone(device)


def test_signals_are_handled_as_before_after_a_run():
    before = [signal.getsignal(number) for number in (signal.SIGINT, *STOPS)]
    simulate(load_scene("wall", {"duration_s": 0.01}), device=Recording())
    assert [signal.getsignal(number) for number in (signal.SIGINT, *STOPS)] == before
