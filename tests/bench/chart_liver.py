"""Depth at which the linear force on a sphere passes 1, 5 and 10 % of error.

`python tests/bench/chart_liver.py [--quick]` presses a sphere of 10 mm into a block (100 x 100 x 50
mm, 5 kPa, Poisson's ratio 0.45, a quarter of it by symmetry), the procedural liver and the scanned
one (if its file lies next to the checkout). The reference is the neo-Hookean law on the same mesh.
"""

import argparse
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from harness import machine, table
from newton_press import NewtonSolver, resting_sphere
from scipy.sparse import bsr_array, coo_array

from meshes.base.arrays import Array
from meshes.organs.liver import liver, liver_region
from meshes.surfaces.surface import read_surface
from meshes.tets.regions import nodes_facing
from meshes.tets.structured import grid
from meshes.tets.stuffing import bisected
from meshes.tets.tetrahedra import TetMesh
from meshes.tets.tetrahedralise import tetrahedralise
from tissue.fem.assembly import assemble
from tissue.fem.space import Space, gauss_points, gradient_slopes
from tissue.materials.elasticity import lame

TOLERANCE = 1e-6
NODES = 1e-5
"""Residual of a solve, and distance of a node in contact from the sphere, relative to its radius.

Forces hold to about 1e-5.
"""
LIVER, RADIUS_M = lame(5e3, 0.45), 0.01
DOWN = np.array([0.0, 0.0, -1.0])
DEPTHS_M = np.array([0.5, 1.0, 2.0, 3.0, 4.0, 6.0]) * 1e-3
ANATOMY = Path(__file__).resolve().parents[3] / "shared" / "anatomy" / "liver" / "liver.vtk"
GROWTH = 1.35
"""Of each layer of cells over the one before it, away from the sphere."""
SHARES = (0.01, 0.05, 0.10)


class LinearBody:
    """Body of linear elastic cells, for Newton's method."""

    def __init__(self, space: Space) -> None:
        self.space = space
        self.nodes_m = space.nodes_m
        self._stiffness = assemble(space, LIVER)

    def energy_and_force(self, displacement_m: Array) -> tuple[float, Array]:
        moved = displacement_m.ravel()
        force = self._stiffness @ moved
        return 0.5 * float(moved @ force), force.reshape(-1, 3)

    def stiffness(self, displacement_m: Array) -> bsr_array:
        return self._stiffness.copy()


class NeoHookeanBody:
    """Body with the energy density mu/2 (|F|^2 - 3) - mu ln J + lambda/2 (ln J)^2."""

    def __init__(self, space: Space) -> None:
        self.space = space
        self.nodes_m = space.nodes_m
        at = gauss_points(space.order)
        slopes = np.einsum("aci,qi->qac", gradient_slopes(4, space.order), at)
        self._slopes = np.einsum("qac,mcj->mqaj", slopes, space.gradients[0].numpy())
        self._volume = np.repeat(space.volumes_m3[:, None] / len(at), len(at), axis=1)

    def _deformed(self, displacement_m: Array) -> tuple[Array, Array]:
        moved = displacement_m[self.space.cell_nodes]
        gradient = np.eye(3) + np.einsum("mai,mqaj->mqij", moved, self._slopes)
        return gradient, np.linalg.det(gradient)

    def energy_and_force(self, displacement_m: Array) -> tuple[float, Array]:
        gradient, volume = self._deformed(displacement_m)
        force = np.zeros(self.nodes_m.shape)
        if volume.min() <= 0.0:
            return np.inf, force
        (lam, mu), log = LIVER, np.log(volume)
        square = (gradient**2).sum(axis=(2, 3))
        energy = 0.5 * mu * (square - 3.0) - mu * log + 0.5 * lam * log**2
        back = np.linalg.inv(gradient).transpose(0, 1, 3, 2)
        stress = mu * gradient + (lam * log - mu)[:, :, None, None] * back
        share = np.einsum("mq,mqij,mqaj->mai", self._volume, stress, self._slopes, optimize=True)
        np.add.at(force, self.space.cell_nodes, share)
        return float((self._volume * energy).sum()), force

    def stiffness(self, displacement_m: Array) -> bsr_array:
        gradient, volume = self._deformed(displacement_m)
        (lam, mu), slopes = LIVER, self._slopes
        turned = np.einsum("mqji,mqaj->mqai", np.linalg.inv(gradient), slopes)
        bent = self._volume * (mu - lam * np.log(volume))
        dots = np.einsum("mq,mqaj,mqbj->mab", mu * self._volume, slopes, slopes, optimize=True)
        blocks = np.einsum("mab,ik->maibk", dots, np.eye(3))
        blocks += np.einsum(
            "mq,mqai,mqbk->maibk", lam * self._volume, turned, turned, optimize=True
        )
        blocks += np.einsum("mq,mqbi,mqak->maibk", bent, turned, turned, optimize=True)
        unknowns = (3 * self.space.cell_nodes[:, :, None] + np.arange(3)).reshape(len(blocks), -1)
        width = unknowns.shape[1]
        row = np.repeat(unknowns, width, axis=1).ravel()
        column = np.tile(unknowns, (1, width)).ravel()
        size = self.space.unknown_count
        whole = coo_array((blocks.ravel(), (row, column)), shape=(size, size)).tocsr()
        return bsr_array(whole.tobsr((3, 3)))


