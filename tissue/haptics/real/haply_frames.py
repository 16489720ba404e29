"""Frames (messages) that are exchanged with Haply's Inverse Service.

The sources are the vendor's pages websocket-protocol, control-commands, json-conventions and http
of the Inverse SDK 3.5. Units are m, m/s and N in a right-handed frame with x to the right, y
forward and z up. The first frame contains the whole state of every device. Later frames may contain
only parts of the state. Quaternions are tables with the entries w, x, y and z.
"""

import json
import re
from collections.abc import Mapping
from contextlib import suppress
from http.client import HTTPConnection, HTTPException
from math import exp, hypot
from typing import Any

from meshes.base.errors import InputError, enumerated
from meshes.base.text_tables import read_json
from tissue.haptics.real.adapter import HardwareSample, checked_url
from tissue.motion.quaternion import NOTHING, UPRIGHT, Triple
from tissue.system.stopping import returned_within

GRIPS = ("wireless_verse_grip", "verse_grip", "custom_verse_grip")
"""Names of the kinds of handles with orientation and buttons, in search order."""
VECTOR_SINCE = (3, 5)
"""First service version in which the key of a force is ``vector``.

In earlier versions, the key is ``values``.
"""
MOST = 1e6
"""Bound on valid numbers in a frame.

Positions, velocities and quaternions in SI units are far smaller.
"""
PROFILE = "tissue:simulation"
"""Name of this program's session in the window of the vendor's software."""

USUAL = "ws://localhost:10001"
ANSWER_S = 0.5
STATED_S = 2.0
"""Longest total wait for the service's version [s]; `ANSWER_S` is the limit for each answer."""
LONGEST = 65_536
"""Largest number of bytes read for the version of the service.

Without a limit, another program on the port could send endless data.
"""
MEMORY_S = 0.024
LONGEST_S = 0.005
"""Largest weight of one state in the share of contradictions, see `StateOrder` [s].

The weight of a state is the time since the previous state. `MEMORY_S` is the averaging time of the
share. With this averaging time, a velocity that lags behind the position by up to 6 ms after a blow
does not count as a wrong order.
"""
WRONG = 0.25
RIGHT = 0.05
"""Share of contradictions (see `StateOrder`) below which the order counts as right again.

Above `WRONG`, the order counts as wrong.
"""
LEAST_M = 2e-4
LEAST_M_S = 0.05
"""Smallest speed at which the order of states is checked [m/s].

`LEAST_M` is the smallest distance between two positions [m].

For smaller values, a wrong order of states has no perceptible effect.
"""
AGAINST = -0.5
"""Cosine of the angle between displacement and velocity, below which the two contradict.

On a curved path, the displacement between two states and the velocity have different directions. An
angle of more than 120 degrees means that the device moved backwards.
"""


class ServiceState:
    """State of all devices of the service: the first frame, updated with later frames.

    Attributes
    ----------
    device_id
        Id of the used device, which is the requested device or the first listed device.
    """

    def __init__(self, device_id: str = "") -> None:
        self.device_id = device_id
        self._known: dict[str, dict[str, dict[str, Any]]] = {}

    def take(self, text: str | bytes) -> bool:
        """Merge a frame into the state; return True if the frame has a new state of the device.

        Invalid JSON, or a frame of another structure, is ignored.
        """
        try:
            frame = read_json(text)
        except ValueError:
            return False
        if not isinstance(frame, dict):
            return False
        for group in ("inverse3", *GRIPS):
            for entry in _listed(frame.get(group)):
                device = self._known.setdefault(group, {}).setdefault(entry["device_id"], {})
                _merge(device, entry)
        if not self.device_id:
            self.device_id = next(iter(self._known.get("inverse3", {})), "")
        mine = [
            each for each in _listed(frame.get("inverse3")) if each["device_id"] == self.device_id
        ]
        return any(isinstance(each.get("state"), dict) for each in mine)

    @property
    def device_ids(self) -> tuple[str, ...]:
        """Ids of the listed devices."""
        return tuple(self._known.get("inverse3", {}))

    @property
    def device(self) -> dict[str, Any]:
        """All entries of the device; empty if the device is not listed."""
        return self._known.get("inverse3", {}).get(self.device_id, {})

    def status(self, name: str) -> object:
        """Return an entry of the device's status; None if the entry is missing."""
        return _part(self.device, "status").get(name)

    def sample(self) -> HardwareSample | None:
        """Return the device's sample with orientation and buttons of the handle.

        The sample is None if a number is missing or invalid.
        """
        state = _part(self.device, "state")
        grips = [each for group in GRIPS for each in self._known.get(group, {}).values()]
        held = _part(grips[0] if grips else {}, "state")
        position = _numbers(state.get("cursor_position"), "xyz")
        if not position:
            return None
        x, y, z = position
        u, v, w = _numbers(state.get("cursor_velocity"), "xyz") or NOTHING
        a, b, c, d = _numbers(held.get("orientation"), "xyzw") or UPRIGHT
        return HardwareSample((x, y, z), (u, v, w), (a, b, c, d), buttons=_buttons(held))

    def model(self) -> str:
        """Return type, id, firmware and handedness of the device as a text, as far as known."""
        config = _part(self.device, "config")
        info = _part(config, "device_info")
        parts = [str(config.get("type", "inverse3")), self.device_id]
        if "major_version" in info:
            parts.append(f"firmware {info['major_version']}.{info.get('minor_version', 0)}")
        if "handedness" in config:
            parts.append(f"{config['handedness']}-handed")
        return ", ".join(parts)


