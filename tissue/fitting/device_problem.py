"""Logs of a haptic device as a fit takes them."""

from pathlib import Path

from meshes.base.errors import InputError
from tissue.fitting.device import device_fit, least_friction_N
from tissue.fitting.device_log import read_device_log
from tissue.fitting.device_windows import APART_S, DeviceLog
from tissue.fitting.problem import Problem
from tissue.materials.constants import constants, listed

__all__ = ["device_problem"]


def device_problem(name: str, free: Path, held: Path | None, columns: tuple[str, ...]) -> Problem:
    """Mass, damping and friction of a device, from a log of it free and one of it held.

    Parameters
    ----------
    name
        Of `tissue/materials/devices.toml`.
    free, held
        Logs, see `tissue.fitting.device_log.read_device_log`; the second may be left out, and newtons are then those
        of the motors.
    columns
        As there.

    Raises
    ------
    InputError
        If there is no such device, or it never moves.
    """
    if name not in (known := [each for each in listed("devices") if each != "any"]):
        raise InputError(f"device must be one of {', '.join(known)}, got {name}: write device:{known[0]}")
    logs: list[DeviceLog] = [read_device_log(free, columns, held=False)]
    notes = ["what to measure next is not computed for a device"]
    if held is None:
        notes.append("no held log: the three constants are known to the gain of the motors, 10 %")
    else:
        logs.append(read_device_log(held, columns, held=True))
    forward, measured = device_fit(name, *logs)
    notes += [note for each in logs for note in each.notes]
    step = constants("devices", name)["encoder_step_m"].value
    if (least := max(least_friction_N(each, step) for each in logs)) > 0.0:
        notes.append(f"friction is no less than {least:.3g} N, which the tip resisted at rest")
    return Problem(forward, measured, APART_S, lambda _: [], tuple(notes))
