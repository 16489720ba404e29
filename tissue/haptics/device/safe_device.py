"""Safe operation of a device in a haptic loop, with zero force on the hand at the end."""

import contextvars
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from math import inf
from time import perf_counter, sleep
from types import FrameType, TracebackType
from typing import Self

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, counted
from tissue.haptics.device.device import (
    Device,
    DeviceError,
    DeviceParameters,
    ReportsPlayedForce,
    Sample,
)
from tissue.haptics.loop.filters import SlewLimit
from tissue.models.tissue_model import TICK_S
from tissue.system.stopping import (
    STOPS,
    Terminated,
    interrupt_is_free,
    returned_within,
    signals_handled,
)

RAMP_S = 0.03
"""Time in which the last force is ramped to zero at a regular end of the loop [s].

Without a ramp, the hand would jump. The ramp is shorter than `STALL_S`, so that the force is
removed within 50 ms in every case.
"""
STALL_S = 0.05
"""Longest time without a command before the force is removed [s].

The network protocol of this package uses the same time: a device that receives no packet for 50 ms
removes its force.
"""
GIVE_UP_S = 1.0
"""Longest duration of a read or a command before the device is treated as lost [s].

The force is already removed after `STALL_S`. The longer time limits how long a user waits for the
device.
"""
OPENING_S = 10.0
"""Longest time for opening a device [s], including search, connection and wake-up.

The slowest adapter of this package waits for at most 5 s.
"""
ANSWER_S = 0.2
"""Longest time for closing a device, or for commanding zero force from a second thread [s].

The second thread waits for a lock, for the command and for the close, each for at most this time.
The sum of 0.6 s is less than `GIVE_UP_S`.
"""
OPENED = ", and give it without `with`: the run opens and closes it"
NO_CALL = ("", inf)
"""Stored name and start time of a call while no call of the device is running."""


