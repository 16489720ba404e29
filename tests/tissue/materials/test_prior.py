"""Priors of cited constants: quantiles, inverse and slope against their definitions.

All constants are tested.
"""

import numpy as np
import pytest
from scipy.stats import halfnorm, norm

from tissue import InputError
from tissue.materials.constants import Prior, constants, listed

TABLES = ("cutting", "needle", "soft", "devices", "tooth")
CITED = {
    f"{table}.{material}.{name}": constant
    for table in TABLES
    for material in listed(table)
    for name, constant in constants(table, material).items()
}
Z = np.linspace(-4.0, 4.0, 161)
Z_95 = norm.ppf(0.95)
FREE = {
    name: Prior.of(constant, name)
    for name, constant in CITED.items()
    if constant.low < constant.high
}


def test_value_and_range_are_the_quantiles():
    for name, prior in FREE.items():
        if prior.low < prior.value < prior.high:
            low, value, high = prior.x([-Z_95, 0.0, Z_95])
            np.testing.assert_allclose(
                [value, high], [prior.value, prior.high], rtol=1e-12, err_msg=name
            )
            # a range from zero cannot reach zero and stay positive: within 4 % of the value
            np.testing.assert_allclose(
                low, prior.low, rtol=1e-12, atol=0.04 * prior.value * (prior.low == 0.0)
            )


@pytest.mark.parametrize(
    "free", [(1.0, 2.0, 8.0), (2.0, 4.0, 5.0)], ids=["long above", "long below"]
)
def test_a_skewed_range_is_log_normal_about_its_end(free):
    low, value, high = np.log(free)
    ratio = (high - value) / (value - low)
    end = value - (high - value) / (ratio - 1.0)
    spread = norm.ppf([0.1, 0.7])
    expected = np.exp(end + (value - end) * np.exp(np.log(ratio) * spread / Z_95))
    np.testing.assert_allclose(Prior(free[1], free[0], free[2]).x(spread), expected, rtol=1e-12)


def test_an_even_range_is_log_normal_and_one_about_zero_normal():
    np.testing.assert_allclose(Prior(2.0, 1.0, 4.0).x(Z), 2.0 * 2.0 ** (Z / Z_95), rtol=1e-12)
    np.testing.assert_allclose(Prior(0.0, -3.0, 3.0).x(Z), 3.0 * Z / Z_95, atol=1e-12)


@pytest.mark.parametrize("value", [0.0, 6.0], ids=["at the lower end", "at the upper end"])
def test_a_value_at_an_end_of_its_range_is_half_normal(value):
    prior = Prior(0.0, 0.0, 6.0) if value == 0.0 else Prior(0.0, -6.0, 0.0)
    share = norm.cdf(Z)
    scale = 6.0 / halfnorm.ppf(0.95)
    expected = (
        halfnorm.ppf(share, scale=scale) if value == 0.0 else -halfnorm.isf(share, scale=scale)
    )
    np.testing.assert_allclose(prior.x(Z), expected, rtol=1e-9)


def test_every_constant_rises_strictly_and_stays_where_a_scene_accepts_it():
    for name, prior in FREE.items():
        x = prior.x(Z)
        # to rounding at a bound
        assert (np.diff(x[np.abs(Z) < 3.0]) > 0.0).all() and (np.diff(x) >= 0.0).all(), name
        assert prior.low < 0.0 or (x > 0.0).all(), name
        if name.endswith("poisson_ratio"):
            assert (prior.x([-40.0, 40.0]) < 0.5).all(), name
    shares = [FREE[f"soft.liver.prony_g{number}"].x(6.0) for number in (1, 2)]
    assert sum(shares) < 1.0


def test_the_inverse_gives_back_z():
    z = np.linspace(-3.0, 3.0, 25)
    for name, prior in FREE.items():
        x, slope = prior.x(z), prior.slope(z)
        # rounding of x to 16 digits is an error of z of that over the slope
        np.testing.assert_allclose(
            prior.z(x), z, atol=1e-9 + 1e-14 * float(np.max(np.abs(x) / slope)), err_msg=name
        )


def test_the_slope_is_the_derivative():
    z, step = np.linspace(-3.0, 3.0, 25), 1e-5
    for name, prior in FREE.items():
        difference = (prior.x(z + step) - prior.x(z - step)) / (2.0 * step)
        # second order in the step, and rounding of x over the step
        near = 1e-6 * np.abs(difference).max() * 1e-2 + 1e-10 * np.abs(prior.x(z))
        assert (np.abs(prior.slope(z) - difference) < 1e-6 * np.abs(difference) + near).all(), name


@pytest.mark.parametrize("numbers", [(5.0, 1.0, 4.0), (2.0, np.nan, 4.0), (2.0, 1.0, np.inf)])
def test_a_range_that_does_not_hold_its_value_is_refused(numbers):
    with pytest.raises(InputError, match="range must contain the value"):
        Prior(*numbers)
