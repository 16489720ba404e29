"""Cost of assembling tetrahedra.

Run: `python tests/bench/bench_liver_assembly.py [--quick]`.

A unit cube of isotropic cells is assembled, and compared with scikit-fem's assembly of the same
mesh in the same run. Our assembly has two parts. The structure (middle nodes, gradients, positions
of the blocks and the cells that they sum) is found once per mesh. The values are summed again
whenever the material changes. The quadrature points of scikit-fem are prepared beforehand and not
counted. Compiling the kernels is not counted. Quadratic cells at 300,000 are too many for
scikit-fem's memory here.
"""

import argparse
import resource
import sys
from time import perf_counter

import numpy as np
from harness import Cost, machine, table

from meshes.tets.structured import box
from tissue.fem.assembly import assemble
from tissue.fem.space import Space
from tissue.materials.elasticity import lame, stiffness_of_lame

YOUNG_PA, RATIO = 5e3, 0.45


def timed(call):
    start = perf_counter()
    made = call()
    return made, perf_counter() - start


def structure(mesh, order):
    space = Space(mesh, order)
    space.cell_nodes  # noqa: B018
    space.gradients  # noqa: B018
    space.pattern  # noqa: B018
    return space


def theirs(mesh, order, count):
    """Seconds of each of `count` assemblies by scikit-fem, none where it is absent."""
    try:
        import skfem
        from skfem.models.elasticity import lame_parameters, linear_elasticity
    except ImportError:
        print("scikit-fem is not installed: pip install scikit-fem", file=sys.stderr)
        return []
    element = skfem.ElementVector(skfem.ElementTetP1() if order == 1 else skfem.ElementTetP2())
    basis = skfem.Basis(
        skfem.MeshTet(mesh.nodes_m.T.copy(), mesh.cells.T.copy()), element, intorder=2 * order - 2
    )
    form = linear_elasticity(*lame_parameters(YOUNG_PA, RATIO))
    return [timed(lambda: form.assemble(basis))[1] for _ in range(count)]


def row(cells, order, peer_count):
    mesh = box((1.0, 1.0, 1.0), (cells,) * 3)
    pairs = np.tile(lame(YOUNG_PA, RATIO), (len(mesh.cells), 1))
    every = [timed(lambda: structure(mesh, order)) for _ in range(5)]
    space = every[-1][0]
    found = Cost([seconds for _, seconds in every])
    same, by_cell, matrix = (
        Cost([timed(lambda: assemble(space, material))[1] for _ in range(7)])  # noqa: B023
        for material in (lame(YOUNG_PA, RATIO), pairs, stiffness_of_lame(lame(YOUNG_PA, RATIO)))
    )
    peer = Cost(theirs(mesh, order, peer_count) if peer_count else [])
    ours = found.median + same.median
    ratio = (
        (
            f"{peer.median / 1e3:.0f}",
            f"{peer.median / ours:.0f}",
            f"{peer.median / same.median:.0f}",
        )
        if peer_count and len(peer.us)
        else ("", "", "")
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return (
        f"P{order}",
        f"{len(mesh.cells)}",
        f"{space.unknown_count}",
        f"{found.median / 1e3:.0f}",
        *(f"{cost.median / 1e3:.0f}" for cost in (same, by_cell, matrix)),
        f"{same.worst / 1e3:.0f}",
        *ratio,
        f"{peak:.1f}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="30,000 cells only")
    quick = parser.parse_args().quick
    print(machine())
    soft = lame(5e3, 0.3)
    unit = Space(box((1.0,) * 3, (1, 1, 1)))
    _, compiled = timed(lambda: [assemble(unit, law) for law in (soft, stiffness_of_lame(soft))])
    print(f"kernels compiled or loaded in {compiled:.1f} s\n")
    sizes = (
        [(17, 1, 3), (17, 2, 1)]
        if quick
        else [(17, 1, 3), (37, 1, 1), (55, 1, 0), (17, 2, 1), (37, 2, 0)]
    )
    head = (
        "",
        "cells",
        "unknowns",
        "structure ms",
        "values ms",
        "by cell",
        "matrices",
        "worst",
        "scikit-fem ms",
        "x both",
        "x values",
        "peak GiB",
    )
    print(table([row(*size) for size in sizes], head))


if __name__ == "__main__":
    main()