class SafeDevice:
    """Wrapper that guarantees that the last command to a device is zero force and torque.

    ``with SafeDevice(device) as held:`` enters the device if it is a context manager. At a regular
    end of the block and after `stop`, the force is ramped to zero in `RAMP_S`. After an exception,
    the force is set to zero at once. If the command of zero force fails and the device has the
    method ``close``, the device is closed. An exception in a method of the device is converted to a
    `DeviceError`.

    A loop accepts ``held`` instead of the device. In this case, the loop neither enters nor leaves
    the device, but ends with zero force. One ``with`` block can therefore hold a device for many
    runs.

    A device that is not ``in_process`` may block. Another thread must then call `stop_if_stuck`
    frequently. This method commands zero force if no command was sent for `STALL_S`. It also gives
    up the device if a read or command takes longer than `GIVE_UP_S`, or if opening takes longer
    than `OPENING_S`.

    Parameters
    ----------
    device
        Device with ``read`` and ``command``, or a `SafeDevice` that wraps a device.
    tick_s
        Time between two commands [s].
    limits
        Device parameters with the largest slew rates of force and torque. With None, the slew rates
        are not limited.

    Attributes
    ----------
    entered
        True inside the ``with`` block.
    released
        True after another thread has commanded zero force, until the loop resets the value.
    slow_reads, slowest_read_s
        Number of reads that took longer than a tick, and the longest duration of such a read [s].
    """

    def __init__(
        self,
        device: "Device | SafeDevice",
        *,
        limits: DeviceParameters | None = None,
        tick_s: float = TICK_S,
    ) -> None:
        self._holder = device if isinstance(device, SafeDevice) else None
        self.device: Device = device.device if isinstance(device, SafeDevice) else device
        self.in_process = bool(getattr(self.device, "in_process", False))
        self._reporter = self.device if isinstance(self.device, ReportsPlayedForce) else None
        self.entered = False
        self.released = False
        self.slow_reads = 0
        self.slowest_read_s = 0.0
        self._releases = 0
        self._tick = tick_s
        self._time_s = 0.0
        tick_ms = 1e3 * tick_s
        self._force = SlewLimit(inf if limits is None else tick_ms * limits.force_slew_N_ms)
        self._torque = SlewLimit(inf if limits is None else tick_ms * limits.torque_slew_Nm_ms)
        self._lock = threading.Lock()
        self._stack = ExitStack()
        self._call = NO_CALL  # name and start time of the running call
        self._played = inf  # time of the last command that was not zero
        self._stop: BaseException | None = None
        self._lost: DeviceError | None = None
        self._closed = False

    def happened(self) -> list[tuple[float, str]]:
        """Return events: slow reads, slew-limited commands, and the events that the device reports.

        Each entry is a time [s] and a sentence.
        """
        found = []
        if self.slow_reads:
            slowest = f"{1e3 * self.slowest_read_s:.3g} ms"
            found.append(
                f"{counted(self.slow_reads, 'read')} took longer than a tick, the slowest {slowest}"
            )
        if self._releases:
            late = f"no command came for {1e3 * STALL_S:g} ms"
            found.append(
                f"the force was removed and returned gradually {counted(self._releases, 'time')}, "
                f"because {late}"
            )
        if held := max(self._force.limited, self._torque.limited):
            found.append(
                f"the device's limit of the force rate reduced the force in {counted(held, 'tick')}"
            )
        stated = self._reporter.happened() if self._reporter is not None else []
        return stated + [(self._time_s, what) for what in found]

    def __enter__(self) -> Self:
        # Another `SafeDevice` has entered the device and will leave it.
        held = self._holder is not None and self._holder.entered
        if isinstance(self.device, AbstractContextManager) and not held:
            with self._calling("__enter__"):
                self._stack.enter_context(self.device)
        self.entered = True
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        problem: DeviceError | None = None
        self.entered = False
        try:
            if self._lost is None and (error is None or error is self._stop):
                self._ramp()
        except DeviceError as raised:
            problem = raised
        finally:
            problem = self._zero() or problem
        try:
            with self._calling("__exit__"):
                if not self._closed:
                    self._stack.__exit__(kind, error, trace)
        except DeviceError as raised:
            problem = problem or raised
        if problem is not None and error is None:
            raise problem

    def read(self, time_s: float) -> Sample | None:
        """Return the device's newest sample; None if the sample is too old after a slow read.

        Raises
        ------
        DeviceError
            If the device raised an exception or was given up.
        BaseException
            The exception passed to `stop`.
        """
        self._time_s = time_s
        if self._stop is not None:
            raise self._stop
        start = perf_counter()
        with self._calling("read"):
            sample = self.device.read(time_s)
        if self.in_process:
            return sample
        if self._lost is not None:
            raise self._lost
        took = perf_counter() - start
        if took > self._tick:
            self.slow_reads += 1
            self.slowest_read_s = max(self.slowest_read_s, took)
        # 2.5 ticks: the age at which the sample guard rejects a sample.
        return sample if took <= 2.5 * self._tick else None

    def play(self, force_N: Array, torque_Nm: Array) -> tuple[Array, Array]:
        """Send a force [N] and a torque [N m], limited in slew rate, to the device.

        The method returns the force and the torque that the device applies.

        Raises
        ------
        DeviceError
            If the device raised an exception or was given up.
        """
        force = self._force.step(force_N)
        torque = self._torque.step(torque_Nm)
        with self._lock:
            if self._lost is not None:
                raise self._lost
            self._command(force, torque)
            # the device was given up during the command and may push again
            if self._lost is not None:
                with suppress(Exception):
                    self.device.command(np.zeros(3), np.zeros(3))
                raise self._lost
        return (force, torque) if self._reporter is None else self._reporter.played

    def stop(self, reason: BaseException) -> None:
        """Make the next call of `read` raise ``reason``; the force is then ramped to zero."""
        self._stop = reason

    def stop_if_stuck(self) -> DeviceError | None:
        """Remove the force, or give up the device, if the loop in another thread is blocked.

        The method returns the error if the device was given up.
        """
        now = perf_counter()
        if now - self._played > STALL_S:
            self.release()
        name, since = self._call
        limit, within = (
            (OPENING_S, f"{OPENING_S:g} s") if name == "__enter__" else (GIVE_UP_S, "a tick")
        )
        if now - since > limit and self._lost is None:
            self._lost = DeviceError(
                f"device.{name}",
                f"return within {within}",
                f"no answer for {limit:g} s",
                f"check the device and its cable{self._close()}",
            )
        return self._lost

    def release(self) -> None:
        """Command zero force from a second thread; if the command fails, close the device."""
        self._played = inf
        self.released = True
        self._releases += 1
        # The thread of the loop may hold the lock while its command hangs.
        if self._lock.acquire(timeout=ANSWER_S):
            try:
                self._force.value = np.zeros(3)
                self._torque.value = np.zeros(3)
                sent = returned_within(
                    ANSWER_S, lambda: self.device.command(np.zeros(3), np.zeros(3))
                )
            finally:
                self._lock.release()
            if sent:
                return
        self._lost = DeviceError(
            "device.command",
            "play zero once the loop stops",
            f"no answer for {ANSWER_S:g} s",
            f"check the device and its cable{self._close()}",
        )

    def _command(self, force: Array, torque: Array) -> None:
        """Send one command and record its time."""
        if not self.in_process:
            # After a zero command no force has to be removed, so its time is not monitored.
            self._played = perf_counter() if any(force.tolist()) or any(torque.tolist()) else inf
        with self._calling("command"):
            self.device.command(force, torque)

    @contextmanager
    def _calling(self, name: str) -> Iterator[None]:
        """Record the start of a call, and convert an exception of the call to a `DeviceError`."""
        self._call = (name, perf_counter())
        try:
            yield
        except Exception as error:
            raise self._failed(name, error) from error
        finally:
            self._call = NO_CALL

    def _ramp(self) -> None:
        """Ramp the last force linearly to zero.

        For a device that is ``in_process``, the commands of the ramp are sent without waiting.
        """
        force = self._force.value
        torque = self._torque.value
        if not (force.any() or torque.any()):
            return
        start = perf_counter()
        steps = max(round(RAMP_S / self._tick), 1)
        for step in range(1, steps):
            share = 1.0 - step / steps
            if not self.in_process:
                sleep(max(start + step * self._tick - perf_counter(), 0.0))
                share = 1.0 - (perf_counter() - start) / RAMP_S
            if share <= 0.0:
                return
            with self._lock:
                self._command(share * force, share * torque)

    def _zero(self) -> DeviceError | None:
        """Command zero force; if the command fails, close the device and return the error."""
        problem = None
        while not self._closed:
            try:
                with self._lock:
                    self._force.value = np.zeros(3)
                    self._torque.value = np.zeros(3)
                    self._command(np.zeros(3), np.zeros(3))
            except KeyboardInterrupt:
                continue  # a second Ctrl-C must not interrupt the end after the first one
            except DeviceError as error:
                problem = error
                self._close()
            break
        return problem

    def _close(self) -> str:
        """Close the device permanently, and return the outcome as the end of a sentence."""
        close = getattr(self.device, "close", None)
        if self._closed:
            return ""
        if close is None:
            return "; it has no method close and may still push: switch it off"
        self._closed = True
        if self._holder is not None:
            self._holder._closed = True
        return (
            "; it was closed"
            if returned_within(ANSWER_S, close)
            else "; it did not close and may still push: switch it off"
        )

    def _failed(self, name: str, error: Exception) -> DeviceError:
        """Return the `DeviceError` for an exception of the device."""
        # The message of this error is already a sentence for the user.
        if isinstance(error, InputError):
            return DeviceError(str(error))
        message = " ".join(str(error).split())
        return DeviceError(
            f"device.{name}",
            "not fail",
            f"{type(error).__name__}{(f' ({message})' if message else '')} at {self._time_s:.3f} s",
            f"check the device and its cable{(OPENED if name == '__enter__' else '')}",
        )


