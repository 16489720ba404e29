"""Coverage of fits to milled logs.

Intervals hold the planted values, with the size exponent at its cited value of 0.
"""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "bench"))

from bench_fit_cutting import one

FITS = 6


@pytest.mark.slow
def test_intervals_hold_coefficients_where_the_size_exponent_is_zero():
    """Intervals hold coefficients where constants at an end of their range have that value.

    `bench_fit_cutting.py block --truth ends` counts 400 logs; a half-normal prior holds fewer than
    three quarters.
    """
    held = [each for seed in range(FITS) for each in one(("block", seed, "ends", False))[0]]
    two_sided = [inside for name, inside in held if name.startswith("constant cutting")]
    at_an_end = [inside for name, inside in held if name.startswith("constant at an end")]
    assert len(two_sided) >= FITS
    assert 0.8 <= sum(two_sided) / len(two_sided) <= 0.99
    assert all(at_an_end)
