"""Who answers a session, and the files it begins with."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError
from tissue.evaluation.calibration.intervals import Person
from tissue.evaluation.calibration.session import Comparison, Magnitude, Plan
from tissue.evaluation.calibration.simulated_observer import SimulatedObservers, draw_observers
from tissue.evaluation.calibration.trial_log import TrialLog, log_path, read_log
from tissue.haptics.device.device import Device, device_parameters
from tissue.haptics.device.recorded import MouseDevice
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.scene.registry import DEVICES, GROUPS
from tissue.system.outputs import require_new_file

__all__ = ["Answer", "begin", "questioner", "simulated_answers", "simulated_observer"]

Answer = Callable[[Comparison | Magnitude, int], float]
"""Answers a trial of that number."""


def simulated_observer(spec: str) -> tuple[SimulatedObservers, int]:
    """The one observer that simulated:SEED or simulated:GROUP:SEED names, and the seed.

    Raises
    ------
    InputError
        If the name is another.
    """
    kind, *parts = spec.split(":")
    group, seed = (parts[0], parts[1]) if len(parts) == 2 else ("intermediate", parts[0] if parts else "")
    if kind != "simulated" or len(parts) not in (1, 2) or not seed.isdecimal() or group not in GROUPS:
        raise InputError(
            f"observer must be simulated:SEED or simulated:GROUP:SEED with {', '.join(GROUPS)}, got {spec}: "
            "use simulated:1"
        )
    return draw_observers(group, 1, np.random.default_rng(int(seed))), int(seed)


def simulated_answers(people: SimulatedObservers, seed: int) -> Answer:
    """Answers of one simulated observer; each trial draws from a generator of its own, so order does not matter."""

    def answer(asked: Comparison | Magnitude, trial: int) -> float:
        rng = np.random.default_rng([seed, 2, trial])
        if isinstance(asked, Magnitude):
            return float(people.number(asked.force_N, rng)[0])
        right = bool(people.correct(asked.base_N, asked.step_N, rng, trial=trial)[0])
        return asked.greater if right else 3 - asked.greater

    return answer


def questioner(
    observer: str | None, device: str, *, seed: int, read: Callable[[], str], show: Callable[[str], None]
) -> tuple[Answer, float]:
    """Who answers, and the greatest force of the device [N]: a simulated observer, or a person at the keyboard.

    Raises
    ------
    InputError
        If observer or device is unknown.
    """
    if device not in ("mouse", *DEVICES):
        raise InputError(f"device must be one of mouse, {', '.join(DEVICES)}, got {device}: use mouse")
    limits = device_parameters("touch" if device == "mouse" else device)
    if observer is not None:
        people, observer_seed = simulated_observer(observer)
        return simulated_answers(people, observer_seed), limits.force_limit_N
    plays: Device = MouseDevice() if device == "mouse" else SimulatedDevice(limits)
    show("bars represent forces, as no force can be felt here: what is calibrated is the eye")
    person = Person(plays, read=read, show=show, bars_N=limits.force_limit_N)
    return lambda asked, _: person.answer(asked), limits.force_limit_N


def begin(out: Path, observer: str, plan: Plan, *, overwrite: bool) -> TrialLog:
    """The log of a session, begun or gone on with.

    Raises
    ------
    InputError
        If the observer's file is there already and may not be replaced, or the log is of another session.
    """
    if out.suffix != ".json":
        raise InputError(f"out must be the name of a file that ends in .json, got {out}: use observer.json")
    path, picture = log_path(out), out.with_suffix(".png")
    for each in (out, picture):
        require_new_file(each, overwrite=overwrite)
    require_new_file(path, overwrite=True)  # one that is there is read below
    if overwrite and path.exists():
        read_log(path)
        path.unlink()
    return TrialLog(path, observer, plan)
