"""Solve paths of ``K u = f`` on the real liver and on a box.

All give equal answers, each to its stated tolerance.
"""

import numpy as np
import pytest

from meshes.tets.files import read_tets
from meshes.tets.structured import box
from tissue.fem.assembly import assemble
from tissue.fem.solvers.compliance import reduced_compliance_m_N, surface_compliance_m_N
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody, held_nodes
from tissue.fem.solvers.multigrid import MultigridSolver
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

RATIOS = (0.3, 0.45, 0.49)


@pytest.fixture
def fresh_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path))


def organ(mesh, ratio, order=1):
    """A body of 5 kPa held below: nodes within a sixth of its height of its lowest."""
    space = Space(mesh, order=order)
    height = space.nodes_m[:, 2]
    held = height <= height.min() + np.ptp(height) / 6.0
    return HeldBody(assemble(space, lame(5e3, ratio)), space.nodes_m, held_nodes(held))


def energy_error(body, found, exact):
    off = (found - exact).ravel()
    return np.sqrt(
        off @ (body.stiffness @ off) / (exact.ravel() @ (body.stiffness @ exact.ravel()))
    )


def assert_paths_agree(body, touchable):
    """Check every path against the factor.

    The loads are a press on the top and random forces on all touchable nodes.
    """
    factor = DirectSolver(body)
    compliance = surface_compliance_m_N(body, touchable)
    multigrid = MultigridSolver(body)
    reduced = reduced_compliance_m_N(factor, touchable, 3 * len(touchable))
    assert np.abs(reduced - compliance).max() < 1e-6 * np.abs(compliance).max()
    highest = touchable[np.argsort(body.nodes_m[touchable, 2])[-5:]]
    press = np.zeros(body.nodes_m.shape)
    press[highest, 2] = -0.2
    shaken = np.zeros_like(press)
    shaken[touchable] = np.random.default_rng(0).normal(size=(len(touchable), 3))
    for load in (press, shaken):
        exact = factor.solve(load)
        assert exact.converged and exact.residual < 1e-10
        found = multigrid.solve(load)
        assert found.converged
        assert energy_error(body, found.displacement_m, exact.displacement_m) <= multigrid.tolerance
        expected = exact.displacement_m[touchable].ravel()
        assert (
            np.abs(compliance @ load[touchable].ravel() - expected).max()
            < 1e-10 * np.abs(expected).max()
        )


def above(mesh, body):
    """Surface nodes of the upper half."""
    height = body.nodes_m[:, 2]
    nodes = mesh.surface_nodes
    return nodes[height[nodes] > height.min() + 0.5 * np.ptp(height)]


@pytest.mark.usefixtures("fresh_cache")
@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("order", [1, 2])
def test_paths_agree_on_a_box(order, ratio):
    mesh = box((0.1, 0.08, 0.06), (5, 4, 3))
    body = organ(mesh, ratio, order)
    assert_paths_agree(body, above(mesh, body))


@pytest.mark.usefixtures("fresh_cache")
@pytest.mark.parametrize(("name", "unit_mm"), [("liver.v22.msh", 34.3), ("liver2.v22.msh", 110.0)])
def test_paths_agree_on_a_tetrahedral_liver(anatomy, name, unit_mm):
    """The second has cells of a thousandth of the largest volume."""
    mesh = read_tets(anatomy / "liver" / name, unit_mm=unit_mm).mesh
    body = organ(mesh, 0.45)
    assert_paths_agree(body, above(mesh, body))
