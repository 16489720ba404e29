"""Address, version and device problems of Haply's Inverse Service."""

from contextlib import suppress
from http.client import HTTPConnection, HTTPException
from urllib.parse import urlsplit

from meshes.base.errors import InputError
from tissue.haptics.real.haply_frames import ServiceState, version_in
from tissue.system.stopping import returned_within

__all__ = ["asked_version", "problem_of", "service_address"]

USUAL = "ws://localhost:10001"
ANSWER_S, STATED_S = 0.5, 2.0
"""Longest silence of the service before it states its version, and longest total time [s]."""
LONGEST = 65_536
"""Largest number of bytes read from a version answer."""


def service_address(address: str) -> tuple[str, str, int, str]:
    """Return URL, host, port and device id of ``hardware.address``.

    Raises
    ------
    InputError
        If the address is invalid.
    """
    parts = urlsplit(address or USUAL)
    try:
        host = parts.hostname
        port = parts.port
    except ValueError:
        host = port = None
    if parts.scheme != "ws" or not host or not port or parts.path not in ("", "/"):
        raise InputError(
            "hardware.address",
            "be ws://HOST:PORT, with #DEVICE for one of several",
            address,
            f"use {USUAL}",
        )
    return f"ws://{parts.netloc}", host, port, parts.fragment


def problem_of(state: ServiceState) -> str:
    """Return the reason that the device cannot be used, in one sentence; empty if it can."""
    name = state.device_id
    ids = state.device_ids
    if not ids:
        return (
            "haply must list an Inverse3, got none: plug it in, switch it on, and look for it in "
            "Haply Hub"
        )
    if name not in ids:
        return (
            f"hardware.address must name one of the devices {', '.join(ids)} behind #, got "
            f"{name}: use #{ids[0]}"
        )
    for entry, must, remedy in (
        ("calibrated", "be calibrated", "calibrate it as Haply Hub shows, and start again"),
        ("power_supply", "have power", "connect its power supply"),
        ("ready", "be ready", "wait until its light shows that it is, and start again"),
    ):
        if state.status(entry) is False:
            return f"haply must {must}, got {entry} = false of {name}: {remedy}"
    return ""


def asked_version(host: str, port: int) -> tuple[int, int] | None:
    """Return the service's version from HTTP at the same port; None without a timely answer."""
    found: list[tuple[int, int]] = []
    returned_within(STATED_S, lambda: found.extend(_versions(host, port)))
    return found[0] if found else None


def _versions(host: str, port: int) -> list[tuple[int, int]]:
    """Return the versions stated at the usual paths, at most one."""
    for path in ("/version", "/3.1/version"):
        with suppress(OSError, HTTPException):
            connection = HTTPConnection(host, port, timeout=ANSWER_S)
            try:
                connection.request("GET", path)
                answer = connection.getresponse()
                if answer.status == 200 and (found := version_in(answer.read(LONGEST))) is not None:
                    return [found]
            finally:
                connection.close()
    return []
