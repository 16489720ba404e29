"""How far observables are from being closed, and the order of one-step errors that follows from it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.prediction.edmd.lifted import Generator

__all__ = ["StepErrors", "closure_defects", "step_errors"]


@dataclass(frozen=True)
class StepErrors:
    """One-step errors of a generator against the step, in scaled observables, mean over the states.

    Attributes
    ----------
    steps_s
        Steps h [s], shape (k,).
    euler
        |φ(x(t + h)) - φ - h (Kφ + Bu)|, the update that the paper's Theorem 1 calls O(h²), shape (k,).
    exact
        The same with the exact exponential of K over the step, shape (k,).
    defect
        |Lφ - (Kφ + Bu)| [1/s]: where it is not zero both errors tend to h times it.
    """

    steps_s: Array
    euler: Array
    exact: Array
    defect: float


def closure_defects(generator: Generator, states: Array, rates: Array, inputs: Array | None = None) -> Array:
    """|Lφ - (Kφ + Bu)| at each state, in scaled observables [1/s], shape (n,); Lφ = ∇φ · dx/dt.

    Parameters
    ----------
    states, rates
        States and their time derivatives, shape (n, d); with delays whole windows of them, newest first.
    inputs
        Inputs acting there, shape (n, m).
    """
    true = generator.dictionary.lift_rates(states, rates)
    fitted = generator.dictionary.lift(states) @ generator.A.T + generator.offset
    if inputs is not None:
        fitted = fitted + inputs @ generator.B.T
    return np.asarray(np.linalg.norm((true - fitted) / generator.scale, axis=1))


def step_errors(
    generator: Generator,
    states: Array,
    rates: Array,
    flow: Callable[[float], Array],
    steps_s: Sequence[float],
    *,
    inputs: Array | None = None,
) -> StepErrors:
    """Measure one-step errors from given states for several steps.

    The claim (Theorem 1) is O(h²) whatever the dictionary. By Taylor, φ(x(t + h)) = φ + h Lφ + O(h²), so the error is
    h |Lφ - Kφ| + O(h²): second order only where the dictionary is closed, and then zero with the exact exponential.

    Parameters
    ----------
    states, rates, inputs
        As in `closure_defects`; the inputs are held over the step.
    flow
        From a step [s] to the states that far ahead, shape (n, d), to much better than the errors looked for.

    Raises
    ------
    InputError
        If the dictionary has delays: a window does not move as a state does.
    """
    if generator.dictionary.lags:
        raise InputError(
            f"the dictionary must have no delays here, got {generator.dictionary.lags} lags: use its inner"
        )
    lifted = generator.dictionary.lift(states)
    acting = np.zeros((len(states), generator.B.shape[1])) if inputs is None else inputs
    fitted = lifted @ generator.A.T + acting @ generator.B.T + generator.offset
    euler, exact = [], []
    for step in steps_s:
        advanced = generator.dictionary.lift(flow(step))
        missed = (advanced - lifted - step * fitted, advanced - generator.discrete(step).advance(lifted, acting))
        sizes = [float(np.linalg.norm(each / generator.scale, axis=1).mean()) for each in missed]
        euler.append(sizes[0])
        exact.append(sizes[1])
    defect = float(closure_defects(generator, states, rates, inputs).mean())
    return StepErrors(np.asarray(steps_s, dtype=np.float64), np.array(euler), np.array(exact), defect)
