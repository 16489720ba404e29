"""Atlas pages on tetrahedral meshes: locking, large rotation, inverted and sliver cells."""

import numpy as np
from matplotlib.figure import Figure
from scipy.linalg import eigvalsh
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array, Flags, Ints
from meshes.tets.quality import SLIVER, repair_tets
from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh, mean_ratio
from tissue.evaluation.atlas.page import (
    ENGINE,
    FAILING,
    ORANGE,
    THEORY,
    Conduct,
    Curve,
    Data,
    Page,
    Verdict,
    error_of,
    log_slope,
    panel,
    sweep,
)
from tissue.fem.assembly import assemble, traction
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.materials.hyperelasticity import Hyperelastic

LENGTH = 10.0
YOUNG = 1000.0
"""Young's modulus of the cantilever bar [Pa].

The bar measures 10 m x 1 m x 1 m and carries a force of 1 N at its end. The relative error of the
deflection does not depend on modulus and force.
"""
MESHES = {
    "quadratic": (2, (16, 2, 2), ENGINE),
    "linear_fine": (1, (30, 4, 4), ("^", ORANGE)),
    "linear_coarse": (1, (20, 2, 2), FAILING),
}
"""Order of the tetrahedra, numbers of blocks along x, y and z, and plot style of each mesh.

A block is divided into six tetrahedra. The bar extends along x.
"""


def deflection(order: int, cells: tuple[int, int, int], ratio: float) -> tuple[float, float]:
    """Compute the tip deflection [m] of a clamped bar, and a flag for convergence.

    `order` is the order of the elements, `cells` the number of blocks along each axis, and `ratio`
    Poisson's ratio. The flag is 1 if the solver has converged and 0 otherwise.
    """
    space = Space(box((LENGTH, 1.0, 1.0), cells), order)
    # rounding of node coordinates, far below an edge
    held = np.repeat(space.nodes_m[:, :1] < 1e-9, 3, axis=1)
    faces = space.faces[(space.nodes_m[space.faces[:, :3], 0] > LENGTH - 1e-9).all(axis=1)]
    body = HeldBody(assemble(space, lame(YOUNG, ratio)), space.nodes_m, held)
    solution = DirectSolver(body).solve(traction(space, (0.0, 0.0, 1.0), faces=faces))
    # all nodes of the end face, to rounding
    tip = solution.displacement_m[space.nodes_m[:, 0] > LENGTH - 1e-9, 2].mean()
    return float(tip), float(solution.outcome is SolverOutcome.CONVERGED)


