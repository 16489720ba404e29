"""Cost of the solve paths of K u = f for a liver.

Run: `python tests/bench/bench_liver_solvers.py [--quick]`.

1. About 30,000 tetrahedra: check of the supports, factor, solve, and multigrid. They are compared
   with conjugate gradients with the diagonal, and with scikit-fem's assembly with default SuperLU.
2. Compliance of some 500 touchable nodes: computed, ready for contact from the cache, columns on
   demand, and basis size against error.
3. Multigrid on boxes up to a million tetrahedra: growth of set-up and of one right side,
   iterations, memory.
"""

import argparse
import os
import tempfile
from time import perf_counter

import numpy as np
import psutil
from harness import machine, memory_bytes, table  # adds the fixtures to the path
from scipy.sparse.linalg import LinearOperator, cg, splu

from meshes.organs.liver import liver, liver_region
from meshes.tets.structured import box
from tissue.fem.assembly import assemble
from tissue.fem.solvers.compliance import LazyCompliance, surface_compliance_m_N
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody, held_nodes
from tissue.fem.solvers.multigrid import MultigridSolver
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

YOUNG_PA, TOUCHABLE = 5e3, 500


class Clock:
    """Seconds since it was last asked."""

    def __init__(self):
        self._last = perf_counter()

    def __call__(self):
        now = perf_counter()
        passed, self._last = now - self._last, now
        return passed


def press(nodes, top):
    """A newton down on the topmost nodes."""
    load = np.zeros(nodes.shape)
    load[top] = [0.1 / len(top), 0.0, -1.0 / len(top)]
    return load


def held_liver(mesh, ratio):
    held = np.zeros(len(mesh.nodes_m), dtype=bool)
    held[liver_region(mesh, "below")] = True
    return HeldBody(assemble(Space(mesh), lame(YOUNG_PA, ratio)), mesh.nodes_m, held_nodes(held))


def by_jacobi(body, load):
    """Iterations and seconds of conjugate gradients with the diagonal, to 1e-8 in the residual."""
    matrix = body.stiffness.tocsr()[body.free][:, body.free]
    inverse = 1.0 / matrix.diagonal()
    counted = []
    clock = Clock()
    cg(
        matrix,
        body.right_side(load),
        rtol=1e-8,
        maxiter=5000,
        callback=lambda _: counted.append(1),
        M=LinearOperator(matrix.shape, matvec=lambda r: inverse * r.ravel(), dtype=float),
    )
    return len(counted), clock()


def by_scikit_fem(mesh, body, ratio):
    """Seconds of assembly, factorisation and a solve."""
    import skfem
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    basis = skfem.Basis(
        skfem.MeshTet(mesh.nodes_m.T.copy(), mesh.cells.T.copy()),
        skfem.ElementVector(skfem.ElementTetP1()),
    )
    clock = Clock()
    matrix = linear_elasticity(*lame_parameters(YOUNG_PA, ratio)).assemble(basis)
    assembled = clock()
    factor = splu(matrix[body.free][:, body.free].tocsc())
    factored = clock()
    factor.solve(np.ones(len(body.free)))
    return assembled, factored, clock()


def paths(mesh):
    rows = []
    for ratio in (0.3, 0.45, 0.49):
        body = held_liver(mesh, ratio)
        clock = Clock()
        HeldBody(body.stiffness, body.nodes_m, body.fixed)
        checked = clock()
        factor = DirectSolver(body)
        factored = clock()
        top = mesh.surface_nodes[np.argsort(mesh.nodes_m[mesh.surface_nodes, 2])[-12:]]
        load = press(mesh.nodes_m, top)
        exact = factor.solve(load)
        solved = clock()
        grid = MultigridSolver(body)
        set_up = clock()
        found = grid.solve(load)
        iterated = clock()
        assert exact.converged and found.converged
        count, jacobi = by_jacobi(body, load)
        rows.append(
            (
                f"{ratio}",
                f"{checked * 1e3:.0f}",
                f"{factored:.2f}",
                f"{solved * 1e3:.1f}",
                f"{set_up:.2f}",
                f"{iterated:.2f}",
                f"{found.iterations}",
                f"{jacobi:.2f}",
                f"{count}",
                f"{jacobi / iterated:.1f}",
            )
        )
    head = (
        "ratio",
        "check ms",
        "factor s",
        "solve ms",
        "set-up s",
        "solve s",
        "iterations",
        "Jacobi s",
        "iterations",
        "ratio",
    )
    print(
        f"\n{len(mesh.cells)} tetrahedra, {3 * len(mesh.nodes_m)} unknowns: factor, "
        "multigrid, CG with the diagonal"
    )
    print(table(rows, head))
    print(
        f"factor {memory_bytes(factor) / 1e6:.0f} MB, multigrid {memory_bytes(grid) / 1e6:.0f} MB"
    )
    try:
        assembled, factored_plainly, solved_plainly = by_scikit_fem(mesh, body, 0.49)
    except ImportError:
        print("scikit-fem is not installed: pip install scikit-fem")
        return
    print(
        f"scikit-fem {assembled:.2f} s, SuperLU as it comes {factored_plainly:.2f} s and "
        f"{solved_plainly * 1e3:.1f} ms a solve: {factored_plainly / factored:.1f} and "
        f"{solved_plainly / solved:.1f} x ours"
    )


