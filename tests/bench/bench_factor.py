"""Cost of a factor of soft organs in CPU seconds, the fastest of three runs.

Run: `python tests/bench/bench_factor.py`.

Multifrontal Cholesky is compared with SuperLU in the same order and with SuperLU by default, which
scikit-fem calls. Each is timed with one solve. Numbers of the factor count the stored ones, for
SuperLU in both its triangles.
"""

from time import process_time

import numpy as np
from harness import machine, table  # adds the fixtures to the path
from scipy.sparse.linalg import splu

from meshes.organs.liver import liver, liver_region
from meshes.tets.structured import box
from tissue.fem.assembly import assemble
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody, held_nodes
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

ROUNDS = 3
PLAIN_UNKNOWNS = 25_000
"""Largest number of unknowns for default SuperLU.

Its time grows nearly with the square of the unknowns.
"""


def quickest(made):
    """CPU seconds of the quickest of some rounds, and what it made."""
    seconds = []
    for _ in range(ROUNDS):
        start = process_time()
        result = made()
        seconds.append(process_time() - start)
    return min(seconds), result


def body_of(mesh, held):
    return HeldBody(assemble(Space(mesh), lame(5e3, 0.45)), mesh.nodes_m, held_nodes(held))


def bodies():
    for name, size, cells in (
        ("cube", (1.0, 1.0, 1.0), (12, 12, 12)),
        ("slab", (0.2, 0.2, 0.03), (40, 40, 6)),
        ("cube", (1.0, 1.0, 1.0), (22, 22, 22)),
    ):
        mesh = box(size, cells)
        yield name, body_of(mesh, mesh.nodes_m[:, 2] < 1e-9)
    mesh = liver(spacing_m=8.4e-3)
    held = np.zeros(len(mesh.nodes_m), dtype=bool)
    held[liver_region(mesh, "below")] = True
    yield "liver", body_of(mesh, held)


def main():
    print(machine())
    rows = []
    for name, body in bodies():
        right = np.random.default_rng(0).normal(size=len(body.free))
        ours, solver = quickest(lambda body=body: DirectSolver(body))
        kept, matrix, factor = solver._order, solver._matrix, solver._factor
        solve, found = quickest(lambda factor=factor, right=right: factor.solve(right))
        same, other = quickest(
            lambda matrix=matrix: splu(
                matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        )
        same_solve, exact = quickest(lambda other=other, right=right: other.solve(right))
        apart = np.abs(found - exact).max() / np.abs(exact).max()
        plain = "-"
        if len(kept) <= PLAIN_UNKNOWNS:
            sorted_matrix = body.stiffness.tocsr()[body.free][:, body.free].tocsc()
            seconds, factor_plain = quickest(lambda matrix=sorted_matrix: splu(matrix))
            seconds += quickest(lambda factor=factor_plain, right=right: factor.solve(right))[0]
            plain = f"{seconds:.2f} ({seconds / (ours + solve):.1f})"
        rows.append(
            (
                name,
                f"{len(kept)}",
                f"{ours:.2f}",
                f"{1e3 * solve:.0f}",
                f"{factor.entries / 1e6:.1f}",
                f"{same:.2f} ({same / ours:.1f})",
                f"{1e3 * same_solve:.0f}",
                plain,
                f"{apart:.0e}",
            )
        )
    head = (
        "body",
        "unknowns",
        "ours s",
        "solve ms",
        "factor 1e6",
        "SuperLU, same order s",
        "solve ms",
        "SuperLU as it comes, with a solve s",
        "apart",
    )
    print(table(rows, head))


if __name__ == "__main__":
    main()
