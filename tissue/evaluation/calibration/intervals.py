"""Trials that are put to a person: forces on a device, answers from the keyboard."""

from collections.abc import Callable
from math import cos, pi
from time import perf_counter, sleep

import numpy as np

from meshes.base.errors import InputError
from meshes.base.text_numbers import number_in
from tissue.evaluation.calibration.session import Comparison, Magnitude
from tissue.haptics.device.device import Device
from tissue.models.tissue_model import TICK_S

__all__ = ["Person", "StoppedError", "play"]

DIRECTION = np.array([0.0, 0.0, -1.0])
"""Direction in which forces push the hand: down."""
LENGTH_S, RAMP_S, PAUSE_S = 0.8, 0.1, 0.4
"""Length of an interval, of its soft start and end, and of the pause between two [s]."""


class StoppedError(Exception):
    """The person wants to go on another time."""


def play(
    device: Device,
    force_N: float,
    *,
    length_s: float = LENGTH_S,
    tick_s: float = TICK_S,
    clock: Callable[[], float],
    wait: Callable[[float], None] = sleep,
) -> None:
    """Push with a force for a while, with soft edges; whatever happens, the device is left without force.

    Parameters
    ----------
    device
        What plays it.
    force_N
        Force [N].
    length_s
        How long [s].
    tick_s
        Time between two commands [s].
    clock, wait
        Time since the device was started [s], and how to let time pass.
    """
    began, still = clock(), np.zeros(3)
    try:
        while (at := clock() - began) < length_s:
            edge = min(at, length_s - at, RAMP_S) / RAMP_S
            if device.read(began + at) is not None:
                device.command(force_N * 0.5 * (1.0 - cos(pi * edge)) * DIRECTION, still)
            else:
                device.command(still, still)
            wait(tick_s)
    finally:
        device.command(still, still)


class Person:
    """A person at a keyboard with a device.

    Parameters
    ----------
    device
        What plays the forces.
    read
        Gives the next line that the person types, without its end; raises EOFError when there is none.
    show
        Shows a line to the person.
    bars_N
        Greatest force for bars that represent forces, for devices that cannot push; None where they can.
    clock, wait
        Time that passes [s], from any start, and how to let it pass.
    """

    def __init__(
        self,
        device: Device,
        *,
        read: Callable[[], str],
        show: Callable[[str], None],
        bars_N: float | None = None,
        clock: Callable[[], float] = perf_counter,
        wait: Callable[[float], None] = sleep,
    ) -> None:
        self._device, self._read, self._show, self._bars_N = device, read, show, bars_N
        self._wait, start = wait, clock()
        self._clock = lambda: clock() - start

    def answer(self, asked: Comparison | Magnitude) -> float:
        """Play a trial and ask until the answer is a possible one.

        Raises
        ------
        StoppedError
            If the person types q, or nothing more comes.
        """
        compares = isinstance(asked, Comparison)
        forces = asked.forces_N if isinstance(asked, Comparison) else (asked.force_N,)
        question = "which was stronger, 1 or 2?" if compares else "how strong was it, as a number above 0?"
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
                return self._possible(word, compares)
            except InputError as problem:
                self._show(str(problem))

    @staticmethod
    def _possible(word: str, compares: bool) -> float:
        """The answer in a word."""
        if compares:
            if word not in ("1", "2"):
                raise InputError(f"answer must be 1 or 2, got {word or 'nothing'}: in which interval was it stronger?")
            return int(word)
        try:
            number = number_in(word.replace(",", "."))
        except ValueError:
            number = np.nan
        if not 0.0 < number < np.inf:
            raise InputError(f"answer must be a number above 0, got {word or 'nothing'}: for example 10")
        return number

    def _present(self, forces_N: tuple[float, ...]) -> None:
        for index, force in enumerate(forces_N, start=1):
            bar = "" if self._bars_N is None else "  " + "█" * max(round(60.0 * force / self._bars_N), 1)
            self._show(f"interval {index}{bar}")
            play(self._device, force, clock=self._clock, wait=self._wait)
            self._wait(PAUSE_S)
