"""Extended dynamic mode decomposition with inputs, over many episodes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.prediction.edmd.dictionary import Dictionary
from tissue.prediction.edmd.episodes import STILL, Episode, blocks, check_episodes
from tissue.prediction.edmd.lifted import FitStatistics, Generator, LiftedMap, Operator
from tissue.prediction.edmd.regression import regress, triangle

__all__ = ["Edmd"]


@dataclass(frozen=True)
class Edmd:
    """Fit of a linear map of observables by least squares (Williams, Kevrekidis & Rowley 2015; Korda & Mezić 2018).

    Observables and inputs are centred on their means and scaled by their standard deviations inside, and an offset is
    fitted with them; the operator that comes out is in the units of the states.

    Parameters
    ----------
    dictionary
        The observables.
    ridge
        Penalty on the weights of the scaled observables, as a share of their variance (Tikhonov); at least 0.
    rank
        Singular values of the scaled data to keep; None for all.
    cap
        Largest size that eigenvalues are left with (`tissue.prediction.edmd.spectrum`); None to leave them.
    offset
        Whether to centre and to fit an offset; without, zero maps to zero.
    """

    dictionary: Dictionary
    ridge: float = 0.0
    rank: int | None = None
    cap: float | None = 1.0
    offset: bool = True

    def __post_init__(self) -> None:
        if self.cap is not None and not 0.0 < self.cap < np.inf:
            raise InputError(f"cap must be positive and finite, got {self.cap}: use 1, or None for no cap")

    def fit(self, episodes: Sequence[Episode]) -> Operator:
        """The operator over one step that fits all pairs of neighbouring samples.

        Raises
        ------
        InputError
            If the episodes cannot be learnt from (`check_episodes`), observables overflow, or columns are collinear
            and neither ridge nor rank is set.
        """
        ready = check_episodes(episodes, self.dictionary.lags)
        operator = Operator(**vars(self._fit(ready, rates=False)), step_s=ready[0].step_s)
        return operator if self.cap is None else operator.capped(self.cap)

    def fit_generator(self, episodes: Sequence[Episode]) -> Generator:
        """The generator that fits the observables' rates ∇φ · dx/dt (gEDMD, Klus et al. 2020); cap does not apply.

        Raises
        ------
        InputError
            As `fit`.
        """
        return Generator(**vars(self._fit(check_episodes(episodes, self.dictionary.lags), rates=True)))

    def _fit(self, episodes: list[Episode], *, rates: bool) -> LiftedMap:
        """The map, in the units of the observables."""
        state_size, lead = episodes[0].states.shape[1], int(self.offset)
        count = self.dictionary.size(state_size)
        carried = 0 if rates else self.dictionary.lags * state_size
        factor, samples = triangle(_rows(episodes, self.dictionary, lead, rates))
        ones, known = factor[:, :lead].sum(axis=1, keepdims=True), factor.shape[1] - (count - carried)
        middle = factor[0, lead:known] / factor[0, 0] * self.offset
        spread = np.sqrt((factor[lead:, lead:known] ** 2).sum(axis=0) / samples)
        scale = np.where(spread > STILL * np.abs(middle), spread, 1.0)
        kept = slice(0, count)
        # Delayed states are targets that are regressors already, a lag earlier: they are not factored twice.
        columns = np.concatenate(
            (known + np.arange(state_size), lead + np.arange(carried), known + np.arange(state_size, count - carried))
        )
        targets = factor[:, columns] if rates else factor[:, columns] - ones * middle[kept]
        scaled = ((factor[:, lead:known] - ones * middle) / scale, factor[:, :lead], targets / scale[kept])
        found = regress(np.hstack(scaled), samples, size=known, ridge=self.ridge, rank=self.rank, free=lead)
        weights, size = found.weights.T, len(scale)
        A = weights[:, :count] * scale[kept, None] / scale[kept]
        B = weights[:, count:size] * scale[kept, None] / scale[count:]
        constant = weights[:, size] * scale[kept] if self.offset else np.zeros(count)
        constant = constant - A @ middle[kept] - B @ middle[count:] + (0.0 if rates else middle[kept])
        values = np.linalg.eigvals(weights[:, :count])
        return LiftedMap(
            dictionary=self.dictionary,
            A=A,
            B=B,
            offset=constant,
            middle=middle[kept],
            scale=scale[kept],
            input_middle=middle[count:],
            input_scale=scale[count:],
            moments=found.moments,
            lowest=np.min([each.states.min(axis=0) for each in episodes], axis=0),
            highest=np.max([each.states.max(axis=0) for each in episodes], axis=0),
            statistics=FitStatistics(
                samples=found.samples,
                episodes=len(episodes),
                rank=found.rank,
                condition=found.condition,
                residual_rms=found.residual_rms * scale[kept],
                radius_before=float(values.real.max() if rates else np.abs(values).max()),
            ),
        )


def _rows(episodes: list[Episode], dictionary: Dictionary, lead: int, rates: bool) -> Iterator[Array]:
    """Rows [1, φ, u, new] of some thousand samples at a time, without the ones if `lead` is 0.

    `new` are the observables a step later that are not among φ, as all but the newest of delayed states are; for a
    generator the rates of all.
    """
    for episode in episodes:
        slopes = None
        if rates and episode.rates is not None:
            slopes = blocks(Episode(episode.rates, None, episode.step_s), dictionary.lags)
        width = episode.states.shape[1]
        for windows, inputs in blocks(episode, dictionary.lags):
            with np.errstate(over="ignore", invalid="ignore"):
                lifted = dictionary.lift(windows)
            if not np.isfinite(lifted).all():
                raise InputError(
                    "observables must be finite on all states, got overflow: scale the states, or the dictionary"
                )
            if slopes is None:
                after = [lifted[1:, :width], lifted[1:, width * (dictionary.lags + 1) :]]
            else:
                after = [dictionary.lift_rates(windows, next(slopes)[0])[:-1]]
            yield np.hstack((np.ones((len(inputs), lead)), lifted[:-1], inputs, *after))
