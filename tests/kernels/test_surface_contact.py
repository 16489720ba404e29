"""Solved contact against the laws that all its points must obey together.

The displacements come from NumPy.
"""

import numpy as np
import pytest
from falling_sheet import falling_sheet

from tissue.models.organ.contact import ContactOutcome, SurfaceContact
from tissue.models.organ.probe import SphereProbe

TOLERANCE = 1e-9
"""Step of the last sweep over the largest displacement."""
LEFT = 1e-6
"""Error of gaps and slips after the sweeps, relative to the largest displacement.

The sweeps converge by a factor of ten each; the bound includes a margin.
"""
RADIUS_M = 6e-3


@pytest.mark.parametrize("friction", [0.0, 0.1, 0.4])
def test_all_points_obey_signorini_and_coulomb_together(friction):
    """All points obey Signorini and Coulomb together.

    u = W H^T f; no gap is negative, no force pulls, one of them is zero, and friction is at most mu
    times normal.
    """
    nodes, faces, compliance = falling_sheet(cells=20, edge_m=0.02)
    contact = SurfaceContact(
        nodes,
        faces,
        compliance,
        SphereProbe(RADIUS_M),
        friction=friction,
        tolerance=TOLERANCE,
        sweeps=2000,
    )
    weights = np.random.default_rng(0).dirichlet([4.0, 4.0, 4.0], len(contact._points.weight))
    # off the triangles' middles, where the three nodes would be alike
    contact._points.weight.assign(weights)
    contact.place(np.array([0.0, 0.0, 1e-4]), np.eye(3))
    tip = np.array([0.0, 0.0, -2e-3])
    for step in range(3):
        tip = tip + np.array([2e-4, 1e-4 * step, -1e-4])
        result = contact.solve(tip, np.eye(3))
        assert result.outcome is ContactOutcome.CONVERGED
        points = contact._points
        first, following, weight = (
            getattr(points, name).numpy() for name in ("first", "following", "weight")
        )
        triangle = np.full(len(weight), -1)
        for face, point in enumerate(first):
            while point >= 0:
                triangle[point] = face
                point = following[point]
        force = contact._points.force.numpy()
        nodal = np.zeros_like(nodes)
        np.add.at(nodal, faces[triangle], weight[:, :, None] * force[:, None])
        moved = (compliance @ nodal.ravel()).reshape(-1, 3)
        from_tip = np.einsum("pa,pax->px", weight, (nodes + moved)[faces[triangle]]) - tip
        arm = from_tip - np.array([0.0, 0.0, RADIUS_M])
        gap = np.linalg.norm(arm, axis=1) - RADIUS_M
        normal = arm / np.linalg.norm(arm, axis=1)[:, None]
        press = np.einsum("px,px->p", force, normal)
        across = np.linalg.norm(force - press[:, None] * normal, axis=1)
        size, largest = np.linalg.norm(moved, axis=1).max(), press.max()
        assert gap.min() >= -LEFT * size
        assert press.min() >= -LEFT * largest
        assert np.abs(gap[press > 0.0]).max() <= LEFT * size
        assert (across - friction * press).max() <= LEFT * largest
        assert result.force_N == pytest.approx(-force.sum(axis=0), abs=1e-12 * largest)
        torque = -np.cross(from_tip, force).sum(axis=0)
        assert result.torque_Nm == pytest.approx(torque, abs=LEFT * RADIUS_M * largest)
        assert (press > 0.0).sum() == result.contacts > 5
        assert friction == 0.0 or across.max() > 0.01 * largest
