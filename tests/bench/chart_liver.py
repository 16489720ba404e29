"""Cost and error of each choice for soft tissue, against a converged solution.

`python tests/bench/chart_liver.py --out DIR [--quick]` writes tables (CSV) and a picture:

- force on a sphere of 10 mm, 4 mm deep in a block (100 x 100 x 50 mm, 5 kPa, Poisson's ratio 0.45,
  a quarter of it by symmetry): order, refinement and law, solved whole or tick by tick on the
  linear compliance;
- the answer of one linear body to one load: solve path, tolerance, basis size;
- the depth at which the linear force passes 1, 5 and 10 % of error against neo-Hookean, on the
  block, the procedural liver and the scanned one (if its file lies next to the checkout).

The reference is neo-Hookean on the finest quadratic mesh. Its distance to the next coarser mesh is
the bar below which no difference is resolved. Coarse and linear cells are too stiff, the linear law
is too soft. Single points may be close by accident, a trend over refinement is not. Agreement with
the reference is not agreement with an organ, whose moduli scatter by 20 % and more.
"""

import argparse
import csv
from pathlib import Path
from time import perf_counter

import numpy as np
from harness import cost_of, machine, table
from linear_limits import LinearLimits, linear_limits, press
from liver_picture import SHARES, Point, draw, frontier

from meshes.organs.liver import liver, liver_region
from meshes.surfaces.surface import read_surface
from meshes.tets.regions import nodes_facing
from meshes.tets.structured import grid
from meshes.tets.stuffing import bisected
from meshes.tets.tetrahedralise import tetrahedralise
from tissue.fem.assembly import assemble
from tissue.fem.hyperelastic import Law, NonlinearBody
from tissue.fem.newton import NewtonSolver
from tissue.fem.solvers.compliance import surface_compliance_m_N
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody, held_nodes
from tissue.fem.solvers.multigrid import MultigridSolver
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.models.organ.contact import SurfaceContact
from tissue.models.organ.probe import SphereProbe

LIVER, RADIUS_M, DEPTH_M = lame(5e3, 0.45), 0.01, 4e-3
DEPTHS_M = np.array([0.5, 1.0, 2.0, 3.0, 4.0, 6.0]) * 1e-3
ANATOMY = Path(__file__).resolve().parents[3] / "shared" / "anatomy" / "liver" / "liver.vtk"
GROWTH = 1.35
"""Of each layer of cells over the one before it, away from the sphere."""
LAW_NAMES = {Law.LINEAR: "linear", Law.COROTATIONAL: "corotational", Law.NEO_HOOKEAN: "neo-Hookean"}


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


def whole_solve(space: Space, held: np.ndarray, law: Law) -> tuple[float, float]:
    """Force at the depth [N] and time of all of it, from the mesh [s]."""
    start = perf_counter()
    force = quarter_forces_N(space, held, law, np.array([DEPTH_M]))[-1]
    return float(force), perf_counter() - start


def ticks(space: Space, held: np.ndarray) -> tuple[float, float]:
    """Return the force at the depth [N] and the median time of a tick there [s].

    The force is found tick by tick on the compliance.
    """
    faces = space.faces
    if space.order == 2:
        faces = faces[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]].reshape(-1, 3)
    near = (space.nodes_m[:, 2] > -1e-12) & (np.linalg.norm(space.nodes_m, axis=1) < 1.5 * RADIUS_M)
    faces = faces[near[faces].all(axis=1)]
    nodes, corners = np.unique(faces, return_inverse=True)
    body = HeldBody(assemble(space, LIVER), space.nodes_m, held)
    compliance = surface_compliance_m_N(body, nodes)
    contact = SurfaceContact(
        space.nodes_m[nodes],
        corners.reshape(-1, 3),
        compliance,
        SphereProbe(RADIUS_M),
        friction=0.0,
    )
    upright = np.eye(3)
    for depth in np.linspace(-1e-4, DEPTH_M, 60):
        result = contact.solve(np.array([0.0, 0.0, -depth]), upright)
    force = 4.0 * float(result.force_N[2])
    cost = cost_of(
        lambda k: contact.solve(np.array([0.0, 0.0, 2e-6 * np.sin(0.3 * k) - DEPTH_M]), upright),
        count=400,
    )
    return force, 1e-6 * cost.median


def forces(quick: bool) -> tuple[list[Point], float]:
    """Return errors of the force on the sphere, and the remaining error of the reference.

    The errors are given by order, refinement, law and solver.
    """
    finest, next_finest = ((2, 7), (2, 6)) if quick else ((2, 9), (2, 8))
    sizes = {1: (5, 6) if quick else (5, 6, 7, 8, 10), 2: (5,) if quick else (4, 5, 6, 7)}
    reference, _ = whole_solve(*quarter(*finest), Law.NEO_HOOKEAN)
    nearly, _ = whole_solve(*quarter(*next_finest), Law.NEO_HOOKEAN)
    print(f"reference {reference:.4f} N, next coarser {nearly:.4f} N")
    points = []
    for order, layers in [(o, n) for o, counts in sizes.items() for n in counts]:
        space, held = quarter(order, layers)
        name = f"P{order} {1e3 * np.unique(space.mesh.nodes_m[:, 0])[1]:.1f} mm"
        for law in Law:
            force, cost = whole_solve(space, held, law)
            points.append((LAW_NAMES[law], name, cost, abs(force / reference - 1.0)))
        force, cost = ticks(space, held)
        points.append(("linear, 1 kHz", name, cost, abs(force / reference - 1.0)))
    return points, abs(nearly / reference - 1.0)


