"""Force over the nodule of `palpation` by an independent finite element code.

Run: `python tests/bench/nodule_reference.py 5`.

Hexahedra of 27 nodes whose faces follow the ball exactly, one half of the slab, a rigid ball
without friction that is held off at Gauss points by multipliers. Shares with the library only the
sparse factor. The number is the count of elements over half the width of the box around the nodule;
5 takes a minute, 6 two. Prints force with the nodule, force where the nodule has the modulus of the
tissue around it, and the excess, by depth.
"""

import argparse
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, coo_array

from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody

Array = NDArray[np.float64]
CENTRE, RADIUS, BOX = np.array([-20.0, 0.0, -17.0]), 9.0, 17.0
"""Nodule and half the side of the box around it [mm]."""
BALL, POISSON, NODULE_KPA, TISSUE_KPA = 8.0, 0.49, 100.0, 20.0
DEPTHS = (2.0, 3.0, 3.5, 4.0)
CORE, ROUNDED = 0.5, 0.06
"""Half-side of the cube in the middle of the nodule, and the inset of its corners.

The half-side is relative to the nodule's radius.
"""
REACH, PENALTY, GAP = 11.0, 600.0, 2e-3
"""Radius of touchable nodes [mm], contact stiffness [kPa/mm] and allowed penetration [mm]."""


def with_middles(edges: Array) -> Array:
    """Nodes of quadratic elements between edges."""
    nodes = np.empty(2 * len(edges) - 1)
    nodes[::2] = edges
    nodes[1::2] = 0.5 * (edges[1:] + edges[:-1])
    return nodes


def grown(start: float, end: float, first: float) -> Array:
    """Edges from one place to another, each element about 2.2 times as long as the last."""
    sizes = [first]
    while sum(sizes) < abs(end - start):
        sizes.append(2.2 * sizes[-1])
    steps = np.cumsum([0.0, *sizes]) / sum(sizes)
    return start + steps * (end - start)


def shapes(at: Array) -> tuple[Array, Array]:
    """Quadratic shape functions on a line and their slopes, shape (points, 3)."""
    values = np.stack([0.5 * at * (at - 1.0), 1.0 - at * at, 0.5 * at * (at + 1.0)], axis=-1)
    return values, np.stack([at - 0.5, -2.0 * at, at + 0.5], axis=-1)


def elements_of(points: Array) -> list[Array]:
    """Return the elements of a lattice of nodes, shape (a, b, c, 3).

    Each is turned so that its volume is positive.
    """
    found = []
    for i, j, k in product(*(range(0, size - 1, 2) for size in points.shape[:3])):
        part = points[i : i + 3, j : j + 3, k : k + 3]
        sides = (
            part[2, 1, 1] - part[0, 1, 1],
            part[1, 2, 1] - part[1, 0, 1],
            part[1, 1, 2] - part[1, 1, 0],
        )
        if np.linalg.det(sides) < 0.0:
            part = part[::-1]
        found.append(part.reshape(27, 3))
    return found


