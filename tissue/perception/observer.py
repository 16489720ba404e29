"""Force perception of one person (an observer) and of a population, and files of observers."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, isclose, log, nan
from pathlib import Path

import numpy as np
from scipy.special import digamma, expit, logit, polygamma

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_range
from meshes.base.file_limits import require_regular
from meshes.base.text_tables import read_json
from meshes.base.whole_file import package_version, require_new_file, require_version, write_text
from tissue.materials.constants import constants

PARAMETERS = ("alpha", "beta", "kappa", "offset_N", "lapse", "sigma")
"""Names of the parameters of an observer's force perception.

The parameters alpha, beta and sigma are the factor, the exponent and the relative scatter in
Stevens' law. The intensity at a force F is S = alpha (F / 1 N)^beta (1 + sigma e), where e is a
random number with variance 1. The parameters kappa and offset_N are the Weber fraction and the
low-force term in Weber's law. For two forces that differ by kappa (F + offset_N), 75 % of the
answers about the larger force are right, apart from lapses. The parameter lapse is the share of
wrong answers for large differences.
"""
BOUNDS = {
    "alpha": (1e-3, 1e3),
    "beta": (0.05, 5.0),
    "kappa": (1e-3, 1.0),
    "offset_N": (1e-4, 10.0),
    "lapse": (1e-6, 0.5),
    "sigma": (1e-4, 2.0),
}
"""Smallest and largest plausible median of each parameter of a person.

A median outside these bounds indicates a wrong unit or a failed fit.
"""
FORMAT = "tissue observer"
VERSION = 1
COORDINATES = ("ln alpha", "beta", "ln kappa", "ln offset_N", "logit lapse", "ln sigma")
TO_COORDINATE = dict.fromkeys(PARAMETERS, np.log) | {"beta": np.asarray, "lapse": logit}
WIDEST = 10.0
"""Largest accepted standard deviation of a coordinate of `Observer`; above it, a fit has failed."""
REPORTED_N = 2.0
"""Force for which the threshold of an observer is written to files [N]."""
ROUNDING = 1e-5
"""Relative tolerance between numbers with six digits in a file and the posterior in this file."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observer:
    """Force perception of one person, as a normal posterior of the person's parameters.

    The posterior is normal in the coordinates (ln alpha, beta, ln kappa, ln offset, logit lapse, ln
    sigma); see `PARAMETERS`. With these coordinates, every draw has a positive alpha (factor),
    kappa, offset and sigma (scatter), and a lapse rate between 0 and 1.

    Attributes
    ----------
    name
        Name of the observer.
    mean
        Mean of the coordinates, shape (6,), in the order of `PARAMETERS`.
    covariance
        Covariance of the coordinates, shape (6, 6), positive semidefinite. It is zero if the
        parameters are known exactly.
    trials
        Number of trials from which the posterior was estimated; 0 for a prior.

    Raises
    ------
    InputError
        If a number is not finite, a median is not in `BOUNDS`, or the covariance is not valid.
    """

    name: str
    mean: Array
    covariance: Array
    trials: int = 0

    def __post_init__(self) -> None:
        mean = np.array(self.mean, dtype=float)
        covariance = np.array(self.covariance, dtype=float)
        if mean.shape != (6,) or covariance.shape != (6, 6):
            raise InputError(
                "mean and covariance",
                "have shapes (6,) and (6, 6)",
                f"{mean.shape} and {covariance.shape}",
                f"give one coordinate for each of {', '.join(PARAMETERS)}",
            )
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            raise InputError(
                "mean and covariance", "be finite", "NaN or infinity", "calibrate again"
            )
        for index, (name, (low, high)) in enumerate(BOUNDS.items()):
            median = float(_from(name, mean[index]))
            require_range(name, median, low, high, "calibrate again, forces in N")
        # A covariance of zeros means exactly known parameters. A tolerance of 1e-9 of the largest
        # entry allows for rounding, because a covariance may be computed from draws and written in
        # decimals.
        scale = max(np.abs(covariance).max(), 1e-300)
        is_symmetric = np.abs(covariance - covariance.T).max() <= 1e-9 * scale
        if not is_symmetric or np.linalg.eigvalsh(covariance).min() < -1e-9 * scale:
            raise InputError(
                "covariance",
                "be symmetric, without negative eigenvalues",
                "another matrix",
                "calibrate again",
            )
        widest = np.sqrt(np.diag(covariance).clip(0.0)).max()
        require_range("standard deviation", widest, 0.0, WIDEST, "run more trials")
        # The bound 1e9 rejects a damaged file.
        require_range("trials", self.trials, 0, 1e9, "give the number of trials")
        mean.flags.writeable = covariance.flags.writeable = False
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    def known(
        cls,
        name: str,
        *,
        spread: Mapping[str, float] | None = None,
        trials: int = 0,
        **medians: float,
    ) -> "Observer":
        """Return an observer with given medians and standard deviations of the parameters.

        `medians` must contain all `PARAMETERS`. `spread` contains standard deviations of the
        coordinates, keyed by parameter. Correlations are zero.
        """
        mean = np.array([TO_COORDINATE[parameter](medians[parameter]) for parameter in PARAMETERS])
        spreads = [(spread or {}).get(parameter, 0.0) for parameter in PARAMETERS]
        return cls(name=name, mean=mean, covariance=np.diag(np.square(spreads)), trials=trials)

    @classmethod
    def from_draws(cls, name: str, draws: Mapping[str, Array], *, trials: int) -> "Observer":
        """Return an observer whose posterior has the mean and the covariance of given draws.

        `draws` contains an array of shape (n,) for each parameter, keyed by parameter.
        """
        rows = np.array([TO_COORDINATE[parameter](draws[parameter]) for parameter in PARAMETERS])
        return cls(name=name, mean=rows.mean(axis=1), covariance=np.cov(rows), trials=trials)

    @property
    def alpha(self) -> float:
        """Median of Stevens' factor: intensity at 1 N, relative to the reference observer."""
        return exp(self.mean[0])

    @property
    def beta(self) -> float:
        """Mean of Stevens' exponent."""
        return float(self.mean[1])

    @property
    def kappa(self) -> float:
        """Median of the Weber fraction."""
        return exp(self.mean[2])

    @property
    def offset_N(self) -> float:
        """Median of Weber's low-force term [N]."""
        return exp(self.mean[3])

    @property
    def lapse(self) -> float:
        """Median of the lapse rate, the share of wrong answers for large differences of force."""
        # in the order of PARAMETERS
        return float(expit(self.mean[4]))

    @property
    def sigma(self) -> float:
        """Median of the relative scatter of a reported intensity."""
        # in the order of PARAMETERS
        return exp(self.mean[5])

    def draw(self, count: int, rng: np.random.Generator) -> dict[str, Array]:
        """Return joint draws of all parameters, each of shape (count,), keyed by parameter."""
        values, vectors = np.linalg.eigh(self.covariance)
        # A matrix square root is used instead of Cholesky's factor, because the covariance may be
        # singular. Rounding may make eigenvalues of zero negative.
        root = vectors * np.sqrt(values.clip(0.0))
        drawn = self.mean + rng.standard_normal((count, 6)) @ root.T
        return {name: _from(name, drawn[:, k]) for k, name in enumerate(PARAMETERS)}


