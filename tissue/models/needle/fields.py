"""Displacement, strain and stress of a tissue block that a needle drags along, for display.

The needle's own model (`tissue.models.needle.insertion`) is one-dimensional. It gives the
deflection of the organ at the needle and the inserted length. Here a linear-elastic block around
the first track responds to that deflection. The nodes along the inserted shaft, before the puncture
the node at the entry, are displaced by the deflection along the needle's axis, by the forces that
this requires. The force on the needle never comes from this block.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Ints
from meshes.organs.liver import slab, slab_base
from meshes.tets.stuffing import bisected
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.assembly import assemble
from tissue.fem.fields import FieldSeries
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody, held_nodes
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.materials.scene_constants import Materials
from tissue.models.needle.model import LEAST_COSINE
from tissue.models.needle.parameters import NeedleTissue
from tissue.models.organ.fields import OrganFields

__all__ = ["NeedleFields", "Track", "needle_block"]

SIDE_M = 0.08
"""Side of the block across the needle [m]."""
BELOW_M = 0.03
"""Tissue between the deepest tip and the base [m]."""
COARSE_M = 0.01
FINE_M = 2.2e-3
GROWTH = 0.75
"""Bricks of the block [m], longest edge on the track [m], and growth of edges with the distance.

The distance is measured from the track.
"""
ON_TRACK_M = 1e-9
"""Rounding error of a node's position [m]."""


@dataclass(frozen=True, eq=False)
class Track:
    """Entry, direction and depth of a needle.

    Attributes
    ----------
    entry_m
        Intersection of the needle's axis with the surface z = 0 [m], shape (3,).
    outward
        Unit vector along its axis from tip to shank, shape (3,).
    deepest_m
        Largest travel of the tip beyond the surface, along the axis [m].
    """

    entry_m: Array
    outward: Array
    deepest_m: float

    @classmethod
    def first_of(cls, tips_m: Array, outward: Array, *, diameter_m: float) -> "Track | None":
        """Return the first track of a motion.

        It is None where the needle stays outside, starts inside or lies flat.

        Parameters
        ----------
        tips_m, outward
            Tip positions that outline the motion [m] and the needle's axis there, shape (n, 3)
            both.
        diameter_m
            Distance of two entries within which they count as one [m].
        """
        steep = outward[:, 2] >= LEAST_COSINE
        travel = np.where(steep, -tips_m[:, 2] / np.where(steep, outward[:, 2], 1.0), -np.inf)
        inside = np.flatnonzero(travel > 0.0)
        if len(inside) == 0 or inside[0] == 0:
            return None
        entries = tips_m[inside] + travel[inside, None] * outward[inside]
        same = np.linalg.norm(entries - entries[0], axis=1) <= diameter_m
        return cls(entries[0], outward[inside[0]], float(travel[inside][same].max()))


def needle_block(track: Track) -> tuple[TetMesh, Ints, Array]:
    """Return a block of tissue around a track, its nodes on the track and their depths [m].

    The nodes, shape (k,), are ordered from the surface down; the depths have shape (k,). The block
    is a slab sheared so that its middle line is the needle's axis. Depths count along the axis. The
    top face is at z = 0.
    """
    drop = track.deepest_m * float(track.outward[2])
    block = slab(size_m=(SIDE_M, SIDE_M, drop + BELOW_M), spacing_m=COARSE_M)
    slope = track.outward / track.outward[2]
    height = block.nodes_m[:, 2:]
    nodes = np.hstack([block.nodes_m[:, :2] + height * slope[:2] + track.entry_m[:2], height])

    def away(points_m: Array) -> Array:
        arm = points_m - track.entry_m
        along = np.clip(-arm @ track.outward, 0.0, track.deepest_m)
        distance: Array = np.linalg.norm(arm + along[:, None] * track.outward, axis=1)
        return distance

    mesh = bisected(
        replace(block, nodes_m=nodes, part_names=("parenchyma",)),
        lambda points: FINE_M + GROWTH * away(points),
    )
    depth = -mesh.nodes_m[:, 2] / float(track.outward[2])
    on = np.flatnonzero((away(mesh.nodes_m) < ON_TRACK_M) & (depth < track.deepest_m + ON_TRACK_M))
    on = on[np.argsort(depth[on])]
    return mesh, on, depth[on]


