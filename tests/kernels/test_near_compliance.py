"""Gathered rows against the compliance that they come from.

The rows are read after nodes came near, were loaded, rested and left.
"""

import numpy as np
import pytest
from falling_sheet import falling_sheet

from tissue.models.organ.contact import SurfaceContact
from tissue.models.organ.probe import SphereProbe

ROUNDING = 1e-13
"""Sums of at most a hundred products, relative to their largest."""


@pytest.mark.parametrize("scale", [1.0, 0.4])
def test_rows_stay_those_of_the_compliance_while_nodes_come_and_go(scale):
    """The tool wanders, lifts off and comes back; halfway the compliance is scaled.

    Rows are kept however a solve ends: in a few of these ticks the sweeps run out.
    """
    nodes, faces, compliance = falling_sheet(cells=22, edge_m=0.04)
    contact = SurfaceContact(nodes, faces, compliance, SphereProbe(0.006))
    contact.place(np.array([-0.008, 0.0, 1e-3]), np.eye(3))
    patch, seen = contact._patch, []
    for tick in range(240):
        if tick == 120:
            contact.scale_compliance(scale)
        at = 0.05 * tick
        result = contact.solve(
            np.array([0.009 * np.sin(at), 0.007 * np.sin(0.7 * at), 2e-3 * np.cos(at)]), np.eye(3)
        )
        near, loaded, _ = patch.count.numpy()
        seen.append((near, loaded))
        node = patch.node.numpy()[:near]
        assert len(np.unique(node)) == near
        np.testing.assert_array_equal(np.flatnonzero(patch.slot.numpy() >= 0), np.sort(node))
        np.testing.assert_array_equal(patch.slot.numpy()[node], np.arange(near))
        assert np.isin(np.flatnonzero(result.nodal_forces_N.any(axis=1)), node[:loaded]).all()
        columns = (3 * node[:, None] + np.arange(3)).ravel()
        factor = scale if tick >= 120 else 1.0
        expected = factor * compliance[np.ix_(columns[: 3 * loaded], columns)]
        np.testing.assert_array_equal(patch.row.numpy()[: 3 * loaded, : 3 * near], expected)
        moved, right = patch.moved.numpy()[: 3 * near].reshape(-1, 3), result.displacement_m()
        assert np.abs(moved - right[node]).max(initial=0.0) <= ROUNDING * np.abs(right).max()
    counts = np.array(seen)
    assert counts[:, 1].min() == 0 and counts[:, 1].max() > 12 and np.ptp(counts[:, 0]) > 12