def mesh_of(count: int) -> tuple[Array, NDArray[np.int64], NDArray[np.bool_]]:
    """Nodes [mm], elements, and whether each element lies in the nodule."""
    even = np.linspace(-1.0, 1.0, 2 * count + 1)
    edges = np.sign(even) * np.abs(even) ** 1.25
    line = with_middles(edges)
    half = line[line >= -1e-12]
    lines = (line, half, line)

    def core(cube: Array) -> Array:
        size = np.linalg.norm(cube, axis=-1, keepdims=True)
        return CORE * RADIUS * cube * (1.0 - ROUNDED * (size**2 - 1.0))

    inside = elements_of(CENTRE + core(np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)))
    outside = []
    for axis, sign in ((0, -1.0), (0, 1.0), (1, 1.0), (2, -1.0), (2, 1.0)):
        across = [other for other in range(3) if other != axis]
        face = np.full((len(lines[across[0]]), len(lines[across[1]]), 3), sign)
        face[..., across[0]], face[..., across[1]] = np.meshgrid(
            *(lines[a] for a in across), indexing="ij"
        )
        sphere = RADIUS * face / np.linalg.norm(face, axis=-1, keepdims=True)
        for found, low, high, layers in (
            (inside, core(face), sphere, 1),
            (outside, sphere, BOX * face, 3),
        ):
            share = with_middles(np.linspace(0.0, 1.0, layers + 1))[:, None]
            found += elements_of(
                CENTRE + low[:, :, None] * (1.0 - share) + high[:, :, None] * share
            )
    first, (x, y, z) = BOX * (edges[-1] - edges[-2]), CENTRE
    sides = (
        np.concatenate(
            [grown(x - BOX, -60.0, first)[:0:-1], x + BOX * edges, grown(x + BOX, 60.0, first)[1:]]
        ),
        np.concatenate([y + BOX * edges[edges >= -1e-12], grown(y + BOX, 40.0, first)[1:]]),
        np.concatenate([np.linspace(-40.0, z - BOX, 3)[:-1], z + BOX * edges]),
    )
    for place in product(*(range(len(each) - 1) for each in sides)):
        ends = [each[at : at + 2] for each, at in zip(sides, place, strict=True)]
        if not (np.abs(np.mean(ends, axis=1) - CENTRE) < BOX).all():
            outside += elements_of(
                np.stack(np.meshgrid(*map(with_middles, ends), indexing="ij"), axis=-1)
            )
    corners = np.round(np.array(inside + outside).reshape(-1, 3), 5) + 0.0
    nodes, number = np.unique(corners, axis=0, return_inverse=True)
    cells = number.reshape(-1, 27)
    return nodes, cells, np.arange(len(cells)) < len(inside)


def stiffness_of(
    nodes: Array, cells: NDArray[np.int64], inside: NDArray[np.bool_], nodule_kPa: float
) -> bsr_array:
    """Stiffness [mN/mm], the slab graded from 5 to 50 kPa along x."""
    at, weights = np.polynomial.legendre.leggauss(3)
    value, slope = shapes(at)
    corners, blocks = nodes[cells], np.zeros((len(cells), 27, 3, 27, 3))
    for a, b, c in product(range(3), repeat=3):
        of = lambda i, j, k: np.einsum("i,j,k->ijk", i, j, k).ravel()  # noqa: E731
        local = np.stack(
            [
                of(slope[a], value[b], value[c]),
                of(value[a], slope[b], value[c]),
                of(value[a], value[b], slope[c]),
            ],
            axis=-1,
        )
        jacobian = np.einsum("eai,aj->eij", corners, local)
        volume = weights[a] * weights[b] * weights[c] * np.linalg.det(jacobian)
        assert volume.min() > 0.0
        gradient = np.einsum("aj,eji->eai", local, np.linalg.inv(jacobian))
        x = corners[:, :, 0] @ of(value[a], value[b], value[c])
        young = np.where(inside, nodule_kPa, 5.0 + 45.0 * (x + 60.0) / 120.0)
        shear = 0.5 * young / (1.0 + POISSON) * volume
        first = 2.0 * shear * POISSON / (1.0 - 2.0 * POISSON)
        blocks += np.einsum("e,eai,ebj->eaibj", first, gradient, gradient)
        blocks += np.einsum("e,eaj,ebi->eaibj", shear, gradient, gradient)
        both = np.einsum("e,eak,ebk->eab", shear, gradient, gradient)
        for i in range(3):
            blocks[:, :, i, :, i] += both
    unknowns = (3 * cells[:, :, None] + np.arange(3)).reshape(len(cells), 81)
    ends = np.repeat(unknowns, 81, axis=1).ravel(), np.tile(unknowns, (1, 81)).ravel()
    whole = coo_array((blocks.ravel(), ends), shape=(3 * len(nodes),) * 2).tocsr()
    return bsr_array((0.5 * (whole + whole.T)).tobsr((3, 3)))