class NeedleFields:
    """Displacement, strain, stress and reaction of a block around a needle's first track.

    A frame costs a tick a copy of three numbers. The fields are computed after the end of the run.
    Other tracks are not shown: the block is at rest then.

    The cells are linear, so Poisson's ratio should not be near 0.5. Right at the shaft strain and
    stress depend on the edges of the mesh, because a line that moves through an elastic body has no
    limit. The force on the line has none either.

    Parameters
    ----------
    track
        Entry, direction and depth of the needle.
    elasticity
        Lame constants [Pa], shape (2,).
    near_m
        Largest distance of an entry from the track's entry at which it belongs to the track [m],
        such as the needle's diameter.
    interval_s
        Time between two frames [s].
    """

    def __init__(
        self, track: Track, elasticity: ArrayLike, *, near_m: float, interval_s: float
    ) -> None:
        mesh, nodes, self._depths_m = needle_block(track)
        held = slab_base(mesh)
        rows = np.broadcast_to(np.asarray(elasticity, dtype=float), (len(mesh.cells), 2))
        space = Space(mesh, 1, device="cpu")
        fixed = np.zeros(len(mesh.nodes_m), dtype=bool)
        fixed[held] = True
        body = HeldBody(assemble(space, rows), space.nodes_m, held_nodes(fixed))
        self.track = track
        self.nodes = nodes
        self._inward = -track.outward
        self._near_m = near_m
        self._columns = self._axial_columns(DirectSolver(body))
        self._compliance = self._columns[:, nodes] @ self._inward
        self._fields = OrganFields(
            space,
            rows,
            solve=lambda loads: np.tensordot(loads[:, nodes] @ self._inward, self._columns, axes=1),
            product=lambda moved: (body.stiffness @ moved.ravel()).reshape(-1, 3),
            touchable=nodes,
            rest_m=np.zeros(space.nodes_m.shape),
            rest_load_N=np.zeros(space.nodes_m.shape),
            held=held,
            interval_s=interval_s,
        )
        self.next_s = 0.0
        self._kept = list[tuple[float, float, float]]()

    @classmethod
    def of_liver(
        cls,
        track: Track,
        *,
        near_m: float,
        interval_s: float,
        constants: Materials = Materials.cited,
    ) -> "NeedleFields":
        """Return the fields in a liver with the cited modulus.

        Poisson's ratio is the smallest cited value, because linear cells lock at larger values.
        """
        cited = constants.constants("soft", "liver")
        elasticity = lame(1e3 * cited["modulus_kPa"].value, cited["poisson_ratio"].low)
        return cls(track, elasticity, near_m=near_m, interval_s=interval_s)

    @property
    def series(self) -> FieldSeries:
        """Mesh and frames."""
        return self._fields.series

    def keep(
        self, time_s: float, *, deflection_m: float, inserted_m: float, entry_m: Array
    ) -> None:
        """Store the organ's deflection, the needle's inserted length and its entry [m]."""
        self.next_s += self._fields.interval_s
        here = float(np.linalg.norm(entry_m - self.track.entry_m)) <= self._near_m
        self._kept.append((time_s, deflection_m, inserted_m) if here else (time_s, 0.0, 0.0))

    def compute(self) -> None:
        """Solve the stored frames."""
        for time_s, deflection, inserted in self._kept:
            force = self.forces_N(deflection, inserted)[:, None] * self._inward
            self._fields.keep(time_s, force, force)
        self._kept.clear()
        self._fields.compute()

    def note(self, tissue: NeedleTissue) -> str:
        """Return a sentence that describes the fields.

        It also states the force of the block next to the force of the needle's model.
        """
        puncture = tissue.membranes[0].puncture_N if tissue.membranes else tissue.cutting_N
        moved = tissue.deflection_m(puncture)
        deepest = self.track.deepest_m
        entry, shaft = (float(self.forces_N(moved, inserted).sum()) for inserted in (0.0, deepest))
        size = " x ".join(f"{1e3 * side:.0f}" for side in np.ptp(self.series.nodes_m, axis=0))
        return (
            f"the linear-elastic answer of a block of {size} mm around the first track, its "
            "base held, to the "
            "deflection that the needle's model gives: a picture, not a second model of the "
            "force. To move by "
            f"{1e3 * moved:.1f} mm it takes {entry:.2g} N at the entry and {shaft:.2g} N "
            f"along {1e3 * deepest:.0f} mm "
            f"of shaft, where the needle's model has {puncture:.2f} N: the block has neither "
            "capsule nor strain "
            "stiffening, and what it takes depends on the edges of its "
            f"{len(self.series.cells)} linear tetrahedra"
        )

    def forces_N(self, deflection_m: float, inserted_m: float) -> Array:
        """Return axial forces [N], inwards, that move the track's nodes by a deflection.

        The nodes down to the inserted length are moved. The shape is (k,).
        """
        moved = self._depths_m <= inserted_m + ON_TRACK_M
        forces = np.zeros(len(self.nodes))
        forces[moved] = np.linalg.solve(
            self._compliance[np.ix_(moved, moved)], np.full(moved.sum(), deflection_m)
        )
        return forces

    def _axial_columns(self, solver: DirectSolver) -> Array:
        """Return displacements of all nodes by a unit axial force at each node of the track.

        The shape is (k, n, 3). The force acts inwards.
        """
        found = np.zeros((len(self.nodes), len(solver.body.nodes_m), 3))
        for component in np.flatnonzero(self._inward):
            columns = solver.columns(3 * self.nodes + component)
            found += self._inward[component] * columns.T.reshape(found.shape)
        return found
