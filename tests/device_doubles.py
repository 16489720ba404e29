"""Stand-ins for a device's hardware, for tests: they press a wall, record what they are told, and fail on demand."""

import threading

import numpy as np

from tissue.haptics.device.device import ComputedDevice, Sample

PRESSED_S = 0.3
"""When faults come [s]: the wall has been pressed for a while."""


class Recording:
    """A vendor's device with read and command alone; it moves onto the wall at z = 0 and 10 mm into it.

    Parameters
    ----------
    fault
        What happens at `PRESSED_S`, None for nothing: called with the device, in ``read`` or in ``command``.
    where
        ``read`` or ``command``.
    """

    def __init__(self, fault=None, *, where="read"):
        self.fault, self.where = fault, where
        self.commands, self.time_s = [], 0.0
        self.blocked, self.freed = threading.Event(), threading.Event()

    def read(self, time_s):
        self.time_s = time_s
        self._fail("read")
        return Sample(time_s, (0.0, 0.0, 0.02 - 0.1 * min(time_s, PRESSED_S)))

    def command(self, force_N, torque_Nm):
        if np.any(force_N):
            self._fail("command")
        self.commands.append((*force_N, *torque_Nm))

    def _fail(self, where):
        if self.fault is not None and where == self.where and self.time_s >= PRESSED_S:
            self.fault(self)

    @property
    def sizes_N(self):
        """Size of every commanded force [N]."""
        return np.linalg.norm(np.array(self.commands)[:, :3], axis=1)


class Managed(Recording):
    """The same as a context manager that can be closed."""

    entered = left = closed = 0

    def __enter__(self):
        self.entered += 1
        return self

    def __exit__(self, kind, error, trace):
        self.left += 1

    def close(self):
        self.closed += 1
        self.commands.append((0.0,) * 6)


class Computed(Recording, ComputedDevice):
    """The same as a device that only computes, whose ticks run in the calling thread."""


def block(device):
    """A vendor's call that never returns."""
    device.blocked.set()
    device.freed.wait()
