"""Creep of a finite element surface under contact.

It is compared with closed forms, the direct hereditary integral, and Lee and Radok's limit.
"""

import numpy as np
import pytest
from prony_series import compliance_of, modulus_of, started

from meshes.tets.structured import box
from tissue.fem.assembly import assemble
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.materials.prony import Prony

SERIES = Prony(g=(0.3, 0.3), tau_s=(0.5, 10.0))
STEP_S = 1e-2
SIDE_M, DEPTH_M = 0.04, 0.02


@pytest.fixture(scope="module")
def surface():
    """Return the top nodes of a small block on a fixed base, and their compliance [m/N].

    The block has E = 5 kPa.
    """
    space = Space(box((SIDE_M, SIDE_M, DEPTH_M), (8, 8, 4)))
    stiffness = assemble(space, lame(5e3, 0.4)).toarray()
    free = np.flatnonzero(np.repeat(space.nodes_m[:, 2] > 1e-9, 3))
    top = np.flatnonzero(space.nodes_m[:, 2] > DEPTH_M - 1e-9)
    unknowns = (3 * top[:, None] + np.arange(3)).ravel()
    unit = np.zeros((len(free), len(unknowns)))
    unit[np.searchsorted(free, unknowns), np.arange(len(unknowns))] = 1.0
    compliance = np.linalg.solve(stiffness[np.ix_(free, free)], unit)[
        np.searchsorted(free, unknowns)
    ]
    return space.nodes_m[top], 0.5 * (compliance + compliance.T)


def test_step_of_force_creeps(surface):
    """A force that jumps and stays: the creep compliance at every node, exactly."""
    nodes, compliance = surface
    elastic = (compliance @ np.random.default_rng(0).normal(size=3 * len(nodes))).reshape(-1, 3)
    creep = started(SERIES.retardation, elastic, step_s=STEP_S)
    for tick in range(1, 2001):
        now = creep.instant_factor * elastic + creep.history
        creep.advance(elastic)
        if tick in (1, 10, 100, 2000):
            np.testing.assert_allclose(
                now, compliance_of(SERIES, tick * STEP_S) * elastic, rtol=1e-11
            )


def patch(surface):
    """Vertical unknowns of the nodes within 8 mm of the middle, and the compliance between them."""
    nodes, compliance = surface
    near = np.flatnonzero(np.linalg.norm(nodes[:, :2] - SIDE_M / 2, axis=1) < 8e-3)
    return near, compliance[:, 3 * near + 2]


def pressed(surface, depths, *, elastic_start=0.0, step_s=STEP_S):
    """Return the force [N] on a bonded punch that follows ``depths`` [m].

    It is solved tick by tick on the compliance.
    """
    near, columns = patch(surface)
    mutual = columns[3 * near + 2]
    before = (columns @ np.linalg.solve(mutual, np.full(len(near), elastic_start))).reshape(-1, 3)
    creep = started(SERIES.retardation, before, step_s=step_s)
    force = []
    for depth in depths:
        nodal = np.linalg.solve(creep.instant_factor * mutual, depth - creep.history[near, 2])
        creep.advance((columns @ nodal).reshape(-1, 3))
        force.append(nodal.sum())
    return np.array(force) / np.linalg.solve(mutual, np.ones(len(near))).sum()


def test_step_of_displacement_relaxes(surface):
    """A punch that jumps in and stays: the relaxation modulus. The force is not linear in a
    tick: 1e-4, as asked.
    """
    ticks = np.array([10, 100, 1000])
    force = pressed(surface, np.ones(1000), elastic_start=1.0)
    np.testing.assert_allclose(force[ticks - 1], modulus_of(SERIES, ticks * STEP_S), rtol=1e-4)


def test_ramp_and_hold(surface):
    """A ramp of 1 s and a hold: the tabulated values to 1e-4."""
    time = STEP_S * np.arange(1, 1001)
    force = pressed(surface, np.minimum(time, 1.0))
    np.testing.assert_allclose(
        force[[49, 99, 199, 999]], (0.441130, 0.815187, 0.675873, 0.516071), atol=1e-4
    )


def test_second_order_in_time(surface):
    """The force of a ramp, at half the tick a quarter of the error."""
    steps = np.array([0.2, 0.1, 0.05, 0.025])
    last = [pressed(surface, h * np.arange(1, round(1.0 / h) + 1), step_s=h)[-1] for h in steps]
    errors = np.abs(np.array(last) - 0.815187)
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.2)
    assert errors[-1] < 1e-4
