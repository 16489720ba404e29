"""Draws of a posterior: right where it is known, warned of where they are not to be trusted."""

import csv
import sys
from functools import partial

import numpy as np
import pytest
from planted_logs import planted, slot
from scipy.integrate import cumulative_simpson
from scipy.special import ndtr

from meshes.base.errors import InputError
from tissue.fitting.draws_file import draws_numbers, write_draws
from tissue.fitting.nuts import Draws, draw_by_nuts, require_nuts
from tissue.fitting.target import OFFSET_S, Target

NEEDED = partial(pytest.importorskip, "numpyro", reason="the extra perception is not installed")


def draws_of(u, *, r_hat=1.0, effective=1000.0, divergences=0):
    return Draws(u, np.full(u.shape[2], r_hat), np.full(u.shape[2], effective), divergences)


def test_a_missing_sampler_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "numpyro", None)
    with pytest.raises(InputError, match=r"nuts must be sampled by numpyro, got none: pip install 'tissue-sim\[perc"):
        require_nuts()


def test_intervals_and_correlation_are_those_of_the_draws():
    """A normal pair of correlation 0.8, one of them bent: its interval is bent, the copula's correlation is not."""
    u = np.random.default_rng(0).multivariate_normal([0.0, 0.0], [[1.0, 0.8], [0.8, 1.0]], (4, 5000))
    u[..., 1] = np.exp(u[..., 1])
    draws = draws_of(u)
    assert draws.quantiles(1) == pytest.approx(np.exp([-1.645, 0.0, 1.645]), rel=0.06)
    assert draws.correlation(np.array([0, 1])) == pytest.approx(np.array([[1.0, 0.8], [0.8, 1.0]]), abs=0.01)
    assert draws.correlation(np.array([1])).shape == (1, 1)


def test_draws_that_are_not_to_be_trusted_are_named():
    u = np.zeros((2, 50, 3))
    assert draws_of(u).warnings == ()
    assert "disagree, R-hat 1.050" in draws_of(u, r_hat=1.05).warnings[0]
    assert "disagree" in draws_of(u, r_hat=np.nan).warnings[0]
    assert "3 of 100 transitions" in draws_of(u, divergences=3).warnings[0]
    assert "effective sample size of NUTS is 120" in draws_of(u, effective=120.0).warnings[0]


def test_the_file_holds_every_number_in_its_unit(tmp_path):
    log, _ = planted(slot(), np.random.default_rng(1))
    target = Target(slot(), log)
    draws = draws_of(0.1 * np.random.default_rng(2).standard_normal((2, 3, target.size)))
    write_draws(draws, target, tmp_path / "draws.csv")
    with (tmp_path / "draws.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["chain"]) for row in rows] == [1, 1, 1, 2, 2, 2]
    assert len(rows[0]) == 1 + target.size
    last, u = rows[-1], draws.u[1, 2]
    first = target.forward.parameters[0]
    assert float(last[first.name]) == pytest.approx(first.prior.x(u[0]))
    assert float(last["offset_s"]) == pytest.approx(OFFSET_S * u[4])
    each = target.unpacked(u)
    assert float(last["noise_scale_force_z_N"]) == pytest.approx(each.scale[2])
    assert float(last["noise_correlation_force_y_N"]) == pytest.approx(each.correlation[1])
    assert draws_numbers(draws, target)["draws"] == 6


class Linear:
    """A linear model with normal noise and a standard normal prior: its posterior is normal and known."""

    def __init__(self, rng):
        design, data = rng.standard_normal((20, 4)), rng.standard_normal(20)
        self.precision = np.eye(4) + design.T @ design
        self.covariance = np.linalg.inv(self.precision)
        self.mean = self.covariance @ design.T @ data

    def value_and_gradient(self, u):
        assert u.dtype == np.float64
        pull = -self.precision @ (u - self.mean)
        return 0.5 * float((u - self.mean) @ pull), pull


class Banana:
    """The sum of exp of a normal number and of another, that is known to 0.3: a ridge that bends."""

    KNOWN = 0.3

    def value_and_gradient(self, u):
        product = np.exp(u[0]) + u[1]
        rest = (2.0 - product) / self.KNOWN
        return float(-0.5 * rest**2 - 0.5 * u @ u), rest / self.KNOWN * np.array([np.exp(u[0]), 1.0]) - u

    def quantiles(self, at, shares):
        grid = np.linspace(-6.0, 6.0, 2401)
        first, second = np.meshgrid(grid, grid, indexing="ij")
        density = np.exp(-0.5 * ((2.0 - np.exp(first) - second) / self.KNOWN) ** 2 - 0.5 * (first**2 + second**2))
        summed = cumulative_simpson(density.sum(axis=1 - at), x=grid, initial=0.0)
        return np.interp(np.array(shares) * summed[-1], summed, grid)


@pytest.mark.slow
def test_a_normal_posterior_is_drawn_as_it_is():
    """From a start and a scale that are wrong; within 4.5 standard errors of a mean, and of a variance."""
    NEEDED()
    model = Linear(np.random.default_rng(3))
    spread = np.sqrt(np.diag(model.covariance))
    draws = draw_by_nuts(model, model.mean + spread, 2.0 * model.covariance, seed=4, warm_up=200, draws=300)
    assert draws.warnings == ()
    error = spread / np.sqrt(draws.effective)
    assert np.all(np.abs(draws.together.mean(axis=0) - model.mean) < 4.5 * error)
    found = np.cov(draws.together, rowvar=False)
    assert np.abs(found / np.outer(spread, spread) - model.covariance / np.outer(spread, spread)).max() < 4.5 * np.sqrt(
        2.0 / draws.effective.min()
    )
    import jax

    assert not jax.config.read("jax_enable_x64")


@pytest.mark.slow
def test_a_bent_ridge_is_followed_where_a_normal_law_leaves_it():
    """Truth by quadrature: the share of draws below its quantiles within 4.5 standard errors of their number, which the
    normal law about the maximum misses by more."""
    NEEDED()
    model, shares = Banana(), np.array([0.05, 0.5, 0.95])
    u = np.zeros(2)
    for _ in range(50):  # Gauss-Newton
        slope = np.array([np.exp(u[0]), 1.0]) / Banana.KNOWN
        information = np.outer(slope, slope) + np.eye(2)
        u = u + 0.5 * np.linalg.solve(information, model.value_and_gradient(u)[1])
    covariance = np.linalg.inv(information)
    draws = draw_by_nuts(model, u, covariance, seed=5)
    error = np.sqrt(shares * (1.0 - shares) / draws.effective.min())
    missed = []
    for at in range(2):
        truth = model.quantiles(at, shares)
        below = np.array([np.mean(draws.together[:, at] < each) for each in truth])
        print(draws.quantiles(at), truth, (below - shares) / error)
        assert np.all(np.abs(below - shares) < 4.5 * error)
        missed.append(np.abs(ndtr((truth - u[at]) / np.sqrt(covariance[at, at])) - shares) / error)
    print(draws.sentence, missed)
    assert np.max(missed) > 4.5
