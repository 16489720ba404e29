"""The frames of Haply's Inverse Service: what it sends merged and read, and what it is sent.

Facts: the vendor's pages websocket-protocol, control-commands, json-conventions and http of the
Inverse SDK 3.5, read. Metres, m/s and newtons in a right-handed frame with x to the right, y
forward and z up. The first frame holds all of every device; later ones may hold less of it.
Quaternions come as w, x, y, z by name.
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
"""Handles that give orientation and buttons, in the order in which they are looked for."""
VECTOR_SINCE = (3, 5)
"""Version of the service from which a force is called ``vector``; before it is called
``values``.
"""
MOST = 1e6
"""A number of this size or more is none that a device states."""
PROFILE = "tissue:simulation"
"""Name under which the vendor's window shows the session."""


class ServiceState:
    """What is known of the devices of a service: the first frame, and what later frames have
    changed of it.

    Attributes
    ----------
    device_id
        The device that is used: the first one that was listed, or the one that was asked for.
    """

    def __init__(self, device_id: str = "") -> None:
        self.device_id = device_id
        self._known: dict[str, dict[str, dict[str, Any]]] = {}

    def take(self, text: str | bytes) -> bool:
        """Merge a frame; whether it holds something of the device's state, so that it gives a new
        sample.

        What is no JSON, or not built as a frame is, changes nothing.
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
        """The devices that were listed."""
        return tuple(self._known.get("inverse3", {}))

    @property
    def device(self) -> dict[str, Any]:
        """All that is known of the device; empty where it is not listed."""
        return self._known.get("inverse3", {}).get(self.device_id, {})

    def status(self, name: str) -> object:
        """An entry of the device's status; None where it was not stated."""
        return _part(self.device, "status").get(name)

    def sample(self) -> HardwareSample | None:
        """The device's sample with orientation and buttons of the handle; None where a number is
        missing or none.
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
        """The first handle that is listed; empty where there is none."""
        for group in GRIPS:
            for grip in self._known.get(group, {}).values():
                return grip
        return {}

    def model(self) -> str:
        """Type, identity, firmware and hand of the device in words, as far as they were stated."""
        config = _part(self.device, "config")
        info = _part(config, "device_info")
        parts = [str(config.get("type", "inverse3")), self.device_id]
        if "major_version" in info:
            parts.append(f"firmware {info['major_version']}.{info.get('minor_version', 0)}")
        if "handedness" in config:
            parts.append(f"{config['handedness']}-handed")
        return ", ".join(parts)


def spelling_of(version: tuple[int, int] | None, *, has_session: bool) -> str:
    """Name of the force in a command, ``vector`` or ``values``: by the version; where it is
    unknown, by a session.
    """
    return (
        "vector" if (version >= VECTOR_SINCE if version is not None else has_session) else "values"
    )


def version_in(text: str | bytes) -> tuple[int, int] | None:
    """Major and minor version in what the service answers to ``/version``; None where there is
    none.
    """
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
    """The command of a force in the device's frame, which the service forgets unless it is sent
    again.
    """
    x, y, z = force_N
    vector = f'{{"x":{x:.6f},"y":{y:.6f},"z":{z:.6f}}}'
    return (
        f'{{"inverse3":[{{"device_id":{json.dumps(device_id)},'
        f'"commands":{{"set_cursor_force":{{"{spelling}":{vector}}}}}}}]}}'
    )


def opening_frame(device_id: str, spelling: str) -> str:
    """The first frame that is sent: the session's name, and no force."""
    frame = read_json(force_frame(device_id, (0.0, 0.0, 0.0), spelling))
    return json.dumps({"session": {"configure": {"profile": {"name": PROFILE}}}} | frame)


def _listed(group: object) -> list[dict[str, Any]]:
    """The devices of a group that are built as devices are."""
    devices = group if isinstance(group, list) else []
    return [
        each
        for each in devices
        if isinstance(each, dict) and isinstance(each.get("device_id"), str)
    ]


def _merge(known: dict[str, Any], news: Mapping[str, Any]) -> None:
    """Put what is new into what is known, entry by entry."""
    for name, value in news.items():
        if isinstance(value, dict) and isinstance(known.get(name), dict):
            _merge(known[name], value)
        else:
            known[name] = value


def _part(whole: object, name: str) -> dict[str, Any]:
    """A table in a table; empty where there is none."""
    part = whole.get(name) if isinstance(whole, Mapping) else None
    return part if isinstance(part, dict) else {}


def _numbers(table: object, names: str) -> list[float] | None:
    """Finite numbers of a table by their names; None where one is missing or none."""
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
    """Bit i for the i-th button by name; a handle with one alone calls it ``button``."""
    buttons = state.get("buttons")
    held = (
        [buttons[name] for name in sorted(buttons)]
        if isinstance(buttons, dict)
        else [state.get("button", False)]
    )
    return sum(1 << place for place, each in enumerate(held) if each is True)
