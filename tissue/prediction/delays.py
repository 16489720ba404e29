"""Delay-coordinate (Hankel) Koopman operator of a device and its coupling.

The coordinates are a delay embedding (Takens 1981) of the displacement of the device and the
stretch of the coupling. For each number of ticks ahead, a linear map is fitted directly (Brunton,
Brunton, Proctor, Kaiser & Kutz 2017). Powers of the map for one tick had a larger error. Errors e
are compared as excess errors sqrt(e^2 - e0^2), where e0 is the lower bound of the error. The excess
error is divided by the excess error of the zero-order hold. For predictions 4 ms ahead in the scene
`wall`, this ratio is 0.22 with powers and 0.19 with direct maps (nine delays).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil

import numpy as np
from scipy.linalg import block_diag
from scipy.linalg.lapack import dposv

from meshes.base.arrays import Array
from meshes.base.errors import InputError

DELAYS = (0, 1, 2, 3, 4, 6, 8, 11, 14, 18, 22, 32, 46, 64, 80)
"""Delays of the coordinates [ticks].

These delays replace all 81 delays from 0 to 80. The stretch was predicted 4 ms ahead by direct
regression, for simulated hands that were not in the training data. The excess error was divided by
the excess error of the zero-order hold. With these delays, the ratios are 0.32 in molar, 0.40 in
pedicle and 0.49 in incision. With all 81 delays, the ratios are 0.32, 0.41 and 0.48, and with
`PATH_DELAYS` 0.52, 0.47 and 0.52.
"""
PATH_DELAYS = (0, 4, 8, 14, 22, 32, 46, 64, 80)
"""Delays from which the displacement is predicted [ticks].

At shorter delays, the displacement is smaller than an encoder step. The excess error of `LookAhead`
4 ms ahead in palpation was divided by the excess error of the zero-order hold. This ratio is 0.31
with these delays and 0.33 with all of `DELAYS`.
"""
COORDINATES = 2 * len(DELAYS) - 1
"""Number of coordinates of an axis: displacements between delays, and stretches at delays."""
HORIZON = 20
"""Largest number of ticks by which displacement and stretch are predicted ahead.

This number is enough for 16 ms of latency and the path to the motor, in total 18.1 ticks.

For a longer time, the prediction at the horizon is used.
"""
PATH_RIDGE = 1e-6
"""Ridge penalty for the displacement, relative to the mean square of each coordinate.

The penalty keeps the weights small if the positions at neighbouring delays differ by less than an
encoder step. A penalty of 1e-3 was worse in all scenes. In palpation, the ratio of the excess error
to the excess error of the zero-order hold was larger by 0.02.
"""
STRETCH_RIDGE = 1e-10
"""Ridge penalty for the stretch, relative to the mean square of each coordinate.

