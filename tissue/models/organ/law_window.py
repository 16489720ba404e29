"""Windows on an organ in which its hyperelastic law is solved.

A window is a region around a point on the surface of the organ. Outside the region the organ is
linear (`tissue.fem.region`). With an infinite radius, the region is the whole organ. When the
contact leaves a window, the nearest window is used next. Crept forces are the contact forces after
creep of the tissue, see `tissue.models.organ.law`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from scipy.sparse import bsr_array
from scipy.spatial import cKDTree

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError
from tissue.fem.quasi_newton import QuasiNewton, Springs
from tissue.fem.region import RegionBody
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody
from tissue.models.organ.compliance import FACTOR_UNKNOWNS
from tissue.models.organ.soft_organ import OrganLaw, SoftOrgan, ToolPath
from tissue.models.state import State, copied, put_back

HOP = 0.5
"""Largest distance of a contact from the centre of its window, divided by the law's radius.

The law's radius is `OrganLaw.region_m`. The radius of a window is the law's radius plus this
distance. In a deep press with twice the force of the linear law, the error of the force after the
motion is 3.3 % with 0.25 and 2.0 % with 0.5.
"""
LOADED = 1e-3
"""Smallest crept force of a node that a spring holds, relative to the largest crept force.

Crept forces are the contact forces after creep of the tissue. At places that the tool has left, the
crept forces decay but never reach zero. The value is chosen.
"""

TOUCHED = 2.0 / 3.0
"""Largest distance of a node in contact from a window's centre, relative to the window's radius.

