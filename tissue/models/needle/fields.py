"""Displacement, strain and stress of a tissue block that a needle deflects, for display.

The needle's own model (`tissue.models.needle.model`) is one-dimensional. This model computes the
deflection of the organ at the needle, and the inserted length. For display, this deflection is
applied to a linear-elastic block around the first track of the needle. The nodes along the inserted
shaft are displaced along the needle's axis by the deflection. Before the puncture, only the node at
the entry is displaced. The solver computes the nodal forces that cause these displacements. The
force on the needle does not depend on this block.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Ints
from meshes.base.errors import by
from meshes.organs.liver import slab, slab_base
from meshes.tets.stuffing import bisected
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.fields import FieldSeries
from tissue.materials.elasticity import lame
from tissue.materials.scene_constants import Materials
from tissue.models.needle.parameters import LEAST_COSINE
from tissue.models.organ.fields import OrganFields
from tissue.models.organ.soft_organ import SoftOrgan

SIDE_M = 0.08
"""Width of the block across the needle [m].

The block is only for display. Its size and its mesh edges are chosen; no force depends on them.
"""
BELOW_M = 0.03
"""Distance from the deepest position of the needle's tip to the base of the block [m]."""
COARSE_M = 0.01
FINE_M = 2.2e-3
GROWTH = 0.75
"""Increase of the length of the mesh edges per distance from the needle's track.

The largest length of a mesh edge is `FINE_M` [m] on the track, and `COARSE_M` [m] far from the
track.
"""
ON_TRACK_M = 1e-9
"""Largest distance from the track at which a node is treated as lying on the track [m]."""


@dataclass(frozen=True, eq=False)
class Track:
    """Entry point, direction and depth of a needle.

    Attributes
    ----------
    entry_m
        Intersection of the needle's axis with the surface z = 0 [m], shape (3,).
    outward
        Unit vector along the needle's axis from tip to shank, shape (3,).
    deepest_m
        Largest travel of the tip beyond the surface, along the axis [m].
    arm_m
        Vector from the entry to the deepest position of the tip in the first insertion [m], shape
        (3,). It is parallel to the axis if the needle moves along its axis.
    """

    entry_m: Array
    outward: Array
    deepest_m: float
    arm_m: Array

    @classmethod
    def first_of(cls, tips_m: Array, outward: Array, *, diameter_m: float) -> "Track | None":
        """Return the first track of a needle's motion.

        The result is None if the needle stays outside the tissue, starts inside it or lies flat on
        it.

        Parameters
        ----------
        tips_m, outward
            Tip positions along the motion [m], and directions of the needle's axis at these
            positions, each of shape (n, 3).
        diameter_m
            Distance within which two entry points count as equal [m].
        """
        steep = outward[:, 2] >= LEAST_COSINE
        travel = np.where(steep, -tips_m[:, 2] / np.where(steep, outward[:, 2], 1.0), -np.inf)
        inside = np.flatnonzero(travel > 0.0)
        # The needle stays outside, or starts inside, so no entry is known.
        if len(inside) == 0 or inside[0] == 0:
            return None
        first = int(inside[0])
        before, after = tips_m[first - 1 : first + 1]
        height = max(before[2], 0.0)
        entry = before + height / (height - after[2]) * (after - before)
        left = first + np.flatnonzero(travel[first:] <= 0.0)
        visit = travel[first : left[0] if len(left) else None]
        entries = tips_m[inside] + travel[inside, None] * outward[inside]
        same = np.linalg.norm(entries - entry, axis=1) <= diameter_m
        deepest = max(visit.max(), travel[inside][same].max(initial=0.0))
        arm = tips_m[first + int(visit.argmax())] - entry
        return cls(entry, outward[first], float(deepest), arm)


def needle_block(track: Track) -> tuple[TetMesh, Ints, Array]:
    """Return a block of tissue around a track, the nodes on the track, and the node depths [m].

    The nodes are in the order of their depths; nodes and depths have shape (k,). The block is a
    sheared slab whose middle line is the needle's axis. Depths are measured along the axis. The top
    face is at z = 0.
    """
    drop = track.deepest_m * float(track.outward[2])
    block = slab(size_m=(SIDE_M, SIDE_M, drop + BELOW_M), spacing_m=COARSE_M)
    slope = track.outward / track.outward[2]
    height = block.nodes_m[:, 2:]
    nodes = np.hstack([block.nodes_m[:, :2] + height * slope[:2] + track.entry_m[:2], height])

    def away(points_m: Array) -> Array:
        arm = points_m - track.entry_m
        along = np.clip(-arm @ track.outward, 0.0, track.deepest_m)
        return np.linalg.norm(arm + along[:, None] * track.outward, axis=1)

    mesh = bisected(
        replace(block, nodes_m=nodes, part_names=("parenchyma",)),
        lambda points: FINE_M + GROWTH * away(points),
    )
    depth = -mesh.nodes_m[:, 2] / track.outward[2]
    on = np.flatnonzero((away(mesh.nodes_m) < ON_TRACK_M) & (depth < track.deepest_m + ON_TRACK_M))
    on = on[np.argsort(depth[on])]
    return mesh, on, depth[on]


