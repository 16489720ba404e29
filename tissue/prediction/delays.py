"""Delay-coordinate (Hankel) Koopman operator that predicts the motion of a haptic device.

The coordinates are a delay embedding (Takens 1981) of two vectors: the displacement of the device,
and the stretch of the coupling spring between device and tool. For each number of ticks ahead, a
linear map is fitted directly (Brunton, Brunton, Proctor, Kaiser & Kutz 2017). Powers of the map for
one tick had larger errors. To compare errors e, excess errors sqrt(e^2 - e0^2) are computed, where
e0 is the lower bound of the error. The error ratio is the excess error divided by the excess error
of the zero-order hold. For predictions 4 ms ahead in the scene `wall` with nine delays, the error
ratio is 0.22 with powers and 0.19 with direct maps.
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

The stretch of the coupling was predicted 4 ms ahead, for simulated hands that were not in the
training data. The error ratio is the excess error divided by the excess error of the zero-order
hold, as defined at the start of this module. With these delays, the error ratio is 0.32 in the
scene molar, 0.40 in pedicle and 0.49 in incision. In the same scenes, the ratios are 0.32, 0.41 and
0.48 with all 81 delays from 0 to 80, and 0.52, 0.47 and 0.52 with `PATH_DELAYS`.
"""
PATH_DELAYS = (0, 4, 8, 14, 22, 32, 46, 64, 80)
"""Delays that are used to predict the displacement of the device [ticks].

Between closer delays, the displacement is smaller than an encoder step. For predictions of
`LookAhead` 4 ms ahead in the scene palpation, the error ratio (see `DELAYS`) is 0.31 with these
delays, and 0.33 with `DELAYS`.
"""
COORDINATES = 2 * len(DELAYS) - 1
"""Number of coordinates per axis: displacements between delays, and stretches at delays."""
HORIZON = 20
"""Largest number of ticks by which displacement and stretch are predicted ahead.

This number is enough for 16 ms of latency and the path to the motor, in total 18.1 ticks.

For a later time, the prediction for `HORIZON` ticks is used.
"""
PATH_RIDGE = 1e-6
"""Ridge penalty for the displacement, relative to the mean square of each coordinate.

The penalty keeps the weights small if the positions at neighbouring delays differ by less than an
encoder step. With a penalty of 1e-3, predictions were worse in all scenes. In palpation, the error
ratio (see `DELAYS`) was larger by 0.02.
"""
STRETCH_RIDGE = 1e-10
"""Ridge penalty for the stretch, relative to the mean square of each coordinate.

With a penalty of 1e-6, the error ratio (see `DELAYS`) increases from 0.34 to 0.42 in the scene
molar.
"""
KEPT_LEADS = 16
"""Number of prediction horizons whose maps are cached.

A haptic loop uses two horizons: its own horizon and one tick.
"""


@dataclass(frozen=True)
class Moments:
    """Second moments of delay coordinates and targets, to which a linear map is fitted.

    Attributes
    ----------
    coordinates
        Mean of z zᵀ over all axes and ticks [m2], shape (COORDINATES, COORDINATES). The vector z
        contains the coordinates of one spatial axis at one tick.
    targets
        Mean of z yᵀ [m2], shape (COORDINATES, 2 HORIZON). The targets y are the device
        displacements after 1 to `HORIZON` ticks, followed by the changes of the coupling's stretch
        after the same ticks.
    """

    coordinates: Array
    targets: Array

    @classmethod
    def pooled(cls, parts: Iterable["Moments"]) -> "Moments":
        """Return the mean of several moments that are first scaled to the same `power_m2`.

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
        """Mean square displacement between each delay and the next, summed over all delays."""
        return float(np.diag(self.coordinates)[: len(DELAYS) - 1].sum())

    def check(self) -> None:
        """Raise an InputError if a coordinate is always zero."""
        if not (np.diag(self.coordinates) > 0.0).all():
            raise InputError(
                "trials",
                "include a motion of the tool in contact with the tissue",
                "none",
                "use a longer duration_s",
            )

    def weights(self) -> Array:
        """Return the weights that predict the targets, shape (2 HORIZON, COORDINATES).

        Raises
        ------
        InputError
            If a coordinate is always zero.
        """
        self.check()
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
"""Matrix, shape (17, COORDINATES), that maps coordinates at `DELAYS` to those at `PATH_DELAYS`."""


@dataclass(frozen=True)
class DelayOperator:
    """Linear operator, fitted to recorded runs, that predicts displacement and stretch.

    The displacement is the motion of the device after the present tick. The stretch is the vector
    from the device to the tool. All axes use the same operator, without an offset. The prediction
    is therefore invariant to translation and rotation, and does not depend on the scale of the
    forces.

    Attributes
    ----------
    moments
        Moments of the training data.
    growth
        Limit of the sum that decides whether a motion is within the training range. To check a
        motion, each coordinate is divided by its RMS in the training data. The squares of these
        ratios are averaged over the coordinates and summed over the axes. The motion is within the
        training range if this sum does not exceed `growth`.
    """

    moments: Moments
    growth: float


def coordinates(position_m: Array, stretch_m: Array) -> Array:
    """Compute coordinates, shape (COORDINATES, ...), from positions and stretches at `DELAYS`.

    Positions and stretches have shape (delays, ...), with the newest value first.
    """
    return np.concatenate((position_m[:-1] - position_m[1:], stretch_m))


class DelayPath:
    """Predictor of a device's displacement and of the stretch of the coupling to its tool.

    Parameters
    ----------
    operator
        Operator with which displacement and stretch are predicted.
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
        """True if enough samples are known and the motion is within the training range."""
        if self._is_empty or self._missing:
            return False
        scaled = (self._coordinates * self._inverse).ravel()
        return float(scaled.dot(scaled)) <= self._growth

    def observe(self, position_m: Array, stretch_m: Array, filtered_m: Array | None = None) -> None:
        """Update with the device position and the coupling stretch in a tick, each of shape (3,).

        The first sample is used for all delays, because a run starts with the device at rest. After
        a pause, the prediction is not trusted until samples at all delays are known. `filtered_m`
        is the filtered device position, if the coupling filters it. This argument is ignored here,
        because a trained operator includes the effect of the filter.
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
        """Predict the displacement [m], shape (3,), of the device after a number of ticks."""
        displacement: Array = self._map(ticks)[0].dot(self._coordinates)
        return displacement

    def stretch_m(self, ticks: float) -> Array:
        """Predict the stretch of the coupling [m], shape (3,), after a number of ticks."""
        stretch: Array = self._recent[0, 1] + self._map(ticks)[1].dot(self._coordinates)
        return stretch

    def pause(self) -> None:
        """Discard all previous samples."""
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
