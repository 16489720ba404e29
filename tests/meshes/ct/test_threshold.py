"""Thresholds between the parts of a histogram."""

import numpy as np
import pytest

from meshes.ct.inspection import Histogram
from meshes.ct.threshold import suggest_threshold


def test_a_threshold_lies_in_the_middle_of_the_gap_between_two_values():
    """Every value in the gap parts the image alike, and the surface between voxels depends on which one is taken."""
    counts = np.zeros(1501, dtype=np.int64)
    counts[0], counts[1500] = 60_000, 40_000
    assert suggest_threshold(Histogram(0, counts), is_hounsfield=False).threshold == pytest.approx(750.0, abs=1)


@pytest.mark.parametrize("scale", [1.0, 4.0, -1.0])
def test_a_threshold_follows_the_scale_and_sign_of_the_values(scale):
    rng = np.random.default_rng(3)
    samples = np.concatenate([rng.normal(100, 10, 20_000), rng.normal(300, 20, 10_000)]).round()
    whole = (scale * samples).astype(np.int64)
    first = int(whole.min())
    found = suggest_threshold(Histogram(first, np.bincount(whole - first)), is_hounsfield=False)
    # Otsu's threshold of two parts is near the mean of their means (Otsu 1979).
    assert found.threshold / scale == pytest.approx(200.0, abs=25.0)