def compliance(mesh):
    body = held_liver(mesh, 0.45)
    loose = mesh.surface_nodes[~body.fixed[mesh.surface_nodes, 0]]
    top = loose[np.argsort(mesh.nodes_m[loose, 2])[-TOUCHABLE:]]
    print(
        f"\n{len(top)} touchable of {len(mesh.surface_nodes)} surface nodes; W "
        f"{8 * (3 * len(top)) ** 2 / 1e6:.0f} MB"
    )
    clock = Clock()
    surface_compliance_m_N(body, top)
    print(f"found in {clock():.1f} s")
    again = held_liver(mesh, 0.45)
    surface_compliance_m_N(again, top)
    print(f"assembled, checked and ready from the cache in {clock():.2f} s")
    factor = DirectSolver(body)
    near = np.argsort(np.linalg.norm(mesh.nodes_m[top] - mesh.nodes_m[top[0]], axis=1))[:40]
    there = LazyCompliance(factor, top)
    clock()
    there.want(near)
    there.fill()
    each = clock() / len(near)
    out = np.full((3 * len(top),) * 2, np.nan)
    times = []
    for _ in near:
        clock()
        there.pour(out)
        times.append(clock())
    print(f"on demand {each * 1e3:.1f} ms a node; one poured {np.median(times) * 1e6:.0f} us")


def growth(targets):
    rows, sizes, per_solve = [], [], []
    process = psutil.Process()
    for target in targets:
        cells = round((target / 6) ** (1.0 / 3.0))
        before = process.memory_info().rss
        mesh = box((0.1, 0.1, 0.1), (cells,) * 3)
        space = Space(mesh)
        body = HeldBody(
            assemble(space, lame(YOUNG_PA, 0.45)),
            mesh.nodes_m,
            held_nodes(mesh.nodes_m[:, 2] < 1e-9),
        )
        held = process.memory_info().rss
        clock = Clock()
        grid = MultigridSolver(body)
        set_up = clock()
        inside = (mesh.nodes_m[:, 2] > 0.1 - 1e-9) & (
            np.abs(mesh.nodes_m[:, :2] - 0.05) < 0.02
        ).all(axis=1)
        load = press(mesh.nodes_m, np.flatnonzero(inside))
        clock()
        found = grid.solve(load)
        solved = clock()
        after = process.memory_info().rss
        assert found.converged
        sizes.append(len(mesh.cells))
        per_solve.append(solved)
        rows.append(
            (
                f"{len(mesh.cells)}",
                f"{body.stiffness.shape[0]}",
                f"{set_up:.2f}",
                f"{solved:.2f}",
                f"{found.iterations}",
                f"{solved / found.iterations * 1e3:.0f}",
                f"{(held - before) / 1e6:.0f}",
                f"{memory_bytes(grid) / 1e6:.0f}",
                f"{after / 1e6:.0f}",
            )
        )
        print(*rows[-1], flush=True)
    head = (
        "tetrahedra",
        "unknowns",
        "set-up s",
        "solve s",
        "iterations",
        "ms each",
        "K MB",
        "levels MB",
        "process MB",
    )
    print(f"\nmultigrid to 1e-8 at ratio 0.45\n{table(rows, head)}")
    print(
        "one right side grows with tetrahedra to the power "
        f"{np.polyfit(np.log(sizes), np.log(per_solve), 1)[0]:.2f}"
    )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small meshes only")
    quick = parser.parse_args().quick
    print(machine())
    with tempfile.TemporaryDirectory() as cache:
        os.environ["TISSUE_CACHE"] = cache
        mesh = liver(spacing_m=14e-3 if quick else 8.4e-3)
        paths(mesh)
        compliance(mesh)
    growth((3_000, 10_000, 30_000) if quick else (30_000, 100_000, 300_000, 1_000_000))


if __name__ == "__main__":
    main()
