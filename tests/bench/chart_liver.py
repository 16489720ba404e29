"""Depth at which the linear force on a sphere passes 1, 5 and 10 % of error.

`python tests/bench/chart_liver.py [--quick]` presses a sphere of 10 mm into a block (100 x 100 x 50
mm, 5 kPa, Poisson's ratio 0.45, a quarter of it by symmetry), the procedural liver and the scanned
one (if its file lies next to the checkout). The reference is the neo-Hookean law on the same mesh.
"""

import argparse
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from harness import machine, table
from numpy.typing import ArrayLike, NDArray

from meshes.organs.liver import liver, liver_region
from meshes.surfaces.surface import read_surface
from meshes.tets.regions import nodes_facing
from meshes.tets.structured import grid
from meshes.tets.stuffing import bisected
from meshes.tets.tetrahedralise import tetrahedralise
from tissue.fem.hyperelastic import Law, NonlinearBody
from tissue.fem.newton import LONGEST, NODES, NewtonSolution, NewtonSolver, resting_sphere
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

Array = NDArray[np.float64]


TOLERANCE = 1e-6
"""Residual of a solve; with nodes `NODES` off, forces hold to about 1e-5."""


@dataclass(frozen=True, eq=False)
class LinearLimits:
    """Forces on a sphere by depth under each law.

    Attributes
    ----------
    depth_m
        Depths pressed to [m], shape (d,), rising.
    force_N
        Force against the press [N], shape (d,), of each law; NaN where a solve did not converge.
    """

    depth_m: Array
    force_N: dict[Law, Array]

    def error(self, law: Law) -> Array:
        """Force over the neo-Hookean one, less 1, shape (d,)."""
        return self.force_N[law] / self.force_N[Law.NEO_HOOKEAN] - 1.0

    def passed_at_m(self, share: float, law: Law = Law.LINEAR) -> float:
        """Return the depth [m] at which the error first passes a share.

        It is interpolated linearly between two depths, and NaN if the error does not pass.
        """
        depths, errors = np.append(0.0, self.depth_m), np.append(0.0, np.abs(self.error(law)))
        for (near, low), (far, high) in pairwise(zip(depths, errors, strict=True)):
            if low <= share < high:
                return float(near + (far - near) * (share - low) / (high - low))
        return float("nan")


def press(
    body: NonlinearBody,
    held: NDArray[np.bool_],
    *,
    point_m: ArrayLike,
    inward: ArrayLike,
    radius_m: float,
    depths_m: Iterable[float],
    solver: NewtonSolver | None = None,
) -> list[NewtonSolution]:
    """Yield the equilibria with a rigid sphere at each depth.

    Each starts from the one before; the first that does not converge ends the series.

    Parameters
    ----------
    body
        Body and law.
    held
        Fixed nodes, shape (n,).
    point_m, inward
        Where on the surface the sphere is aimed [m], and along which direction, shapes (3,).
    radius_m
        Radius of the sphere [m].
    depths_m
        Path length of the sphere from where it first touches a node [m], positive and rising.
    solver
        Solver to use, for its factorisation; default: a new one.
    """
    start, direction = np.asarray(point_m, dtype=np.float64), np.asarray(inward, dtype=np.float64)
    direction = direction / np.linalg.norm(direction)
    depths = np.fromiter(depths_m, dtype=np.float64)
    solver = solver or NewtonSolver(body, np.repeat(held[:, None], 3, axis=1))
    sphere, touching = resting_sphere(solver, start, direction, radius_m, NODES)
    solutions: list[NewtonSolution] = []
    now, reached = None, 0.0
    for depth in depths:
        # A sphere that jumped by its radius would find nodes behind its centre and keep them there.
        stops = np.linspace(
            reached, depth, 2 + int((depth - reached) / (LONGEST * sphere.radius_m))
        )[1:]
        for stop in stops:
            sphere.centre_m = start + (touching + stop) * direction
            solution = solver.solve(sphere=sphere, start_m=now)
            now = solution.displacement_m
            if not solution.converged:
                return [*solutions, solution]
        solutions.append(solution)
        reached = depth
    return solutions


def linear_limits(
    space: Space,
    lame_Pa: ArrayLike,
    held: NDArray[np.bool_],
    *,
    point_m: ArrayLike,
    inward: ArrayLike,
    radius_m: float,
    depths_m: ArrayLike,
    laws: Iterable[Law] = tuple(Law),
) -> LinearLimits:
    """Press a sphere under each law.

    The arguments equal the arguments of `press`, with Lame constants [Pa] as for `NonlinearBody`.
    """
    depths = np.asarray(depths_m, dtype=np.float64)
    direction = np.asarray(inward, dtype=np.float64) / np.linalg.norm(inward)
    forces = {}
    for law in laws:
        solver = NewtonSolver(
            NonlinearBody(space, lame_Pa, law=law),
            np.repeat(held[:, None], 3, axis=1),
            tolerance=TOLERANCE,
        )
        found = press(
            solver.body,
            held,
            point_m=point_m,
            inward=inward,
            radius_m=radius_m,
            depths_m=depths,
            solver=solver,
        )
        force = [-float(s.tool_force_N @ direction) if s.converged else np.nan for s in found]
        forces[law] = np.array(force + [np.nan] * (len(depths) - len(force)))
    return LinearLimits(depths, forces)


