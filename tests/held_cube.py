"""A distorted cube as soft as a liver, held at its bottom; loads on it and errors of answers."""

import numpy as np
from tet_bodies import distorted

from tissue.fem.assembly import assemble
from tissue.fem.solvers.condensed import CondensedSolver, surface_compliance
from tissue.fem.solvers.solution import HeldBody, Supports
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

LIVER = (5e3, 0.45)
MESH = distorted(4, seed=3)
SURFACE = MESH.surface_nodes
BOTTOM = MESH.nodes_m[:, 2] < 1e-9


def body_of(mesh=MESH, supports=None, order=1, law=LIVER):
    space = Space(mesh, order=order)
    if supports is None:
        supports = Supports.of_nodes(space.nodes_m[:, 2] < 1e-9)
    return HeldBody(assemble(space, lame(*law)), space.nodes_m, supports)


def condensed_path(body):
    compliance = surface_compliance(body, SURFACE, shown=np.arange(len(body.nodes_m)))
    return CondensedSolver(body, compliance)


def load_on(nodes, seed=0, count=125):
    load = np.zeros((count, 3))
    load[nodes] = np.random.default_rng(seed).normal(size=(len(nodes), 3))
    return load


def energy_error(body, found, exact):
    """Error in the energy norm relative to the answer's."""
    off = (found - exact).ravel()
    matrix = body.sprung
    return np.sqrt(off @ (matrix @ off) / (exact.ravel() @ (matrix @ exact.ravel())))
