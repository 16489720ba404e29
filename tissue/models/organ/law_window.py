"""Windows on an organ in which its hyperelastic law is solved.

A window is the whole organ, or a region around a place on its surface. Outside the region the organ
is linear (`tissue.fem.region`). A tool that slides passes from window to window.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import bsr_array

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.quasi_newton import QuasiNewton
from tissue.fem.region import RegionBody
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ.compliance import FACTOR_UNKNOWNS
from tissue.models.organ.soft_organ import OrganLaw, SoftOrgan

__all__ = ["TOUCHED", "LawWindow", "follower_of", "whole_window", "window_centres", "window_of"]


TOUCHED = 2.0 / 3.0
"""Largest distance of a node in a contact from the centre of the window, over its radius.

A window reaches three radii of the ball. A contact reaches one radius, and its centre is at most
one radius from that of the window.
"""


@dataclass(frozen=True, eq=False)
class LawWindow:
    """Solver of a law in the whole organ or in a region of it.

    Attributes
    ----------
    follower
        Solver of the window's equilibria.
    inside
        Touchable nodes in the window, as positions among all touchable nodes, rising, shape (w,).
    places
        Positions of these nodes among the nodes of the window, shape (w,).
    fixed
        Unknat_rests of the window that are zero, shape (n, 3).
    region
        Region of the window; None for the whole organ.
    """

    follower: QuasiNewton
    inside: Ints
    places: Ints
    fixed: Flags
    region: RegionBody | None = None

    def spread(self, forces_N: Array) -> Array:
        """Return the forces on the window's nodes [N], shape (n, 3), from all touchable nodes."""
        load = np.zeros(self.fixed.shape)
        load[self.places] = forces_N[self.inside]
        return load

    def nodal_into(self, nodal_m: Array, unknowns_m: Array) -> None:
        """Write the displacements of the window's nodes [m] to those of the organ, (nodes, 3)."""
        if self.region is None:
            nodal_m[:] = unknowns_m
        else:
            nodal_m[self.region.all_nodes] = self.region.nodal_m(unknowns_m)

    def gathered(self, nodal_m: Array) -> Array:
        """Return the unknowns nearest to displacements of the organ's nodes [m], shape (n, 3)."""
        return nodal_m if self.region is None else self.region.gathered(nodal_m)


def follower_of(
    organ: SoftOrgan, law: Hyperelastic, cell_factors: Array, nodes: Ints
) -> QuasiNewton:
    """Return the solver that follows the equilibria of an organ.

    Its factors hold the compliance between some nodes.

    Raises
    ------
    InputError
        If the mesh is too large for a factor.
    """
    at_rest = organ.factor.solver
    if not isinstance(at_rest, DirectSolver):
        raise InputError(
            "organ.law",
            f"be linear on more than {FACTOR_UNKNOWNS:,} unknowns",
            f"{len(organ.body.free):,}",
            "use longer edges",
        )

    def factorised(stiffness: bsr_array) -> DirectSolver:
        return DirectSolver(HeldBody(stiffness, organ.space.nodes_m, organ.body.fixed), last=nodes)

    # An organ that was solved before may have been eliminated in another order.
    if not np.isin(nodes, at_rest.last).all():
        at_rest = factorised(organ.body.stiffness)
    body = NonlinearBody(
        organ.space, None, law=law, cell_factors=cell_factors, membrane=organ.membrane
    )
    return QuasiNewton(body, organ.body.fixed, at_rest, factorised)


def whole_window(organ: SoftOrgan, law: OrganLaw, touchable: Ints) -> LawWindow:
    """Return a window on the whole organ."""
    follower = follower_of(organ, law.law, law.cell_factors, touchable)
    inside = np.arange(len(touchable))
    return LawWindow(follower, inside, touchable, organ.body.fixed)


def window_centres(points_m: Array, apart_m: float) -> Array:
    """Return some of the points [m], shape (k, 3), so that none is farther than `apart_m` from one.

    Points are taken in their order along a path, shape (p, 3).
    """
    centres = points_m[:1]
    for point in points_m[1:]:
        if np.linalg.norm(centres - point, axis=1).min() > apart_m:
            centres = np.vstack([centres, point])
    return centres


def window_of(
    organ: SoftOrgan, law: OrganLaw, touchable: Ints, centre_m: Array, radius_m: float
) -> LawWindow:
    """Return a window on the cells within a radius [m] of a centre [m].

    On a coarse mesh it has further cells, so that no node in a contact is on the border.
    """
    space = organ.space
    away = np.linalg.norm(space.nodes_m[space.cell_nodes].mean(axis=1) - centre_m, axis=1)
    from_centre = np.linalg.norm(space.nodes_m[touchable] - centre_m, axis=1)
    touched = touchable[from_centre <= max(TOUCHED * radius_m, from_centre.min())]
    near = np.flatnonzero(np.linalg.norm(space.nodes_m - centre_m, axis=1) <= TOUCHED * radius_m)
    cells = np.flatnonzero((away <= radius_m) | np.isin(space.cell_nodes, touched).any(axis=1))
    whole = organ.factor.solver
    assert isinstance(whole, DirectSolver)
    body = RegionBody(
        space,
        whole,
        cells,
        loaded=(touched, near),
        law=law.law,
        cell_factors=law.cell_factors,
        membrane=None if organ.capsule is None else organ.capsule.stiffness,
    )
    back = np.full(space.node_count, -1)
    back[body.nodes] = np.arange(len(body.nodes))
    inside = np.flatnonzero(back[touchable] >= 0)
    places = back[touchable[inside]]
    last = np.concatenate([np.sort(places), np.arange(len(body.nodes), len(body.nodes_m))])
    stiffness = body.stiffness(np.zeros_like(body.nodes_m))
    at_rest = DirectSolver(
        HeldBody(stiffness, body.nodes_m, body.fixed, is_grounded=True), last=last
    )

    def factorised(tangent: bsr_array) -> DirectSolver:
        held = HeldBody(tangent, body.nodes_m, body.fixed, is_grounded=True)
        return DirectSolver(held, like=at_rest)

    follower = QuasiNewton(body, body.fixed, at_rest, factorised)
    return LawWindow(follower, inside, places, body.fixed, body)
