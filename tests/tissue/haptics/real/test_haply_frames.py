"""Frames of Haply's Inverse Service, as its documentation prints them."""

import json

import numpy as np
import pytest

from tissue import InputError
from tissue.haptics.real.haply_frames import (
    ServiceState,
    force_frame,
    opening_frame,
    problem_of,
    service_address,
    version_in,
)

FIRST = {
    "session_id": 7,
    "inverse3": [
        {
            "device_id": "049D",
            "config": {"type": "inverse3", "device_info": {"major_version": 7, "minor_version": 4}},
            "state": {
                "cursor_position": {"x": 0.01, "y": -0.12, "z": 0.15},
                "cursor_velocity": {"x": 0.1, "y": 0.2, "z": -0.3},
                "body_orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
            },
            "status": {
                "calibrated": True,
                "in_use": False,
                "power_supply": True,
                "ready": True,
                "started": True,
            },
        }
    ],
    "wireless_verse_grip": [
        {
            "device_id": "61548",
            "state": {
                "orientation": {"w": 0.5, "x": 0.5, "y": -0.5, "z": 0.5},
                "buttons": {"a": False, "b": True, "c": True},
                "battery_level": 0.8,
            },
            "status": {"connected": True, "awake": True, "ready": True},
        }
    ],
}


def state_after(*frames, device_id=""):
    state = ServiceState(device_id)
    for frame in frames:
        state.take(json.dumps(frame))
    return state


def test_the_first_frame_gives_pose_speed_orientation_and_buttons():
    sample = state_after(FIRST).sample()
    assert sample.position_m == (0.01, -0.12, 0.15) and sample.velocity_m_s == (0.1, 0.2, -0.3)
    assert sample.quaternion == (0.5, -0.5, 0.5, 0.5) and sample.buttons == 0b110
    assert state_after(FIRST).model() == "inverse3, 049D, firmware 7.4"


def test_later_frames_change_what_they_hold_and_leave_the_rest():
    partial = {
        "inverse3": [
            {"device_id": "049D", "state": {"cursor_position": {"x": 0.02, "y": -0.11, "z": 0.14}}}
        ]
    }
    pressed = {"wireless_verse_grip": [{"device_id": "61548", "state": {"buttons": {"a": True}}}]}
    state = state_after(FIRST)
    assert state.take(json.dumps(partial)) and not state.take(json.dumps(pressed))
    sample = state.sample()
    assert sample.position_m == (0.02, -0.11, 0.14) and sample.velocity_m_s == (0.1, 0.2, -0.3)
    assert sample.quaternion == (0.5, -0.5, 0.5, 0.5) and sample.buttons == 0b111
    assert state.status("calibrated") is True


@pytest.mark.parametrize("wrong", ["0.1", None, True, float("nan"), float("inf"), {}, 10**400])
def test_a_number_that_is_none_gives_no_sample(wrong):
    position = {"x": wrong, "y": 0.0, "z": 0.0}
    state = state_after(FIRST)
    state.take(
        json.dumps({"inverse3": [{"device_id": "049D", "state": {"cursor_position": position}}]})
    )
    assert state.sample() is None


def test_a_handle_with_one_button_and_none_at_all():
    wired = dict(FIRST)
    del wired["wireless_verse_grip"]
    assert state_after(wired).sample().quaternion == (0.0, 0.0, 0.0, 1.0)
    wired["verse_grip"] = [
        {
            "device_id": "A",
            "state": {"button": True, "orientation": {"w": 1, "x": 0, "y": 0, "z": 0}},
        }
    ]
    assert state_after(wired).sample().buttons == 1


@pytest.mark.parametrize("spelling", ["vector", "values"])
def test_a_force_in_both_spellings(spelling):
    frame = json.loads(force_frame("049D", (0.25, -1e-9, 1.5), spelling))
    vector = {"x": 0.25, "y": 0.0, "z": 1.5}
    assert frame == {
        "inverse3": [{"device_id": "049D", "commands": {"set_cursor_force": {spelling: vector}}}]
    }
    opening = json.loads(opening_frame('0"9', spelling))
    assert opening["session"] == {"configure": {"profile": {"name": "tissue:simulation"}}}
    assert opening["inverse3"][0]["device_id"] == '0"9'
    assert opening["inverse3"][0]["commands"]["set_cursor_force"][spelling] == {
        "x": 0.0,
        "y": 0.0,
        "z": 0.0,
    }


@pytest.mark.parametrize(
    ("answer", "version"),
    [
        ('{"git_tag": "3.5.0", "project_version": "3.5.0.0"}', (3, 5)),
        ('{"ok": true, "data": {"git_tag": "v3.1.2"}}', (3, 1)),
        ('{"git_describe": "3.10.0-2-gce34c39e"}', (3, 10)),
        ('{"ok": false}', None),
        ("not found", None),
        ("[]", None),
    ],
)
def test_the_version_of_a_service(answer, version):
    assert version_in(answer) == version


@pytest.mark.parametrize(
    "address",
    [
        "localhost:10001",
        "http://x:1",
        "ws://x",
        "ws://x:0",
        "ws://x:99999",
        "ws://x:1/path",
        "049D",
    ],
)
def test_what_is_no_address_is_refused(address):
    with pytest.raises(
        InputError, match=r"^hardware\.address must be ws://HOST:PORT.*\. Use ws://localhost:10001$"
    ):
        service_address(address)


def test_no_text_of_a_service_raises():
    """No text of a service raises.

    Frames have exchanged characters, entries and whole branches: they are merged or ignored, and
    give a sample or none.
    """
    rng, whole = np.random.default_rng(1), json.dumps(FIRST)
    values = [None, True, 7, -1e308, "x", [], {}, [[]], {"x": {"x": {}}}, [{"device_id": "049D"}]]
    state = state_after(FIRST)
    for _ in range(3000):
        text = bytearray(whole.encode())
        for place in rng.integers(0, len(text), size=rng.integers(1, 4)):
            text[place] = rng.integers(32, 127)
        table = json.loads(whole)
        branch = table
        while isinstance(branch, dict | list) and branch and rng.random() < 0.9:
            key = (
                rng.choice(list(branch))
                if isinstance(branch, dict)
                else int(rng.integers(len(branch)))
            )
            if not isinstance(branch[key], dict | list) or rng.random() < 0.3:
                branch[key] = values[rng.integers(len(values))]
                break
            branch = branch[key]
        for frame in (bytes(text), json.dumps(table)):
            state.take(frame)
            sample = state.sample()
            assert sample is None or all(
                abs(each) < 1e6 for each in (*sample.position_m, *sample.quaternion)
            )
            assert isinstance(problem_of(state), str) and isinstance(state.model(), str)