def write_observer(observer: Observer, path: Path, *, overwrite: bool = False) -> None:
    """Write an observer to a JSON file.

    The file contains the posterior. For human readers, the file also contains the parameters'
    medians as numbers with units.

    Raises
    ------
    InputError
        If the file exists and `overwrite` is not set.
    """
    require_new_file(path, overwrite=overwrite)
    stored = {
        "format": FORMAT,
        "version": VERSION,
        "tissue": package_version(),
        "name": observer.name,
        "trials": observer.trials,
        **_plain_numbers(observer, REPORTED_N),
        "coordinates": list(COORDINATES),
        "mean": observer.mean.tolist(),
        "covariance": observer.covariance.tolist(),
    }
    write_text(path, json.dumps(stored, indent=1) + "\n")


def read_observer(path: Path) -> Observer:
    """Read an observer from a JSON file.

    Raises
    ------
    InputError
        If the file is missing, does not contain an observer, has an unknown version, or contains
        impossible numbers. It is also raised if the file's medians contradict the file's posterior.
    """
    calibrate = "write one with tissue calibrate --out"
    require_regular(path)
    try:
        stored = read_json(path.read_text("utf-8"))
        if stored["format"] != FORMAT:
            raise ValueError("another format")
    except (OSError, ValueError, TypeError, KeyError) as problem:
        raise InputError(
            "observer", "be an observer file", f"{path} ({_reason(problem)})", calibrate
        ) from problem
    require_version(
        "observer", stored, VERSION, key="version", where=path, remedy="calibrate again"
    )
    try:
        if stored["coordinates"] != list(COORDINATES):
            raise ValueError("other coordinates")
        observer = Observer(
            name=str(stored["name"]),
            mean=np.array(stored["mean"], dtype=float),
            covariance=np.array(stored["covariance"], dtype=float),
            trials=int(stored["trials"]),
        )
        _require_agreement(observer, stored)
        return observer
    except (KeyError, TypeError, ValueError, OverflowError) as problem:
        raise InputError(f"observer {path}: {_reason(problem)}") from problem


def _reason(problem: Exception) -> str:
    """Return the reason why a file cannot be used as text for an error message."""
    return f"the entry {problem} is missing" if isinstance(problem, KeyError) else str(problem)