class Locking(Page):
    """Locking as Poisson's ratio approaches 0.5: linear tetrahedra lock, quadratic ones do not."""

    name = "locking"
    title = "ν → 0.5: do linear tetrahedra lock?"
    question = (
        "A cantilever of a nearly incompressible material under a force at its end. How far does "
        "it bend with linear and with quadratic tetrahedra?"
    )
    source = (
        "Timoshenko's beam with κ = 5/6; Benzley et al. (1995) report 71.7 % error of linear "
        "tetrahedra at ν = 0.49"
    )

    def measure(self) -> Data:
        """Vary Poisson's ratio nu so that log(1 - 2 nu) changes in equal steps."""
        # 1 - 2 nu from 0.4 (nu = 0.3) to 2e-4 (nu = 0.4999), evenly on a logarithmic axis
        ratios = 0.5 * (1.0 - np.geomspace(0.4, 2e-4, 8))
        shear = YOUNG / (2.0 * (1.0 + ratios))
        # P L^3 / (3 E I) + P L / (kappa G A) with kappa = 5/6, for a force of 1 N
        beam = LENGTH**3 / (3.0 * YOUNG / 12.0) + LENGTH / (5.0 / 6.0 * shear)
        bar = {"poisson_ratio": ratios, "timoshenko_m": beam}
        for name, (order, cells, _) in MESHES.items():
            found = np.array([deflection(order, cells, ratio) for ratio in ratios.tolist()])
            bar[f"{name}_m"], bar[f"{name}_trusted"] = found.T
        return {"bar": bar}

    def judge(self, data: Data) -> Verdict:
        """Compare the deflections of linear and quadratic tetrahedra with Timoshenko's beam."""
        bar = data["bar"]
        ratio = bar["poisson_ratio"]
        linear = bar["linear_coarse_m"] / bar["timoshenko_m"]
        trusted = bar["quadratic_trusted"] > 0.0
        off = error_of(bar["quadratic_m"][trusted], bar["timoshenko_m"][trusted])
        last = ratio[trusted].max()
        lost = "" if trusted.all() else "; above that the solver reports a loss of precision"
        return Verdict(
            # measured: linear cells bend 50 % of the beam's deflection at nu = 0.3 and 1 % at
            # 0.4999
            linear[-1] < 0.5 and linear[-1] < 0.7 * linear[0],
            # The clamp prevents lateral expansion, which reduces the deflection by 1 to 4 %, most
            # towards 0.5. The coarse cells reduce it by a few per cent more.
            off < 0.1 and last > 0.49,
            f"Linear tetrahedra bend {100 * linear[0]:.0f} % as far as the beam at ν = "
            f"{ratio[0]:.2f} and {100 * linear[-1]:.0f} % at {ratio[-1]:.4f}. Quadratic tetrahedra "
            f"stay within {100 * off:.1f} % up to {last:.4f}{lost}.",
        )

    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the deflection relative to Timoshenko's beam against 1 - 2 nu."""
        bar = data["bar"]
        gap = 1.0 - 2.0 * bar["poisson_ratio"]
        limit = gap[bar["quadratic_trusted"] > 0.0].min()
        curves: list[Curve] = [("theory: Timoshenko beam", 1.0, THEORY)]
        for name, (_, bricks, look) in MESHES.items():
            label = f"{name.replace('_', ' ')}, {' × '.join(map(str, bricks))} bricks of 6"
            curves.append((label, bar[f"{name}_m"] / bar["timoshenko_m"], look))
        panel(
            chart.subplots(),
            gap,
            ("1 − 2ν  (0: incompressible)", "deflection / that of the beam"),
            curves,
            conduct=[(Conduct.HOLDS, limit, gap[0]), (Conduct.REFUSES, gap[-1], limit)],
            log="x",
            xlim=gap[[0, -1]],
            # 1 is the deflection of the beam
            ylim=(0.0, 1.15),
            legend="center right",
        )


YOUNG_PA = 5e3
WIDTH_M = 0.015
LENGTH_M = 0.06
ANGLES = np.array([1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0])
LAME_PA = lame(YOUNG_PA, 0.0)
NEO_HOOKEAN = Hyperelastic.neo_hookean(
    LAME_PA[1], bulk_Pa=float(LAME_PA[0] + 2.0 / 3.0 * LAME_PA[1])
)
LAW_LOOKS = {"linear": FAILING, "neo-Hookean": ENGINE}


def bar() -> tuple[Space, Flags]:
    """Return the `Space` of a bar, and a mask of the displacement components held at its ends."""
    # the strain of a rotated bar is uniform, so that a coarse mesh is exact
    space = Space(box((LENGTH_M, WIDTH_M, WIDTH_M), (6, 2, 2)))
    # both end faces, to rounding
    ends = (space.nodes_m[:, 0] < 1e-9) | (space.nodes_m[:, 0] > LENGTH_M - 1e-9)
    return space, np.repeat(ends[:, None], 3, axis=1)


def turned(nodes_m: Array, degrees: float) -> Array:
    """Return the displacements [m] of nodes in a rotation about z; same shape as `nodes_m`."""
    turn = Rotation.from_euler("z", degrees, degrees=True)
    return turn.apply(nodes_m) - nodes_m


def pulled_Pa(space: Space, force_N: Array) -> float:
    """Compute the stress [Pa] on the bar's end face at x = 0 from the nodal forces."""
    # the nodes of this end, to rounding
    at_end = space.nodes_m[:, 0] < 1e-9
    return float(np.linalg.norm(force_N[at_end].sum(axis=0))) / WIDTH_M**2