With a penalty of 1e-6, the ratio of excess errors that is defined at `DELAYS` rises from 0.34 to
0.42 in molar.
"""
KEPT_LEADS = 16
"""Number of prediction horizons whose maps are kept; a loop uses its horizon and one tick."""


@dataclass(frozen=True)
class Moments:
    """Second moments of coordinates and targets, the sufficient statistics of a linear fit.

    Attributes
    ----------
    coordinates
        Mean of z zᵀ over all axes and ticks [m2], shape (COORDINATES, COORDINATES). z is the vector
        of the coordinates of an axis in a tick.
    targets
        Mean of z yᵀ [m2], shape (COORDINATES, 2 HORIZON). The targets y are the displacements after
        1 to `HORIZON` ticks, followed by the changes of the stretch after the same ticks.
    """

    coordinates: Array
    targets: Array

    @classmethod
    def pooled(cls, parts: Iterable["Moments"]) -> "Moments":
        """Return the mean of several moments, after scaling them to the same power.

        The common power is the geometric mean of the values of `power_m2`.
        """
        ready = list(parts)
        powers = np.array([each.power_m2 for each in ready])
        shares = np.exp(np.log(powers).mean()) / powers / len(ready)
        pairs = list(zip(shares, ready, strict=True))
        return cls(
            np.sum([share * each.coordinates for share, each in pairs], axis=0),
            np.sum([share * each.targets for share, each in pairs], axis=0),
        )

    @property
    def power_m2(self) -> float:
        """Mean square of the displacement between two delays, summed over the delays."""
        return float(np.diag(self.coordinates)[: len(DELAYS) - 1].sum())

    def weights(self) -> Array:
        """Return the weights that predict the targets, shape (2 HORIZON, COORDINATES).

        Raises
        ------
        InputError
            If a coordinate is always zero.
        """
        if not (np.diag(self.coordinates) > 0.0).all():
            raise InputError(
                "trials",
                "have a tool that moves and touches the tissue",
                "none in any trial",
                "use a longer duration",
            )
        path = PATH_COORDINATES
        displacement = _solved(
            path @ self.coordinates @ path.T, path @ self.targets[:, :HORIZON], PATH_RIDGE
        )
        stretch = _solved(self.coordinates, self.targets[:, HORIZON:], STRETCH_RIDGE)
        return np.concatenate((displacement @ path, stretch))


def _solved(squares: Array, products: Array, ridge: float) -> Array:
    """Return the weights of a ridge regression, shape (targets, coordinates)."""
    scale = np.sqrt(np.diag(squares))
    matrix = squares / np.outer(scale, scale)
    matrix.flat[:: len(scale) + 1] += ridge
    _, solved, _ = dposv(matrix, products / scale[:, None])
    weights: Array = (solved / scale[:, None]).T
    return weights


def _path_coordinates() -> Array:
    """Return the matrix that maps coordinates at `DELAYS` to coordinates at `PATH_DELAYS`.

    Displacements between delays are summed, and stretches are selected.
    """
    delays = np.array(DELAYS)
    path_delays = np.array(PATH_DELAYS)[:, None]
    starts = path_delays[:-1]
    ends = path_delays[1:]
    parts = (delays[:-1] >= starts) & (delays[1:] <= ends)
    chosen = path_delays == delays
    return np.asarray(block_diag(parts, chosen), dtype=np.float64)


PATH_COORDINATES = _path_coordinates()
"""Matrix of the coordinates from which the displacement is predicted, shape (17, COORDINATES)."""


@dataclass(frozen=True)
class DelayOperator:
    """Operator that predicts displacement and stretch of an axis, fitted to recorded runs.

    All axes use the same operator on displacements and stretches, without an offset. The prediction
    is therefore invariant to translation and rotation. It does not depend on the scale of the
    forces.

    Attributes
    ----------
    moments
        Moments of the training data.
    growth
        Limit of the training range. Each coordinate is divided by its RMS in the training data. The
        mean of the squares over the coordinates, summed over the axes, must not exceed the limit.
    """

    moments: Moments
    growth: float


def coordinates(position_m: Array, stretch_m: Array) -> Array:
    """Return the coordinates, shape (COORDINATES, ...), from the values at `DELAYS`.

    Positions and stretches have shape (delays, ...), with the newest value first.
    """
    return np.concatenate((position_m[:-1] - position_m[1:], stretch_m))


class DelayPath:
    """Predictor of a device's displacement and its coupling's stretch with a delay operator.

    Parameters
    ----------
    operator
        Operator that predicts displacement and stretch of an axis.
    """

    def __init__(self, operator: DelayOperator) -> None:
        self._weights = operator.moments.weights()
        # The mean square over all coordinates is compared with `growth`.
        scale = np.sqrt(COORDINATES * np.diag(operator.moments.coordinates))
        self._inverse = 1.0 / scale[:, None]
        self._growth = operator.growth
        # Positions and stretches of the last ticks, newest first.
        self._recent = np.zeros((DELAYS[-1] + 1, 2, 3))
        self._coordinates = np.zeros((COORDINATES, 3))
        self._maps: dict[float, Array] = {}
        self._is_empty = True
        self._missing = 0

    @property
    def trusted(self) -> bool:
        """True if all delays are known and the motion is within the training range."""
        if self._is_empty or self._missing:
            return False
        scaled = (self._coordinates * self._inverse).ravel()
        return float(scaled.dot(scaled)) <= self._growth

    def observe(self, position_m: Array, stretch_m: Array, filtered_m: Array | None = None) -> None:
        """Update with the device position and the coupling stretch in a tick, each of shape (3,).

        The first state fills all delays, as if the device had been at rest. This assumption is true
        at the start of a run. After a pause, the path is not trusted until all delays are measured.
        `filtered_m` is the position that the coupling uses, if it is not the measured position. It
        is not used here, because a trained operator includes the difference between these
        positions.
        """
        recent = self._recent
        self._missing = max(self._missing - 1, 0)
        if self._is_empty:
            recent[:] = position_m, stretch_m
            self._is_empty = False
        else:
            recent[1:] = recent[:-1]
            recent[0] = position_m, stretch_m
        seen = recent[DELAYS, :]
        self._coordinates = coordinates(seen[:, 0], seen[:, 1])

    def displacement_m(self, ticks: float) -> Array:
        """Predict the displacement of the device from its last observed position, shape (3,)."""
        displacement: Array = self._map(ticks)[0].dot(self._coordinates)
        return displacement

    def stretch_m(self, ticks: float) -> Array:
        """Predict the coupling's stretch after a number of ticks, shape (3,)."""
        stretch: Array = self._recent[0, 1] + self._map(ticks)[1].dot(self._coordinates)
        return stretch

    def pause(self) -> None:
        """Clear all delays; they are filled again from the next tick on."""
        self._is_empty = True
        self._missing = DELAYS[-1] + 1

    def _map(self, ticks: float) -> Array:
        """Return the weights for displacement and change of stretch, shape (2, COORDINATES)."""
        found = self._maps.get(ticks)
        if found is None:
            # Between two whole ticks the weights are interpolated.
            weights = self._weights.reshape(2, HORIZON, COORDINATES)
            low = min(int(ticks), HORIZON)
            high = min(ceil(ticks), HORIZON)
            before = weights[:, low - 1] if low else np.zeros((2, COORDINATES))
            after = weights[:, high - 1] if high else before
            found = before + (ticks - int(ticks)) * (after - before)
            if len(self._maps) < KEPT_LEADS:
                self._maps[ticks] = found
        return found
