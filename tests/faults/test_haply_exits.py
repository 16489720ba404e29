"""Runs on Haply's device against a stand-in service.

The device presses, is stable, and every fault leaves it without force. The stand-in runs in a
process of its own and records the time of each force. The tests assert the order of commands. The
time from a fault to zero, at most 50 ms, is measured, and asserted of the best of some tries in the
slow set.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from haply_service import RemoteService

from tissue import InputError, load_scene, simulate
from tissue.simulation.run_folder import SavedRun

PUSHING_N = 0.5
"""Force at the time of a fault."""
PATIENCE_S = 30.0
"""Longest time to wait for an expected event [s]; no result depends on it."""
WITHIN_S = 0.05
"""Longest time from a fault to the last nonzero force [s]."""
PRESSED = {"device": "haply", "hardware.ramp_ms": 50.0, "duration_s": 60.0}


def scene_on(service, **changes):
    return load_scene("wall", PRESSED | {"hardware.address": service.url} | changes)


class Pressing:
    """Tick callback that makes a fault once the run has pressed for a while.

    The run ends some time after the fault.

    Parameters
    ----------
    service
        The stand-in.
    fault
        Called in a thread of its own; returns when the fault began [s].
    expected
        What the stand-in's last command has to become, called with its session and force, before
        the run ends.
    """

    def __init__(self, service, fault, expected=lambda session, force: not any(force)):
        self.service, self.fault, self.expected = service, fault, expected
        self.began_s = self.over_s = None
        self.over = threading.Event()
        self._thread, self._pushed = None, 0

    def __call__(self, tick, row):
        self._pushed = self._pushed + 1 if row["device_force_z_N"] > PUSHING_N else 0
        if self._thread is None and self._pushed > 30:
            self._thread = threading.Thread(target=self._make, daemon=True)
            self._thread.start()
        return not self.over.is_set()

    def _make(self):
        self.began_s = self.fault()
        until = time.perf_counter() + PATIENCE_S
        while not self.expected(*self.service.get("last")) and time.perf_counter() < until:
            time.sleep(0.01)
        time.sleep(0.2)
        self.over_s = time.perf_counter()
        self.over.set()


def zeroed(commands, began_s, until_s=None):
    """Return the time from a fault to the zero after the last other force [s].

    The last force until then must be zero.
    """
    kept = [each for each in commands if until_s is None or each[0] < until_s]
    forces = np.array([force for *_, force in kept])
    times = np.array([time_s for time_s, *_ in kept])
    pushing = np.flatnonzero(np.any(forces != 0.0, axis=1))
    assert not forces[-1].any(), "the last command is zero"
    assert np.linalg.norm(forces[times < began_s], axis=1).max() > PUSHING_N, (
        "it was pressed before the fault"
    )
    return times[pushing[-1] + 1] - began_s


def best_of(tries, measure):
    """Return the smallest of some measurements [s].

    Each is made anew where the one before it was too long.
    """
    found = []
    while len(found) < tries and (not found or min(found) > WITHIN_S):
        found.append(measure())
    print(f"zero {1e3 * min(found):.1f} ms after the fault, best of {len(found)}")
    return min(found)


class AtRest:
    """Tick callback that ends a run once the device is pushed at rest.

    At rest means a number of consecutive ticks in which the device moved by little.
    """

    def __init__(self, ticks, within_mm):
        self._depths, self._ticks, self._within = [], ticks, within_mm
        self.reached = False

    def __call__(self, tick, row):
        self._depths.append(row["device_z_mm"])
        if not row["device_force_z_N"] > 0.0 or np.ptp(self._depths) > self._within:
            self._depths.clear()
        self.reached = len(self._depths) >= self._ticks
        return not self.reached


@pytest.mark.parametrize("version", ["3.5.0", "3.1.2"])
def test_a_wall_is_pressed_in_closed_loop_until_hand_and_wall_balance(version):
    """At the stiffness that is judged stable, the wall is pressed until hand and wall balance.

    The device rests where the spring of the hand equals the spring of the wall.
    """
    with RemoteService(version=version, press_m=0.03) as service:
        at_rest = AtRest(150, 0.2)
        run = simulate(scene_on(service), on_tick=at_rest)
        commands = service.commands()
    assert "is stable" in run.parts.notes["coupling"] and at_rest.reached
    played, depth = run.trace["device_force_z_N"][-150:], -1e-3 * run.trace["device_z_mm"][-150:]
    share = np.median(played) / (150.0 * (0.03 - 0.02 - np.median(depth)))
    assert share == pytest.approx(1.0, abs=0.05)
    assert max(np.linalg.norm(force) for *_, force in commands) <= 10.0 and not any(commands[-1][2])


FAULTS = {
    "dropped": lambda service: service.set(dropped=1.0),
    "late": lambda service: service.set(late_s=0.08),
    "broken": lambda service: service.set(broken="{"),
    "uncalibrated": lambda service: service.set(
        status={"calibrated": False, "power_supply": True, "ready": True, "in_use": False}
    ),
}


def run_with_fault(name):
    """Return the commands of a run with a fault of the service, and the callback that made it."""
    with RemoteService(press_m=0.03) as service:
        pressing = Pressing(service, lambda: FAULTS[name](service))
        if name == "uncalibrated":
            with pytest.raises(InputError, match="haply must be calibrated"):
                simulate(scene_on(service), on_tick=pressing)
            pressing.over.wait(PATIENCE_S)
        else:
            simulate(scene_on(service), on_tick=pressing)
        return service.commands(), pressing


@pytest.mark.parametrize("name", ["dropped", "uncalibrated"])
def test_a_fault_of_the_service_takes_the_force_off(name):
    commands, pressing = run_with_fault(name)
    before = [force for time_s, _, force in commands if time_s < pressing.began_s]
    during = [force for time_s, _, force in commands if time_s < pressing.over_s]
    assert np.linalg.norm(before, axis=1).max() > PUSHING_N
    assert list(during[-1]) == [0.0, 0.0, 0.0]


def after_fault(name):
    """Return the time from a fault of the service to zero force while the run continues [s]."""
    commands, pressing = run_with_fault(name)
    return zeroed(commands, pressing.began_s, pressing.over_s)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_zero_follows_a_fault_of_the_service_soon(name):
    assert best_of(5, lambda: after_fault(name)) <= WITHIN_S


def after_shuffling(states):
    """Return the times to zero and the events after states come in a random order.

    The hand moves in a circle, and groups of `states` states, one per millisecond, are shuffled.
    """
    with RemoteService(press_m=0.035, circle_m=0.03) as service:
        pressing = Pressing(service, lambda: service.set(shuffled=states))
        run = simulate(scene_on(service), on_tick=pressing)
        return zeroed(service.commands(), pressing.began_s, pressing.over_s), run.events


@pytest.mark.slow
@pytest.mark.parametrize("states", [2, 10])
def test_zero_follows_states_in_a_wrong_order_soon(states):
    assert best_of(8, lambda: after_shuffling(states)[0]) <= WITHIN_S


def after_standstill():
    """Check that zero is sent before the ticks continue after a standstill of half a second."""
    stood = []
    with RemoteService(press_m=0.03) as service:
        pressing = Pressing(service, lambda: 1.0)

        def stands(tick, row):
            goes_on = pressing(tick, row)
            if pressing.began_s is not None and not stood:
                stood.append(time.perf_counter())
                pressing.over.wait(PATIENCE_S)  # until zero has come
                stood.append(time.perf_counter())
            return goes_on

        simulate(scene_on(service), on_tick=stands)
        return zeroed(service.commands(), stood[0], until_s=stood[1])


@pytest.mark.slow
def test_zero_follows_a_standstill_soon():
    assert best_of(5, after_standstill) <= WITHIN_S


CHILD = """
import sys
from pathlib import Path
from tissue import load_scene, simulate

def on_tick(tick, row):
    if row["device_force_z_N"] > 0.5 and tick % 100 == 0:
        print("pressed", flush=True)

values = {"device": "haply", "hardware.ramp_ms": 50.0, "hardware.address": sys.argv[1], "duration_s": 60.0}
simulate(load_scene("wall", values), on_tick=on_tick, out=Path(sys.argv[2]))
"""


def after_signal(name, folder):
    with RemoteService(press_m=0.03) as service:
        command = [sys.executable, "-c", CHILD, service.url, str(folder)]
        child = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        try:
            while (line := child.stdout.readline()) and line != "pressed\n":
                pass
            sent_s = time.perf_counter()
            child.send_signal(getattr(signal, name))
            child.communicate(timeout=60)
        finally:
            child.kill()
        assert SavedRun(folder).status == "interrupted"
        return zeroed(service.commands(), sent_s)


@pytest.mark.skipif(os.name == "nt", reason="Windows delivers none of these signals to a process")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
@pytest.mark.slow
def test_a_signal_ends_at_zero_soon(name, tmp_path):
    runs = iter(range(100))
    folder = lambda: Path(tmp_path / str(next(runs)))  # noqa: E731
    assert best_of(6, lambda: after_signal(name, folder())) <= WITHIN_S
