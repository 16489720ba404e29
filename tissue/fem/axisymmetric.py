"""Equilibrium of an axisymmetric layer on a rigid base under a rigid ball without friction.

The layer is bonded to its base. Its cells are quadrilaterals of nine nodes with nine Gauss points.
At a radius r the deformation gradient has the in-plane part ``I + grad u`` and the hoop stretch ``1
+ u_r / r``. Energy, force and tangent are computed from the derivatives of the law with respect to
the logarithms of the principal stretches. Newton's method computes each step from the tangent, and
halves the step until the energy decreases.

Contact is evaluated at Gauss points of the top face. Let g be the depth of a Gauss point inside the
ball, p a multiplier and k a penalty. The method of augmented Lagrangians adds the energy ``(max(0,
p + k g)^2 - p^2) / 2 k`` per area (Simo and Laursen 1992, Comput. Struct. 42:97).

The solver has about 3,000 unknowns, compared with 30,000 for tetrahedra. A fit of material
constants can therefore evaluate many laws.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError
from tissue.materials.hyperelasticity import Hyperelastic

WIDTH = 4.0
"""Smallest radius of the layer, divided by the sum of layer thickness and ball radius.

With 3 instead of 4, the force at a depth of 0.75 ball radii changes by less than 0.1 %, for a
thickness of 1 to 5 ball radii.
"""
FIRST = 0.12
"""Edge of a cell on the axis at the surface, divided by the ball's radius.

With 0.045 instead of 0.12, the forces at depths of 0.1 to 0.75 ball radii change by at most 0.3 %.
With 0.18 they change by 1.3 % (`tests/verification/test_axisymmetric.py`).
"""
GROWTH = 1.22
"""Ratio of the lengths of neighbouring cells outside the contact."""
CONTACT = 0.9
"""Radius within which the surface cells have equal length, divided by the ball's radius."""
PENALTY = 100.0
"""Contact stiffness per area, in units of shear modulus divided by surface cell length."""
CORRECTIONS = 30
"""Largest number of corrections of the contact multipliers."""
TOLERANCE = 1e-4
"""Accepted penetration of a contact point into the ball, divided by the ball's radius."""
TRUSTED = 1.5
"""Largest contact pressure that the tangent uses, divided by the present multiplier.

A larger pressure is only a first guess and would make the tangent indefinite.
"""
REST = np.array([1.0, 0.0, 0.0, 1.0, 1.0])
"""Components rr, rz, zr, zz and hoop of the identity, the undeformed state."""
NEWTON_STEPS = 40
"""Largest number of Newton steps for one equilibrium."""
HALVINGS = 12
"""Number of halvings of a step, down to 1/4096, before the solver gives up."""
ARMIJO = 1e-4
"""Share of the predicted decrease of the energy that a step must achieve (Armijo 1966)."""
ROUNDING = 1e-16
"""Rounding error of the energy, relative to the product of volume and largest modulus."""
SETTLED = 1e-5
"""Allowed unbalanced force in an equilibrium, divided by the largest nodal force."""
SHORTEST = 1.0 / 64.0
"""Smallest fraction of a step of the ball that is tried before the press counts as failed."""


@dataclass(frozen=True)
class LinearLaw:
    """Linear elasticity at small strains with Lame constants [Pa]."""

    first_Pa: float
    shear_Pa: float


@dataclass(frozen=True, eq=False)
class LayerMesh:
    """Mesh of quadrilaterals in a meridian section.

    Attributes
    ----------
    nodes_m
        Radius and height of the nodes [m], shape (n, 2). The top face lies at height zero.
    cells
        Nodes of each cell, shape (m, 9): three rows of three nodes, from the lowest row to the
        highest.
    top
        Nodes of the top face, ordered by increasing radius, shape (t,).
    held
        True for displacement components that are held at zero, shape (n, 2).
    radius_m
        Radius of the ball for which the mesh was made [m].
    """

    nodes_m: Array
    cells: Ints
    top: Ints
    held: Flags
    radius_m: float