class NeedleFields:
    """Displacement, strain, stress and reaction of a block around a needle's first track.

    When a frame of the display is due, the tick only copies time, deflection and inserted length.
    The fields are computed after the end of the run. While the needle is in another track, the
    block is shown without deformation.

    The finite elements are linear, so Poisson's ratio should not be near 0.5. The force on the
    shaft, and strain and stress next to the shaft, depend on the length of the mesh edges. These
    results do not converge when the mesh is refined, because the displacement of a line in an
    elastic body is prescribed.

    Parameters
    ----------
    track
        Entry point, direction and depth of the needle.
    elasticity
        Lame constants [Pa], shape (2,).
    near_m
        Largest distance [m] between the entry point of the track and another entry point that
        belongs to the track, for example the needle's diameter.
    interval_s
        Time between two frames [s].
    """

    def __init__(
        self, track: Track, elasticity: ArrayLike, *, near_m: float, interval_s: float
    ) -> None:
        mesh, self.nodes, self._depths_m = needle_block(track)
        self._lame_Pa = np.asarray(elasticity, float)
        rows = np.broadcast_to(self._lame_Pa, (len(mesh.cells), 2))
        organ = SoftOrgan(mesh, rows, slab_base(mesh), order=1)
        self.track = track
        self._inward = -track.outward
        self._near_m = near_m
        self._compliance = organ.compliance_between(self.nodes)
        self._fields = OrganFields(organ, self.nodes, interval_s=interval_s)
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
        """Return the fields of a block with the Young's modulus of liver in the cited sources.

        Poisson's ratio is the smallest value in the cited sources, because linear finite elements
        lock at larger values.
        """
        cited = constants.constants("soft", "liver")
        elasticity = lame(1e3 * cited["modulus_kPa"].value, cited["poisson_ratio"].low)
        return cls(track, elasticity, near_m=near_m, interval_s=interval_s)

    @property
    def series(self) -> FieldSeries:
        """Mesh and frames of the block."""
        return self._fields.series

    def keep(
        self, time_s: float, *, deflection_m: float, inserted_m: float, entry_m: Array
    ) -> None:
        """Store deflection of the organ, inserted length and entry point [m] for one frame."""
        self.next_s += self._fields.interval_s
        here = np.linalg.norm(entry_m - self.track.entry_m) <= self._near_m
        self._kept.append((time_s, deflection_m, inserted_m) if here else (time_s, 0.0, 0.0))

    def compute(self) -> None:
        """Solve for the fields at all stored times."""
        for time_s, deflection, inserted in self._kept:
            force = self.forces_N(deflection, inserted)
            self._fields.keep(time_s, force, force)
        self._kept.clear()
        self._fields.compute()

    @property
    def note(self) -> str:
        """Sentence that describes the fields."""
        size = by(1e3 * np.ptp(self.series.nodes_m, axis=0), ".0f")
        first, second = self._lame_Pa
        modulus_kPa = 1e-3 * second * (3.0 * first + 2.0 * second) / (first + second)
        return (
            f"a linear-elastic block of {size} mm around the first track, displaced by the "
            "deflection of the needle's model. Stress and reaction follow from a modulus of "
            f"{modulus_kPa:.3g} kPa (soft.liver.modulus_kPa), not from the needle's constants. The "
            "block serves the pictures; the force does not depend on it"
        )

    def forces_N(self, deflection_m: float, inserted_m: float) -> Array:
        """Return the nodal forces [N] that cause a deflection, shape (k, 3).

        The track has k nodes. Nodes down to the inserted length move along the needle by the
        deflection. The needle is rigid, so the nodes are not displaced across it.
        """
        moved = self._depths_m <= inserted_m + ON_TRACK_M
        forces = np.zeros((len(self.nodes), 3))
        rows = np.repeat(moved, 3)
        shift = np.tile(deflection_m * self._inward, moved.sum())
        forces[moved] = np.linalg.solve(self._compliance[np.ix_(rows, rows)], shift).reshape(-1, 3)
        return forces
