"""Draws of constants given a log by the No-U-Turn sampler: what a normal law about the maximum misses.

The density is NumPy, the sampler NumPyro's (Hoffman and Gelman 2014): it asks for the density and its gradient through
a callback, in double precision. Places are whitened by the normal law about the maximum, so that the sampler sees about
a standard normal law.
"""

from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata

from meshes.base.arrays import Array
from meshes.base.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from jax import Array as JaxArray

__all__ = ["SHARES", "Density", "Draws", "draw_by_nuts", "require_nuts"]

CHAINS, WARM_UP, DRAWS = 4, 300, 500
"""Chains from different starts, and their steps spent on tuning and kept: 2,000 independent draws give the ends of a
90 % interval within 0.05 standard deviations."""
ACCEPT = 0.9
"""Share of steps to accept: smaller steps than the usual 0.8, for laws that a normal one does not describe."""
DEEPEST = 7
"""Doublings of a path, 127 gradients: where a log knows combinations far better than their members, paths along the
thin curved ridge would be longer and a draw take seconds; whether shorter ones suffice is seen by R-hat."""
LEAST_VARIANCE = 1e-12
"""Least variance of a direction, that of the prior being 1 and the greatest: a search without a maximum knows none."""
R_HAT = 1.01
"""Greatest ratio of the spread of all chains to that of each at which they agree (Vehtari et al. 2021)."""
LEAST_EFFECTIVE = 400.0
"""Independent draws below which the ends of an interval are not known (the same)."""
SHARES = (0.05, 0.5, 0.95)
"""Quantiles that stand for a law: median and 90 % interval."""


class Density(Protocol):
    """A log density of numbers of about unit size, see `tissue.fitting.target.Target`."""

    def value_and_gradient(self, u: Array, /) -> tuple[float, Array]:
        """Log density, up to a constant, and its gradient, shape (size,)."""
        ...


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of a density.

    Attributes
    ----------
    u
        Shape (chains, draws, size).
    r_hat
        Spread of all chains over that of each, of each number, shape (size,): 1 where they agree.
    effective
        Effective sample size: independent draws of the same error, of each number, shape (size,).
    divergences
        Divergent transitions: steps whose energy error was too great.
    """

    u: Array
    r_hat: Array
    effective: Array
    divergences: int

    @cached_property
    def together(self) -> Array:
        """The draws of all chains, shape (chains * draws, size)."""
        return self.u.reshape(-1, self.u.shape[2])

    def quantiles(self, at: int) -> Array:
        """5, 50 and 95 % of a number, by its place, shape (3,)."""
        return np.asarray(np.quantile(self.together[:, at], SHARES))

    def correlation(self, places: Array) -> Array:
        """Of the normal scores of some numbers, by their places: that of a Gaussian copula, shape (n, n)."""
        ranks = rankdata(self.together[:, places], axis=0)
        scores = ndtri(ranks / (len(ranks) + 1.0))
        return np.atleast_2d(np.corrcoef(scores, rowvar=False))

    @property
    def sentence(self) -> str:
        """How many draws there are, and how good."""
        return (
            f"NUTS: {len(self.together)} draws in {len(self.u)} chains, R-hat at most {np.max(self.r_hat):.3f}, "
            f"effective sample size {np.min(self.effective):.0f} or more, {self.divergences} divergences"
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Why the draws are not to be trusted, in sentences; none where they are."""
        found = []
        worst, least = float(np.max(self.r_hat)), float(np.min(self.effective))
        if not worst <= R_HAT:
            found.append(
                f"the chains of NUTS disagree, R-hat {worst:.3f} above {R_HAT:g}: its intervals are not to be trusted"
            )
        if self.divergences:
            found.append(
                f"{self.divergences} of {len(self.together)} transitions of NUTS diverged: its intervals may be "
                "too narrow"
            )
        if not least >= LEAST_EFFECTIVE:
            found.append(
                f"the effective sample size of NUTS is {least:.0f}, below {LEAST_EFFECTIVE:.0f}: the ends "
                "of its intervals are rough"
            )
        return tuple(found)


def require_nuts() -> None:
    """Refuse to sample without NumPyro.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        import numpyro  # noqa: F401
    except ImportError:
        raise InputError("nuts must be sampled by numpyro, got none: pip install 'tissue-sim[perception]'") from None


def draw_by_nuts(
    density: Density,
    maximum: Array,
    covariance: Array,
    *,
    seed: int,
    chains: int = CHAINS,
    warm_up: int = WARM_UP,
    draws: int = DRAWS,
) -> Draws:
    """Draw from a density.

    Parameters
    ----------
    density
        What to draw from.
    maximum, covariance
        A normal law near it, shape (size,) and (size, size): starts are drawn from it.
    seed
        Of starts and draws.
    chains, warm_up, draws
        Chains, and steps of each that are spent on tuning and that are kept.

    Raises
    ------
    InputError
        If NumPyro is not installed.
    """
    require_nuts()
    import jax
    from numpyro.diagnostics import effective_sample_size, split_gelman_rubin
    from numpyro.infer import MCMC, NUTS

    values, vectors = np.linalg.eigh(covariance)
    root = np.asarray(vectors * np.sqrt(np.clip(values, LEAST_VARIANCE, 1.0)), dtype=np.float64)
    starts = np.random.default_rng(seed).standard_normal((chains, len(maximum)))
    with _double_precision():
        run = MCMC(
            NUTS(
                potential_fn=_potential(density, maximum, root),
                dense_mass=True,
                target_accept_prob=ACCEPT,
                max_tree_depth=DEEPEST,
            ),
            num_warmup=warm_up,
            num_samples=draws,
            num_chains=chains,
            chain_method="sequential",
            progress_bar=False,
        )
        first = jax.numpy.asarray(starts if chains > 1 else starts[0])
        run.run(jax.random.PRNGKey(seed), init_params=first, extra_fields=("diverging",))
        white = np.asarray(run.get_samples(group_by_chain=True), dtype=np.float64)
        diverging = int(np.sum(run.get_extra_fields()["diverging"]))
    u = maximum + white @ root.T
    return Draws(u, np.asarray(split_gelman_rubin(u)), np.asarray(effective_sample_size(u)), diverging)


@contextmanager
def _double_precision() -> "Iterator[None]":
    """JAX in double precision in all threads: callbacks come in another, where `jax.enable_x64` does not hold."""
    import jax

    before = jax.config.read("jax_enable_x64")
    jax.config.update("jax_enable_x64", True)
    try:
        yield
    finally:
        jax.config.update("jax_enable_x64", before)


def _potential(density: Density, middle: Array, root: Array) -> "Callable[[JaxArray], JaxArray]":
    """The negative log density of whitened places, as JAX calls and differentiates it."""
    import jax

    shapes = (
        jax.ShapeDtypeStruct((), np.float64),
        jax.ShapeDtypeStruct(middle.shape, np.float64),
    )

    def in_numpy(white: "JaxArray") -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            value, gradient = density.value_and_gradient(middle + root @ np.asarray(white))
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            return np.array(np.inf), np.zeros_like(middle)
        return np.array(-value), -(root.T @ gradient)

    @jax.custom_vjp
    def potential(white: "JaxArray") -> "JaxArray":
        return forward(white)[0]

    def forward(white: "JaxArray") -> "tuple[JaxArray, JaxArray]":
        value, gradient = jax.pure_callback(in_numpy, shapes, white)
        return value, gradient

    def backward(gradient: "JaxArray", seed: "JaxArray") -> "tuple[JaxArray]":
        return (seed * gradient,)

    potential.defvjp(forward, backward)
    return potential