def gauss_points(
    nodes: Array, cells: NDArray[np.int64], near: NDArray[np.int64]
) -> tuple[Array, Array, Array]:
    """Return Gauss points of the upper face [mm], areas [mm2] and weights of the near nodes.

    The weights have shape (q, k).
    """
    at, weights = np.polynomial.legendre.leggauss(5)
    value, slope = shapes(at)
    points, areas, shares = [], [], []
    place = np.full(len(nodes), -1)
    place[near] = np.arange(len(near))
    for cube in cells.reshape(-1, 3, 3, 3):
        for face in (cube[0], cube[2], cube[:, 0], cube[:, 2], cube[:, :, 0], cube[:, :, 2]):
            corner = face.ravel()
            if (place[corner] < 0).any():
                continue
            for a, b in product(range(5), repeat=2):
                share = np.outer(value[a], value[b]).ravel()
                sides = (
                    np.outer(slope[a], value[b]).ravel() @ nodes[corner],
                    np.outer(value[a], slope[b]).ravel() @ nodes[corner],
                )
                row = np.zeros(len(near))
                row[place[corner]] = share
                points.append(share @ nodes[corner])
                areas.append(weights[a] * weights[b] * np.linalg.norm(np.cross(*sides)))
                shares.append(row)
    return np.array(points), np.array(areas), np.array(shares)


def forces_N(nodes: Array, cells: NDArray[np.int64], stiffness: bsr_array) -> Array:
    """Force on the ball at each depth [N]."""
    held = np.zeros(nodes.shape, dtype=bool)
    held[nodes[:, 2] < -40.0 + 1e-6] = True
    held[nodes[:, 1] < 1e-6, 1] = True
    top = nodes[:, 2] > -1e-6
    near = np.flatnonzero(top & (np.hypot(nodes[:, 0] - CENTRE[0], nodes[:, 1]) < REACH))
    solver = DirectSolver(HeldBody(stiffness, nodes, held), last=near)
    free = ~held[near].ravel()
    surface = np.linalg.inv(solver.compliance_between(near)[np.ix_(free, free)])
    points, areas, shares = gauss_points(nodes, cells, near)
    moves = np.stack([np.kron(shares, np.eye(3)[c])[:, free] for c in range(3)])
    moved, multiplier, found = np.zeros(int(free.sum())), np.zeros(len(areas)), []
    for depth in DEPTHS:
        centre = np.array([CENTRE[0], 0.0, BALL - depth])
        for _ in range(20):
            for step_number in range(40):
                arm = points + np.einsum("cqf,f->qc", moves, moved) - centre
                length = np.linalg.norm(arm, axis=1)
                normal = arm / length[:, None]
                pressure = np.maximum(multiplier - PENALTY * (length - BALL), 0.0)
                slope = surface @ moved - np.einsum(
                    "cqf,qc->f", moves, (areas * pressure)[:, None] * normal
                )
                if step_number and np.abs(slope).max() < 1e-7 * np.abs(surface @ moved).max():
                    break
                on = pressure > 0.0
                along = np.einsum("qc,cqf->qf", normal[on], moves[:, on])
                turning = areas[on] * pressure[on] / length[on]
                tangent = surface + along.T @ ((areas[on] * PENALTY + turning)[:, None] * along)
                tangent -= sum(move.T @ (turning[:, None] * move) for move in moves[:, on])
                step = np.linalg.solve(tangent, -slope)
                moved = moved + step * min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-12))
            multiplier = pressure
            if np.abs(length - BALL)[pressure > 0.0].max() < GAP:
                break
        found.append(-2e-3 * float((areas * pressure) @ normal[:, 2]))
    return np.array(found)


def main() -> None:
    """Print forces and excess by depth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=5)
    nodes, cells, inside = mesh_of(parser.parse_args().count)
    stiff, plain = (
        forces_N(nodes, cells, stiffness_of(nodes, cells, inside, young))
        for young in (NODULE_KPA, TISSUE_KPA)
    )
    print(f"{3 * len(nodes)} unknowns; depth mm, force with the nodule N, without N, excess")
    for depth, one, other in zip(DEPTHS, stiff, plain, strict=True):
        print(f"{depth:4.1f} {one:.4f} {other:.4f} {one / other - 1.0:.2%}")


if __name__ == "__main__":
    main()
