"""Adapter for Haply's device Inverse3, which is accessed through the Inverse Service.

The device applies force in three degrees of freedom. The handle provides orientation and buttons.
The adapter is not for clinical use. It was tested with a simulated service that uses the documented
protocol, and not with the device.

A thread exchanges frames with the service: it sends the newest force and receives the newest state
of the device. The service answers every frame with one state. The service removes a force that is
not sent repeatedly. The thread sends a frame only after the answer to the previous frame, so at
most one answer is pending. An answer contains the state that belongs to the previous frame. The age
of a state is therefore at most the duration of one exchange. Answers do not identify the frame to
which they belong. If an answer is late, the thread immediately sends a frame with zero force. It
then sends nothing until the answers to both frames have arrived or are treated as lost.
"""

import socket
import threading
from contextlib import ExitStack, suppress
from time import perf_counter, sleep
from typing import TYPE_CHECKING

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.extras import install_command
from tissue.haptics.device.device import DeviceError
from tissue.haptics.real.adapter import FoundDevice, HardwareAdapter, HardwareSample
from tissue.haptics.real.haply_frames import (
    ServiceState,
    StateOrder,
    asked_version,
    force_frame,
    opening_frame,
    problem_of,
    service_address,
    spelling_of,
)
from tissue.motion.quaternion import NOTHING, Triple
from tissue.scene.coupling import Hardware
from tissue.system.stopping import returned_within

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

PERIOD_S = 1e-3
"""Longest time between an answer and the next frame [s]: one tick."""
ANSWER_S = 0.02
"""Longest time to wait for an answer of the service before the force is removed [s].

The value equals the default of the scene key ``hardware.watchdog_ms``. The vendor does not publish
a limit.
"""
LOST_S = 0.5
"""Time without answers after which late answers are treated as lost [s].

A long time is safe, because the force is zero during this time.
"""
PATIENCE_S = 0.01
"""Interval at which the thread checks whether it must end [s]."""
HOLD_S = 0.03
"""Longest time for which a force is repeated without a new command from the loop [s].

The value allows for late ticks. After a failure of the loop, the force is still removed within 50
ms.
"""
GIVE_UP_S = 3.0
"""Longest time for which a run continues without a sample [s].

The time is longer than `AGAIN_S`, so that attempts to reconnect end before the run.
"""
AGAIN_S = 2.5
"""Longest time for attempts to reconnect to the service, for example after a restart [s]."""
MOST_BEHIND = 20
"""Largest number of frames read at once, if the service sends more frames than requested."""
OPEN_S = 2.0
"""Longest time for the service to open and to send its first frame [s]."""
START_IT = (
    "start the Inverse Service (it runs while Haply Hub is open), or give its address: "
    "hardware.address in a scene, --address in a command"
)


