"""Modulus contrast: plain conjugate gradients follow it, the multigrid does not."""

import numpy as np
from matplotlib.figure import Figure
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import cg

from meshes.base.arrays import Array
from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, shown
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import HexGrid, ParticleSet
from tissue.models.tooth.supports import NodeSupports

__all__ = ["PAGE"]

EDGE_M, TOLERANCE = 8e-3, 1e-6
REAL = 42e3
"""Enamel of 84 GPa over pulp of 2 MPa."""
MOST = 5000
"""Iterations after which a plain solve is given up."""


def soft_middle(cells: int, contrast: float) -> ParticleBody:
    """A block of 84 GPa about a ball, and on a layer, that are softer by a factor; held at its base."""
    lattice = (np.arange(2 * cells) + 0.5) * 0.5 * EDGE_M / cells
    position = np.stack(np.meshgrid(lattice, lattice, lattice, indexing="ij"), -1).reshape(-1, 3)
    soft = (np.linalg.norm(position - 0.5 * EDGE_M, axis=1) < 0.25 * EDGE_M) | (position[:, 2] < 0.125 * EDGE_M)
    particles = ParticleSet.uniform(position, volume_m3=(0.5 * EDGE_M / cells) ** 3, modulus_Pa=84e9)
    particles.modulus_Pa[soft] /= contrast
    grid = HexGrid.around(position, edge_m=EDGE_M / cells, origin_m=np.zeros(3))
    return ParticleBody(particles, grid, NodeSupports.of(grid.node_count, held=grid.node_place[:, 2] == 0))


def pushed(body: ParticleBody) -> Array:
    """A slanting force on the top."""
    return body.spread(np.array([0.5, 0.4, 1.0]) * EDGE_M, np.array([0.3, 0.0, -1.0]))


def plain_iterations(body: ParticleBody, *, scaled: bool) -> float:
    """Iterations of SciPy's conjugate gradients until the energy of the error is 1e-6 of the first, at most 5000."""
    matrix = csr_array(body.matrix())
    kept = np.flatnonzero(matrix.diagonal() > 0.0)
    free = kept[body.grid.node_place[kept // 3, 2] > 0]
    inner, load = csr_array(matrix[free][:, free]), pushed(body).ravel()[free]
    exact = body.solve(pushed(body), tolerance=1e-12, cold=True).displacement_m.ravel()[free]
    goal = TOLERANCE**2 * float(exact @ (inner @ exact))
    count = 0

    class _Near(Exception):  # noqa: N818 - it is no error
        """The goal is reached."""

    def keep(found: Array) -> None:
        """Stop where every fifth iterate is near enough."""
        nonlocal count
        count += 1
        left = found - exact
        if count % 5 == 0 and float(left @ (inner @ left)) <= goal:
            raise _Near

    try:
        scale = diags_array(1.0 / inner.diagonal()) if scaled else None
        cg(inner, load, rtol=0.0, maxiter=MOST, M=scale, callback=keep)
    except _Near:
        return float(count)
    return float(MOST)


def measure(quick: bool) -> Data:
    """Iterations over contrast, and ours over refinement."""
    contrasts = np.array([1.0, 1e2, REAL] if quick else [1.0, 10.0, 1e2, 1e3, 4200.0, REAL, 1e6])
    bodies = {n: [soft_middle(n, c) for c in contrasts.tolist()] for n in ([8] if quick else [8, 12])}
    ours = {
        f"multigrid_{n}": np.array(
            [float(b.solve(pushed(b), tolerance=TOLERANCE, cold=True).iterations) for b in refined]
        )
        for n, refined in bodies.items()
    }
    return {
        "contrast": {
            "contrast": contrasts,
            **ours,
            "diagonal": np.array([plain_iterations(b, scaled=True) for b in bodies[8]]),
            "plain": np.array([plain_iterations(b, scaled=False) for b in bodies[8]]),
        }
    }


def judge(data: Data) -> Verdict:
    """Growth of the plain solve's iterations, and the multigrid's largest count."""
    table = data["contrast"]
    growth = float(table["plain"][-1] / table["plain"][0])
    ours = np.concatenate([values for name, values in table.items() if name.startswith("multigrid")])
    stopped = "" if table["plain"][-1] < MOST else " and more"
    return Verdict(
        growth > 3.0,
        float(ours.max()) <= 25.0 and float(ours.max() - ours.min()) <= 12.0,
        f"From a contrast of 1 to {table['contrast'][-1]:.0e} plain conjugate gradients take {table['plain'][0]:.0f} "
        f"to {table['plain'][-1]:.0f}{stopped} iterations and those scaled by the diagonal {table['diagonal'][0]:.0f} "
        f"to {table['diagonal'][-1]:.0f}; the multigrid {ours.min():.0f} to {ours.max():.0f}, on finer cells too.",
    )


def ask() -> list[Answer]:
    """Too few iterations, a load on nothing, an unheld body."""
    body = soft_middle(8, REAL)
    short = body.solve(pushed(body), limit=2, cold=True)
    loose = ParticleBody(body.particles, body.grid, NodeSupports.of(body.grid.node_count))
    unheld = loose.solve(pushed(loose))
    none = body.solve(np.zeros((body.grid.node_count, 3)), cold=True)
    return [
        shown("an answer in two iterations", short.outcome is SolverOutcome.NOT_CONVERGED,
              f"{short.outcome.name}, error {short.error:.0e}: {short.outcome.value}", conduct=Conduct.REFUSES),
        shown("a body that nothing holds", unheld.outcome is SolverOutcome.UNSUPPORTED,
              f"{unheld.outcome.name}: {unheld.outcome.value}", conduct=Conduct.REFUSES),
        shown("no load at all", none.converged and none.iterations == 0, "no iteration, no displacement"),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """Iterations over contrast."""
    axes, table = chart.subplots(), data["contrast"]
    contrast = table["contrast"]
    axes.axvline(REAL, color=GREY, linestyle=":", label="enamel to pulp")
    ours = [name for name in table if name.startswith("multigrid")]
    panel(axes, contrast, "contrast of moduli", "iterations to 1e-6 in energy", [
        ("theory: bound by the condition number, √contrast", table["plain"][0] * np.sqrt(contrast), "-", GREY),
        ("plain", table["plain"], "s", RED),
        ("scaled by the diagonal", table["diagonal"], "^", ORANGE),
        *((f"multigrid (ours), {name[10:]}³ cells", table[name], marker, BLUE)
          for name, marker in zip(ours, "oD", strict=False)),
    ], ylim=(1.0, 3e5))  # fmt: skip


PAGE = Page(
    "contrast",
    "Modulus contrast: do iterations follow it?",
    "A block about a soft ball on a soft layer, as a tooth about its pulp in its ligament. How many iterations does a "
    "solve take as the contrast rises to 42,000 and past it?",
    "√κ bounds the iterations of plain conjugate gradients, a few soft parts take fewer; multigrid of Trottenberg et "
    "al. (2001)",
    measure,
    judge,
    ask,
    draw,
)