def linear_stress_Pa() -> Array:
    """Compute the erroneous stress [Pa] that the linear law gives at an end of a rotated bar.

    The correct stress is zero. Both ends of the bar are rotated by each angle in `ANGLES`.
    """
    space, held = bar()
    stiffness = assemble(space, LAME_PA)
    solver = DirectSolver(HeldBody(stiffness, space.nodes_m, held))
    stresses = []
    for angle in ANGLES.tolist():
        moved = np.where(held, turned(space.nodes_m, angle), 0.0)
        load = -(stiffness @ moved.ravel()).reshape(-1, 3)
        moved = moved + solver.solve(load).displacement_m
        stresses.append(pulled_Pa(space, (stiffness @ moved.ravel()).reshape(-1, 3)))
    return np.array(stresses)


def hyperelastic_stress_Pa() -> Array:
    """Compute the erroneous stress [Pa] that a hyperelastic law gives at an end of a rotated bar.

    Apart from rounding, the nodal forces of the rotated bar are zero, so it is in equilibrium.
    """
    space, _ = bar()
    body = NonlinearBody(space, law=NEO_HOOKEAN)
    stresses = []
    for angle in ANGLES.tolist():
        _, force = body.energy_and_force(turned(space.nodes_m, angle))
        stresses.append(pulled_Pa(space, force))
    return np.array(stresses)


