"""Cut cells: with few particles in a cell its stiffness is singular; a tenth of inner stiffness closes it."""

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, log_slope, shown, sweep
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.models.tooth.body import INNER_STRENGTH, LEAST_FILL, ParticleBody
from tissue.models.tooth.grid import HexGrid, ParticleSet
from tissue.models.tooth.supports import NodeSupports

__all__ = ["PAGE"]

EDGE_M, CELLS = 1e-3, 3
SINGULAR = 1e14
"""Condition number from which on a double can no longer distinguish a matrix from a singular one."""


def cut_block(fill: float, strength: float) -> ParticleBody:
    """A block of full cells, 8 particles each, under a layer of cells that hold one particle of so much volume."""
    places = np.array([[i, j, k] for i in (0.25, 0.75) for j in (0.25, 0.75) for k in (0.25, 0.75)])
    sides = np.stack(np.meshgrid(*[np.arange(n) for n in (CELLS, CELLS, CELLS + 1)], indexing="ij"), -1).reshape(-1, 3)
    full, cut = sides[sides[:, 2] < CELLS], sides[sides[:, 2] == CELLS]
    inside = (full[:, None] + places).reshape(-1, 3)
    position = EDGE_M * np.concatenate([inside, cut + np.array([0.5, 0.5, 0.5 * fill])])
    volume = EDGE_M**3 * np.concatenate([np.full(len(inside), 0.125), np.full(len(cut), fill)])
    whole = ParticleSet.uniform(position, volume_m3=1.0, modulus_Pa=1e9)
    particles = ParticleSet(position, volume, whole.modulus_Pa, whole.poisson_ratio, whole.layer, whole.remaining)
    grid = HexGrid.around(position, edge_m=EDGE_M, origin_m=np.zeros(3))
    supports = NodeSupports.of(grid.node_count, held=grid.node_place[:, 2] == 0)
    return ParticleBody(particles, grid, supports, inner_strength=strength)


def conditions(body: ParticleBody) -> tuple[float, float]:
    """Condition number of the stiffness, as it is and scaled by its diagonal; at most 1e17."""
    matrix = body.matrix().toarray()
    kept = np.flatnonzero(np.diag(matrix) > 0.0)
    inner, scale = matrix[np.ix_(kept, kept)], 1.0 / np.sqrt(np.diag(matrix)[kept])
    found = []
    for each in (inner, scale[:, None] * inner * scale):
        values = np.linalg.eigvalsh(each)
        found.append(float(values[-1] / max(values[0], 1e-17 * values[-1])))
    return found[0], found[1]


def give_m_N(body: ParticleBody, fill: float) -> float:
    """Compliance at the place of a force on top [m/N]."""
    load = body.spread(EDGE_M * np.array([1.5, 1.5, CELLS + 0.999 * fill]), np.array([0.0, 0.0, -1.0]))
    return float((load * body.solve(load, tolerance=1e-10).displacement_m).sum())


def at_fill(fill: float) -> dict[str, float]:
    """Condition numbers and give at a fill of the cut cells, without and with inner stiffness."""
    bare, faint, ours = (cut_block(fill, strength) for strength in (0.0, 1e-3, INNER_STRENGTH))
    condition, scaled = conditions(ours)
    return {
        "bare_scaled": conditions(bare)[1],
        "condition": condition,
        "scaled": scaled,
        "carried": ours.cells.live.sum() == ours.grid.cell_count,
        "cost": abs(give_m_N(ours, fill) / give_m_N(faint, fill) - 1.0),
    }


def measure(quick: bool) -> Data:
    """Condition numbers and give over the fill."""
    return {"fill": sweep("fill", np.geomspace(1.0, 2e-4, 5 if quick else 13), at_fill)}


def judge(data: Data) -> Verdict:
    """Singular without inner stiffness while cells carry; bounded with it; what that costs."""
    table = data["fill"]
    carried = table["carried"] > 0.0
    worst, cost = float(table["scaled"].max()), float(table["cost"].max())
    slope = log_slope(table["fill"][carried], table["condition"][carried])
    dropped = table["fill"][~carried].max() if not carried.all() else np.nan
    return Verdict(
        bool((table["bare_scaled"][carried] > SINGULAR).all() and -1.2 < slope < -0.7),
        worst < 1e3 and cost < 0.1 and bool((table["fill"][carried] >= LEAST_FILL).all()),
        f"With one particle in a cell the stiffness is singular at every fill. With {INNER_STRENGTH:g} of a full "
        f"cell's inner stiffness its condition number grows as the fill to the power {slope:.2f} (theory −1), and "
        f"scaled by the diagonal it stays below {worst:.0f}; a force on top yields up to {100 * cost:.1f} % less. "
        f"Cells below {LEAST_FILL:g} are dropped (here from {dropped:.1e} on).",
    )


def ask() -> list[Answer]:
    """Loads on a body that is singular, on one that is not, and on debris."""
    random = np.random.default_rng(0)
    outcomes = {}
    for strength in (0.0, INNER_STRENGTH):
        body = cut_block(0.1, strength)
        load = random.normal(size=(body.grid.node_count, 3)) * body.carrying[:, None]
        outcomes[strength] = body.solve(load).outcome
    bare, ours = outcomes.values()
    thin = cut_block(0.5 * LEAST_FILL, INNER_STRENGTH)
    return [
        shown("a load on cells without inner stiffness", bare is not SolverOutcome.CONVERGED,
              f"{bare.name}: {bare.value}", conduct=Conduct.REFUSES),
        shown("the same with it", ours is SolverOutcome.CONVERGED, f"{ours.name}: {ours.value}"),
        shown(f"cells filled to {0.5 * LEAST_FILL:g}", int((thin.cells.live == 0).sum()) == CELLS**2,
              f"{int((thin.cells.live == 0).sum())} cells carry nothing and are left out", conduct=Conduct.FALLS_BACK),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """Condition and cost over the fill."""
    left, right = chart.subplots(1, 2)
    table = data["fill"]
    fill, carried = table["fill"], np.where(table["carried"] > 0.0, 1.0, np.nan)
    conduct = [(Conduct.HOLDS, LEAST_FILL, 1.0), (Conduct.FALLS_BACK, fill.min(), LEAST_FILL)]
    panel(left, fill, "fill of the cut cells", "condition number", [
        ("none: singular", carried * table["bare_scaled"], "s", RED),
        ("theory: one over the fill", carried * table["condition"][0] / fill, "-", GREY),
        ("0.1 inner stiffness", carried * table["condition"], "^", ORANGE),
        ("the same, scaled (ours)", table["scaled"], "o", BLUE),
    ], conduct=conduct, ylim=(10.0, 1e19), legend="center right")  # fmt: skip
    panel(right, fill, "fill of the cut cells", "give that the stabilisation costs / %", [
        ("against 0.001 of inner stiffness", 100.0 * table["cost"], "o", BLUE),
    ], conduct=conduct, log="x")  # fmt: skip


PAGE = Page(
    "cut_cells",
    "Cut cells: how little may a cell hold?",
    "A block of particle finite elements ends in cells that hold one particle of ever less volume. What becomes of the "
    "stiffness, and what does its stabilisation cost?",
    "Hourglass control of Flanagan and Belytschko (1981), scaled by what the particles miss; trilinear cells of 1 mm",
    measure,
    judge,
    ask,
    draw,
)