For a ball-shaped tool in a scene, the radius of a window is three radii of the ball. The centre of
the contact is at most one of these radii from the centre of the window, and the contact extends one
radius beyond its centre.
"""


@dataclass(frozen=True, eq=False)
class LawWindow:
    """Solver of a hyperelastic law in a region of the organ.

    Attributes
    ----------
    follower
        Solver for the equilibria of the nodes in the window.
    inside
        Touchable nodes in the window, as increasing indices into all touchable nodes, shape (w,).
    places
        For each node in `inside`, its index among the nodes of the window, shape (w,).
    region
        Region of the window.
    """

    follower: QuasiNewton
    inside: Ints
    places: Ints
    region: RegionBody

    @property
    def fixed(self) -> Flags:
        """Mask of the unknowns of the window that are held at zero, shape (n, 3)."""
        return self.region.fixed

    def spread(self, forces_N: Array) -> Array:
        """Convert forces on all touchable nodes to loads [N], shape (n, 3), of this window."""
        load = np.zeros(self.fixed.shape)
        load[self.places] = forces_N[self.inside]
        return load

    def nodal_into(self, nodal_m: Array, unknowns_m: Array) -> None:
        """Write the displacements of this window's nodes [m] to `nodal_m`.

        `nodal_m` has a row for every node of the organ. `unknowns_m` are the unknowns of the
        window, shape (n, 3).
        """
        nodal_m[self.region.all_nodes] = self.region.nodal_m(unknowns_m)

    def springs(
        self, crept_N: Array, held_m: Array, compliance: Callable[["LawWindow", Ints], Array]
    ) -> Springs:
        """Build springs that hold the loaded nodes near given displacements.

        Parameters
        ----------
        crept_N, held_m
            Crept forces [N] (forces that would cause the displacements without creep) and
            displacements [m] of all touchable nodes, each of shape (t, 3).
        compliance
            Function that returns the compliance of the springs [m/N], shape (3l, 3l). Its arguments
            are this window and the loaded nodes, as indices into `inside`, shape (l,).
        """
        size_N = np.linalg.norm(crept_N[self.inside], axis=1)
        # A node on a support needs no spring, and has no compliance.
        free = ~self.fixed[self.places].any(axis=1)
        loaded = np.flatnonzero((size_N > LOADED * size_N.max(initial=0.0)) & free)
        if not len(loaded):
            return Springs.none(self.fixed.size)
        return Springs.holding(
            self.places[loaded],
            compliance(self, loaded),
            held_m[self.inside[loaded]],
            unknowns=self.fixed.size,
        )


class LawWindows:
    """Windows along the path of a tool, one of which is in use.

    Parameters
    ----------
    organ, law
        The organ, and its law.
    touchable
        Nodes of the contact, shape (t,).
    tool
        The tool and its poses. The poses determine the windows.

    Attributes
    ----------
    now
        Window in use.
    """

    def __init__(self, organ: SoftOrgan, law: OrganLaw, touchable: Ints, tool: ToolPath) -> None:
        self._nodes_m = organ.space.nodes_m[touchable]
        hop_m = HOP * law.region_m
        self._centres_m = self._nodes_m.mean(axis=0)[None]
        if hop_m < inf:
            away, places = cKDTree(self._nodes_m).query(tool.tips_m)
            # On a coarse mesh, a small tool between the nodes may be farther from all of them.
            is_near = away <= max(law.region_m, away.min())
            self._centres_m = window_centres(self._nodes_m[places[is_near]], hop_m)
        self._windows = [
            window_of(organ, law, touchable, centre, law.region_m + hop_m)
            for centre in self._centres_m
        ]
        self.now = self._windows[0]
        self._count = organ.space.node_count

    def choose(self, nodal_forces_N: Array, crept_N: Array) -> bool:
        """Use the window nearest to the contact, and return True if the window changed.

        A new window starts from the displacement of the last window. Nodes outside the last window
        start from the displacement that the linear law gives.

        Parameters
        ----------
        nodal_forces_N, crept_N
            Contact forces, and crept forces (forces that would cause the present displacement
            without creep) [N], each of shape (t, 3).
        """
        size_N = np.linalg.norm(nodal_forces_N, axis=1)
        if len(self._windows) == 1 or not size_N.any():
            return False
        centre = size_N @ self._nodes_m / size_N.sum()
        nearest = int(np.argmin(np.linalg.norm(self._centres_m - centre, axis=1)))
        before = self.now
        after = self._windows[nearest]
        if after is before:
            return False
        guess = after.follower.at_rest.displacement_m(after.spread(crept_N))
        moved = np.full((self._count, 3), np.nan)
        after.nodal_into(moved, guess)
        before.nodal_into(moved, before.follower.displacement_m)
        after.follower.restart(after.region.gathered(moved))
        self.now = after
        return True

    def state(self) -> State:
        """Return a copy of the state on which the next equilibria depend.

        The state contains the solution of the window in use only. Other windows restart when the
        tool reaches them.
        """
        return {
            "place": self._windows.index(self.now),
            "now": self.now.follower.state(),
            "records": [copied(each.follower, QuasiNewton.RECORD) for each in self._windows],
        }

    def restore(self, state: State) -> None:
        """Restore a state that `state` has returned."""
        self.now = self._windows[state["place"]]
        self.now.follower.restore(state["now"])
        for window, record in zip(self._windows, state["records"], strict=True):
            put_back(window.follower, record)

    @property
    def indefinite(self) -> int:
        """Number of tangent stiffness matrices that have not been positive definite so far."""
        return sum(window.follower.indefinite for window in self._windows)


def window_centres(points_m: Array, apart_m: float) -> Array:
    """Select centres of windows from the points on a path [m]; the result has shape (k, 3).

    The distance of every given point from the nearest selected point is at most `apart_m`. The
    points must be in their order along the path.
    """
    centres = points_m[:1]
    for point in points_m[1:]:
        if np.linalg.norm(centres - point, axis=1).min() > apart_m:
            centres = np.vstack([centres, point])
    return centres


def window_of(
    organ: SoftOrgan, law: OrganLaw, touchable: Ints, centre_m: Array, radius_m: float
) -> LawWindow:
    """Return a window that consists of the cells within a radius [m] of a centre [m].

    On a coarse mesh, cells are added so that no node in contact lies on the border of the window.

    Raises
    ------
    InputError
        If the mesh of the organ is too large for a factorisation.
    """
    space = organ.space
    whole = organ.factor.solver
    if not isinstance(whole, DirectSolver):
        raise InputError(
            "organ.law",
            f"be linear for a mesh with more than {FACTOR_UNKNOWNS:,} unknowns",
            f"{len(organ.body.free):,}",
            "use longer edges or the linear law",
        )
    away = np.linalg.norm(space.nodes_m[space.cell_nodes].mean(axis=1) - centre_m, axis=1)
    from_centre = np.linalg.norm(space.nodes_m[touchable] - centre_m, axis=1)
    touched = touchable[from_centre <= max(TOUCHED * radius_m, from_centre.min())]
    near = np.flatnonzero(np.linalg.norm(space.nodes_m - centre_m, axis=1) <= TOUCHED * radius_m)
    cells = np.flatnonzero((away <= radius_m) | np.isin(space.cell_nodes, touched).any(axis=1))
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
    held = HeldBody(stiffness, body.nodes_m, body.fixed, is_grounded=True)
    # In a part of an organ, single precision changes the force of a press by 0.0004 %.
    at_rest = DirectSolver(held, last=last, single=radius_m < inf)

    def factorised(tangent: bsr_array) -> DirectSolver:
        return DirectSolver(replace(held, stiffness=tangent), like=at_rest)

    return LawWindow(QuasiNewton(body, body.fixed, at_rest, factorised), inside, places, body)
