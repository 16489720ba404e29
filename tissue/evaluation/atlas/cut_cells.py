"""Cut cells: a cell with few particles has a singular stiffness, which a tenth of inner
stiffness closes.
"""

import numpy as np
from matplotlib.figure import Figure

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
    log_slope,
    panel,
    shown,
    sweep,
)
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.models.tooth.body import INNER_STRENGTH, LEAST_FILL, ParticleBody
from tissue.models.tooth.grid import HexGrid, NodeSupports, ParticleSet

__all__ = ["PAGE"]

EDGE_M = 1e-3
CELLS = 3
SINGULAR = 1e14
"""Condition number above which a matrix of doubles is indistinguishable from a singular one."""


def cut_block(fill: float, strength: float) -> ParticleBody:
    """Return a block of full cells, 8 particles each, under a layer of cut cells.

    A cut cell has one particle of a volume ``fill``.
    """
    places = np.array([[i, j, k] for i in (0.25, 0.75) for j in (0.25, 0.75) for k in (0.25, 0.75)])
    counts = (CELLS, CELLS, CELLS + 1)
    cells = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), -1).reshape(-1, 3)
    full = cells[cells[:, 2] < CELLS]
    cut = cells[cells[:, 2] == CELLS]
    inside = (full[:, None] + places).reshape(-1, 3)
    position = EDGE_M * np.concatenate([inside, cut + np.array([0.5, 0.5, 0.5 * fill])])
    volume = EDGE_M**3 * np.concatenate([np.full(len(inside), 0.125), np.full(len(cut), fill)])
    whole = ParticleSet.uniform(position, volume_m3=1.0, modulus_Pa=1e9)
    particles = ParticleSet(
        position, volume, whole.modulus_Pa, whole.poisson_ratio, whole.layer, whole.remaining
    )
    grid = HexGrid.around(position, edge_m=EDGE_M, origin_m=np.zeros(3))
    supports = NodeSupports.of(grid.node_count, held=grid.node_place[:, 2] == 0)
    return ParticleBody(particles, grid, supports, inner_strength=strength)


def conditions(body: ParticleBody) -> tuple[float, float]:
    """Compute the condition number of the stiffness, plain and scaled by its diagonal.

    It is limited to 1e17.
    """
    matrix = body.matrix().toarray()
    kept = np.flatnonzero(np.diag(matrix) > 0.0)
    inner = matrix[np.ix_(kept, kept)]
    scale = 1.0 / np.sqrt(np.diag(inner))
    plain, scaled = (np.linalg.eigvalsh(each) for each in (inner, scale[:, None] * inner * scale))
    return (
        float(plain[-1] / max(plain[0], 1e-17 * plain[-1])),
        float(scaled[-1] / max(scaled[0], 1e-17 * scaled[-1])),
    )


def compliance_m_N(body: ParticleBody, fill: float) -> float:
    """Compute the compliance at a force on the top [m/N]."""
    load = body.spread(
        EDGE_M * np.array([1.5, 1.5, CELLS + 0.999 * fill]), np.array([0.0, 0.0, -1.0])
    )
    return float((load * body.solve(load, tolerance=1e-10).displacement_m).sum())


def at_fill(fill: float) -> dict[str, float]:
    """Measure condition numbers and compliance with and without inner stiffness."""
    stabilised = cut_block(fill, INNER_STRENGTH)
    condition, scaled = conditions(stabilised)
    # A thousandth of the inner stiffness closes the matrix and adds next to nothing to the
    # compliance.
    exact = compliance_m_N(cut_block(fill, 1e-3), fill)
    return {
        "bare_scaled": conditions(cut_block(fill, 0.0))[1],
        "condition": condition,
        "scaled": scaled,
        "carried": stabilised.cells.live.sum() == stabilised.grid.cell_count,
        "cost": abs(compliance_m_N(stabilised, fill) / exact - 1.0),
    }


def measure(quick: bool) -> Data:
    """Sweep the fill of the cut cells."""
    return {"fill": sweep("fill", np.geomspace(1.0, 2e-4, 5 if quick else 13), at_fill)}