def paths(quick: bool) -> list[Point]:
    """Return displacement errors of touchable nodes under one load, and the time of a right side.

    The errors are relative to the answer of the factor.
    """
    mesh = bisected(liver(spacing_m=14e-3), lambda at: np.full(len(at), 16e-3 if quick else 13e-3))
    space = Space(mesh)
    held = np.isin(np.arange(space.node_count), liver_region(mesh, "below"))
    body = HeldBody(assemble(space, LIVER), space.nodes_m, held_nodes(held))
    top = mesh.surface_nodes
    touchable = top[np.argsort(np.linalg.norm(space.nodes_m[top], axis=1))[: 100 if quick else 200]]
    load = np.zeros(space.nodes_m.shape)
    away = np.linalg.norm(space.nodes_m[touchable], axis=1)
    load[touchable, 2] = -np.maximum(0.0, 1.0 - (away / (2.0 * RADIUS_M)) ** 2)
    load /= np.abs(load).sum()
    factor = DirectSolver(body)
    exact = factor.solve(load).displacement_m[touchable]

    def point(kind: str, name: str, solve) -> Point:
        found = solve()
        cost = cost_of(lambda _: solve(), count=12, warm_up=2).median
        return kind, name, 1e-6 * cost, float(np.abs(found - exact).max() / np.abs(exact).max())

    matrix = assemble(space, LIVER)
    left = np.abs(
        np.where(
            held[:, None],
            0.0,
            (matrix @ factor.solve(load).displacement_m.ravel()).reshape(-1, 3) - load,
        )
    )
    print(
        f"{len(mesh.cells)} tetrahedra; residual of the factor's answer "
        f"{left.max() / np.abs(load).max():.1e} of the load"
    )
    points = [
        (
            "factor",
            "factor",
            cost_of(lambda _: factor.solve(load), count=12, warm_up=2).median * 1e-6,
            left.max(),
        )
    ]
    for tolerance in (1e-1, 1e-2, 1e-4, 1e-6, 1e-8):
        multigrid = MultigridSolver(body, tolerance=tolerance)
        points.append(
            point(
                "multigrid",
                f"{tolerance:g}",
                lambda m=multigrid: m.solve(load).displacement_m[touchable],
            )
        )
    compliance = surface_compliance_m_N(body, touchable)
    flat = load[touchable].ravel()
    points.append(point("condensed", "condensed", lambda: (compliance @ flat).reshape(-1, 3)))
    rows = (3 * touchable[:, None] + np.arange(3)).ravel()
    values, vectors = np.linalg.eigh(compliance)
    for size in (6, 12, 24, 48, 96, 192, 384):
        if size < len(rows):
            modes = np.ascontiguousarray(vectors[:, -size:] * np.sqrt(values[-size:]))
            points.append(
                point("reduced", f"{size}", lambda m=modes: (m @ (m.T @ flat)).reshape(-1, 3))
            )
    return points


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


def write(path: Path, head: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """A table as CSV and on the screen."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([head, *rows])
    print(table(rows, head), end="\n\n")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for tables and picture")
    parser.add_argument("--quick", action="store_true", help="coarse and few: to see that it runs")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    print(machine())
    by_force, resolution = forces(asked.quick)
    by_path = paths(asked.quick)
    for name, points in (("force", by_force), ("path", by_path)):
        on = {p[:2] for p in frontier([p for p in points if np.isfinite(p[3])])}
        rows = [
            (p[0], p[1], f"{1e3 * p[2]:.4g}", f"{p[3]:.3g}", "yes" if p[:2] in on else "")
            for p in points
        ]
        write(
            asked.out / f"chart_liver_{name}.csv",
            ("kind", "setting", "cost_ms", "error", "frontier"),
            rows,
        )
    judged = limits(asked.quick)
    rows = [
        (name, *(f"{1e3 * found.passed_at_m(s):.2f}" for s in SHARES))
        for name, found in judged.items()
    ]
    write(
        asked.out / "chart_liver_limits.csv",
        ("body", *(f"linear_off_{s:.0%}_at_mm" for s in SHARES)),
        rows,
    )
    rows = [
        (
            name,
            f"{1e3 * depth:g}",
            *(f"{found.force_N[law][k]:.5g}" if law in found.force_N else "" for law in Law),
        )
        for name, found in judged.items()
        for k, depth in enumerate(found.depth_m)
    ]
    write(
        asked.out / "chart_liver_forces.csv",
        ("body", "depth_mm", *(f"{LAW_NAMES[law]}_N" for law in Law)),
        rows,
    )
    draw(
        [
            (
                f"force {1e3 * DEPTH_M:g} mm deep",
                "error to the finest neo-Hookean / %",
                by_force,
                resolution,
            ),
            ("one linear body, one load", "error to the factor's answer / %", by_path, 0.0),
        ],
        judged,
        asked.out / "chart_liver.png",
    )


if __name__ == "__main__":
    main()
