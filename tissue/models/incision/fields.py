"""Displacement, strain and stress of a tissue block that shows the opening of a cut.

The block is used only for display. It is linear-elastic and split along the whole plane of the
first cut. Where the blade has not cut, the two faces of the plane stay together. Where the blade
has cut, the faces are free. Before the cut, the stress across the plane is the prestrain times E /
(1 - nu²). Cutting releases this stress, which acts as a traction that pulls the free faces apart.
The bottom of the block, and its two sides parallel to the cut, do not move. The opening of a long
cut is then close to the opening of an edge crack: 5.8 times the prestrain times the depth (Tada,
Paris and Irwin 2000). The fields do not include the pressure of the blade, other cuts, or contact
between the faces. The force on the blade does not depend on the block.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Flags, Ints, Singles
from meshes.base.errors import by
from meshes.tets.structured import graded, grid
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.fields import FieldSeries, Frame
from tissue.materials.elasticity import lame
from tissue.models.incision.cut import COLUMNS, Cut
from tissue.models.incision.parameters import Blade, IncisedTissue
from tissue.models.organ.fields import OrganFields
from tissue.models.organ.soft_organ import SoftOrgan

SIDE_M = 0.02
"""Thickness of the tissue next to the cut, beyond the ends of the cut and below the cut [m].

The block is only for display. Its size and its mesh edges are chosen; no force depends on them.
"""
ALONG = 40
DEEP = 5
"""Number of mesh edges along the depth of a cut; chosen.

`ALONG` is the number of mesh edges along the length of a cut.
"""
GROWTH = 1.4
"""Ratio of the lengths of two neighbouring mesh edges, outer to inner, next to a cut; chosen."""
LARGEST_RATIO = 0.45
"""Upper limit of the Poisson's ratio of the block, because linear cells lock at larger ratios."""
NEAR_M = 0.01
"""Largest distance between a cut and the planned cut at which the cut is drawn [m].

A simulated hand may miss the planned cut. Within this distance, its cut is drawn at the position of
the planned cut. The value is assumed.
"""


@dataclass(frozen=True, eq=False)
class Track:
    """Planned cut: coordinate frame, ends along the surface, and largest depth.

    Attributes
    ----------
    cut
        Cut that begins where the tool first enters the tissue. It defines the plane of the cut, the
        coordinate s along the surface and the coordinate l along the blade's axis.
    ends_m
        Smallest and largest coordinate along the surface that the blade reaches [m].
    deepest_m
        Largest depth along the blade's axis that the edge reaches [m].
    """

    cut: Cut
    ends_m: tuple[float, float]
    deepest_m: float

    @classmethod
    def first_of(
        cls, tissue: IncisedTissue, blade: Blade, tips_m: Array, rotations: Array
    ) -> "Track | None":
        """Return the first planned cut of a motion, or None if the tip stays outside the tissue.

        Parameters
        ----------
        tissue, blade
            Tissue and blade.
        tips_m, rotations
            Tip positions along the motion [m], shape (n, 3), and rotations of the blade at these
            positions, shape (n, 3, 3).
        """
        inside = np.flatnonzero(tips_m[:, 2] < 0.0)
        if not len(inside) or rotations[inside[0], 2, 2] <= 0.0:
            return None
        cut = Cut(tissue, blade, tips_m[inside[0]], rotations[inside[0]])
        places = np.array([cut.coordinates_m(tip) for tip in tips_m[inside]])
        places = places[np.abs(places[:, 2]) <= NEAR_M]
        ends = float(places[:, 0].min()), float(places[:, 0].max()) + cut.width_m
        return cls(cut, ends, cut.deepest_m(float(places[:, 1].max())))


def _half(track: Track) -> tuple[TetMesh, Ints, Array]:
    """Return the half block on one side of a cut, the nodes on the cut plane, and their areas.

    In the half block, x runs along the surface from the cut's origin, y away from the cut plane,
    and z out of the tissue. The area of a node is its share of the cut plane [m2].
    """
    low, high = track.ends_m
    deep = track.deepest_m * float(track.cut.axis[2])
    edge = (high - low) / ALONG
    aside = graded(0.0, SIDE_M, edge, GROWTH)
    down = deep / DEEP
    x = np.concatenate([low - aside[:0:-1], np.linspace(low, high, ALONG + 1), high + aside[1:]])
    z = np.concatenate(
        [np.linspace(0.0, deep, DEEP + 1), deep + graded(0.0, SIDE_M, down, GROWTH)[1:]]
    )
    z = -z[::-1]
    mesh = grid(x, aside, z)
    nodes = np.flatnonzero(mesh.nodes_m[:, 1] == 0.0)
    share = [
        0.5 * (np.diff(axis, append=axis[-1]) + np.diff(axis, prepend=axis[0])) for axis in (x, z)
    ]
    at = mesh.nodes_m[nodes]
    areas = share[0][np.searchsorted(x, at[:, 0])] * share[1][np.searchsorted(z, at[:, 2])]
    return mesh, nodes, areas


