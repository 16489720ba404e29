"""Reference cutting force by adaptive quadrature over the surface of the cutter.

The quadrature uses no voxels, and no surface elements that are fixed to the tool.

The surface of the cutter is the half section r(s), z(s), rotated about the tool axis by the angle
phi. s is the length along the half section. The tool has N cutting edges and spins at omega.
Averaged over a revolution, the surface element ds dphi contains a cutting edge of length ``N ds
dphi / (2 pi)``. For the area dA of the element, this is ``N dA / (2 pi r)``. Let v be the velocity
of a surface point without the spin, and n the outward normal. The chip thickness is h = max(0, v .
n) 2 pi / (N omega), and the force on the surface element is::

    dF = - (N / 2 pi) [(K_tc c + K_te e) t + (K_rc c + K_re e) n + (K_ac c + K_ae e) a] ds dphi

c is the effective chip thickness, and e is a factor on the edge force. c and e are functions of h,
see `tissue.materials.constants.effective_chip`. t is the direction in which the spin moves the
point, and a is the axis from tip to shank. Every K is a cutting coefficient of the layer at the
surface point, multiplied by (density / reference density) ** exponent. Only engaged points
contribute. A point is engaged if it advances (v . n > 0), lies in the solid (signed distance below
0), and lies outside the volume swept earlier by the tool.

The surface is divided into cells in (s, phi). A cell is integrated with two by two Gauss points if
no boundary of the engaged region crosses it. Other cells are divided into four, down to a finest
size, at which one point per cell is used. The distance functions are 1-Lipschitz, so no boundary is
missed. Boundaries between layers are detected at the corners of the cells.
"""

from dataclasses import dataclass
from math import ceil, pi

import numpy as np

from meshes.base.arrays import Array, Bytes, Flags
from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import Shape
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import Arc, Piece
from tissue.evaluation.reference.path import ToolPath, convex_parts
from tissue.materials.constants import CuttingCoefficients, effective_chip

GAUSS = 0.5 / 3.0**0.5
"""Distance of the two Gauss points from the middle of an interval with length 1."""
TOUCHING_M = 1e-11
"""Distance [m] from an earlier cut up to which a point counts as lying on the cut.

Points of the tool's surface that lie on an earlier cut are not engaged.
"""
CORNERS = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]])


@dataclass(frozen=True)
class Solid:
    """Body that a tool cuts: anatomy and cutting coefficients as functions of position.

    Attributes
    ----------
    anatomy
        Signed distance and layer of the anatomy as functions of position.
    coefficients
        Cutting coefficients of each layer, in the order of the layer names of the anatomy.
    minus
        Volume that was drilled out before the run. None if nothing was drilled out.
    """

    anatomy: Anatomy
    coefficients: tuple[CuttingCoefficients, ...]
    minus: Shape | None = None

    def distance(self, points: Array) -> Array:
        """Return a bound [m] of the signed distance from the solid, shape (n,), negative inside.

        The bound is 1-Lipschitz. The points [m], shape (n, 3), are in the world frame.
        """
        distance = np.asarray(self.anatomy.shape.distance(points), dtype=np.float64)
        return (
            distance if self.minus is None else np.maximum(distance, -self.minus.distance(points))
        )

    def layer(self, points: Array) -> Bytes:
        """Return the index of the layer at each point, shape (n,).

        The points [m] have shape (n, 3).
        """
        return self.anatomy.classify(points, -self.anatomy.shape.distance(points))[0]

    def strengths(self, points: Array) -> Array:
        """Return the cutting coefficients and the constants of the size effect, shape (9, n).

        The rows are the tangential, radial and axial chip coefficients [Pa] and the three edge
        coefficients [N/m]. Rows 6 to 8 are the exponent of the size effect, the minimum chip
        thickness and the reference chip thickness [m]. The coefficients are multiplied by (density
        / reference density) ** exponent, with the exponent of the layer at the point.
        """
        layer, density = self.anatomy.classify(points, -self.anatomy.shape.distance(points))
        names = CuttingCoefficients.CHIP + CuttingCoefficients.EDGE
        table = np.array([[getattr(each, name) for each in self.coefficients] for name in names])
        reference = np.array([each.reference_density_kg_m3 for each in self.coefficients])
        exponent = np.array([each.density_exponent for each in self.coefficients])
        scale = (np.asarray(density, dtype=np.float64) / reference[layer]) ** exponent[layer]
        names = ("size_exponent", "minimum_chip_m", "reference_chip_m")
        size = np.array([[getattr(each, name) for each in self.coefficients] for name in names])
        return np.vstack([table[:, layer] * scale, size[:, layer]])


