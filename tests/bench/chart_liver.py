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

from meshes.base.arrays import Array
from meshes.organs.liver import liver, liver_region
from meshes.surfaces.surface import read_surface
from meshes.tets.regions import nodes_facing
from meshes.tets.structured import grid
from meshes.tets.stuffing import bisected
from meshes.tets.tetrahedra import TetMesh
from meshes.tets.tetrahedralise import tetrahedralise
from tissue.fem.hyperelastic import LinearBody, NonlinearBody
from tissue.fem.newton import NODES, NewtonSolver, press_at, resting_sphere
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.materials.hyperelasticity import Hyperelastic

TOLERANCE = 1e-6
"""Residual of a solve; with nodes `NODES` off, forces hold to about 1e-5."""
LIVER, RADIUS_M = lame(5e3, 0.45), 0.01
NEO_HOOKEAN = Hyperelastic.neo_hookean(LIVER[1], bulk_Pa=LIVER[0] + 2.0 / 3.0 * LIVER[1])
DOWN = np.array([0.0, 0.0, -1.0])
DEPTHS_M = np.array([0.5, 1.0, 2.0, 3.0, 4.0, 6.0]) * 1e-3
ANATOMY = Path(__file__).resolve().parents[3] / "shared" / "anatomy" / "liver" / "liver.vtk"
GROWTH = 1.35
"""Of each layer of cells over the one before it, away from the sphere."""
SHARES = (0.01, 0.05, 0.10)


def force_N(body: LinearBody | NonlinearBody, held: Array, top_m: Array, depths_m: Array) -> Array:
    """Return the force against a sphere pressed down at a point [N], shape (d,).

    Depths begin where it first touches a node. The force is NaN where a solve did not converge.
    """
    solver = NewtonSolver(body, held, tolerance=TOLERANCE)
    _, touching = resting_sphere(solver, top_m, DOWN, RADIUS_M, NODES)
    found = []
    for depth in depths_m:
        tip = top_m + (touching + depth + RADIUS_M) * DOWN
        solution, *_ = press_at(solver, tip, DOWN, radius_m=RADIUS_M)
        found.append(solution.tool_force_N[2] if solution.converged else np.nan)
    return np.array(found)


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
            force_N(body, held, top, depths)
            for body in (LinearBody(space, LIVER), NonlinearBody(space, NEO_HOOKEAN))
        )
        passed = [passed_at_m(depths, linear / neo - 1.0, share) for share in SHARES]
        rows.append((name, *(f"{1e3 * depth:.2f}" for depth in passed)))
    print(table(rows, ("body", *(f"linear off {share:.0%} at mm" for share in SHARES))))


if __name__ == "__main__":
    main()
