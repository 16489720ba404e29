"""The line from grey values to density, and the band that its uncertainties make."""

import json

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.ct.density import ASH_SHARE, ASH_SHARE_SD, CT_DENSITY, DensityLaw


def test_the_line_of_one_scanner_is_ash_over_its_share_of_apparent_density():
    hu = np.array([0.0, 500.0, 1000.0])
    assert CT_DENSITY(hu) == pytest.approx((0.887 * hu + 63.3) / ASH_SHARE, rel=1e-6)
    assert CT_DENSITY.relative_sd == pytest.approx(ASH_SHARE_SD / ASH_SHARE)


def test_density_and_band_stay_within_the_limits():
    law = DensityLaw(1.0, 100.0, 50.0, 900.0, residual_sd_kg_m3=200.0)
    assert law(np.array([-1000.0, 0.0, 5000.0])).tolist() == [50.0, 100.0, 900.0]
    low, high = law.band(np.array([0.0, 5000.0]))
    assert low[0] == 50.0
    assert high[1] == 900.0


def test_the_band_of_a_known_law_is_its_line():
    law = DensityLaw(1.5, 100.0)
    low, high = law.band(np.array([200.0]))
    assert low == high == law(np.array([200.0]))


def test_the_band_covers_lines_drawn_from_the_covariance():
    """20,000 draws: the standard error of a share of 0.9 is 0.002."""
    rng = np.random.default_rng(0)
    covariance = np.array([[0.03**2, -0.4], [-0.4, 20.0**2]])
    law = DensityLaw(1.4, 90.0, 0.0, 5000.0, covariance=(0.03**2, -0.4, 20.0**2), relative_sd=0.01)
    slope, offset = rng.multivariate_normal([1.4, 90.0], covariance, size=20000).T
    for hu in (0.0, 400.0, 1200.0):
        drawn = (slope * hu + offset) + rng.normal(0.0, 0.01, 20000) * (1.4 * hu + 90.0)
        low, high = law.band(np.array([hu]))
        assert np.mean((drawn > low) & (drawn < high)) == pytest.approx(0.9, abs=0.01)


def test_a_law_is_a_json_object():
    stated = json.loads(json.dumps(CT_DENSITY.as_dict()))
    assert DensityLaw(**{**stated, "covariance": tuple(stated["covariance"])}) == CT_DENSITY


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"covariance": (-1.0, 0.0, 1.0)}, "covariance must be of two numbers"),
        ({"covariance": (1.0, 3.0, 4.0)}, "covariance must be of two numbers"),
        ({"covariance": (float("nan"), 0.0, 1.0)}, "covariance must be of two numbers"),
        ({"relative_sd": -0.1}, "relative_sd must be in"),
        ({"residual_sd_kg_m3": float("inf")}, "residual_sd_kg_m3 must be in"),
        ({"lowest_kg_m3": 3000.0}, "lowest_kg_m3 must be in"),
    ],
)
def test_refused_laws(options, message):
    with pytest.raises(InputError, match=message):
        DensityLaw(1.0, 0.0, **options)


def test_a_share_outside_its_range_is_refused():
    with pytest.raises(InputError, match="share must be in"):
        CT_DENSITY.band(np.array([0.0]), share=1.0)
