"""Where the states that an operator has learnt from lie."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array

__all__ = ["TrainingRange"]


@dataclass(frozen=True)
class TrainingRange:
    """Box and ellipsoid around the training states, without their delays.

    Attributes
    ----------
    lowest, highest
        Corners of the box, shape (d,), in the units of the states.
    middle
        Mean state, shape (d,).
    whitening
        Matrix W, shape (d, d): |W (x - middle)| is the Mahalanobis distance (Mahalanobis 1936).
    farthest
        Largest Mahalanobis distance of a training state.
    input_lowest, input_highest
        Corners of the inputs' box, shape (m,).
    """

    lowest: Array
    highest: Array
    middle: Array
    whitening: Array
    farthest: float
    input_lowest: Array
    input_highest: Array

    @classmethod
    def of(cls, states: Sequence[Array], inputs: Sequence[Array]) -> "TrainingRange":
        """The range of tables of states (n, d), and of inputs (n, m)."""
        count = sum(len(each) for each in states)
        middle = sum(each.sum(axis=0) for each in states) / count
        scale = np.sqrt(sum(((each - middle) ** 2).sum(axis=0) for each in states) / count)
        spread = sum(((each - middle) / scale).T @ ((each - middle) / scale) for each in states) / count
        values, vectors = np.linalg.eigh(spread)
        # Directions that hardly vary count as varying by rounding, so that the distance stays finite.
        roots = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
        whitening = (vectors / roots).T / scale
        farthest = max(float(np.sqrt((((each - middle) @ whitening.T) ** 2).sum(axis=1)).max()) for each in states)
        box = [np.array([f(each, axis=0) for each in inputs]) for f in (np.min, np.max)]
        return cls(
            lowest=np.min([each.min(axis=0) for each in states], axis=0),
            highest=np.max([each.max(axis=0) for each in states], axis=0),
            middle=middle,
            whitening=whitening,
            farthest=farthest,
            input_lowest=box[0].min(axis=0),
            input_highest=box[1].max(axis=0),
        )

    def distance(self, state: Array) -> float:
        """Mahalanobis distance of a state from the mean; `farthest` is the largest seen in training."""
        white = self.whitening @ (state - self.middle)
        return float(np.sqrt(white @ white))

    def contains(self, state: Array, slack: float = 0.0) -> bool:
        """Whether a state lies in the box, each side moved out by a share of the box's width."""
        margin = slack * (self.highest - self.lowest)
        return bool(((state >= self.lowest - margin) & (state <= self.highest + margin)).all())
