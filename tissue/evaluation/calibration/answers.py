"""Sources of answers in a calibration session of force perception.

The answers come from a simulated observer, or from a person at the keyboard who feels forces on a
device.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import cos, inf, pi
from pathlib import Path
from time import perf_counter, sleep

import numpy as np

from meshes.base.errors import InputError, enumerated
from meshes.base.hints import suggests_arguments
from meshes.base.text_tables import number_in
from meshes.base.whole_file import require_new_file
from tissue.evaluation.calibration.observers import SimulatedObservers, draw_observers
from tissue.evaluation.calibration.session import (
    Comparison,
    Magnitude,
    Plan,
    TrialLog,
    log_path,
    read_log,
)
from tissue.haptics.device.device import (
    Device,
    DeviceError,
    DeviceParameters,
    device_parameters,
)
from tissue.haptics.device.safe_device import SafeDevice, run_held
from tissue.haptics.device.sample_guard import guard_of
from tissue.models.tissue_model import TICK_S
from tissue.scene.coupling import Hardware
from tissue.scene.registry import DEVICES, GROUPS
from tissue.simulation.builders.parts import new_device

Answer = Callable[[Comparison | Magnitude, int], float]
"""Function that takes a trial and its number in the session, and returns the answer."""
DIRECTION = np.array([0.0, 0.0, -1.0])
"""Unit vector of the force on the hand: downwards."""
LENGTH_S = 0.8
RAMP_S = 0.1
PAUSE_S = 0.4
"""Pause [s] between the two force intervals of a trial.

`LENGTH_S` is the duration of a force interval [s]. In the first and the last `RAMP_S` [s], the
force rises and falls smoothly.

In between, the force is constant for 0.6 s. This is six times the 0.1 s over which a person
averages a force (`integration_s` in perception.toml). Without the ramps, the force would be felt as
a tap.
"""
MOST_INVALID = 0.1
"""Largest accepted fraction of invalid device samples while a force is applied.

