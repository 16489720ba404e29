"""Frames of Haply's Inverse Service: merge received frames, and build frames to send.

Source: the vendor's pages websocket-protocol, control-commands, json-conventions and http of the
Inverse SDK 3.5, read. Units are m, m/s and N in a right-handed frame with x to the right, y forward
and z up. The first frame contains the whole state of every device. Later frames may contain parts
of it. Quaternions are w, x, y, z by name.
"""

import json
import re
from collections.abc import Mapping
from typing import Any

from meshes.base.text_tables import read_json
from tissue.haptics.real.adapter import HardwareSample
from tissue.motion.quaternion import Quaternion, Triple

__all__ = ["ServiceState", "force_frame", "opening_frame", "spelling_of", "version_in"]

GRIPS = ("wireless_verse_grip", "verse_grip", "custom_verse_grip")
"""Handles with orientation and buttons, in search order."""
VECTOR_SINCE = (3, 5)
"""First service version that names a force ``vector``; earlier versions use ``values``."""
MOST = 1e6
"""Bound on valid numbers: a number of this size or more is not a value of a device."""
PROFILE = "tissue:simulation"
"""Name of the session in the vendor's window."""


class ServiceState:
    """State of the devices of a service: the first frame, updated by later frames.

    Attributes
    ----------
    device_id
        Id of the used device: the first one that was listed, or the requested one.
    """

    def __init__(self, device_id: str = "") -> None:
        self.device_id = device_id
        self._known: dict[str, dict[str, dict[str, Any]]] = {}

    def take(self, text: str | bytes) -> bool:
        """Merge a frame, and return whether it contains a state of the device, for a new sample.

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
        """All entries of the device; empty if it is not listed."""
        return self._known.get("inverse3", {}).get(self.device_id, {})

    def status(self, name: str) -> object:
        """Return an entry of the device's status; None if it was not stated."""
        return _part(self.device, "status").get(name)

    def sample(self) -> HardwareSample | None:
        """Return the device's sample with orientation and buttons of the handle.

        It is None if a number is missing or invalid.
        """
        state = _part(self.device, "state")
        grip = self._grip()
        held = _part(grip, "state")
        position = _triple(state.get("cursor_position"))
        velocity = _triple(state.get("cursor_velocity"))
        if position is None:
            return None
        turned = _quaternion(held.get("orientation"))
        return HardwareSample(position, velocity or (0.0, 0.0, 0.0), turned, buttons=_buttons(held))

    def _grip(self) -> dict[str, Any]:
        """Return the first listed handle; empty without one."""
        for group in GRIPS:
            for grip in self._known.get(group, {}).values():
                return grip
        return {}

    def model(self) -> str:
        """Return type, id, firmware and handedness of the device as a text, as far as stated."""
        config = _part(self.device, "config")
        info = _part(config, "device_info")
        parts = [str(config.get("type", "inverse3")), self.device_id]
        if "major_version" in info:
            parts.append(f"firmware {info['major_version']}.{info.get('minor_version', 0)}")
        if "handedness" in config:
            parts.append(f"{config['handedness']}-handed")
        return ", ".join(parts)


def spelling_of(version: tuple[int, int] | None, *, has_session: bool) -> str:
    """Return the name of the force in a command, ``vector`` or ``values``.

    The version decides. If it is unknown, the presence of a session decides.
    """
    return (
        "vector" if (version >= VECTOR_SINCE if version is not None else has_session) else "values"
    )


def version_in(text: str | bytes) -> tuple[int, int] | None:
    """Return the major and minor version in an answer to ``/version``; None without one."""
    try:
        answer = read_json(text)
    except ValueError:
        return None
    inner = _part(answer, "data") or answer
    for name in ("project_version", "git_tag", "git_describe"):
        stated = inner.get(name) if isinstance(inner, Mapping) else None
        if isinstance(stated, str) and (found := re.match(r"\D{0,3}(\d+)\.(\d+)", stated)):
            return int(found[1]), int(found[2])
    return None


def force_frame(device_id: str, force_N: Triple, spelling: str) -> str:
    """Return the command for a force in the device's frame.

    The service drops a force that is not sent again.
    """
    x, y, z = force_N
    vector = f'{{"x":{x:.6f},"y":{y:.6f},"z":{z:.6f}}}'
    return (
        f'{{"inverse3":[{{"device_id":{json.dumps(device_id)},'
        f'"commands":{{"set_cursor_force":{{"{spelling}":{vector}}}}}}}]}}'
    )


def opening_frame(device_id: str, spelling: str) -> str:
    """Return the first frame to send: the name of the session, and zero force."""
    frame = read_json(force_frame(device_id, (0.0, 0.0, 0.0), spelling))
    return json.dumps({"session": {"configure": {"profile": {"name": PROFILE}}}} | frame)


def _listed(group: object) -> list[dict[str, Any]]:
    """Return the entries of a group that have the structure of a device."""
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
    """Return a table within a table; empty without one."""
    part = whole.get(name) if isinstance(whole, Mapping) else None
    return part if isinstance(part, dict) else {}


def _numbers(table: object, names: str) -> list[float] | None:
    """Return finite numbers of a table by name; None if one is missing or invalid."""
    found = [table.get(name) for name in names] if isinstance(table, dict) else [None]
    if not all(
        isinstance(each, int | float) and not isinstance(each, bool) and abs(each) < MOST
        for each in found
    ):
        return None
    return [float(each) for each in found]  # type: ignore[arg-type]


def _triple(table: object) -> Triple | None:
    numbers = _numbers(table, "xyz")
    return None if numbers is None else (numbers[0], numbers[1], numbers[2])


def _quaternion(table: object) -> Quaternion:
    numbers = _numbers(table, "xyzw")
    return (
        (0.0, 0.0, 0.0, 1.0)
        if numbers is None
        else (numbers[0], numbers[1], numbers[2], numbers[3])
    )


def _buttons(state: Mapping[str, Any]) -> int:
    """Return the buttons with bit i for the i-th button by name.

    A handle with a single button calls it ``button``.
    """
    buttons = state.get("buttons")
    held = (
        [buttons[name] for name in sorted(buttons)]
        if isinstance(buttons, dict)
        else [state.get("button", False)]
    )
    return sum(1 << place for place, each in enumerate(held) if each is True)