@dataclass(frozen=True)
class Resolution:
    """Resolution with which the surface of the tool is divided into cells.

    In the built-in scenes, the force at the default resolution differs by at most 0.03 % from the
    force at twice this resolution (``tests/bench/bench_reference.py``).

    Attributes
    ----------
    coarsest
        Number of cells per tool radius, before any cell is divided.
    divisions
        Number of times that a cell can be divided into four.
    """

    coarsest: int = 12
    divisions: int = 4

    def finer(self) -> "Resolution":
        """Return a resolution with cells of half the size."""
        return Resolution(2 * self.coarsest, self.divisions)


@dataclass(frozen=True)
class _Cells:
    """Cells on the tool's surface: middle and size in (s [m], phi), each of shape (n, 2)."""

    middle: Array
    size: Array

    def chosen(self, which: Flags) -> "_Cells":
        return _Cells(self.middle[which], self.size[which])

    def divided(self) -> "_Cells":
        half = 0.5 * self.size
        middle = (self.middle[:, None] + half[:, None] * CORNERS).reshape(-1, 2)
        return _Cells(middle, np.repeat(half, 4, axis=0))

    def points(self, offsets: Array) -> Array:
        """Return k points (s, phi) in each of the n cells, shape (n k, 2).

        The offsets from the middle of a cell have shape (k, 2) and are in units of the cell size.
        """
        return (self.middle[:, None] + self.size[:, None] * offsets).reshape(-1, 2)


def wrench_at(
    tick: int, path: ToolPath, cutter: Cutter, solid: Solid, *, resolution: Resolution | None = None
) -> Array:
    """Return force on the tool [N] and torque about its tip [N m] at a tick, shape (6,).

    Force and torque are in the world frame.
    """
    # a tool at rest makes no chip
    if not (path.velocities[tick].any() or path.turnings[tick].any()):
        return np.zeros(6)
    at_tick = _AtTick(tick, path, cutter, solid)
    total = np.zeros(6)
    for piece in cutter.profile.pieces:
        if piece.cutting:
            total += at_tick.wrench_on(piece, resolution or Resolution())
    rotation = path.rotations[tick]
    return np.concatenate([rotation @ total[:3], rotation @ total[3:]])


