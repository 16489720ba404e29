"""Hierarchical Bayesian model of the force perception of many observers.

The posterior is sampled with Hamiltonian Monte Carlo. The convergence of the samples is checked.
"""

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.extras import install_command
from tissue.perception.laws import D_PRIME_75

if TYPE_CHECKING:
    from jax import Array as JaxArray
    from numpyro.distributions import Distribution

Index = NDArray[np.intp]
HYPER = (
    "log_alpha",
    "log_alpha_spread",
    "beta",
    "beta_spread",
    "variance",
    "log_kappa",
    "log_kappa_spread",
    "log_offset",
    "log_offset_spread",
)
"""Names of the parameters of the population.

They are the mean and the standard deviation, over people, of each parameter of an observer.
``variance`` is the mean of sigma squared.
"""
VARIANCE_SHAPE = 10.0
"""Shape of the inverse-gamma distribution of sigma squared over people.

With this shape, the standard deviation over people is about a third of the mean (assumed, see
perception.toml).
"""
CHAINS = 2
"""Number of Markov chains; the convergence check needs at least two."""
R_HAT = 1.01
ESS = 400.0
"""Smallest effective sample size of a fit that is treated as converged.

`R_HAT` is the largest accepted value of the convergence statistic R-hat. Source: Vehtari et al.,
2021.
"""


@dataclass(frozen=True)
class PopulationTrials:
    """Trials of many observers.

    Attributes
    ----------
    observers
        Number of observers.
    compared
        Row for each comparison: index of the observer, smaller force [N], step to the larger force
        [N], and 1 (right) or 0 (wrong); shape (comparisons, 4).
    rated
        For each reported number: index of the observer, force [N], and number; shape (numbers, 3).
    """

    observers: int
    compared: Array
    rated: Array

    def counts(self) -> tuple[Index, Array, Array, Index, Index]:
        """Count trials and right answers for each observer and each distinct comparison.

        The result is five arrays: observer, base force [N], step [N], number of trials, number of
        right answers. Each combination that occurs has one entry.
        """
        unique, which = np.unique(self.compared[:, :3], axis=0, return_inverse=True)
        asked = np.bincount(which.ravel())
        right = np.bincount(which.ravel(), self.compared[:, 3]).astype(int)
        return unique[:, 0].astype(int), unique[:, 1], unique[:, 2], asked, right


@dataclass(frozen=True)
class PopulationFit:
    """Posterior draws of the hierarchical model, with convergence diagnostics.

    Attributes
    ----------
    draws
        Draws, keyed by the name of the parameter. Parameters of the population (`HYPER`) have the
        shape (chains, draws). Parameters of observers (alpha, beta, kappa, offset_N, lapse, sigma)
        have the shape (chains, draws, observers).
    r_hat, ess
        R-hat (split chains) and effective sample size, keyed by the names in `HYPER`. The value for
        the key ``people`` is the worst among all parameters of observers.
    divergences
        Number of divergent transitions of the sampler.
    """

    draws: dict[str, Array]
    r_hat: dict[str, float]
    ess: dict[str, float]
    divergences: int

    def problems(self) -> list[str]:
        """Return the reasons why the fit should not be used, as sentences; empty for a good fit."""
        found = []
        worst = max(self.r_hat, key=lambda name: np.nan_to_num(self.r_hat[name], nan=np.inf))
        least = min(self.ess, key=lambda name: self.ess[name])
        if not self.r_hat[worst] <= R_HAT:
            found.append(
                f"R-hat of {worst} is {self.r_hat[worst]:.3f}, above {R_HAT}: the chains "
                "have not mixed"
            )
        if not self.ess[least] >= ESS:
            found.append(
                f"the effective sample size of {least} is {self.ess[least]:.0f}, below "
                f"{ESS:.0f}: draw more"
            )
        if self.divergences:
            found.append(f"{self.divergences} transitions diverged: the tails may be missed")
        return found

    def interval(self, name: str) -> tuple[float, float, float]:
        """Return the lower end, median and upper end of a parameter's central 95 % interval.

        The parameter belongs to the population, see `HYPER`.
        """
        low, middle, high = np.quantile(self.draws[name], [0.025, 0.5, 0.975]).tolist()
        return low, middle, high


