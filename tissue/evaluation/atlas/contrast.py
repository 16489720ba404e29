"""Contrast of moduli: its effect on conjugate gradients with and without a multigrid.

The iterations of plain conjugate gradients grow with the contrast. The iterations with the
multigrid do not.
"""

import numpy as np
from matplotlib.figure import Figure
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import cg

from meshes.base.arrays import Array
from tissue.evaluation.atlas.page import (
    BLUE,
    GREY,
    ORANGE,
    RED,
    Answer,
    Conduct,
    Data,
    Page,
    Verdict,
    panel,
    shown,
)
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import HexGrid, NodeSupports, ParticleSet

__all__ = ["PAGE"]

EDGE_M = 8e-3
TOLERANCE = 1e-6
REAL = 42e3
"""Contrast of enamel (84 GPa) to pulp (2 MPa)."""
MOST = 5000
"""Iterations after which a plain solve stops."""


def soft_middle(cells: int, contrast: float) -> ParticleBody:
    """Return a block of 84 GPa, held at its base, with a soft ball and a soft bottom layer.

    Both are softer than the block by the contrast.
    """
    lattice = (np.arange(2 * cells) + 0.5) * 0.5 * EDGE_M / cells
    position = np.stack(np.meshgrid(lattice, lattice, lattice, indexing="ij"), -1).reshape(-1, 3)
    soft = (np.linalg.norm(position - 0.5 * EDGE_M, axis=1) < 0.25 * EDGE_M) | (
        position[:, 2] < 0.125 * EDGE_M
    )
    particles = ParticleSet.uniform(
        position, volume_m3=(0.5 * EDGE_M / cells) ** 3, modulus_Pa=84e9
    )
    particles.modulus_Pa[soft] /= contrast
    grid = HexGrid.around(position, edge_m=EDGE_M / cells, origin_m=np.zeros(3))
    return ParticleBody(
        particles, grid, NodeSupports.of(grid.node_count, held=grid.node_place[:, 2] == 0)
    )


def pushed(body: ParticleBody) -> Array:
    """Return the load of an oblique force on the top."""
    return body.spread(np.array([0.5, 0.4, 1.0]) * EDGE_M, np.array([0.3, 0.0, -1.0]))


class _Near(Exception):  # noqa: N818 - it ends SciPy's solve and is no error
    """The goal is reached."""