class _AtTick:
    """Integral of the cutting force over the tool's surface at one tick, in the tool's frame."""

    def __init__(self, tick: int, path: ToolPath, cutter: Cutter, solid: Solid) -> None:
        self.tick = tick
        self.path = path
        self.cutter = cutter
        self.solid = solid
        self.parts = convex_parts(cutter.profile)
        rotation = path.rotations[tick]
        self.velocity = path.velocities[tick] @ rotation
        self.turning = path.turnings[tick] @ rotation

    def wrench_on(self, piece: Piece, resolution: Resolution) -> Array:
        """Return the force [N] and torque [N m] on one piece of the profile, shape (6,)."""
        total = np.zeros(6)
        cells = self._coarsest(piece, resolution.coarsest)
        for division in range(resolution.divisions + 1):
            cells, smooth = self._sorted(piece, cells)
            total += self._integral(piece, cells.chosen(smooth), GAUSS * 2.0 * CORNERS)
            cells = cells.chosen(~smooth)
            if division < resolution.divisions:
                cells = cells.divided()
        # One point each, nowhere at the same place of its cell: a boundary along a row of cells
        # does not meet all.
        spread = np.arange(1, len(cells.middle) + 1)[:, None] * np.array(
            # powers of the inverse of the plastic number, whose multiples fill a square evenly (R2
            # sequence)
            [0.7548776662466927, 0.5698402909980532]
        )
        shifted = _Cells(cells.middle + cells.size * (spread % 1.0 - 0.5), cells.size)
        total += self._integral(piece, shifted, np.zeros((1, 2)), tested=True)
        return total

    def _coarsest(self, piece: Piece, coarsest: int) -> _Cells:
        """Divide a whole piece of the profile into cells of equal size."""
        radius = self.cutter.profile.radius_m
        # a short piece, such as a rounded edge, has at least four cells along its section
        counts = max(ceil(piece.length_m / radius * coarsest), 4), ceil(2.0 * pi * coarsest)
        size = np.array([piece.length_m / counts[0], 2.0 * pi / counts[1]])
        numbers = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(
            -1, 2
        )
        return _Cells((numbers + 0.5) * size, np.broadcast_to(size, (len(numbers), 2)))

    def _sorted(self, piece: Piece, cells: _Cells) -> tuple[_Cells, Flags]:
        """Return the cells that may be engaged, and a flag for cells that are entirely engaged."""
        points, normals, _ = _surface(piece, cells.middle)
        advance = self._advance(points, normals)
        widest = np.hypot(points[:, 0], points[:, 1]) + 0.5 * cells.size[:, 0]
        # half the diagonal: no point of a cell is farther from its middle
        reach = 0.5 * np.hypot(cells.size[:, 0], widest * cells.size[:, 1])
        bend = (
            0.5 * (cells.size[:, 0] / piece.radius if isinstance(piece, Arc) else 0.0)
            + 0.5 * cells.size[:, 1]
        )
        turning = np.linalg.norm(self.turning)
        speed = np.linalg.norm(self.velocity) + turning * self.path.reach_m
        change = speed * bend + turning * reach
        kept = np.flatnonzero(advance > -change)
        world = self.path.in_world(self.tick, points[kept])
        depth = self.solid.distance(world)
        inside = depth < reach[kept]
        kept = kept[inside]
        world = world[inside]
        depth = depth[inside]
        swept = self.path.swept_distance(self.tick, self.parts, world, limit_m=reach[kept])
        left = swept > -reach[kept]
        kept = kept[left]
        depth = depth[left]
        swept = swept[left]
        cells = _Cells(cells.middle[kept], cells.size[kept])
        smooth = (advance[kept] > change[kept]) & (depth < -reach[kept]) & (swept > reach[kept])
        # the corners decide whether a cell lies in one layer
        if len(self.solid.coefficients) > 1:
            one = np.flatnonzero(smooth)
            corners = _surface(piece, cells.chosen(smooth).points(CORNERS))[0]
            # four corners a cell
            layers = self.solid.layer(self.path.in_world(self.tick, corners)).reshape(-1, 4)
            smooth[one] = (layers == layers[:, :1]).all(axis=1)
        return cells, smooth

    def _advance(self, points: Array, normals: Array) -> Array:
        """Return the speed of points of the surface along their outward normals [m/s]."""
        return ((self.velocity + np.cross(self.turning, points)) * normals).sum(axis=1)

    def _integral(
        self, piece: Piece, cells: _Cells, offsets: Array, *, tested: bool = False
    ) -> Array:
        """Return the force [N] and torque [N m] on cells, shape (6,).

        Each cell is integrated at the points of `offsets`, with equal weights.

        If `tested` is true, points that are not engaged contribute no force. Otherwise, all points
        are assumed to be engaged.
        """
        points, normals, around = _surface(piece, cells.points(offsets))
        weights = np.repeat(cells.size.prod(axis=1) / len(offsets), len(offsets))
        advance = self._advance(points, normals)
        world = self.path.in_world(self.tick, points)
        if tested:
            engaged = (advance > 0.0) & (self.solid.distance(world) < 0.0)
            found = np.flatnonzero(engaged)
            # twice: larger distances are only known to be larger, and `TOUCHING_M` must be decided
            limit_m = np.full(len(found), 2.0 * TOUCHING_M)
            swept = self.path.swept_distance(self.tick, self.parts, world[found], limit_m=limit_m)
            found = found[swept > TOUCHING_M]
            points = points[found]
            normals = normals[found]
            around = around[found]
            weights = weights[found]
            advance = advance[found]
            world = world[found]
        # no point is engaged
        if len(points) == 0:
            return np.zeros(6)
        chip = advance * self.cutter.chip_per_speed_s
        strengths = self.solid.strengths(world)
        length = weights * (self.cutter.flute_count / (2.0 * pi))
        effective, share = effective_chip(chip, *strengths[6:])
        loads = strengths[:3] * effective + strengths[3:6] * share
        factors = self.cutter.load_factors(np.hypot(points[:, 0], points[:, 1])).T
        tangential, radial = -length * factors * loads[:2]
        axial = -length * loads[2]
        force = (np.sign(self.cutter.spin_rad_s) * tangential)[:, None] * around + radial[
            :, None
        ] * normals
        force[:, 2] += axial
        return np.concatenate([force.sum(axis=0), np.cross(points, force).sum(axis=0)])


def _surface(piece: Piece, at: Array) -> tuple[Array, Array, Array]:
    """Return points [m], outward normals and directions of increasing phi, each shape (n, 3).

    The surface positions `at` are (s, phi), shape (n, 2).
    """
    section, outward = piece.at(at[:, 0] / piece.length_m)
    cosine = np.cos(at[:, 1])
    sine = np.sin(at[:, 1])
    points = np.column_stack([section[:, 0] * cosine, section[:, 0] * sine, section[:, 1]])
    normals = np.column_stack([outward[:, 0] * cosine, outward[:, 0] * sine, outward[:, 1]])
    return points, normals, np.column_stack([-sine, cosine, np.zeros(len(at))])