def fit_hierarchy(
    trials: PopulationTrials,
    *,
    seed: int = 0,
    warm_up: int = 600,
    draws: int = 600,
    progress: bool = False,
) -> PopulationFit:
    """Draw samples from the joint posterior of the population's and each observer's parameters.

    The sampler is NUTS, the No-U-Turn sampler of Hoffman and Gelman (2014), in NumPyro.

    The parameters ln alpha, beta, ln kappa and ln offset are normally distributed among observers.
    The variance sigma squared has an inverse-gamma distribution, and lapse rates have the
    distribution Beta(1, 10). The population means have wide priors around published values, and the
    population standard deviations have half-normal priors. ln kappa and ln offset are parametrised
    as deviations from the mean (non-centred), because one observer's trials contain little
    information about them. ln alpha and beta are parametrised directly (centred), because the
    trials contain enough information about them.

    Parameters
    ----------
    trials
        Trials of at least three observers.
    seed
        Seed of the random draws.
    warm_up
        Number of tuning draws per chain.
    draws
        Number of draws that are kept per chain. For eight observers with 60 comparisons and 12
        reported numbers each, the effective sample size is 444 to 499 with 600 draws, and 230 with
        300. A warm-up of 300 draws is enough in this case.
    progress
        True to show a progress bar for each chain.

    Raises
    ------
    InputError
        If NumPyro is not installed.
    """
    try:
        from jax import random
        from numpyro.diagnostics import effective_sample_size, split_gelman_rubin
        from numpyro.infer import MCMC, NUTS
    except ImportError:
        raise InputError(
            f"numpyro must be installed to fit a population. Run {install_command('perception')}"
        ) from None
    # With NumPyro's default acceptance of 0.8, the effective sample size is 362, below ESS.
    run = MCMC(
        NUTS(partial(_model, trials.observers), target_accept_prob=0.9),
        num_warmup=warm_up,
        num_samples=draws,
        num_chains=CHAINS,
        chain_method="sequential",
        progress_bar=progress,
    )
    rater, force_N, number = trials.rated.T
    ratings = (rater.astype(int), np.log(force_N), np.log(number))
    run.run(random.PRNGKey(seed), ratings, trials.counts(), extra_fields=("diverging",))
    drawn = {
        name: np.asarray(values, dtype=float)
        for name, values in run.get_samples(group_by_chain=True).items()
    }
    people = ("alpha", "beta_person", "kappa", "offset_N", "lapse", "sigma")
    judged = {name: (name,) for name in HYPER} | {"people": people}
    r_hat = {
        key: max(float(np.max(split_gelman_rubin(drawn[name]))) for name in names)
        for key, names in judged.items()
    }
    ess = {
        key: min(float(np.min(effective_sample_size(drawn[name]))) for name in names)
        for key, names in judged.items()
    }
    kept = {name: drawn[name] for name in (*HYPER, *people)}
    return PopulationFit(kept, r_hat, ess, int(np.sum(run.get_extra_fields()["diverging"])))


def _model(
    observers: int,
    ratings: tuple[Index, Array, Array],
    counts: tuple[Index, Array, Array, Index, Index],
) -> None:
    """Declare the hierarchical model for NumPyro."""
    import jax.numpy as jnp
    import numpyro
    from jax.scipy.special import ndtr
    from numpyro import distributions as law

    def person(
        name: str, mean: "Distribution", spread: "Distribution", *, is_well_known: bool
    ) -> "JaxArray":
        """Sample a normally distributed parameter of each observer around the population's mean.

        Unless the parameter is well known, it is parametrised as an offset from the mean.
        """
        centre = numpyro.sample(name, mean)
        width = numpyro.sample(f"{name}_spread", spread)
        with numpyro.plate(f"{name}_people", observers):
            # With a centred parametrisation, the thresholds of eight observers give 256 divergences
            # and an effective sample size of 6.
            if is_well_known:
                return numpyro.sample(f"{name}_person", law.Normal(centre, width))
            return centre + width * numpyro.sample(f"{name}_offset", law.Normal(0.0, 1.0))

    # The means have the priors of `tissue.perception.adaptive`. The half-normal scales are larger
    # than the spreads over people in perception.toml, so that the trials determine the result.
    log_alpha = person("log_alpha", law.Normal(0.0, 1.0), law.HalfNormal(0.5), is_well_known=True)
    beta = person("beta", law.Normal(1.4, 0.5), law.HalfNormal(0.4), is_well_known=True)
    log_kappa = person(
        "log_kappa", law.Normal(np.log(0.09), 0.6), law.HalfNormal(0.5), is_well_known=False
    )
    log_offset = person(
        "log_offset", law.Normal(np.log(0.2), 0.5), law.HalfNormal(0.4), is_well_known=False
    )
    # a scatter of 0.24, with two thirds of the probability between 0.15 and 0.4
    variance = numpyro.sample("variance", law.LogNormal(np.log(0.06), 1.0))
    with numpyro.plate("people", observers):
        squared = numpyro.sample(
            "squared", law.InverseGamma(VARIANCE_SHAPE, (VARIANCE_SHAPE - 1.0) * variance)
        )
        # Beta(1, 10): see `ThresholdPrior`.
        lapse = numpyro.sample("lapse", law.Beta(1.0, 10.0))
    kappa = numpyro.deterministic("kappa", jnp.exp(log_kappa))
    offset_N = numpyro.deterministic("offset_N", jnp.exp(log_offset))
    numpyro.deterministic("alpha", jnp.exp(log_alpha))
    sigma = numpyro.deterministic("sigma", jnp.sqrt(squared))
    rater, log_force, log_number = ratings
    felt = log_alpha[rater] + beta[rater] * log_force
    numpyro.sample("numbers", law.Normal(felt, sigma[rater]), obs=log_number)
    who, base_N, step_N, asked, right = counts
    # An observer who lapses guesses, and half of the guesses are right. The share of guesses is
    # therefore twice the lapse rate.
    distance = D_PRIME_75 * step_N / (kappa[who] * (base_N + offset_N[who]))
    blind = 2.0 * jnp.minimum(lapse[who], 0.5)
    share = 0.5 * blind + (1.0 - blind) * ndtr(distance / np.sqrt(2.0))
    # With a share of exactly 1, the log-likelihood of a wrong answer is minus infinity and has no
    # gradient.
    numpyro.sample("answers", law.Binomial(asked, jnp.clip(share, 1e-6, 1.0 - 1e-6)), obs=right)
