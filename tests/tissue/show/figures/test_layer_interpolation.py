"""Values of cells between their centres, layer by layer."""

import numpy as np
import pytest
from tooth_bodies import block

from tissue.fem.fields import FieldSeries
from tissue.models.tooth.field import VTK_ORDER
from tissue.show.figures.organ_surface import interpolate_in_layers

EDGE = 0.5e-3


def halves():
    """Return a block of two layers side by side, and values that are linear within each.

    The values jump from one layer to the other.
    """
    _, grid = block((6, 4, 4), EDGE)
    layer = (grid.cell_place[:, 0] >= 3).astype(np.uint8)
    series = FieldSeries(
        grid.node_position_m, grid.cell_nodes[:, VTK_ORDER].astype(np.int64), layer, ("a", "b")
    )
    return series, linear(grid.cell_centre_m, layer)


def linear(place_m, layer):
    return place_m @ [3.0, -2.0, 5.0] + 7.0 * layer


def test_a_linear_field_is_exact_between_the_centres_of_each_layer():
    series, values = halves()
    random = np.random.default_rng(0)
    layer = np.repeat([0, 1], 100)
    places = EDGE * (
        random.uniform(0.5, [2.5, 3.5, 3.5], (200, 3)) + np.array([3.0, 0.0, 0.0]) * layer[:, None]
    )
    assert interpolate_in_layers(series, values, places, layer) == pytest.approx(
        linear(places, layer), rel=1e-9
    )


def test_no_layer_takes_from_the_other_and_cells_that_are_gone_do_not_count():
    """No layer takes values from the other, and removed cells do not count.

    On both sides of the border between the layers, up to the nearest centres, each keeps to its
    layer's values.
    """
    series, values = halves()
    across = EDGE * np.array([[x, 2.0, 2.0] for x in (2.6, 2.9, 3.1, 3.4)])
    found = interpolate_in_layers(series, values, across, np.array([0, 0, 1, 1]))
    ends = EDGE * np.array([[x, 2.0, 2.0] for x in (2.5, 2.5, 3.5, 3.5)])
    assert found == pytest.approx(linear(ends, np.array([0, 0, 1, 1])), rel=1e-9)
    values[series.layer == 1] = np.nan
    assert interpolate_in_layers(series, values, across[2:], np.array([0, 0])) == pytest.approx(
        found[0], rel=1e-9
    )
    beyond = interpolate_in_layers(series, values, across[2:], np.array([1, 1]))
    assert np.isin(beyond, values).all()


def test_without_any_value_there_is_none():
    series, values = halves()
    assert np.isnan(
        interpolate_in_layers(series, np.full_like(values, np.nan), np.zeros((3, 3)), np.zeros(3))
    ).all()