def _plain_numbers(observer: Observer, force_N: float) -> dict[str, float]:
    """Return the exponent, and the threshold at the force `force_N` [N], rounded to six digits.

    The result also contains the Weber fraction and the low-force term, from which a reader can
    compute the threshold at other forces.
    """
    numbers = {
        "exponent": observer.beta,
        "weber_fraction": observer.kappa,
        "offset_N": observer.offset_N,
        "threshold_at_N": force_N,
        "threshold_N": observer.kappa * (force_N + observer.offset_N),
    }
    return {name: float(f"{value:.6g}") for name, value in numbers.items()}


def _require_agreement(observer: Observer, stored: Mapping[str, object]) -> None:
    """Check that the numbers for human readers in a file, if any, agree with its posterior."""
    force_N = _number(stored.get("threshold_at_N", REPORTED_N))
    for name, computed in _plain_numbers(observer, force_N).items():
        given = stored.get(name, computed)
        if not isclose(_number(given), computed, rel_tol=ROUNDING):
            # 40 characters are enough for any number
            raise InputError(
                f"{name} is {str(given)[:40]}, but the mean gives {computed:g}. Delete {name} from "
                "the file, or calibrate again."
            )


def _number(value: object) -> float:
    """Return a value from a file as a number, or NaN if it is not a number."""
    return float(value) if isinstance(value, int | float) else nan


def _from(parameter: str, coordinate: Array | np.float64) -> Array:
    """Convert a coordinate, such as ln alpha, to the value of its parameter."""
    if parameter == "lapse":
        return np.asarray(expit(coordinate))
    return np.asarray(
        # The coordinate is limited to avoid an overflow: a wide posterior may give very large
        # draws.
        coordinate if parameter == "beta" else np.exp(np.minimum(coordinate, log(1e300)))
    )


@dataclass(frozen=True, kw_only=True)
class Population:
    """Distribution of the parameters of force perception among people.

    The factor alpha, the Weber fraction and the low-force term have log-normal distributions. The
    mean of alpha is 1, because the unit of intensity is the average intensity at 1 N. The exponent
    beta has a normal distribution. Sigma squared has an inverse-gamma distribution, and the lapse
    rate has a logit-normal distribution.

    Attributes
    ----------
    beta, kappa, offset_N, lapse
        Medians of Stevens' exponent, Weber fraction, low-force term [N] and lapse rate.
    sigma
        Relative scatter of reported intensities: square root of the mean of sigma squared.
    alpha_log_spread, beta_spread, kappa_log_spread, offset_log_spread, lapse_logit_spread
        Standard deviations of the coordinates of `Observer` among people.
    sigma_shape
        Shape of the inverse-gamma distribution of sigma squared, above 2.
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

    def draw(self, count: int, rng: np.random.Generator) -> dict[str, Array]:
        """Return the parameters of `count` random people, keyed by parameter.

        Each array has shape (count,).
        """
        normal = rng.standard_normal((5, count))
        scale = (self.sigma_shape - 1.0) * self.sigma**2
        return {
            # A log-normal with the median exp(-spread^2 / 2) has the mean 1.
            "alpha": np.exp(self.alpha_log_spread * normal[0] - 0.5 * self.alpha_log_spread**2),
            "beta": self.beta + self.beta_spread * normal[1],
            "kappa": self.kappa * np.exp(self.kappa_log_spread * normal[2]),
            "offset_N": self.offset_N * np.exp(self.offset_log_spread * normal[3]),
            "lapse": expit(logit(self.lapse) + self.lapse_logit_spread * normal[4]),
            "sigma": np.sqrt(scale / rng.gamma(self.sigma_shape, size=count)),
        }


def population() -> Population:
    """Return the population that is defined in ``tissue/materials/perception.toml``."""
    known = {name: entry.value for name, entry in constants("perception", "force").items()}
    return Population(**{name: known[name] for name in Population.__dataclass_fields__})


def population_observer() -> Observer:
    """Return the observer that represents a person without a calibration.

    The observer has the same distribution as `population`, except that ln sigma has a normal
    distribution with the same mean and the same variance.
    """
    people = population()
    scale = (people.sigma_shape - 1.0) * people.sigma**2
    mean = [
        -0.5 * people.alpha_log_spread**2,
        people.beta,
        np.log(people.kappa),
        np.log(people.offset_N),
        logit(people.lapse),
        0.5 * (np.log(scale) - digamma(people.sigma_shape)),
    ]
    spread = [
        people.alpha_log_spread,
        people.beta_spread,
        people.kappa_log_spread,
        people.offset_log_spread,
        people.lapse_logit_spread,
        0.5 * np.sqrt(polygamma(1, people.sigma_shape)),
    ]
    return Observer(name="population", mean=np.array(mean), covariance=np.diag(np.square(spread)))


def reference_observer() -> Observer:
    """Return the reference observer, with the medians of the population and alpha = 1.

    Its parameters are known exactly. `ForceMap` scales forces so that other observers perceive what
    the reference observer would perceive.
    """
    people = population()
    given = {name: getattr(people, name) for name in PARAMETERS if name != "alpha"}
    return Observer.known("reference", alpha=1.0, **given)