LIVER, RADIUS_M = lame(5e3, 0.45), 0.01
DEPTHS_M = np.array([0.5, 1.0, 2.0, 3.0, 4.0, 6.0]) * 1e-3
ANATOMY = Path(__file__).resolve().parents[3] / "shared" / "anatomy" / "liver" / "liver.vtk"
GROWTH = 1.35
"""Of each layer of cells over the one before it, away from the sphere."""
SHARES = (0.01, 0.05, 0.10)


def quarter(order: int, layers: int) -> tuple[Space, np.ndarray]:
    """Return a quarter of the block about the sphere's axis, and its held components.

    It has `layers` layers of cells in each direction.
    """
    aside = 0.05 * (GROWTH ** np.arange(layers + 1) - 1.0) / (GROWTH**layers - 1.0)
    space = Space(grid(aside, aside, -aside[::-1]), order)
    held = (np.abs(space.nodes_m) < 1e-12) & np.array([True, True, False])
    held[space.nodes_m[:, 2] < -0.05 + 1e-9] = True
    return space, held


def quarter_forces_N(space: Space, held: np.ndarray, law: Law, depths_m: np.ndarray) -> np.ndarray:
    """Return the force on the whole block at each depth [N], shape (d,).

    It is NaN from the first depth that is not solved.
    """
    body = NonlinearBody(space, LIVER, law=law)
    solver = NewtonSolver(body, held, tolerance=1e-6)
    found = press(
        body,
        held.all(axis=1),
        point_m=(0, 0, 0),
        inward=(0, 0, -1),
        radius_m=RADIUS_M,
        depths_m=depths_m,
        solver=solver,
    )
    force = [4.0 * s.tool_force_N[2] if s.converged else np.nan for s in found]
    return np.array(force + [np.nan] * (len(depths_m) - len(force)))


def limits(quick: bool) -> dict[str, LinearLimits]:
    """Forces by depth under linear and neo-Hookean laws, on each body."""
    found = {}
    size = 3e-3 if quick else 2e-3
    depths = DEPTHS_M[2::2] if quick else DEPTHS_M
    laws = (Law.LINEAR, Law.NEO_HOOKEAN)

    def local(mesh, at, fine):
        return bisected(
            mesh, lambda x: fine + 0.5 * np.maximum(np.linalg.norm(x - at, axis=1) - 7e-3, 0.0)
        )

    space, held = quarter(2, 5 if quick else 7)
    by_law = {law: quarter_forces_N(space, held, law, depths) for law in laws}
    found["block, P2"] = LinearLimits(depths, by_law)
    bodies = {
        "procedural liver": (
            liver(spacing_m=14e-3),
            np.zeros(3),
            lambda m: liver_region(m, "below"),
        )
    }
    if ANATOMY.exists() and not quick:
        scanned, _ = tetrahedralise(read_surface(ANATOMY, scale_mm=1.0), edge_m=0.016)
        top = scanned.nodes_m[
            scanned.surface_nodes[scanned.nodes_m[scanned.surface_nodes, 2].argmax()]
        ]
        bodies["scanned liver"] = (
            scanned,
            top,
            lambda m: nodes_facing(m, direction=(0, 0, -1), within_deg=50.0),
        )
    for name, (coarse, top, supports) in bodies.items():
        mesh = local(coarse, top, size)
        space = Space(mesh)
        fixed = np.zeros(space.node_count, dtype=bool)
        fixed[supports(mesh)] = True
        found[f"{name}, P1"] = linear_limits(
            space,
            LIVER,
            fixed,
            point_m=top,
            inward=(0, 0, -1),
            radius_m=RADIUS_M,
            depths_m=depths,
            laws=laws,
        )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="coarse and few: to see that it runs")
    quick = parser.parse_args().quick
    print(machine())
    rows = []
    for name, found in limits(quick).items():
        passed_mm = [f"{1e3 * found.passed_at_m(share):.2f}" for share in SHARES]
        rows.append((name, *passed_mm))
    print(table(rows, ("body", *(f"linear off {share:.0%} at mm" for share in SHARES))))


if __name__ == "__main__":
    main()
