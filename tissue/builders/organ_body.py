"""What a soft organ is solved with: stiffness and supports, weight, compliance and relaxation."""

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.materials.constants import constants
from tissue.scene.organ import Organ

if TYPE_CHECKING:
    from tissue.fem.solvers.direct import DirectSolver
    from tissue.fem.solvers.held_body import HeldBody
    from tissue.fem.solvers.lazy_compliance import LazyCompliance
    from tissue.fem.solvers.multigrid import MultigridSolver
    from tissue.fem.space import Space
    from tissue.materials.prony import Prony

__all__ = ["Factor", "compliance_of", "held_body", "prony_of", "weight_of"]

FACTOR_UNKNOWNS = 200_000
"""Above this, frames are solved by multigrid: a factor would take gigabytes."""


class Factor:
    """A sparse factor that is made when it is first needed; where it would be too large, multigrid."""

    def __init__(self, body: "HeldBody") -> None:
        self._body = body

    @cached_property
    def solver(self) -> "DirectSolver | MultigridSolver":
        """The solver."""
        from tissue.fem.solvers.direct import DirectSolver
        from tissue.fem.solvers.multigrid import MultigridSolver

        return (MultigridSolver if len(self._body.free) > FACTOR_UNKNOWNS else DirectSolver)(self._body)

    def solve_all(self, loads_N: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacements [m] under several loads [N], shape (loads, n, 3) both."""
        return np.stack([self.solve(load) for load in loads_N])

    def solve(self, load_N: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement [m] under a load [N], shape (n, 3)."""
        found = self.solver.solve(load_N)
        if not found.converged:
            raise RuntimeError(f"the organ could not be solved: {found.outcome.value}")
        displacement: NDArray[np.float64] = found.displacement_m
        return displacement


def held_body(
    space: "Space", elasticity: NDArray[np.float64], organ: Organ, held: NDArray[np.int64], notes: dict[str, str]
) -> "HeldBody":
    """Stiffness [N/m], capsule included, and supports; the capsule is added to the notes."""
    from scipy.sparse import bsr_array

    from meshes.tets.regions import faces_of
    from tissue.fem.assembly import assemble
    from tissue.fem.capsule import capsule_stiffness
    from tissue.fem.solvers.held_body import HeldBody, held_nodes

    stiffness = assemble(space, elasticity)
    if organ.capsule:
        table = constants("soft", f"{organ.material}_capsule")
        thickness, young = table["thickness_um"], table["modulus_kPa"]
        membrane = capsule_stiffness(
            space,
            thickness_m=1e-6 * thickness.value,
            young_Pa=1e3 * young.value,
            poisson_ratio=table["poisson_ratio"].value,
        )
        stiffness = bsr_array((stiffness + membrane).tobsr((3, 3)))
        notes["capsule"] = (
            f"{thickness.value:g} ({thickness.low:g}-{thickness.high:g}) um of {1e-3 * young.value:g} "
            f"({1e-3 * young.low:g}-{1e-3 * young.high:g}) MPa, confidence {young.confidence}"
        )
    fixed = np.zeros(space.node_count, dtype=bool)
    fixed[held] = True
    fixed[space.with_middles(faces_of(space.mesh, held))] = True
    return HeldBody(stiffness, space.nodes_m, held_nodes(fixed))


def weight_of(
    space: "Space", organ: Organ, body: "HeldBody", solver: Factor, notes: dict[str, str]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Load of the organ's own weight [N] and the displacement by it [m], shape (n, 3) both; zero without gravity."""
    if not organ.gravity:
        return np.zeros((space.node_count, 3)), np.zeros((space.node_count, 3))
    from tissue.fem.loads import gravity

    load = gravity(space, density_kg_m3=constants("soft", organ.material)["density_kg_m3"].value)
    rest = solver.solve(load)
    notes["gravity"] = f"the organ sags by up to {1e3 * np.linalg.norm(rest, axis=1).max():.3g} mm before it is touched"
    return load, rest


def compliance_of(
    body: "HeldBody", touchable: NDArray[np.int64], organ: Organ, solver: Factor, report: Progress
) -> tuple[NDArray[np.float64], "LazyCompliance | None"]:
    """Compliance of the touchable nodes [m/N], shape (3t, 3t), and what fills it while the tool moves."""
    from tissue.fem.solvers.condensed import surface_compliance_m_N
    from tissue.fem.solvers.lazy_compliance import LazyCompliance
    from tissue.fem.solvers.reduced import ReducedSolver

    if organ.path == "condensed":
        doing = "condensing the compliance to the surface that can be touched"
        return surface_compliance_m_N(
            body, touchable, solver=lambda: solver.solver, progress=lambda share: report(doing, share)
        ), None
    if organ.path == "reduced":
        size = min(organ.basis_size, 3 * len(touchable))
        return ReducedSolver(solver.solver, touchable, size=size).compliance_m_N(), None
    count = 3 * len(touchable)
    return np.full((count, count), np.nan), LazyCompliance(solver.solver, touchable)


def prony_of(organ: Organ, notes: dict[str, str]) -> "Prony | None":
    """The cited relaxation of the organ's material, where the scene asks for it.

    Raises
    ------
    InputError
        If the organ's compliance is lazy, or no relaxation is cited for its material.
    """
    if not organ.viscous:
        return None
    if organ.path == "lazy":
        raise InputError("organ.path must not be lazy for a viscous organ, got lazy: use condensed")
    from tissue.materials.prony import Prony

    table = constants("soft", organ.material)
    numbers = [k for k in range(1, 10) if f"prony_g{k}" in table]
    if not numbers:
        raise InputError(f"organ.viscous must be false for {organ.material}, got true: no relaxation is cited for it")
    shares = tuple(table[f"prony_g{k}"].value for k in numbers)
    times = tuple(table[f"prony_tau{k}_s"].value for k in numbers)
    notes["relaxation"] = (
        "; ".join(f"{g:g} in {t:g} s" for g, t in zip(shares, times, strict=True))
        + "; the modulus is that of the first instant; confidence L"
    )
    return Prony(shares, times)