def spelling_of(version: tuple[int, int] | None, *, has_session: bool) -> str:
    """Return the key of the force in a command, ``vector`` or ``values``.

    The key depends on the version of the service. If the version is unknown, the key depends on
    whether the service has reported a session.
    """
    is_new = has_session if version is None else version >= VECTOR_SINCE
    return "vector" if is_new else "values"


def version_in(text: str | bytes) -> tuple[int, int] | None:
    """Return major and minor version in an answer to ``/version``, or None if it has none."""
    try:
        answer = read_json(text)
    except ValueError:
        return None
    inner = _part(answer, "data") or answer
    for name in ("project_version", "git_tag", "git_describe"):
        stated = inner.get(name) if isinstance(inner, Mapping) else None
        # A tag may have a prefix such as v.
        if isinstance(stated, str) and (found := re.match(r"\D{0,3}(\d+)\.(\d+)", stated)):
            return int(found[1]), int(found[2])
    return None


def force_frame(device_id: str, force_N: Triple, spelling: str) -> str:
    """Return the command for a force in the device's frame.

    The service removes a force that is not sent repeatedly.
    """
    x, y, z = force_N
    vector = f'{{"x":{x:.6f},"y":{y:.6f},"z":{z:.6f}}}'
    return (
        f'{{"inverse3":[{{"device_id":{json.dumps(device_id)},'
        f'"commands":{{"set_cursor_force":{{"{spelling}":{vector}}}}}}}]}}'
    )


def opening_frame(device_id: str, spelling: str) -> str:
    """Return the first frame to send: name of the session, and zero force."""
    frame = read_json(force_frame(device_id, NOTHING, spelling))
    return json.dumps({"session": {"configure": {"profile": {"name": PROFILE}}}} | frame)


def service_address(address: str) -> tuple[str, str, int, str]:
    """Return URL, host, port and device id of ``hardware.address``.

    Raises
    ------
    InputError
        If the address is invalid.
    """
    meant = "ws://HOST:PORT, with #DEVICE for one of several"
    parts, host, port = checked_url(address or USUAL, ("ws",), meant, USUAL)
    return f"ws://{parts.netloc}", host, port, parts.fragment


def problem_of(state: ServiceState) -> str:
    """Return the reason why the device cannot be used; empty if it can be used."""
    name = state.device_id
    ids = state.device_ids
    if not ids:
        return (
            "haply must list an Inverse3, got none. Plug the device in, switch it on, "
            "and look for it in Haply Hub"
        )
    if name not in ids:
        required = f"name the device {enumerated(ids, 'or')} after #"
        return str(InputError("the address of haply", required, name, f"use #{ids[0]}"))
    for entry, must, remedy in (
        (
            "calibrated",
            "be calibrated",
            "calibrate the device as Haply Hub shows, and start the run again",
        ),
        ("power_supply", "have power", "connect the power supply of the device"),
        (
            "ready",
            "be ready",
            "wait until the light of the device shows that it is ready, and start the run again",
        ),
    ):
        # If a status is missing, the device can be used.
        if state.status(entry) is False:
            return str(InputError("haply", must, f"{entry} = false for {name}", remedy))
    return ""


