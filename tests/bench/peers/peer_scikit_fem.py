"""scikit-fem: stiffness of a cube of tetrahedra, and a clamped cube under a load on its top."""

import numpy as np
import skfem
from skfem.models.elasticity import lame_parameters, linear_elasticity
from works import (
    CLAMPED_CELLS,
    CUBE_CELLS,
    POISSON,
    YOUNG_PA,
    bricks_in_tetrahedra,
    print_result,
    timed,
)

FORM = linear_elasticity(*lame_parameters(YOUNG_PA, POISSON))


def basis_of(cells: tuple[int, ...]) -> skfem.Basis:
    nodes, tetrahedra = bricks_in_tetrahedra((1.0, 1.0, 1.0), cells)
    mesh = skfem.MeshTet(nodes.T.copy(), tetrahedra.T.copy())
    return skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP1()), intorder=0)


def main() -> None:
    basis = basis_of(CUBE_CELLS)
    size, made = f"{basis.mesh.nelements} tetrahedra", {}
    times = timed(lambda _: made.update(K=FORM.assemble(basis)), count=4, warm_up=1)
    packages = "scikit-fem numpy scipy"
    print_result(
        "scikit-fem",
        "stiffness again",
        size,
        times,
        packages,
        value=made["K"].diagonal().sum(),
        unit="N/m, trace",
    )
    times = timed(lambda _: made.update(K=FORM.assemble(basis_of(CUBE_CELLS))), count=3)
    print_result(
        "scikit-fem",
        "stiffness of a mesh",
        size,
        times,
        packages,
        value=made["K"].diagonal().sum(),
        unit="N/m, trace",
    )

    basis = basis_of(CLAMPED_CELLS)
    matrix, at = FORM.assemble(basis), basis.mesh.p
    load = np.zeros(basis.N)
    top = np.flatnonzero(at[2] > 1.0 - 1e-9)
    down = basis.nodal_dofs[2, top]
    load[down] = -1.0 / len(top)
    held = basis.nodal_dofs[:, at[2] < 1e-9].ravel()

    def solve(_: int) -> None:
        made["u"] = skfem.solve(*skfem.condense(matrix, load, D=held))

    times = timed(solve, count=2)
    print_result(
        "scikit-fem",
        "factorise and solve",
        f"{basis.N} unknowns",
        times,
        packages,
        value=1e3 * made["u"][down].mean(),
        unit="mm, mean of the top",
    )


if __name__ == "__main__":
    main()