POLL_S = 0.01
"""Interval between two checks for a stuck loop [s], a fifth of `STALL_S`.

A check delays the ticks by some microseconds.
"""


def run_held(work: Callable[[], None], held: SafeDevice) -> None:
    """Run the loop ``work`` of a device, and ensure that the last force is zero.

    If the device may block, the loop runs in a second thread, because a blocked call cannot be
    interrupted. If the loop hangs, the calling thread commands zero force. If the device then does
    not answer, the calling thread gives up the device and no longer waits for ``work``. Ctrl-C ends
    the loop after the current tick. Signals that ask the process to end, such as SIGTERM and
    SIGHUP, have the same effect. The signal handlers are restored before this function returns.

    Raises
    ------
    DeviceError
        If the device was given up.
    KeyboardInterrupt
        After Ctrl-C. After a signal that asks the process to end, the subclass `Terminated` is
        raised.
    """

    def hold() -> None:
        with held:
            work()

    if held.in_process:
        hold()
    else:
        _supervise(hold, held)


def _supervise(work: Callable[[], None], held: SafeDevice) -> None:
    """Run ``work`` in a second thread, and remove the force if this thread does not respond."""
    done = threading.Event()
    raised: list[BaseException] = []

    def run() -> None:
        """Run the work, and store its exception for the waiting thread."""
        try:
            work()
        except BaseException as error:
            raised.append(error)
        finally:
            done.set()

    thread = threading.Thread(
        target=contextvars.copy_context().run, args=(run,), daemon=True, name="ticks"
    )

    def stop(number: int, frame: FrameType | None) -> None:
        held.stop(Terminated(number) if number in STOPS else KeyboardInterrupt())

    # handle Ctrl-C only if no other code does
    taken = (*STOPS, signal.SIGINT) if interrupt_is_free() else STOPS
    with signals_handled(taken, stop):
        thread.start()
        while not done.wait(POLL_S):
            lost = held.stop_if_stuck()
            # If the call returns within this time, the work ends normally with its own error.
            if lost is not None and not done.wait(STALL_S):
                raise lost
    if raised:
        raise raised[0]