def asked_version(host: str, port: int) -> tuple[int, int] | None:
    """Request the service's version by HTTP; return None if no answer arrives in time."""
    found: list[tuple[int, int]] = []

    def ask() -> None:
        # Versions before 3.5 answer under the second path.
        for path in ("/version", "/3.1/version"):
            with suppress(OSError, HTTPException):
                connection = HTTPConnection(host, port, timeout=ANSWER_S)
                try:
                    connection.request("GET", path)
                    answer = connection.getresponse()
                    version = version_in(answer.read(LONGEST)) if answer.status == 200 else None
                finally:
                    connection.close()
                if version is not None:
                    found.append(version)
                    return

    returned_within(STATED_S, ask)
    return found[0] if found else None


def _listed(group: object) -> list[dict[str, Any]]:
    """Return the entries of a list that have the structure of a device."""
    devices = group if isinstance(group, list) else []
    return [
        each
        for each in devices
        if isinstance(each, dict) and isinstance(each.get("device_id"), str)
    ]


def _merge(known: dict[str, Any], news: Mapping[str, Any]) -> None:
    """Merge new entries into known ones, entry by entry."""
    for name, value in news.items():
        if isinstance(value, dict) and isinstance(known.get(name), dict):
            _merge(known[name], value)
        else:
            known[name] = value


def _part(whole: object, name: str) -> dict[str, Any]:
    """Return the table with a given name inside a table; empty if it is missing."""
    part = whole.get(name) if isinstance(whole, Mapping) else None
    return part if isinstance(part, dict) else {}


def _numbers(table: object, names: str) -> tuple[float, ...]:
    """Return the named numbers of a table; empty if a number is missing, not finite or invalid."""
    found = [table.get(name) for name in names] if isinstance(table, dict) else [None]
    # bool is a subclass of int.
    numbers = tuple(
        float(each)
        for each in found
        if isinstance(each, int | float) and not isinstance(each, bool) and abs(each) < MOST
    )
    return numbers if len(numbers) == len(names) else ()


def _buttons(state: Mapping[str, Any]) -> int:
    """Return a bit mask of the pressed buttons, with bit i for the i-th button by name.

    A single button of a handle has the name ``button``.
    """
    buttons = state.get("buttons")
    if not isinstance(buttons, dict):
        return int(state.get("button") is True)
    held = [buttons[name] for name in sorted(buttons)]
    return sum(1 << place for place, each in enumerate(held) if each is True)


class StateOrder:
    """Check that states arrive in order, based on their positions and velocities.

    If a state is older than the state that arrived before it, the displacement between the two
    states is opposite to the velocity. If states arrive in a random order, about half of them have
    this contradiction. The averaged share of contradictions then exceeds the limit of a quarter
    within 17 ms.

    Attributes
    ----------
    is_wrong
        True if the recent states arrived in a wrong order.
    """

    def __init__(self) -> None:
        self.is_wrong = False
        self._share = self._came_s = 0.0
        self._last: HardwareSample | None = None

    def observe(self, sample: HardwareSample, time_s: float) -> bool:
        """Process a state that arrived at a time [s], and return True if the order is wrong."""
        last = self._last
        elapsed = min(time_s - self._came_s, LONGEST_S)
        self._last = sample
        self._came_s = time_s
        if last is None:
            return False
        step = [x - a for x, a in zip(sample.position_m, last.position_m, strict=True)]
        speed = [
            0.5 * (one + other)
            for one, other in zip(sample.velocity_m_s, last.velocity_m_s, strict=True)
        ]
        length = hypot(*step)
        fast = hypot(*speed)
        along = sum(x * v for x, v in zip(step, speed, strict=True))
        is_judged = length > LEAST_M and fast > LEAST_M_S
        against = is_judged and along < AGAINST * length * fast
        self._share += (1.0 - exp(-elapsed / MEMORY_S)) * (against - self._share)
        if self._share > WRONG:
            self.is_wrong = True
        elif self._share < RIGHT:
            self.is_wrong = False
        return self.is_wrong
