"""Cost of particle finite elements.

Run: `python tests/bench/bench_tooth.py [--quick]`.

A block of enamel over dentin with a soft ball and a soft layer (84 GPa to 2 MPa), 8 particles a
cell.

1. Stiffness of all cells from their particles, compared with scikit-fem's assembly of the same
   cells in the same run.
2. A ball of 1 mm cuts 20 um deeper: update, warm solve, stress where it cuts; against the number of
   unknowns.
"""

import argparse
from time import perf_counter

import numpy as np
from harness import Cost, cost_of, machine, table
from tooth_bodies import at_bottom, block, particle_stress

from tissue.models.tooth.body import ParticleBody

SIDE_M, BALL_M, FEED_M, TOLERANCE = 8e-3, 0.5e-3, 2e-5, 1e-4


def tooth_like(x: np.ndarray) -> np.ndarray:
    modulus = np.where(x[:, 2] > 0.75 * SIDE_M, 84e9, 18.6e9)
    modulus[np.linalg.norm(x - 0.4 * SIDE_M, axis=1) < 0.2 * SIDE_M] = 2e6
    modulus[x[:, 2] < 0.1 * SIDE_M] = 50e6
    return modulus


def body_of(cells: int) -> ParticleBody:
    particles, grid = block((cells,) * 3, SIDE_M / cells, modulus_Pa=tooth_like)
    return ParticleBody(particles, grid, at_bottom(grid))


def assembly(cells: int) -> None:
    body = body_of(cells)
    every = np.arange(body.grid.cell_count, dtype=np.int32)
    ours = cost_of(lambda _: body.cells.update(every), count=25, warm_up=5)
    rows = cost_of(lambda _: body.matrix(), count=3, warm_up=1)
    print(
        f"\n{body.grid.cell_count} cells, {3 * body.grid.node_count} unknowns, "
        f"{len(body.particles.layer)} particles"
    )
    print(
        f"cell stiffness {ours.median / 1e3:8.1f} ms; as a sparse matrix "
        f"{rows.median / 1e3:8.1f} ms"
    )
    try:
        import skfem
        from skfem.models.elasticity import linear_elasticity
    except ImportError:
        print("scikit-fem is not installed: pip install scikit-fem")
        return
    mesh = skfem.MeshHex.init_tensor(*[np.linspace(0.0, SIDE_M, cells + 1)] * 3)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex1()), intorder=3)
    modulus = tooth_like(basis.global_coordinates().reshape(3, -1).T).reshape(basis.dx.shape)
    form = linear_elasticity(modulus * 0.3 / (1.3 * 0.4), modulus / 2.6)
    form.assemble(basis)
    theirs = cost_of(lambda _: form.assemble(basis), count=3, warm_up=0)
    cells_only = cost_of(lambda _: form.elemental(basis), count=3, warm_up=0)
    both = ours.median + rows.median
    print(
        f"scikit-fem {theirs.median / 1e3:8.1f} ms to the matrix ({theirs.median / both:.0f} x), "
        f"{cells_only.median / 1e3:8.1f} ms to the cells ({cells_only.median / ours.median:.0f} x)"
    )


def incremental(cells: int, steps: int) -> tuple[tuple[str, ...], float, float]:
    start = perf_counter()
    body = body_of(cells)
    built = perf_counter() - start
    position = body.particles.position_m
    costs: list[tuple[float, ...]] = []
    for step in range(steps):
        tip = np.array([0.52, 0.47, 1.0]) * SIDE_M - [0.0, 0.0, FEED_M * step]
        hit = np.flatnonzero(np.linalg.norm(position - tip, axis=1) < BALL_M)
        t = [perf_counter()]
        body.set_remaining(hit, np.zeros(len(hit), dtype=np.int64))
        body.update()
        t.append(perf_counter())
        found = body.solve(
            body.spread(tip - [0.0, 0.0, BALL_M], np.array([0.2, 0.0, -1.0])), tolerance=TOLERANCE
        )
        t.append(perf_counter())
        near = np.flatnonzero(np.linalg.norm(position - tip, axis=1) < 4.0 * BALL_M)
        particle_stress(body.cells, found.displacement_m, particles=near)
        t.append(perf_counter())
        assert found.converged
        costs.append((*np.diff(t), found.iterations))
    each = np.array(costs)[1:]
    total = Cost(each[:, :3].sum(axis=1))
    unknowns = 3 * body.grid.node_count
    medians = np.median(each[:, :3], axis=0) * 1e3
    row = (
        f"{unknowns}",
        f"{built:.2f}",
        *(f"{m:.1f}" for m in medians),
        f"{total.median / 1e3:.1f}",
        f"{total.p99 / 1e3:.1f}",
        f"{total.worst / 1e3:.1f}",
        f"{each[:, 3].mean():.1f}",
        f"{1e6 / total.median:.0f}",
    )
    return row, float(unknowns), total.median


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small grids only")
    quick = parser.parse_args().quick
    print(machine())
    middle = 12 if quick else 24
    assembly(middle)
    sizes = (8, 12) if quick else (12, 16, 20, 24, 32, 40)
    rows, unknowns, times = zip(*(incremental(n, 40) for n in sizes), strict=True)
    head = (
        "unknowns",
        "set-up s",
        "update ms",
        "solve ms",
        "stress ms",
        "total ms",
        "99 %",
        "worst",
        "iterations",
        "Hz",
    )
    print(f"\nincremental, to {TOLERANCE:g} in the energy norm\n{table(list(rows), head)}")
    print(
        "total grows with unknowns to the power "
        f"{np.polyfit(np.log(unknowns), np.log(times), 1)[0]:.2f}"
    )


if __name__ == "__main__":
    main()