class LargeRotation(Page):
    """Erroneous stress of the linear elastic law in a bar that is only rotated."""

    name = "large_rotation"
    title = "Large rotation: linear against hyperelastic"
    question = "A bar is rotated as a whole, without strain. Which stress do the elastic laws find?"
    source = (
        "The small strain of a rotation is cos θ − 1 along both axes of its plane; bar 60 × 15 × "
        "15 mm, ν = 0"
    )

    def measure(self) -> Data:
        """Vary the angle of rotation, for the linear law and for a hyperelastic law."""
        return {
            "turn": {
                "angle_deg": ANGLES,
                "linear_pa": linear_stress_Pa(),
                "neo_hookean_pa": hyperelastic_stress_Pa(),
                "theory_pa": YOUNG_PA * (1.0 - np.cos(np.deg2rad(ANGLES))),
            }
        }

    def judge(self, data: Data) -> Verdict:
        """Compare linear stress with E (1 - cos θ), and hyperelastic stress with zero."""
        turn = data["turn"]
        off = error_of(turn["linear_pa"], turn["theory_pa"])
        worst = turn["neo_hookean_pa"].max()
        return Verdict(
            off < 1e-3,  # exact for ν = 0 by Betti's theorem, up to the tolerance of the solve
            # Measured: 1e-16 of the modulus. A rotated strain that is rounded to 16 digits leaves
            # less than 1e-12, also for another order of the sums.
            worst < 1e-12 * YOUNG_PA,
            f"Rotated by {turn['angle_deg'][-1]:.0f}° without strain, the bar has a stress of "
            f"{100 * turn['linear_pa'][-1] / YOUNG_PA:.0f} % of E by the linear law. It is E(1 − "
            f"cos θ) to {off:.0e}. By the neo-Hookean law it is at most {worst / YOUNG_PA:.0e} of "
            "E.",
        )

    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the erroneous stress against the angle of rotation."""
        turn = data["turn"]
        # zeros on a logarithmic axis: rounding is below 1e-13 of the modulus
        least = 1e-13
        curves = [
            (
                law,
                np.maximum(turn[f"{law.lower().replace('-', '_')}_pa"] / YOUNG_PA, least),
                look,
            )
            for law, look in LAW_LOOKS.items()
        ]
        panel(
            chart.subplots(),
            turn["angle_deg"],
            ("rotation θ of both ends / degrees", "false stress / E"),
            [
                ("theory of the linear law: 1 − cos θ", turn["theory_pa"] / YOUNG_PA, THEORY),
                *curves,
            ],
            ylim=(least, 10.0),
        )


SIZE_M = 0.1


def middle_node(nodes_m: Array) -> int:
    """Return the index of the node in the middle of the cube."""
    return int(np.argmin(np.linalg.norm(nodes_m - 0.5 * SIZE_M, axis=1)))


def squashed(height: float) -> tuple[Array, Ints]:
    """Return nodes [m] and cells of a tetrahedral cube mesh in which one cell is flattened.

    The middle node of the cube is moved towards the face of this cell that is opposite to the node.
    The new height of the cell is `height` times its original height.
    """
    # few enough nodes for dense eigenvalues; even, so that one node is in the middle
    good = box((SIZE_M,) * 3, (4, 4, 4))
    nodes = good.nodes_m.copy()
    inner = middle_node(nodes)
    cell = good.cells[(good.cells == inner).any(axis=1)][0]
    foot = nodes[cell[cell != inner]].mean(axis=0)
    nodes[inner] = foot + height * (nodes[inner] - foot)
    return nodes, good.cells


def condition(nodes_m: Array, cells: Ints) -> float:
    """Compute the condition number of the stiffness matrix of a mesh whose base is fixed."""
    space = Space(TetMesh(nodes_m, cells))
    # condition numbers do not depend on the modulus, here 5 kPa of soft tissue
    free = np.repeat(nodes_m[:, 2] > 1e-9, 3)
    values = eigvalsh(assemble(space, lame(5e3, 0.3)).toarray()[np.ix_(free, free)])
    return values[-1] / values[0]


def at_height(height: float) -> dict[str, float]:
    """Measure mesh quality and condition number before and after a repair of the mesh.

    One cell of the mesh is flattened to `height` times its original height.
    """
    nodes, cells = squashed(height)
    mesh, _ = repair_tets(nodes, cells)
    return {
        "quality": mean_ratio(nodes, cells).min(),
        "condition": condition(nodes, cells),
        "repaired_quality": mean_ratio(mesh.nodes_m, mesh.cells).min(),
        "repaired_condition": condition(mesh.nodes_m, mesh.cells),
    }


class BadTetrahedra(Page):
    """Inverted and sliver tetrahedra: condition number of the stiffness matrix, and mesh repair."""

    name = "bad_tetrahedra"
    title = "Inverted and sliver tetrahedra"
    question = (
        "One node of a good mesh is moved towards the opposite face. How does the condition number "
        "of the stiffness matrix grow, and how are flat or inverted cells repaired?"
    )
    source = "Mean ratio of Liu and Joe (1994); rules of the repair in meshes.tets.quality"

    def measure(self) -> Data:
        """Vary the height of the flattened cell, relative to its original height."""
        # two heights in a decade, from a good cell to a flat one
        return {"sliver": sweep("height", np.geomspace(1.0, 1e-5, 11), at_height)}

    def judge(self, data: Data) -> Verdict:
        """Check that the condition number grows as 1 / height, and that the repair limits it."""
        table = data["sliver"]
        # where the flat cell alone determines the largest eigenvalue
        flat = table["height"] < 0.03
        slope = log_slope(table["height"][flat], table["condition"][flat])
        first = table["condition"][0]
        worst = table["repaired_condition"].max()
        quality = table["repaired_quality"].min()
        return Verdict(
            # measured: slope -0.99 (theory -1), growth by 7600
            -1.15 < slope < -0.85 and table["condition"].max() > 100.0 * first,
            # Cells just above the sliver limit stay as they are: a tenth of the quality is a tenth
            # of the height.
            worst < 10.0 * first and quality > SLIVER,
            f"The condition number grows as the height of the cell to the power {slope:.2f} "
            f"(theory: −1), from {first:.0f} to {table['condition'].max():.1e}. After repair it is "
            f"at most {worst:.0f}, and the worst quality is {quality:.2f}.",
        )

    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the condition number against the height of the flattened cell."""
        table = data["sliver"]
        height = table["height"]
        bad = height[table["quality"] < SLIVER].max()
        panel(
            chart.subplots(),
            height,
            ("remaining height of a cell / original height", "condition number of the stiffness"),
            [
                ("theory: 1 / height", table["condition"][-1] * height[-1] / height, THEORY),
                ("not repaired", table["condition"], FAILING),
                ("repaired (engine)", table["repaired_condition"], ENGINE),
            ],
            conduct=[(Conduct.HOLDS, bad, height[0]), (Conduct.FALLS_BACK, height[-1], bad)],
        )
