"""Run of a loop with a device in a separate thread, supervised by the calling thread."""

import contextvars
import signal
import threading
from collections.abc import Callable
from types import FrameType

from tissue.haptics.device.safe_device import STALL_S, SafeDevice
from tissue.system.stopping import STOPS, Terminated, interrupt_is_free, signals_handled

__all__ = ["run_held"]

POLL_S = 0.01
"""Interval between two checks [s]; each check costs the ticks some microseconds."""


def run_held(work: Callable[[], None], held: SafeDevice) -> None:
    """Run ``work``, the loop of a device, so that the device is not left pushing.

    A device that may block runs in a second thread, because a blocked call cannot be interrupted.
    The calling thread sends zero if the loop stops, and gives up a device that does not answer. The
    work is then abandoned. Ctrl-C and signals that ask the process to end, such as SIGTERM and the
    SIGHUP of a closed terminal, end the loop after its tick. The signal handlers are restored
    before this function returns.

    Raises
    ------
    DeviceError
        If the device was given up.
    KeyboardInterrupt
        After Ctrl-C, and as `Terminated` after such a signal.
    """

    def hold() -> None:
        with held:
            work()

    if held.in_process:
        hold()
    else:
        _supervise(hold, held)


def _supervise(work: Callable[[], None], held: SafeDevice) -> None:
    """Run ``work`` in a second thread."""
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
            if lost is not None and not done.wait(STALL_S):
                raise lost
    if raised:
        raise raised[0]