def layer_mesh(radius_m: float, thickness_m: float, *, first: float = FIRST) -> LayerMesh:
    """Mesh a layer into which a ball is pressed at the axis.

    Parameters
    ----------
    radius_m, thickness_m
        Radius of the ball and thickness of the layer [m].
    first
        Edge length of the cells under the ball, divided by the ball's radius.

    Raises
    ------
    InputError
        If a length is not positive.
    """
    for name, length in (("radius_m", radius_m), ("thickness_m", thickness_m)):
        if not length > 0.0:
            raise InputError(name, "be positive", f"{length:g} m", "give it in metres")
    edge = first * radius_m
    count = int(np.ceil(CONTACT / first))
    r = _graded(count, edge, WIDTH * (thickness_m + radius_m))
    z = -_graded(1, edge, thickness_m)[::-1]
    mesh = layer_grid(r, z, radius_m)
    mesh.held[mesh.nodes_m[:, 0] == r[-1], 0] = True
    return mesh


def layer_grid(r: Array, z: Array, radius_m: float) -> LayerMesh:
    """Return the mesh with cell boundaries at the radii `r` and the heights `z` [m].

    `r` and `z` are in rising order. The nodes at the base are held, and the nodes on the axis are
    held radially. `radius_m` is the radius [m] of the ball that presses the layers.
    """
    columns = 2 * len(r) - 1
    rows = 2 * len(z) - 1
    fine_r = np.interp(np.arange(columns), 2.0 * np.arange(len(r)), r)
    fine_z = np.interp(np.arange(rows), 2.0 * np.arange(len(z)), z)
    nodes = np.stack(np.meshgrid(fine_r, fine_z), axis=-1).reshape(-1, 2)
    number = np.arange(rows * columns).reshape(rows, columns)
    corner = number[:-1:2, :-1:2].ravel()
    cells = corner[:, None] + (columns * np.arange(3)[:, None] + np.arange(3)).ravel()
    held = np.zeros(nodes.shape, dtype=bool)
    held[number[0]] = True
    held[number[:, 0], 0] = True
    return LayerMesh(nodes, cells, number[-1], held, radius_m)


def _graded(count: int, edge: float, end: float) -> Array:
    """Return rising positions from zero to `end`: first `count` equal steps, then growing steps."""
    steps = [edge] * count
    while sum(steps) < end:
        steps.append(GROWTH * steps[-1])
    places = np.concatenate([[0.0], np.cumsum(steps)])
    # Scale the growing steps so that the last position is the end.
    equal = places[: count + 1]
    if end <= equal[-1]:
        return np.linspace(0.0, end, max(2, round(end / edge)) + 1)
    growing = places[count:]
    scaled = equal[-1] + (growing - equal[-1]) * (end - equal[-1]) / (growing[-1] - equal[-1])
    return np.concatenate([equal[:-1], scaled])


def press_forces(mesh: LayerMesh, law: Hyperelastic | LinearLaw, depths_m: Array) -> Array:
    """Compute the force of a ball on a layer at increasing depths [N], shaped like `depths_m`.

    At the first depth without an equilibrium, and at all larger depths, the forces are NaN.

    Parameters
    ----------
    mesh
        The layer; see `layer_mesh`.
    law
        Elastic law of the layer.
    depths_m
        Depth of the lowest point of the ball below the undeformed surface [m], rising.
    """
    layer = _Layer(mesh, law)
    forces = np.full(len(depths_m), np.nan)
    depth = 0.0
    for number, goal in enumerate(np.asarray(depths_m, dtype=np.float64)):
        share = 1.0
        before = depth
        while depth < goal and share >= SHORTEST:
            step = min(goal - depth, share * (goal - before))
            if layer.advance(depth + step):
                depth += step
            else:
                share *= 0.5
        if depth < goal:
            break
        forces[number] = layer.force_N
    return forces