With this fraction, the time in which the force fades because of invalid samples is shorter than
`RAMP_S`.
"""


class StoppedError(Exception):
    """Error that is raised when a person stops a session."""


def play(
    device: Device | SafeDevice,
    force_N: float,
    *,
    limits: DeviceParameters,
    length_s: float = LENGTH_S,
    tick_s: float = TICK_S,
    clock: Callable[[], float] = perf_counter,
    wait: Callable[[float], None] = sleep,
) -> None:
    """Apply a force for a limited time, with a soft start and a soft end.

    While the device gives no valid samples, the force fades. The last commanded force is always
    zero, even after an error.

    Parameters
    ----------
    device
        Device that applies the force, or a `SafeDevice` that holds one.
    force_N
        Size of the downward force [N].
    limits
        Limits of the device.
    length_s
        Duration [s].
    tick_s
        Time between two commands [s].
    clock, wait
        Function that returns the time since the device was started [s], and function that waits for
        a number of seconds.

    Raises
    ------
    DeviceError
        If the device fails, or more than a tenth of its samples are invalid.
    """
    held = SafeDevice(device, tick_s=tick_s)
    guard = guard_of(held.device, limits, sample_s=max(1.0 / limits.rate_Hz, tick_s))

    def push() -> None:
        """Command the force tick by tick."""
        began = clock()
        ticks = 0
        while (at := clock() - began) < length_s:
            edge = min(at, length_s - at, RAMP_S) / RAMP_S
            wanted = force_N * 0.5 * (1.0 - cos(pi * edge)) * DIRECTION
            sample = guard.validate_sample(held.read(began + at), began + at)
            held.play(*guard.limit_force(None if sample is None else wanted))
            ticks += 1
            wait(tick_s)
        if guard.bad_ticks > MOST_INVALID * ticks:
            raise DeviceError(
                "the device",
                "give valid samples while it plays a force",
                f"{guard.events[0][1]} in {guard.bad_ticks} of {ticks} ticks",
                (
                    "check the device by `tissue devices --test`, then repeat the command "
                    "to continue the session"
                ),
            )

    run_held(push, held)


class Person:
    """Person who feels forces on a device, or sees them as bars, and answers at a keyboard.

    Parameters
    ----------
    device
        Device that applies the forces, or a `SafeDevice` that holds one. If None, each force is
        shown as a bar of characters.
    limits
        Limits of the device. A bar shows the force relative to the largest force of the device.
    read
        Function that returns the next typed line without the newline. The function raises EOFError
        at the end of the input.
    show
        Function that shows a line to the person.
    clock, wait
        Clock with an arbitrary zero that returns the time [s], and function that waits for a number
        of seconds.
    """

    def __init__(
        self,
        device: Device | SafeDevice | None,
        *,
        limits: DeviceParameters,
        read: Callable[[], str],
        show: Callable[[str], None],
        clock: Callable[[], float] = perf_counter,
        wait: Callable[[float], None] = sleep,
    ) -> None:
        self._device = device
        self._limits = limits
        self._read = read
        self._show = show
        self._wait = wait
        start = clock()
        self._clock = lambda: clock() - start

    def answer(self, asked: Comparison | Magnitude) -> float:
        """Apply or show the forces of a trial; repeat the question until the answer is valid.

        Raises
        ------
        StoppedError
            If the person types q, or the input ends.
        """
        forces: tuple[float, ...]
        if isinstance(asked, Comparison):
            question = "which was stronger, 1 or 2?"
            forces = asked.forces_N
        else:
            question = "how strong was it, as a number above 0?"
            forces = (asked.force_N,)
        self._present(forces)
        while True:
            self._show(f"{question} (r: again, q: stop)")
            try:
                word = self._read().strip().lower()
            except EOFError:
                raise StoppedError("no answer came") from None
            if word == "q":
                raise StoppedError("stopped")
            if word == "r":
                self._present(forces)
                continue
            try:
                # a decimal comma is in use too
                number = number_in(word.replace(",", "."))
            except ValueError:
                number = 0.0
            if isinstance(asked, Magnitude) and 0.0 < number < inf:
                return number
            if isinstance(asked, Comparison) and number in (1.0, 2.0):
                return int(number)
            allowed = "1 or 2" if isinstance(asked, Comparison) else "a number above 0"
            self._show(f"answer must be {allowed}, got {word or 'nothing'}")

    def _present(self, forces_N: tuple[float, ...]) -> None:
        for index, force in enumerate(forces_N, start=1):
            if self._device is None:
                self._show(f"interval {index}  {'█' * self._length(force)}")
                self._wait(LENGTH_S)
            else:
                self._show(f"interval {index}")
                play(self._device, force, limits=self._limits, clock=self._clock, wait=self._wait)
            self._wait(PAUSE_S)

    def _length(self, force_N: float) -> int:
        """Return the length of the bar of a force, in characters.

        The bar has at most 60 characters.
        """
        return max(round(60.0 * force_N / self._limits.force_limit_N), 1)


def simulated_observer(spec: str) -> tuple[SimulatedObservers, int]:
    """Return the observer with the name simulated:SEED or simulated:GROUP:SEED, and the seed.

    Raises
    ------
    InputError
        If the name has another form.
    """
    kind, *parts = spec.split(":")
    group, seed = (
        (parts[0], parts[1]) if len(parts) == 2 else ("intermediate", parts[0] if parts else "")
    )
    if (
        kind != "simulated"
        or len(parts) not in (1, 2)
        or not seed.isdecimal()
        or group not in GROUPS
    ):
        raise InputError(
            "observer",
            f"be simulated:SEED or simulated:GROUP:SEED with the group {enumerated(GROUPS, 'or')}",
            spec,
            "use simulated:1",
        )
    return draw_observers(group, 1, np.random.default_rng(int(seed))), int(seed)


@suggests_arguments
def simulated_answers(people: SimulatedObservers, seed: int) -> Answer:
    """Return the function that answers trials as a simulated observer.

    Each trial has its own random generator, so the answers do not depend on the order of the
    trials.
    """

    def answer(asked: Comparison | Magnitude, trial: int) -> float:
        """Answer the trial with the given number."""
        # 2 distinguishes this stream from the streams of `Session.ask` (0) and of other users of
        # the seed
        rng = np.random.default_rng([seed, 2, trial])
        if isinstance(asked, Magnitude):
            return float(people.number(asked.force_N, rng)[0])
        right = bool(people.correct(asked.base_N, asked.step_N, rng)[0])
        # 3 minus an interval is the other interval, 1 or 2
        return asked.greater if right else 3 - asked.greater

    return answer


@contextmanager
def questioner(
    observer: str | None,
    device: str,
    *,
    address: str = "",
    read: Callable[[], str],
    show: Callable[[str], None],
) -> Iterator[tuple[Answer, float]]:
    """Yield a function that answers trials, and the largest force of the device [N].

    The answers come from the simulated observer with the name `observer`, or from a person if
    `observer` is None. A real device stays open until the ``with`` block ends. It applies force
    only during the intervals of a trial in which a force is presented.

    Raises
    ------
    InputError
        If observer or device is unknown, or an address is given without a real device.
    """
    if device != "mouse" and device not in DEVICES:
        raise InputError("device", f"be one of mouse, {', '.join(DEVICES)}", device, "use mouse")
    # a mouse has no force limit; its bars represent forces of a Touch
    limits = device_parameters("touch" if device == "mouse" else device)
    opened = None
    if observer is None and device != "mouse":
        opened = new_device(device, Hardware(address=address, ramp_ms=0.0), start_m=(0.0, 0.0, 0.0))
    if address and opened is None:
        raise InputError(
            "--address",
            "be given only for a real device",
            address,
            "leave it out, or set --device to a real device such as haply",
        )
    if observer is not None:
        people, observer_seed = simulated_observer(observer)
        yield simulated_answers(people, observer_seed), limits.force_limit_N
        return
    if opened is None:
        show(
            "bars represent the forces, because no force can be felt here: the session "
            "calibrates the "
            "eye, not the sense of force"
        )
        person = Person(None, limits=limits, read=read, show=show)
        yield lambda asked, _: person.answer(asked), limits.force_limit_N
        return
    limits = getattr(opened, "limits", limits)
    with SafeDevice(opened) as held:
        show(f"hold the handle loosely: it pushes down with at most {limits.force_limit_N:g} N")
        person = Person(held, limits=limits, read=read, show=show)
        yield lambda asked, _: person.answer(asked), limits.force_limit_N


def begin(out: Path, observer: str, plan: Plan, *, overwrite: bool) -> TrialLog:
    """Open the trial log of a new session, or of a session to be continued.

    Raises
    ------
    InputError
        If `out` exists and `overwrite` is false, or if the log belongs to another session.
    """
    if out.suffix != ".json":
        raise InputError("out", "end in .json", out, "use observer.json")
    path = log_path(out)
    picture = out.with_suffix(".png")
    for each in (out, picture):
        require_new_file(each, overwrite=overwrite)
    require_new_file(path, overwrite=True)  # one that is there is read below
    if overwrite and path.exists():
        read_log(path)
        path.unlink()
    return TrialLog(path, observer, plan)
