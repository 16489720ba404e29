"""Map from force to command, tabulated once, that matches the reference observer's intensity."""

from math import exp, log

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.perception.laws import Intensity

__all__ = ["ForceMap", "LogTable"]

NODES = 4097
"""Nodes of a table.

Over five decades the error of log-linear interpolation is below 1e-6 for every observer whose
exponent is known to 0.5.
"""


class LogTable:
    """Positive function of force, tabulated over ln F and interpolated linearly in its logarithm.

    Exact for a power law. Below the first node it falls linearly to zero; above the last it
    continues linearly.

    Parameters
    ----------
    forces_N
        Nodes [N], rising in equal ratios.
    values
        Values of the function at the nodes, positive.
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
        """Return the function at a force [N], 0 or more."""
        if force_N < self._first:
            return self._below * force_N
        if force_N >= self._last:
            return self._above * force_N
        place = (log(force_N) - self._start) * self._per_log
        node = int(place)
        here = self._logs[node]
        return exp(here + (place - node) * (self._logs[node + 1] - here))


class ForceMap:
    """Command by E5: the force whose expected intensity for this observer matches the reference.

    The reference is the reference observer's intensity at gain x force.

    Stevens' law is homogeneous, so a common factor on all forces keeps every ratio of intensities.
    No other law does. The stated law for a device's range is therefore a factor. ``knee_N`` is the
    strongest force that the device plays uncompressed. The factor is 1 where the observer needs no
    more force than the reference at ``knee_N``. Where the observer needs more force, the factor is
    below 1, so that exactly ``knee_N`` is commanded there. Up to the knee then

        E[S | command(F1)] / E[S | command(F2)] = (F1 / F2)^beta of the reference

    Beyond it `tissue.haptics.loop.filters.ForceRange` compresses, and reports it.

    Neither law has been measured far below the observer's low-force term. Below this term the map
    continues in a straight line to zero. The line also bounds the slope of the map there, so that
    the stiffness at the start of a contact is finite.

    Parameters
    ----------
    reference, observer
        Observer whose intensity is matched, and observer who feels the command.
    lowest_N, knee_N
        Upper end of the straight line [N], above 0, and the strongest force that the device plays
        uncompressed [N], above that end.

    Attributes
    ----------
    gain
        The common factor.
    table, intensity, spread
        Command [N] over force, and mean and standard deviation of intensity over command.
    steepest
        Largest slope of the map: the largest factor on a contact's stiffness in the loop.

    Raises
    ------
    InputError
        If the observer's posterior is too wide for the map to rise with the force.
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
        """Return the force sizes to command [N] for force sizes at the device [N].

        The result is exact, for arrays of any shape.
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