def plain_iterations(body: ParticleBody, *, scaled: bool) -> float:
    """Count iterations of SciPy's conjugate gradients to 1e-6 of the initial error in energy.

    The count is in steps of five.
    """
    matrix = csr_array(body.matrix())
    kept = np.flatnonzero(matrix.diagonal() > 0.0)
    free = kept[body.grid.node_place[kept // 3, 2] > 0]
    inner = csr_array(matrix[free][:, free])
    exact = body.solve(pushed(body), tolerance=1e-12, cold=True).displacement_m.ravel()[free]
    goal = TOLERANCE**2 * float(exact @ (inner @ exact))
    count = 0

    def stop_at_goal(iterate: Array) -> None:
        """Stop at the goal, which every fifth iterate is compared with."""
        nonlocal count
        count += 1
        left = iterate - exact
        if count % 5 == 0 and float(left @ (inner @ left)) <= goal:
            raise _Near

    scale = diags_array(1.0 / inner.diagonal()) if scaled else None
    try:
        cg(
            inner,
            pushed(body).ravel()[free],
            rtol=0.0,
            maxiter=MOST,
            M=scale,
            callback=stop_at_goal,
        )
    except _Near:
        return float(count)
    return float(MOST)


def measure(quick: bool) -> Data:
    """Sweep the contrast, with the multigrid on two grids."""
    contrasts = np.array([1.0, 1e2, REAL] if quick else [1.0, 10.0, 1e2, 1e3, 4200.0, REAL, 1e6])
    bodies = {
        n: [soft_middle(n, contrast) for contrast in contrasts.tolist()]
        for n in ([8] if quick else [8, 12])
    }
    table = {"contrast": contrasts}
    for n, refined in bodies.items():
        iterations = [
            each.solve(pushed(each), tolerance=TOLERANCE, cold=True).iterations for each in refined
        ]
        table[f"multigrid_{n}"] = np.array(iterations, dtype=float)
    table["diagonal"] = np.array([plain_iterations(each, scaled=True) for each in bodies[8]])
    table["plain"] = np.array([plain_iterations(each, scaled=False) for each in bodies[8]])
    return {"contrast": table}


def judge(data: Data) -> Verdict:
    """Compare the growth of plain iterations with the range of the multigrid's."""
    table = data["contrast"]
    plain = table["plain"]
    diagonal = table["diagonal"]
    multigrid = np.concatenate(
        [values for name, values in table.items() if name.startswith("multigrid")]
    )
    stopped = "" if plain[-1] < MOST else " and more"
    return Verdict(
        float(plain[-1] / plain[0]) > 3.0,
        float(multigrid.max()) <= 25.0 and float(np.ptp(multigrid)) <= 12.0,
        f"From a contrast of 1 to {table['contrast'][-1]:.0e} plain conjugate gradients take "
        f"{plain[0]:.0f} to "
        f"{plain[-1]:.0f}{stopped} iterations, and {diagonal[0]:.0f} to {diagonal[-1]:.0f} "
        "scaled by the diagonal. The "
        f"multigrid takes {multigrid.min():.0f} to {multigrid.max():.0f}, on finer cells too.",
    )


def ask() -> list[Answer]:
    """Request a solve in too few iterations, without supports, and without load."""
    body = soft_middle(8, REAL)
    short = body.solve(pushed(body), limit=2, cold=True)
    loose = ParticleBody(body.particles, body.grid, NodeSupports.of(body.grid.node_count))
    unheld = loose.solve(pushed(loose))
    none = body.solve(np.zeros((body.grid.node_count, 3)), cold=True)
    return [
        shown(
            "a solve in two iterations",
            short.outcome is SolverOutcome.NOT_CONVERGED,
            f"{short.outcome.name}, error {short.error:.0e}: {short.outcome.value}",
            conduct=Conduct.REFUSES,
        ),
        shown(
            "a body without supports",
            unheld.outcome is SolverOutcome.UNSUPPORTED,
            f"{unheld.outcome.name}: {unheld.outcome.value}",
            conduct=Conduct.REFUSES,
        ),
        shown(
            "no load at all",
            none.converged and none.iterations == 0,
            "no iteration, no displacement",
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Draw iterations over the contrast."""
    axes = chart.subplots()
    table = data["contrast"]
    contrast = table["contrast"]
    axes.axvline(REAL, color=GREY, linestyle=":", label="enamel to pulp")
    names = [name for name in table if name.startswith("multigrid")]
    multigrid = [
        (f"multigrid (engine), {name[10:]}³ cells", table[name], marker, BLUE)
        for name, marker in zip(names, "oD", strict=False)
    ]
    panel(
        axes,
        contrast,
        ("contrast of moduli", "iterations to 1e-6 in energy"),
        [
            (
                "theory: bound by the condition number, √contrast",
                table["plain"][0] * np.sqrt(contrast),
                "-",
                GREY,
            ),
            ("plain", table["plain"], "s", RED),
            ("scaled by the diagonal", table["diagonal"], "^", ORANGE),
            *multigrid,
        ],
        ylim=(1.0, 3e5),
    )


PAGE = Page(
    "contrast",
    "Modulus contrast: do iterations follow it?",
    "A block with a soft ball on a soft layer, as a tooth with its pulp in its ligament. How "
    "many iterations does a "
    "solve take as the contrast increases to 42,000 and beyond?",
    "√κ bounds the iterations of plain conjugate gradients, a few soft parts take fewer; "
    "multigrid of Trottenberg et "
    "al. (2001)",
    measure,
    judge,
    ask,
    draw,
)