class IncisionFields:
    """Displacement, strain and stress of a tissue block that is split by the first cut of a motion.

    In a tick in which a display frame is due, only the profile of the cut is copied. The fields are
    computed after the end of the run. The block is symmetric, so only half of it is solved.

    Parameters
    ----------
    track
        Planned cut along which the block is split.
    tissue
        Tissue that is cut.
    interval_s
        Time between two frames [s].
    """

    def __init__(self, track: Track, tissue: IncisedTissue, *, interval_s: float) -> None:
        mesh, nodes, areas = _half(track)
        self._track = track
        low = mesh.nodes_m.min(axis=0)
        high = mesh.nodes_m.max(axis=0)
        held = np.flatnonzero((mesh.nodes_m[:, 2] == low[2]) | (mesh.nodes_m[:, 1] == high[1]))
        ratio = min(tissue.poisson_ratio, LARGEST_RATIO)
        rows = np.broadcast_to(lame(tissue.young_Pa, ratio), (len(mesh.cells), 2))
        organ = SoftOrgan(mesh, rows, held, order=1)
        free = ~np.isin(nodes, held)
        self._nodes = nodes[free]
        self._areas = areas[free]
        count = len(self._nodes)
        between = organ.compliance_between(self._nodes).reshape(count, 3, count, 3)
        self._compliance = between[:, 1, :, 1]
        self._traction_Pa = tissue.young_Pa / (1.0 - ratio**2) * tissue.prestrain
        self._fields = OrganFields(organ, self._nodes, interval_s=interval_s)
        self._kept = list[tuple[float, Array, Array]]()
        self.next_s = 0.0
        self.series = self._whole(self._fields.series)

    def keep(self, time_s: float, cuts: Sequence[Cut]) -> None:
        """Store the profiles of the cuts near the planned cut, as the frame at `time_s` [s]."""
        self.next_s += self._fields.interval_s
        near = [
            (middles + cut_s, depths)
            for cut in cuts
            for cut_s, _, aside in [self._track.cut.coordinates_m(cut.origin_m)]
            if abs(aside) <= NEAR_M
            for middles, depths in [cut.profile_m()]
        ]
        middles, depths = (
            (np.concatenate(each) for each in zip(*near, strict=True)) if near else np.zeros((2, 0))
        )
        self._kept.append((time_s, middles, depths))

    @property
    def note(self) -> str:
        """Sentence that describes the fields."""
        size = by(1e3 * np.ptp(self.series.nodes_m, axis=0), ".0f")
        return (
            f"a linear-elastic block of {size} mm, split by the first cut. Its faces open under "
            "the stress of the prestrain. The block serves the pictures; the force does not depend "
            "on it"
        )

    def compute(self) -> None:
        """Solve for the fields at all stored times."""
        for time_s, middles, depths in self._kept:
            force = np.zeros((len(self._nodes), 3))
            force[:, 1] = self._forces_N(self._open(middles, depths))
            self._fields.keep(time_s, force, force)
        self._kept.clear()
        self._fields.compute()
        for frame in self._fields.series.frames[len(self.series.frames) :]:
            self.series.frames.append(self._mirrored(frame))

    def _open(self, middles: Array, depths: Array) -> Flags:
        """Return a mask of the nodes on the cut plane that lie in the cut, shape (k,)."""
        at = self._fields.series.nodes_m[self._nodes]
        if not len(middles):
            return np.zeros(len(at), bool)
        order = np.argsort(middles)
        # Nodes at the ends and at the bottom of a planned cut lie on its boundary, apart from
        # rounding. They stay closed, because the cut must reach one column beyond a node.
        beyond = self._track.cut.width_m / COLUMNS * np.array([[-1.0], [1.0]])
        depth = np.interp(at[:, 0] + beyond, middles[order], depths[order], left=0.0, right=0.0)
        return -at[:, 2] < depth.min(axis=0) * float(self._track.cut.axis[2]) - 1e-9

    def _forces_N(self, is_open: Flags) -> Array:
        """Return the nodal forces normal to the cut plane [N].

        The forces open the cut, and keep the nodes outside the cut on the plane.
        """
        forces = self._traction_Pa * self._areas * is_open
        closed = ~is_open
        compliance = self._compliance
        forces[closed] = -np.linalg.solve(
            compliance[np.ix_(closed, closed)],
            compliance[np.ix_(closed, is_open)] @ forces[is_open],
        )
        return forces

    def _whole(self, half: FieldSeries) -> FieldSeries:
        """Return the mesh of the whole block in world coordinates, without results."""
        cut = self._track.cut
        sideways = np.array([-cut.along[1], cut.along[0], 0.0])
        # Columns of the block are parallel to the blade's axis.
        place = np.column_stack([cut.along, sideways, cut.axis / cut.axis[2]])
        sides = [half.nodes_m @ place.T + cut.origin_m]
        sides.append((half.nodes_m * [1.0, -1.0, 1.0]) @ place.T + cut.origin_m)
        self._turn = np.column_stack([cut.along, sideways, [0.0, 0.0, 1.0]])
        # In a mirrored tetrahedron two corners are exchanged, so that its volume stays positive.
        cells = np.vstack([half.cells, half.cells[:, [1, 0, 2, 3]] + len(half.nodes_m)])
        sets = {
            name: np.concatenate([nodes, nodes + len(half.nodes_m)])
            for name, nodes in half.node_sets.items()
        }
        return FieldSeries(
            np.vstack(sides), cells, np.tile(half.layer, 2), half.layer_names, node_sets=sets
        )

    def _mirrored(self, frame: Frame) -> Frame:
        """Return the fields of the whole block at one time, from the fields of the half block."""

        def both(values: Singles) -> Singles:
            mirrored = values * np.array([1.0, -1.0, 1.0], np.float32)
            return (np.vstack([values, mirrored]) @ self._turn.T).astype(np.float32)

        points = {name: both(values) for name, values in frame.points.items()}
        cells = {name: np.concatenate([each, each]) for name, each in frame.cells.items()}
        return Frame(frame.time_s, points, cells)