def judge(data: Data) -> Verdict:
    """Compare the condition number with and without inner stiffness, and report the cost of it."""
    table = data["fill"]
    carried = table["carried"] > 0.0
    worst = float(table["scaled"].max())
    cost = float(table["cost"].max())
    slope = log_slope(table["fill"][carried], table["condition"][carried])
    dropped = table["fill"][~carried].max() if not carried.all() else np.nan
    return Verdict(
        bool((table["bare_scaled"][carried] > SINGULAR).all() and -1.2 < slope < -0.7),
        worst < 1e3 and cost < 0.1 and bool((table["fill"][carried] >= LEAST_FILL).all()),
        "With one particle in a cell the stiffness is singular at every fill. With "
        f"{INNER_STRENGTH:g} of the inner "
        "stiffness of a full cell its condition number grows as the fill to the power "
        f"{slope:.2f} (theory: −1). "
        f"Scaled by the diagonal it stays below {worst:.0f}. The compliance at a force on "
        "top decreases by up to "
        f"{100 * cost:.1f} %. Cells with a fill below {LEAST_FILL:g} are dropped (here from "
        f"{dropped:.1e} on).",
    )


def ask() -> list[Answer]:
    """Load a singular body, a stabilised body and debris."""
    random = np.random.default_rng(0)
    outcomes = []
    for strength in (0.0, INNER_STRENGTH):
        body = cut_block(0.1, strength)
        load = random.normal(size=(body.grid.node_count, 3)) * body.carrying[:, None]
        outcomes.append(body.solve(load).outcome)
    bare, stabilised = outcomes
    dropped = int((cut_block(0.5 * LEAST_FILL, INNER_STRENGTH).cells.live == 0).sum())
    return [
        shown(
            "a load on cells without inner stiffness",
            bare is not SolverOutcome.CONVERGED,
            f"{bare.name}: {bare.value}",
            conduct=Conduct.REFUSES,
        ),
        shown(
            "a load on cells with inner stiffness",
            stabilised is SolverOutcome.CONVERGED,
            f"{stabilised.name}: {stabilised.value}",
        ),
        shown(
            f"cells filled to {0.5 * LEAST_FILL:g}",
            dropped == CELLS**2,
            f"{dropped} cells carry no load and are left out",
            conduct=Conduct.FALLS_BACK,
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Draw condition number and cost over the fill."""
    left, right = chart.subplots(1, 2)
    table = data["fill"]
    fill = table["fill"]
    carried = np.where(table["carried"] > 0.0, 1.0, np.nan)
    label = "fill of the cut cells"
    conduct = [(Conduct.HOLDS, LEAST_FILL, 1.0), (Conduct.FALLS_BACK, fill.min(), LEAST_FILL)]
    panel(
        left,
        fill,
        (label, "condition number"),
        [
            ("no inner stiffness: singular", carried * table["bare_scaled"], "s", RED),
            ("theory: 1 / fill", carried * table["condition"][0] / fill, "-", GREY),
            ("0.1 inner stiffness", carried * table["condition"], "^", ORANGE),
            ("0.1, scaled (engine)", table["scaled"], "o", BLUE),
        ],
        conduct=conduct,
        ylim=(10.0, 1e19),
        legend="center right",
    )
    panel(
        right,
        fill,
        (label, "change of the compliance by the stabilisation / %"),
        [
            ("against 0.001 of inner stiffness", 100.0 * table["cost"], "o", BLUE),
        ],
        conduct=conduct,
        log="x",
    )


PAGE = Page(
    "cut_cells",
    "Cut cells: how little may a cell hold?",
    "A block of particle finite elements ends in cells that hold one particle of decreasing "
    "volume. How does the "
    "condition number of the stiffness grow, and what does the stabilisation cost?",
    (
        "Hourglass control of Flanagan and Belytschko (1981), scaled by the missing part of the "
        "cell; cells of 1 mm"
    ),
    measure,
    judge,
    ask,
    draw,
)