def force_N(
    body: "LinearBody | NeoHookeanBody", held: Array, top_m: Array, depths_m: Array
) -> Array:
    """Return the force against a sphere pressed down at a point [N], shape (d,).

    Depths begin where it first touches a node. The force is NaN from the first depth at which a
    solve did not converge.
    """
    solver = NewtonSolver(body, held, tolerance=TOLERANCE)
    sphere, touching = resting_sphere(solver, top_m, DOWN, RADIUS_M, NODES)
    found = np.full(len(depths_m), np.nan)
    now = None
    for number, depth in enumerate(depths_m):
        sphere.centre_m = top_m + (touching + depth) * DOWN
        solution = solver.solve(sphere=sphere, start_m=now)
        if not solution.converged:
            break
        now = solution.displacement_m
        found[number] = solution.tool_force_N[2]
    return found


def passed_at_m(depths_m: Array, error: Array, share: float) -> float:
    """Return the depth [m] at which an error first passes a share, or NaN.

    It is interpolated linearly between two depths.
    """
    depths, errors = np.append(0.0, depths_m), np.append(0.0, np.abs(error))
    for (near, low), (far, high) in pairwise(zip(depths, errors, strict=True)):
        if low <= share < high:
            return float(near + (far - near) * (share - low) / (high - low))
    return float("nan")


def quarter(layers: int) -> tuple[Space, Array]:
    """Return a quarter of the block about the sphere's axis, and its held components.

    It has `layers` layers of cells in each direction.
    """
    aside = 0.05 * (GROWTH ** np.arange(layers + 1) - 1.0) / (GROWTH**layers - 1.0)
    space = Space(grid(aside, aside, -aside[::-1]), 2)
    held = (np.abs(space.nodes_m) < 1e-12) & np.array([True, True, False])
    held[space.nodes_m[:, 2] < -0.05 + 1e-9] = True
    return space, held


def refined(mesh: TetMesh, top_m: Array, size_m: float) -> Space:
    """Cells that are fine where the sphere touches."""

    def edge_m(places_m: Array) -> Array:
        away = np.linalg.norm(places_m - top_m, axis=1)
        return size_m + 0.5 * np.maximum(away - 7e-3, 0.0)

    return Space(bisected(mesh, edge_m))


def bodies(quick: bool) -> Iterator[tuple[str, Space, Array, Array]]:
    """Yield the name, cells, held components and top of each body."""
    size = 3e-3 if quick else 2e-3
    yield "block, P2", *quarter(5 if quick else 7), np.zeros(3)
    space = refined(liver(spacing_m=14e-3), np.zeros(3), size)
    yield (
        "procedural liver, P1",
        space,
        fixed(space, liver_region(space.mesh, "below")),
        np.zeros(3),
    )
    if ANATOMY.exists() and not quick:
        scanned, _ = tetrahedralise(read_surface(ANATOMY, scale_mm=1.0), edge_m=0.016)
        places = scanned.nodes_m[scanned.surface_nodes]
        top = places[places[:, 2].argmax()]
        space = refined(scanned, top, size)
        below = nodes_facing(space.mesh, direction=DOWN, within_deg=50.0)
        yield "scanned liver, P1", space, fixed(space, below), top


def fixed(space: Space, nodes: Array) -> Array:
    """All components of some nodes."""
    held = np.zeros((space.node_count, 3), dtype=bool)
    held[nodes] = True
    return held


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="coarse and few: to see that it runs")
    quick = parser.parse_args().quick
    print(machine())
    depths, rows = DEPTHS_M[2::2] if quick else DEPTHS_M, []
    for name, space, held, top in bodies(quick):
        linear, neo = (
            force_N(body, held, top, depths) for body in (LinearBody(space), NeoHookeanBody(space))
        )
        passed = [passed_at_m(depths, linear / neo - 1.0, share) for share in SHARES]
        rows.append((name, *(f"{1e3 * depth:.2f}" for depth in passed)))
    print(table(rows, ("body", *(f"linear off {share:.0%} at mm" for share in SHARES))))


if __name__ == "__main__":
    main()
