"""A call that blocks is given up, and one that fails has not returned."""

import threading

from tissue.system.stopping import returned_within


def test_what_returns_raises_or_blocks():
    def fail():
        raise OSError

    blocked = threading.Event()
    assert returned_within(30.0, lambda: None)
    assert not returned_within(0.05, fail)
    assert not returned_within(0.05, blocked.wait)
    blocked.set()
