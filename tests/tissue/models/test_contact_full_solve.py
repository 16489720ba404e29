"""Contact on the compliance against a full solve of all displacements and contact forces."""

import numpy as np
import pytest
from contact_slab import TIGHT, along, away
from scipy.sparse import block_array, block_diag, coo_array
from scipy.sparse.linalg import spsolve

from tissue.models.organ.contact import ContactOutcome
from tissue.models.organ.probe import SphereProbe


def full_solve(slab, radius, path, friction):
    """Return the contact of a sphere on nodes, solved with the whole stiffness.

    It is a saddle system in all displacements and contact forces. Newton solves the equations of
    Alart and Curnier (1991), and normals are updated between solves until they rest.
    """
    count = slab.stiffness.shape[0]
    m = len(slab.top)
    u = np.zeros(count)
    force = np.zeros((m, 3))
    last = path[0]
    for tip in path[1:]:
        anchor = slab.rest + u[slab.unknowns].reshape(-1, 3) + (tip - last)
        for _ in range(60):
            where = slab.rest + u[slab.unknowns].reshape(-1, 3)
            arm = where - tip - [0.0, 0.0, radius]
            length = np.linalg.norm(arm, axis=1)
            normal = arm / length[:, None]
            before = force
            force = newton(slab, u, force, length - radius, normal, where, anchor, friction)
            if np.abs(force - before).max() < 1e-14:
                break
        last = tip
    return force


def newton(slab, u, force, gap, normal, where, anchor, friction, scale=1.0):
    """Forces for gaps linear about `where`; `u` is brought up to date."""
    near = np.flatnonzero(gap < 0.01)
    eye = np.eye(3)
    for _ in range(60):
        now = slab.rest + u[slab.unknowns].reshape(-1, 3)
        rows = []
        contact_rows = []
        right = []
        for i in near:
            n = normal[i]
            tangent = eye - np.outer(n, n)
            g = gap[i] + n @ (now[i] - where[i])
            press = force[i] @ n
            side = tangent @ force[i]
            slip = tangent @ (now[i] - anchor[i])
            trial = press - scale * g
            pull = side - scale * slip
            if trial <= 0.0:
                by_u = np.zeros((3, 3))
                by_f = eye
                residual = force[i]
            elif np.linalg.norm(pull) <= friction * trial:
                by_u = scale * (np.outer(n, n) + tangent)
                by_f = np.zeros((3, 3))
                residual = scale * (g * n + slip)
            else:
                size = np.linalg.norm(pull)
                direction = pull / size
                turn = friction * trial / size * (tangent - np.outer(direction, direction))
                by_u = scale * (np.outer(n, n) + turn + friction * np.outer(direction, n))
                by_f = tangent - turn - friction * np.outer(direction, n)
                residual = scale * g * n + side - friction * trial * direction
            rows.append(by_u), contact_rows.append(by_f), right.append(residual)
        columns = slab.unknowns.reshape(-1, 3)[near].ravel()
        size = 3 * len(near)
        pick = coo_array((np.ones(size), (columns, np.arange(size))), shape=(len(u), size)).tocsc()
        by_u = block_diag(rows, format="csc")
        by_f = block_diag(contact_rows, format="csc")
        balance = slab.stiffness @ u - pick @ force[near].ravel()
        matrix = block_array([[slab.stiffness, -pick], [by_u @ pick.T, by_f]], format="csc")
        step = spsolve(matrix, -np.concatenate([balance, np.concatenate(right)]))
        u += step[: len(u)]
        force = force.copy()
        force[near] += step[len(u) :].reshape(-1, 3)
        if np.abs(step).max() < 1e-15 + 1e-13 * np.abs(force).max():
            break
    else:
        raise AssertionError("the full solve did not converge")
    return force


@pytest.mark.parametrize("friction", [pytest.param(0.0, marks=pytest.mark.slow), 0.3])
def test_contact_on_the_compliance_equals_a_full_solve(slab, friction):
    path = [*away([0.0013, -0.0007, -0.003])[::2], np.array([0.0013, -0.0007, -0.003])]
    expected = full_solve(slab, 0.011, path, friction)
    result = along(
        slab.contact(SphereProbe(0.011), friction=friction, spacing_m=1.0, **TIGHT), path
    )
    assert result.outcome is ContactOutcome.CONVERGED
    np.testing.assert_allclose(
        result.force_N, -expected.sum(axis=0), atol=1e-6 * np.linalg.norm(result.force_N)
    )
    np.testing.assert_allclose(
        result.nodal_forces_N, expected, atol=1e-6 * np.linalg.norm(result.force_N)
    )
    assert expected.any(axis=1).sum() >= 5
