"""Ticks at a raised priority: in which thread, how long, and when it is given back."""

import threading

from tissue import load_scene
from tissue.haptics.device.recorded import MouseDevice
from tissue.simulation.live.run import LiveObserver
from tissue.simulation.observer import Prioritised
from tissue.simulation.simulate import simulate

HALF = {"duration_s": 0.5}


class FakePriority:
    """A priority that records what was asked, by which thread."""

    def __init__(self):
        self.asked, self.granted = [], "ordinary priority"

    def begin(self):
        self.asked.append(("begin", threading.get_native_id()))
        self.granted = "raised"

    def end(self):
        self.asked.append(("end", threading.get_native_id()))


def live_by(priority, changes=HALF, device=None):
    scene = load_scene("wall", {"device": "touch"} | changes)
    prioritised = Prioritised(priority)
    both = prioritised, LiveObserver(scene, None)
    return simulate(scene, observers=both, device=device), prioritised


def test_the_thread_of_the_ticks_has_its_priority_raised_while_they_run():
    priority = FakePriority()
    _, observer = live_by(priority, {"duration_s": 0.05})
    this = threading.get_native_id()
    assert priority.asked == [("begin", this), ("end", this)] and observer.note == "raised"
    priority = FakePriority()
    live_by(priority, {"duration_s": 0.05}, MouseDevice((0.0, 0.0, 0.0)))
    threads = [thread for _, thread in priority.asked]
    assert [what for what, _ in priority.asked] == ["begin", "end"] and threads[1] == this


def test_ticks_that_leave_nothing_to_others_lose_their_priority(monkeypatch):
    """Ticks that leave nothing to others lose their priority.

    Ticks of any length exceed a share of zero; at 90 % the ticks of a wall, a twentieth of a
    millisecond, do not.
    """
    priority = FakePriority()
    run, _ = live_by(priority)
    assert (
        not any("ordinary priority" in what for _, what in run.events) and len(priority.asked) == 2
    )
    monkeypatch.setattr("tissue.simulation.observer.FULL", 0.0)
    run, _ = live_by(priority)
    assert [what for _, what in run.events if "ordinary priority" in what] == [
        "the ticks took over 0% of the time: from now on they have ordinary priority"
    ]
    assert [what for what, _ in priority.asked[2:]] == ["begin", "end", "end"]