class HaplyAdapter(HardwareAdapter):
    """Adapter of an Inverse3; its x axis points to the right, y forward and z up.

    The methods `poll` and `push` never wait, because they only exchange numbers with the thread of
    a `_Session`. Torque is ignored. However the exchange ends, the last force sent to the service
    is zero.

    Parameters
    ----------
    hardware
        Settings of the device. The setting ``address`` is the address of the service,
        ``ws://HOST:PORT``. Append ``#DEVICE`` to select one of several devices.
    """

    name = "haply"

    def __init__(self, hardware: Hardware | None = None) -> None:
        super().__init__(hardware)
        self._session = _Session(self._given)

    @classmethod
    def find(cls, address: str = "") -> list[FoundDevice]:
        """Return the devices of a service, or the reason why there are none."""
        try:
            session = _Session(address)
            session.connect()
        except InputError as error:
            return cls.missing(error, address)
        try:
            state = session.state
            version = session.version
            stated = "of unknown version" if version is None else "{}.{}".format(*version)
            found = []
            if not state.device_ids:
                return cls.missing(problem_of(state), session.url)
            for device_id in state.device_ids:
                state.device_id = device_id
                busy = ", used by another program" if state.status("in_use") is True else ""
                detail = f"{state.model()}, service {stated}{busy}"
                found.append(cls.found(f"{session.url}#{device_id}", detail, problem_of(state)))
            return found
        finally:
            session.end()

    def open(self) -> None:
        """Start to exchange frames with zero force, and wait for the first sample.

        Raises
        ------
        InputError
            If the service does not answer, or the device cannot be used in its present state.
        """
        self._session.end()
        # The thread of the last session may still try to reconnect. It uses the last session, which
        # has ended, so that it cannot send over the new connection.
        self._session = _Session(self._given)
        self._session.connect()
        self._session.start()
        self.releases = self._session.releases

    def poll(self) -> HardwareSample | None:
        """Return the newest sample; None if there is no new sample since the last call."""
        session = self._session
        sample = session.newest()
        self.releases = session.releases
        return sample

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Set the force to send every millisecond, for at most `HOLD_S` after the last call."""
        x, y, z = force_N.tolist()
        self._session.play((x, y, z))

    def close(self) -> None:
        """Send zero as the last force, and disconnect from the service."""
        self._session.end()

    def happened(self) -> list[str]:
        """Return the events of the exchange with the service so far, as sentences."""
        return self._session.events


class _Session:
    """Session with the Inverse Service, with the thread that exchanges frames.

    Parameters
    ----------
    address
        Address of the service; empty for the default address and the first device.

    Attributes
    ----------
    url
        Address of the service.
    state
        State of the devices, as reported by the service.
    version
        Major and minor version of the service; None if the service does not report its version.
    events
        Events so far, as sentences.
    releases
        Number of times that this session has removed the force.
    """

    def __init__(self, address: str) -> None:
        self.url, self._host, self._port, self._device_id = service_address(address)
        self.state = ServiceState(self._device_id)
        self.version: tuple[int, int] | None = None
        self.events: list[str] = []
        self.releases = 0
        self._was_off = True
        self._spelling = "vector"
        self._socket: ClientConnection | None = None
        self._stack = ExitStack()
        self._sample: HardwareSample | None = None
        self._sampled_s = self._asked_s = 0.0
        self._force = NOTHING
        self._pushed_s = 0.0
        self._problem = ""
        self._order = StateOrder()
        self._wake = threading.Event()
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        self._sending = threading.Lock()  # no frame may follow the zero force at the end

    def start(self) -> None:
        """Start the thread with zero force, and wait for the first sample.

        Raises
        ------
        InputError
            If the device cannot be used in its present state.
        """
        if problem := problem_of(self.state):
            raise InputError(problem)
        if self.state.status("in_use") is True:
            self.events.append(
                "another program uses the device, and the service adds the forces of both. "
                "Close the other program"
            )
        self._sampled_s = perf_counter()
        self._thread = threading.Thread(target=self._run, daemon=True, name="haply")
        self._thread.start()
        until = perf_counter() + OPEN_S
        while self._sample is None and not self._problem and perf_counter() < until:
            sleep(PERIOD_S)  # the state in the first frame may be old

    def newest(self) -> HardwareSample | None:
        """Return the newest sample; None if there is no new sample since the last call.

        Raises
        ------
        DeviceError
            If the service or the device is permanently lost.
        """
        sample = self._sample
        self._sample = None
        if self._problem:
            raise DeviceError(self._problem)
        is_silent = perf_counter() - self._sampled_s > GIVE_UP_S
        if sample is None and is_silent and not self._ended.is_set():
            raise DeviceError(
                HaplyAdapter.name,
                "answer",
                f"no state of {self.state.device_id} for {GIVE_UP_S:g} s",
                "check the device's cable and power, and restart the Inverse Service",
            )
        return sample

    def play(self, force_N: Triple) -> None:
        """Set the force to send from now on."""
        self._force = force_N
        self._pushed_s = perf_counter()
        self._wake.set()

    def end(self) -> None:
        """Send zero as the last force and disconnect.

        The method may be called repeatedly, and from any thread.
        """
        self._force = NOTHING
        self._ended.set()
        self._wake.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            # The waits of this function take 0.3 s in total. A run gives up a device after 1 s.
            self._thread.join(0.15)
        zero = force_frame(self.state.device_id, NOTHING, self._spelling)
        is_read = self._thread is None
        if self._thread is not None and self._sending.acquire(timeout=0.05):
            # On a busy computer, the thread may not have sent the zero force. If the service no
            # longer reads, sending would block the thread.
            is_read = returned_within(0.1, lambda: self._open_socket.send(zero))
            self._sending.release()
        self._disconnect(cut=not is_read)

    def connect(self) -> None:
        """Connect to the service and receive its first frame.

        Raises
        ------
        InputError
            If the library is missing or the service does not answer.
        """
        try:
            from websockets.exceptions import WebSocketException
            from websockets.sync.client import connect
        except ModuleNotFoundError:
            raise InputError(
                f"websockets must be installed for device = haply. Run {install_command('haply')}"
            ) from None
        self.state = ServiceState(self._device_id)
        try:
            self._socket = self._stack.enter_context(
                connect(
                    self.url,
                    compression=None,
                    proxy=None,
                    open_timeout=OPEN_S,
                    close_timeout=0.1,
                    ping_interval=None,
                )
            )
            first = self._socket.recv(timeout=OPEN_S)
        except (OSError, WebSocketException) as error:
            self._disconnect()
            words = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                HaplyAdapter.name, f"be reachable at {self.url}", words, START_IT
            ) from None
        self.state.take(first)
        self.version = asked_version(self._host, self._port)
        text = first.encode() if isinstance(first, str) else first
        self._spelling = spelling_of(self.version, has_session=b"session_id" in text)

    def _run(self) -> None:
        """Exchange frames until the end; reconnect to a service that was restarted."""
        from websockets.exceptions import WebSocketException

        goes_on = True
        while goes_on and not self._ended.is_set():
            try:
                self._exchange()
            except (OSError, WebSocketException) as error:
                why = " ".join(str(error).split())
                goes_on = not self._ended.is_set() and self._reached_again(why)
            except Exception as error:
                # otherwise the loop would wait for a thread that has ended
                failed = f"{type(error).__name__} ({error})"
                self._problem = str(
                    InputError(
                        "haply",
                        "send frames as documented",
                        failed,
                        "report this message to the developers of tissue",
                    )
                )
                goes_on = False
        with suppress(OSError, WebSocketException):
            self._send(NOTHING)
        self._disconnect()

    def _exchange(self) -> None:
        """Exchange frames one by one until the session ends or the connection fails."""
        self._asked_s = perf_counter()
        self._open_socket.send(opening_frame(self.state.device_id, self._spelling))
        while not self._ended.is_set():
            if not self._receive(ANSWER_S) and not self._ended.is_set():
                self._await_answers()
            self._wake.wait(PERIOD_S)
            self._wake.clear()
            is_old = perf_counter() - self._pushed_s > HOLD_S
            is_off = is_old or self._order.is_wrong or bool(self._problem) or self._ended.is_set()
            self.releases += is_off and not self._was_off
            self._was_off = is_off
            self._send(NOTHING if is_off else self._force)

    def _send(self, force_N: Triple) -> None:
        self._asked_s = perf_counter()
        with self._sending:
            sent = NOTHING if self._ended.is_set() else force_N
            self._open_socket.send(force_frame(self.state.device_id, sent, self._spelling))

    def _receive(self, seconds: float) -> bool:
        """Receive the answer and all later frames; return True if the answer arrived in time."""
        link = self._open_socket
        answered = False
        with suppress(TimeoutError):
            for _ in range(MOST_BEHIND):
                self._take(link.recv(timeout=0 if answered else seconds))
                answered = True
        return answered

    def _take(self, text: str | bytes) -> None:
        """Merge a frame into the state, and store its new sample."""
        if not self.state.take(text):
            return
        if problem := problem_of(self.state):
            self._force = NOTHING
            self._problem = problem
        elif (sample := self.state.sample()) is not None:
            was_wrong = self._order.is_wrong
            now = perf_counter()
            # States in a wrong order are not used as samples.
            if not self._order.observe(sample, now):
                # the thread may have been suspended before it received the answer
                if now - self._asked_s < ANSWER_S:
                    self._sample = sample
                    self._sampled_s = now
            elif not was_wrong:
                self.events.append(
                    "states of the service arrive in a wrong order: the force is removed"
                )

    def _release(self, why: str) -> None:
        """Remove the force, and discard a sample that may be old."""
        self._force = NOTHING
        self._sample = None
        self.releases += 1
        self.events.append(why)

    def _await_answers(self) -> None:
        """Remove the force and wait for late answers, which are not used as samples."""
        self._release(
            f"the service did not answer within {1e3 * ANSWER_S:g} ms: the force is removed"
        )
        self._send(NOTHING)
        link = self._open_socket
        # The late answer, and the answer to the zero force that was just sent.
        missing = 2
        until = perf_counter() + LOST_S
        while missing > 0 and perf_counter() < until and not self._ended.is_set():
            with suppress(TimeoutError):
                self.state.take(link.recv(timeout=PATIENCE_S))
                missing = missing - 1
                until = perf_counter() + LOST_S

    def _reached_again(self, why: str) -> bool:
        """Reconnect to a restarted service; return True if the service answers in time."""
        self._release("the service closed the connection: the force is zero until it is back")
        until = perf_counter() + AGAIN_S
        # Wait between attempts, because a service that restarts refuses connections for some time.
        while perf_counter() < until and not self._ended.wait(0.05):
            self._disconnect()
            with suppress(InputError):
                self.connect()
                if not problem_of(self.state):
                    self._sampled_s = perf_counter()
                    return True
        problem = problem_of(self.state) if self.state.device_ids else ""
        lost = str(
            InputError("haply", "keep its connection", why or "a closed connection", START_IT)
        )
        self._problem = problem or lost
        return False

    @property
    def _open_socket(self) -> "ClientConnection":
        """Return the open connection; raise `OSError` if another thread has closed it."""
        if self._socket is None:
            raise OSError("the session was ended")
        return self._socket

    def _disconnect(self, *, cut: bool = False) -> None:
        """Close the connection; abort the connection first if the service no longer reads."""
        stack = self._stack
        link = self._socket
        self._stack = ExitStack()
        self._socket = None
        if cut and link is not None:
            with suppress(OSError):
                link.socket.shutdown(socket.SHUT_RDWR)
        with suppress(OSError):
            stack.close()