class _Layer:
    """State of a layer under a ball."""

    def __init__(self, mesh: LayerMesh, law: Hyperelastic | LinearLaw) -> None:
        self._law = law
        self._mesh = mesh
        self._free = np.flatnonzero(~mesh.held.ravel())
        corners = mesh.nodes_m[mesh.cells]
        points, weights = np.polynomial.legendre.leggauss(3)
        at = np.stack(np.meshgrid(points, points), axis=-1).reshape(-1, 2)
        weight = np.outer(weights, weights).ravel()
        value_r, slope_r = _lagrange(at[:, 0])
        value_z, slope_z = _lagrange(at[:, 1])
        shape = np.einsum("qj,qi->qji", value_z, value_r).reshape(-1, 9)
        by_r = np.einsum("qj,qi->qji", value_z, slope_r).reshape(-1, 9)
        by_z = np.einsum("qj,qi->qji", slope_z, value_r).reshape(-1, 9)
        radius = corners[..., 0] @ shape.T
        # Derivatives of the two coordinates with respect to the two positions in the cell.
        jacobian = np.einsum("aqk,mkc->mqac", np.stack([by_r, by_z]), corners)
        gradient = np.einsum(
            "mqca,aqk->mqkc", np.linalg.inv(jacobian), np.stack([by_r, by_z]), optimize=True
        )
        gradient_r = gradient[..., 0]
        gradient_z = gradient[..., 1]
        self._volume = 2.0 * np.pi * radius * np.linalg.det(jacobian) * weight
        # Derivatives of the gradient rr, rz, zr, zz and hoop with respect to the 18 components of a
        # cell.
        slots = np.zeros((*radius.shape, 5, 9, 2))
        slots[..., 0, :, 0] = gradient_r
        slots[..., 1, :, 0] = gradient_z
        slots[..., 2, :, 1] = gradient_r
        slots[..., 3, :, 1] = gradient_z
        slots[..., 4, :, 0] = shape / radius[..., None]
        self._slots = slots.reshape(*radius.shape, 5, 18)
        self._places = (2 * mesh.cells[:, :, None] + np.arange(2)).reshape(-1, 18)
        # Contact points on the three-node edges of the top face.
        edges = mesh.top[2 * np.arange(len(mesh.top) // 2)[:, None] + np.arange(3)]
        near = mesh.nodes_m[edges[:, 0], 0] < 2.0 * mesh.radius_m
        edges = edges[near]
        points, weights = np.polynomial.legendre.leggauss(2)
        value, _ = _lagrange(points)
        ends = mesh.nodes_m[edges, 0]
        radius = ends @ value.T
        self._share = value
        self._edges = edges
        self._area = 2.0 * np.pi * radius * (0.5 * (ends[:, 2] - ends[:, 0]))[:, None] * weights
        self._edge_places = (2 * edges[:, :, None] + np.arange(2)).reshape(-1, 6)
        self._stiff = PENALTY * law.shear_Pa / float(ends[0, 2] - ends[0, 0])
        stiffest = law.first_Pa if isinstance(law, LinearLaw) else law.bulk_Pa
        self._rounding_J = ROUNDING * stiffest * self._volume.sum()
        self._pressure = np.zeros_like(self._area)
        self._u = np.zeros(mesh.nodes_m.shape)
        self._centre = mesh.radius_m
        self.force_N = 0.0

    def advance(self, depth_m: float) -> bool:
        """Move the ball to a depth [m]; return True if there is an equilibrium.

        Without an equilibrium, the state does not change.
        """
        before = self._u.copy(), self._pressure.copy(), self._centre
        self._centre = self._mesh.radius_m - depth_m
        for _ in range(CORRECTIONS):
            if not self._balance():
                break
            pressed, gap, _ = self._contact(self._u)
            violation = np.maximum(-gap, -self._pressure / self._stiff)
            change = np.abs(pressed - self._pressure) / self._stiff
            self._pressure = pressed
            if max(violation.max(), change.max()) < TOLERANCE * self._mesh.radius_m:
                _, _, normal = self._contact(self._u)
                self.force_N = -float(np.sum(self._area * pressed * normal[..., 1]))
                return True
        self._u, self._pressure, self._centre = before
        return False

    def _contact(self, u: Array) -> tuple[Array, Array, Array]:
        """Return contact pressure, gap, and outward normal of the ball, at the contact points."""
        place = np.einsum("qa,eac->eqc", self._share, (self._mesh.nodes_m + u)[self._edges])
        away = place - [0.0, self._centre]
        distance = np.linalg.norm(away, axis=-1)
        gap = distance - self._mesh.radius_m
        pressed = np.maximum(0.0, self._pressure - self._stiff * gap)
        return pressed, gap, away / distance[..., None]

    def _energy(self, u: Array) -> float:
        energy, _, _ = self._state(u, order=0)
        pressed, _, _ = self._contact(u)
        extra = 0.5 * np.sum(self._area * (pressed**2 - self._pressure**2)) / self._stiff
        return float(np.sum(self._volume * energy) + extra)

    def _state(self, u: Array, *, order: int) -> tuple[Array, Array, Array]:
        """Return energy density, stress and tangent of the law at the Gauss points."""
        flat = u.ravel()[self._places]
        moved = np.einsum("mqsk,mk->mqs", self._slots, flat)
        if isinstance(self._law, LinearLaw):
            return _linear(self._law, moved)
        return _stretched(self._law, moved + REST, order)

    def _balance(self) -> bool:
        """Minimise the energy for constant multipliers of the contact."""
        energy = self._energy(self._u)
        size = self._u.size
        for _ in range(NEWTON_STEPS):
            _, stress, tangent = self._state(self._u, order=2)
            inner = np.einsum("mq,mqsk,mqs->mk", self._volume, self._slots, stress, optimize=True)
            force = np.bincount(self._places.ravel(), inner.ravel(), size)
            pressed, gap, normal = self._contact(self._u)
            push = -np.einsum("eq,qa,eqc->eac", self._area * pressed, self._share, normal)
            left = force + np.bincount(self._edge_places.ravel(), push.ravel(), size)
            scale = np.abs(force).max()
            worst = np.abs(left[self._free]).max()
            if worst <= SETTLED * scale or worst == 0.0:
                return True
            weighted = self._volume[..., None, None] * tangent
            cells = np.einsum(
                "mqsk,mqst,mqtn->mkn", self._slots, weighted, self._slots, optimize=True
            )
            along = normal[..., :, None] * normal[..., None, :]
            distance = self._mesh.radius_m + gap
            stiff = np.where(pressed > 0.0, self._stiff, 0.0)[..., None, None] * along
            # A pressure far above the multiplier is only a first guess. It would make the matrix
            # indefinite, so it is limited.
            turning = np.minimum(pressed, TRUSTED * self._pressure) / distance
            stiff = stiff - turning[..., None, None] * (np.eye(2) - along)
            blocks = np.einsum(
                "eq,qa,qb,eqcd->eacbd", self._area, self._share, self._share, stiff, optimize=True
            ).reshape(-1, 6, 6)
            whole = _assembled(self._places, cells, size) + _assembled(
                self._edge_places, blocks, size
            )
            step = np.zeros(size)
            step[self._free] = splu(csc_array(whole[self._free][:, self._free])).solve(
                -left[self._free]
            )
            downhill = float(left @ step)
            if downhill > 0.0:
                # In a direction of negative curvature the opposite step lowers the energy.
                step = -step
                downhill = -downhill
            share = 1.0
            for _ in range(HALVINGS):
                trial = self._u + share * step.reshape(-1, 2)
                there = self._energy(trial)
                if there <= energy + ARMIJO * share * downhill + self._rounding_J:
                    break
                share *= 0.5
            else:
                return False
            self._u = trial
            energy = there
        return False


def _lagrange(at: Array) -> tuple[Array, Array]:
    """Return quadratic shape functions of nodes -1, 0, 1 and their derivatives, shape (q, 3)."""
    value = np.stack([0.5 * at * (at - 1.0), 1.0 - at**2, 0.5 * at * (at + 1.0)], axis=-1)
    slope = np.stack([at - 0.5, -2.0 * at, at + 0.5], axis=-1)
    return value, slope


def _assembled(places: Ints, blocks: Array, size: int) -> csc_array:
    """Sum square blocks into a sparse matrix."""
    width = places.shape[1]
    row = np.repeat(places, width, axis=1).ravel()
    column = np.tile(places, (1, width)).ravel()
    return csc_array(coo_array((blocks.ravel(), (row, column)), shape=(size, size)))


def _linear(law: LinearLaw, moved: Array) -> tuple[Array, Array, Array]:
    """Return energy, stress and tangent at small strains, in components rr, rz, zr, zz, hoop."""
    tangent = law.first_Pa * np.outer(REST, REST) + 2.0 * law.shear_Pa * np.diag(REST)
    tangent[1:3, 1:3] += law.shear_Pa
    stress = moved @ tangent
    return (
        0.5 * np.sum(stress * moved, axis=-1),
        stress,
        np.broadcast_to(tangent, (*moved.shape, 5)),
    )


def _stretched(law: Hyperelastic, gradient: Array, order: int) -> tuple[Array, Array, Array]:
    """Return energy, stress and tangent of a law, in components rr, rz, zr, zz, hoop.

    The energy is infinite if a cell is inverted.
    """
    plane = gradient[..., :4].reshape(*gradient.shape[:-1], 2, 2)
    hoop = gradient[..., 4]
    valid = (np.linalg.det(plane) > 0.0) & (hoop > 0.0)
    if order == 0 and not valid.all():
        return np.where(valid, 0.0, np.inf), gradient, gradient
    u, pair, v = np.linalg.svd(plane)
    stretch = np.concatenate([pair, hoop[..., None]], axis=-1)
    energy, slope, curvature = law.derivatives(stretch)
    if order == 0:
        return energy, gradient, gradient
    first = slope / stretch
    second = curvature / (stretch[..., :, None] * stretch[..., None, :])
    second = second - np.eye(3) * (first / stretch)[..., None, :]
    # Directions of the principal stretches in the five components.
    frame = np.zeros((*gradient.shape[:-1], 5, 5))
    frame[..., :4, :4] = np.einsum("...ia,...bj->...ijab", u, v).reshape(*hoop.shape, 4, 4)
    frame[..., 4, 4] = 1.0
    a = stretch[..., 0]
    b = stretch[..., 1]
    equal = np.abs(a - b) < 1e-5 * (a + b)
    limit = 0.5 * (second[..., 0, 0] + second[..., 1, 1]) - second[..., 0, 1]
    rise = (first[..., 0] - first[..., 1]) / np.where(equal, 1.0, a - b)
    stretching = np.where(equal, limit, rise)
    turning = (first[..., 0] + first[..., 1]) / (a + b)
    local = np.zeros((*hoop.shape, 5, 5))
    diagonal = [0, 3, 4]
    local[..., np.ix_(diagonal, diagonal)[0], np.ix_(diagonal, diagonal)[1]] = second
    local[..., 1, 1] = local[..., 2, 2] = 0.5 * (stretching + turning)
    local[..., 1, 2] = local[..., 2, 1] = 0.5 * (stretching - turning)
    principal = np.zeros(gradient.shape)
    principal[..., diagonal] = first
    stress = np.einsum("...sp,...p->...s", frame, principal)
    return energy, stress, frame @ local @ np.swapaxes(frame, -1, -2)
