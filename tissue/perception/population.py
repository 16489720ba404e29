"""People: how intensities and thresholds of force are spread over them, and the reference among them."""

from dataclasses import dataclass

import numpy as np
from scipy.special import digamma, expit, logit, polygamma

from meshes.base.arrays import Array
from tissue.materials.constants import constants
from tissue.perception.observer import PARAMETERS, Observer

__all__ = ["Population", "population", "population_observer", "reference_observer"]


@dataclass(frozen=True, kw_only=True)
class Population:
    """Law by which people differ: alpha log-normal with mean 1, beta normal, sigma squared inverse-gamma.

    The mean of alpha is 1, because the unit of intensity is free: it is what people feel at 1 N on the average. Weber's
    fraction and low-force term are log-normal, so that thresholds are positive (E6); the lapse is logit-normal.

    Attributes
    ----------
    beta, kappa, offset_N, lapse
        Medians of Stevens' exponent, Weber's fraction, its low-force term [N] and the share of lapses.
    sigma
        Relative scatter of reported intensities: root of the mean of sigma squared.
    alpha_log_spread, beta_spread, kappa_log_spread, offset_log_spread, lapse_logit_spread
        Standard deviations over people.
    sigma_shape
        Shape of the inverse-gamma law, above 2.
    """

    beta: float
    kappa: float
    offset_N: float
    lapse: float
    sigma: float
    alpha_log_spread: float
    beta_spread: float
    kappa_log_spread: float
    offset_log_spread: float
    lapse_logit_spread: float
    sigma_shape: float

    def draws(self, count: int, rng: np.random.Generator) -> dict[str, Array]:
        """Parameters of so many people, each of shape (count,), by the names of an observer's parameters."""
        normal = rng.standard_normal((5, count))
        scale = (self.sigma_shape - 1.0) * self.sigma**2
        return {
            "alpha": np.exp(self.alpha_log_spread * normal[0] - 0.5 * self.alpha_log_spread**2),
            "beta": self.beta + self.beta_spread * normal[1],
            "kappa": self.kappa * np.exp(self.kappa_log_spread * normal[2]),
            "offset_N": self.offset_N * np.exp(self.offset_log_spread * normal[3]),
            "lapse": expit(logit(self.lapse) + self.lapse_logit_spread * normal[4]),
            "sigma": np.sqrt(scale / rng.gamma(self.sigma_shape, size=count)),
        }

    def observer(self) -> Observer:
        """What is known of a person of whom nothing is: the population in the coordinates of an observer.

        All is exact but for sigma, of whose logarithm mean and variance are kept.
        """
        scale = (self.sigma_shape - 1.0) * self.sigma**2
        mean = [
            -0.5 * self.alpha_log_spread**2,
            self.beta,
            np.log(self.kappa),
            np.log(self.offset_N),
            logit(self.lapse),
            0.5 * (np.log(scale) - digamma(self.sigma_shape)),
        ]
        spread = [
            self.alpha_log_spread,
            self.beta_spread,
            self.kappa_log_spread,
            self.offset_log_spread,
            self.lapse_logit_spread,
            0.5 * np.sqrt(polygamma(1, self.sigma_shape)),
        ]
        return Observer(name="population", mean=np.array(mean), covariance=np.diag(np.square(spread)))


def population() -> Population:
    """The population of ``perception.toml``."""
    known = {name: entry.value for name, entry in constants("perception", "force").items()}
    return Population(**{name: known[name] for name in Population.__dataclass_fields__})


def population_observer() -> Observer:
    """What is known of a person of whom nothing is."""
    return population().observer()


def reference_observer() -> Observer:
    """The person whose intensities others are brought to: the population's medians, known exactly, and alpha 1."""
    people = population()
    given = {name: getattr(people, name) for name in PARAMETERS if name != "alpha"}
    return Observer.known("reference", alpha=1.0, **given)
