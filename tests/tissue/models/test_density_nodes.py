"""Powers of many densities from a few nodes, against the powers themselves."""

import numpy as np
import pytest

from tissue.models.bone.engagement import ERROR, DensityNodes, densities_of


@pytest.mark.parametrize(
    ("densities", "off"),
    [
        ((1800, 1800), ERROR),
        ((900, 901), ERROR),
        ((300, 2000), ERROR),
        ((20, 4095), ERROR),
        ((1, 4095), 5e-7),
    ],
)
def test_powers_follow_from_the_nodes_for_every_exponent(densities, off):
    """Over three and a half decades the rounding of terms of 1e9 shows."""
    nodes = DensityNodes.of(*densities)
    density = np.arange(densities[0], densities[1] + 1)
    for exponent in (0.0, 0.7, 1.5, 2.0, 3.3, 5.0):
        got = nodes.shares[density] @ nodes.strengths(exponent, reference_kg_m3=1800.0, factor=1.1)
        want = (1.1 * density / 1800.0) ** exponent
        assert got == pytest.approx(want, rel=off)
        slope = nodes.shares[density] @ (
            nodes.strengths(exponent, reference_kg_m3=1800.0, factor=1.1)
            * nodes.logarithms(reference_kg_m3=1800.0, factor=1.1)
        )
        # A derivative is off by about the number of nodes times as much as the power itself.
        assert slope == pytest.approx(
            want * np.log(1.1 * density / 1800.0), abs=100 * off * want.max()
        )


def test_the_range_of_a_layer_leaves_out_others_and_voxels_without_density():
    words = np.array([[(700 << 16) | 1, (300 << 16) | 1, 1, (50 << 16) | 0]], dtype=np.uint32)
    assert densities_of(words, 1).tolist() == [300, 700]
    assert densities_of(words, 2).tolist() == [0, 0]


def test_densities_beyond_the_table_count_as_its_ends():
    """Densities beyond the table count as its ends.

    The strength table ends at 20000 kg/m3 and starts at 1: a single number beyond is one node
    there.
    """
    assert DensityNodes.of(25000, 30000).densities_kg_m3.tolist() == [20000.0]
    assert DensityNodes.of(0, 0).densities_kg_m3.tolist() == [1.0]
    nodes = DensityNodes.of(900, 30000).densities_kg_m3
    assert nodes.min() > 900.0 and 19000.0 < nodes.max() < 20000.0
