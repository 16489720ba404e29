"""Samples of constants: their laws, correlations and how fast sums converge."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.fitting.bands.sample import Ranges, normals, rounded
from tissue.materials.constants import Prior

PRIORS = {
    "cutting.bone.radial_chip_N_mm2": Prior(60.0, 15.0, 180.0),
    "cutting.bone.axial_chip_N_mm2": Prior(0.0, 0.0, 60.0),
    "cutting.bone.density_exponent": Prior(1.5, 1.0, 2.0),
}


def test_samples_have_the_quantiles_of_the_ranges():
    ranges = Ranges(tuple(PRIORS), tuple(PRIORS.values()), np.eye(3))
    x = ranges.x(normals(4096, 3, seed=3))
    low, middle, high = np.quantile(x, (0.05, 0.5, 0.95), axis=0)
    assert middle[[0, 2]] == pytest.approx([60.0, 1.5], rel=2e-3)
    assert low[[0, 2]] == pytest.approx([15.0, 1.0], rel=5e-3)
    assert high[[0, 2]] == pytest.approx([180.0, 2.0], rel=5e-3)
    assert np.quantile(x[:, 1], 0.95) == pytest.approx(60.0, rel=5e-3), (
        "95 % of a one-sided range lie inside"
    )


def test_correlated_constants_are_drawn_together_and_make_one_group():
    correlation = np.array([[1.0, 0.0, -0.9], [0.0, 1.0, 0.0], [-0.9, 0.0, 1.0]])
    ranges = Ranges(tuple(PRIORS), tuple(PRIORS.values()), correlation)
    assert ranges.groups == ((0, 2), (1,))
    assert ranges.group_names[0] == "cutting.bone.radial_chip_N_mm2 + cutting.bone.density_exponent"
    x = ranges.x(normals(4096, 3, seed=0))
    z = np.column_stack([prior.z(x[:, at]) for at, prior in enumerate(ranges.priors)])
    assert np.corrcoef(z[:, 0], z[:, 2])[0, 1] == pytest.approx(-0.9, abs=0.01)
    assert np.corrcoef(z[:, 0], z[:, 1])[0, 1] == pytest.approx(0.0, abs=0.02)


def test_counts_are_powers_of_two():
    assert [rounded(each) for each in (16, 200, 256, 257)] == [16, 256, 256, 512]
    for wrong in (3, 0, 1_000_000):
        with pytest.raises(InputError, match="band must be"):
            rounded(wrong)
