"""The force to command so that an observer feels what the reference observer would, as a table
built once.
"""

from math import exp, log

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.perception.laws import Intensity

__all__ = ["ForceMap", "LogTable"]

NODES = 4097
"""Nodes of a table: over five decades the error of log-linear interpolation is below 1e-6 for every
observer whose exponent is known to 0.5."""


class LogTable:
    """A positive function of force, tabulated over ln F and interpolated linearly in its own
    logarithm.

    Exact for a power law. Below the first node it falls linearly to zero, above the last it goes on
    linearly.

    Parameters
    ----------
    forces_N
        Nodes [N], rising in equal ratios.
    values
        The function there, positive.
    """

    def __init__(self, forces_N: Array, values: Array) -> None:
        if not (np.isfinite(values).all() and (values > 0.0).all()):
            raise InputError(
                "values", "be positive and finite", "one that is not", "narrow the range of forces"
            )
        self._first = float(forces_N[0])
        self._last = float(forces_N[-1])
        self._start = log(self._first)
        self._per_log = (len(forces_N) - 1) / log(self._last / self._first)
        self._logs = np.log(values).tolist()
        self._below = float(values[0]) / self._first
        self._above = float(values[-1]) / self._last

    def at(self, force_N: float) -> float:
        """Return the function at a force of at least 0 [N]."""
        if force_N < self._first:
            return self._below * force_N
        if force_N >= self._last:
            return self._above * force_N
        place = (log(force_N) - self._start) * self._per_log
        node = int(place)
        here = self._logs[node]
        return exp(here + (place - node) * (self._logs[node + 1] - here))


class ForceMap:
    """Command by E5: the force whose expected intensity for this observer is the reference
    observer's at gain x force.

    Stevens' law is homogeneous, so a common factor on all forces keeps every ratio of intensities,
    and is the only law that does. The stated law for a device's range is therefore a factor: 1
    where the observer needs no more force than the reference at the strongest force that the device
    plays uncompressed (``knee_N``), and below 1 just so that this force is commanded there where he
    needs more. Up to the knee then

        E[S | command(F1)] / E[S | command(F2)] = (F1 / F2)^beta of the reference

    Beyond it `tissue.haptics.loop.filters.ForceRange` compresses, and reports it.

    Neither law has been measured far below the observer's low-force term: below it the map is
    continued in a straight line to zero, which also bounds its slope there, so that a contact does
    not begin infinitely stiff.

    Parameters
    ----------
    reference, observer
        Whose intensity is wanted, and who feels.
    lowest_N, knee_N
        Where the straight line ends [N], above 0, and the strongest force that the device plays
        uncompressed [N], above that.

    Attributes
    ----------
    gain
        The common factor.
    table, intensity, spread
        Command [N] over force, and mean and standard deviation of intensity over command.
    steepest
        Greatest slope of the map: how many times stiffer a contact can feel to the loop.

    Raises
    ------
    InputError
        If the observer is known too badly for the map to rise with the force.
    """

    def __init__(
        self, reference: Intensity, observer: Intensity, *, lowest_N: float, knee_N: float
    ) -> None:
        self._reference = reference
        self._observer = observer
        need = float(observer.force_N(reference.expected(knee_N)))
        most = float(reference.force_N(observer.expected(knee_N)))
        self.gain = 1.0 if need <= knee_N else most / knee_N
        self.forces_N: Array = np.geomspace(lowest_N, 100.0 * knee_N, NODES)
        commands = self._exact(self.forces_N)
        slopes = np.diff(commands) / np.diff(self.forces_N)
        if not (slopes > 0.0).all():
            raise InputError(
                "observer",
                "need more force for more intensity",
                "one who does not",
                "ask more trials",
            )
        within = int(np.searchsorted(self.forces_N, knee_N))
        self.steepest = float(max(slopes[:within].max(), commands[0] / lowest_N))
        self.table = LogTable(self.forces_N, commands)
        felt = np.geomspace(1e-3 * knee_N, 100.0 * knee_N, NODES)
        self.intensity = LogTable(felt, observer.expected(felt))
        self.spread = LogTable(felt, np.maximum(observer.spread(felt), 1e-12))

    def command_N(self, force_N: ArrayLike) -> Array:
        """Return the sizes of force to command [N] for sizes of force at the device [N],
        exactly, of any shape.
        """
        forces = np.asarray(force_N, dtype=float)
        first = self.forces_N[0]
        straight = forces * float(self._exact(first)) / first
        return np.where(forces < first, straight, self._exact(np.maximum(forces, first)))

    def _exact(self, force_N: ArrayLike) -> Array:
        """Return the inverse by closed form, without the straight line."""
        return self._observer.force_N(
            self._reference.expected(self.gain * np.asarray(force_N, dtype=float))
        )
