"""Online update of an operator by recursive least squares with forgetting and a bounded gain."""

from dataclasses import replace
from math import isfinite, nan

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_positive, require_range
from tissue.prediction.edmd.lifted import Operator

__all__ = ["Online"]


class Online:
    """Recursive least squares for an operator's A, B and offset, at a fixed cost a sample.

    It works in scaled observables. With plain forgetting, the covariance of regressors that are not
    excited grows without bound, and the next large error destroys the operator. Here each sample
    also adds a little information about one regressor in turn, which keeps the current weights
    there. This follows the cyclic leakage of Gunnarsson (1996). The share is chosen so that the
    covariance never exceeds 4 gain_limit². The gain P g / (1 + g·P g) is at most half the root of
    the covariance, so it never exceeds gain_limit.

    Parameters
    ----------
    operator
        Initial operator. The covariance starts as if the training data were the number of samples
        that the memory holds.
    forgetting
        Weight that a sample keeps from one to the next, in (0.5, 1]; the memory is 1 / (1 -
        forgetting) samples.
    gain_limit
        Largest change of the scaled weights for a scaled one-step error of one.

    Raises
    ------
    InputError
        If an option is out of its range.
    """

    def __init__(
        self, operator: Operator, *, forgetting: float = 0.999, gain_limit: float = 1.0
    ) -> None:
        require_range("forgetting", forgetting, 0.5, 1.0, "use 0.999")
        require_positive("gain_limit", gain_limit, "use 1")
        self._start = operator
        self._forgetting = float(forgetting)
        count, inputs = operator.B.shape
        self._count = count
        self._size = len(operator.moments)
        self._middle = np.concatenate((operator.middle, operator.input_middle))
        self._scale = np.concatenate((operator.scale, operator.input_scale))
        rows = operator.scale[:, None]
        self._weights = np.hstack((operator.A, operator.B)) * self._scale / rows
        if self._size > count + inputs:
            moved = (
                operator.A @ operator.middle + operator.B @ operator.input_middle + operator.offset
            )
            self._weights = np.hstack((self._weights, (moved - operator.middle)[:, None] / rows))
        largest = 4.0 * gain_limit**2
        cycle = self._forgetting**self._size
        self._leak = (1.0 - cycle) / (cycle * largest)
        memory = operator.statistics.samples
        if forgetting < 1.0:
            memory = min(memory, round(1.0 / (1.0 - forgetting)))
        information = memory * operator.moments + np.eye(self._size) / (cycle * largest)
        covariance = np.linalg.inv(information)
        self._covariance = 0.5 * (covariance + covariance.T)
        self._regressors = np.ones(self._size)
        self._square = np.empty((self._size, self._size))
        self._change = np.empty_like(self._weights)
        self._turn = 0

    def update(self, lifted: Array, inputs: Array | None, lifted_after: Array) -> float:
        """Update the operator with one step and return the error before the update.

        The step is given by the observables (D,), the inputs (m,) and the observables after it. The
        error is the root mean square of the scaled one-step error. If a number is not finite, the
        error is NaN and the operator does not change.
        """
        given = self._regressors
        given[: self._count] = lifted
        if inputs is not None:
            given[self._count : len(self._scale)] = inputs
        given[: len(self._scale)] -= self._middle
        given[: len(self._scale)] /= self._scale
        error = (lifted_after - self._middle[: self._count]) / self._scale[
            : self._count
        ] - self._weights @ given
        size = float(error @ error)
        if not (isfinite(size) and isfinite(float(given @ given))):
            return nan
        covariance = self._covariance
        covariance /= self._forgetting
        spread = covariance @ given
        gain = spread / (1.0 + float(given @ spread))
        self._weights += np.multiply.outer(error, gain, out=self._change)
        covariance -= np.multiply.outer(spread, spread, out=self._square) / (
            1.0 + float(given @ spread)
        )
        column = covariance[self._turn].copy()
        share = self._leak / (1.0 + self._leak * column[self._turn])
        covariance -= np.multiply.outer(column, column, out=self._square) * share
        self._turn = (self._turn + 1) % self._size
        return (size / self._count) ** 0.5

    def operator(self, cap: float | None = 1.0) -> Operator:
        """Return the present operator in the units of the observables, its eigenvalues capped.

        A cap of None leaves the eigenvalues unchanged.

        Raises
        ------
        InputError
            If the cap is not positive.
        """
        start = self._start
        count = self._count
        rows = start.scale[:, None]
        raw = self._weights[:, : len(self._scale)] * rows / self._scale
        constant = np.zeros(count)
        if self._size > len(self._scale):
            constant = self._weights[:, -1] * start.scale + start.middle - raw @ self._middle
        learnt = replace(start, A=raw[:, :count], B=raw[:, count:], offset=constant)
        return learnt if cap is None else learnt.capped(cap)
