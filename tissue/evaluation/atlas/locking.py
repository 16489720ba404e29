"""Poisson's ratio towards 0.5: linear tetrahedra lock, quadratic ones do not."""

import numpy as np
from matplotlib.figure import Figure

from meshes.tets.structured import box
from tissue.evaluation.atlas.page import (
    BLUE,
    GREY,
    ORANGE,
    RED,
    Answer,
    Conduct,
    Curve,
    Data,
    Page,
    Verdict,
    panel,
    refused,
    shown,
)
from tissue.fem.assembly import assemble, traction
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.scene.organ import Organ, SlabAnatomy
from tissue.simulation.builders.organ import elasticity_of

__all__ = ["PAGE"]

LENGTH = 10.0
YOUNG = 1000.0
"""Bar of 10 m x 1 m x 1 m and 1 kPa under 1 N at its end, as the published cantilever. The
result is scale-free.
"""
MESHES = {
    "linear_coarse": (1, (20, 2, 2)),
    "linear_fine": (1, (30, 4, 4)),
    "quadratic": (2, (16, 2, 2)),
}
"""Order of the tetrahedra, and bricks of six tetrahedra along the bar and across it."""
LOOKS = {"quadratic": ("o", BLUE), "linear_fine": ("^", ORANGE), "linear_coarse": ("s", RED)}


def deflection(order: int, cells: tuple[int, int, int], ratio: float) -> tuple[float, float]:
    """Compute the tip deflection of the clamped bar [m], and the solver's trust in it.

    The trust is 1 if the solver reports a valid result and 0 otherwise.
    """
    space = Space(box((LENGTH, 1.0, 1.0), cells), order)
    held = np.repeat(space.nodes_m[:, :1] < 1e-9, 3, axis=1)
    faces = space.faces[(space.nodes_m[space.faces[:, :3], 0] > LENGTH - 1e-9).all(axis=1)]
    body = HeldBody(assemble(space, lame(YOUNG, ratio)), space.nodes_m, held)
    solution = DirectSolver(body).solve(traction(space, (0.0, 0.0, 1.0), faces=faces))
    tip = solution.displacement_m[space.nodes_m[:, 0] > LENGTH - 1e-9, 2].mean()
    return float(tip), float(solution.outcome is SolverOutcome.CONVERGED)


def timoshenko(ratio: float) -> float:
    """Compute P L^3 / (3 E I) + P L / (kappa G A) with kappa = 5/6, for a force of 1 N [m]."""
    shear = YOUNG / (2.0 * (1.0 + ratio))
    return LENGTH**3 / (3.0 * YOUNG / 12.0) + LENGTH / (5.0 / 6.0 * shear)


def measure(quick: bool) -> Data:
    """Sweep 1 - 2 nu."""
    gap = np.geomspace(0.4, 1e-2 if quick else 2e-4, 3 if quick else 8)
    ratios = 0.5 * (1.0 - gap)
    bar = {
        "poisson_ratio": ratios,
        "timoshenko_m": np.array([timoshenko(r) for r in ratios.tolist()]),
    }
    for name, (order, cells) in MESHES.items():
        if quick and name == "linear_fine":
            continue
        found = np.array([deflection(order, cells, ratio) for ratio in ratios.tolist()])
        bar[f"{name}_m"] = found[:, 0]
        bar[f"{name}_trusted"] = found[:, 1]
    return {"bar": bar}


def judge(data: Data) -> Verdict:
    """Compare linear and quadratic cells with the beam."""
    bar = data["bar"]
    ratio = bar["poisson_ratio"]
    quadratic = bar["quadratic_m"] / bar["timoshenko_m"]
    linear = bar["linear_coarse_m"] / bar["timoshenko_m"]
    trusted = bar["quadratic_trusted"] > 0.0
    off = float(np.abs(quadratic[trusted] - 1.0).max())
    last = ratio[trusted].max()
    lost = "" if trusted.all() else "; above that the solver reports a loss of precision"
    return Verdict(
        bool(linear[-1] < 0.5 and linear[-1] < 0.7 * linear[0]),
        # A clamp that stops bulging takes 1 to 4 % off a beam that may bulge, increasing towards
        # 0.5. The coarse cells take off a few per cent more.
        off < 0.1 and last > 0.49,
        f"Linear tetrahedra bend {100 * linear[0]:.0f} % as far as the beam at ν = "
        f"{ratio[0]:.2f} and "
        f"{100 * linear[-1]:.0f} % at {ratio[-1]:.4f}. Quadratic tetrahedra stay within "
        f"{100 * off:.1f} % up to "
        f"{last:.4f}{lost}.",
    )


def ask() -> list[Answer]:
    """Request the limit itself, an order that does not exist, and an organ of locking cells."""
    mesh = box((0.02, 0.02, 0.02), (1, 1, 1))
    _, note = elasticity_of(
        mesh, SlabAnatomy(kind="slab", nodule_diameter_mm=0.0), Organ(order=1, poisson_ratio=0.49)
    )
    return [
        refused("ν = 0.5", lambda: lame(YOUNG, 0.5)),
        refused("tetrahedra of order 3", lambda: Space(mesh, 3)),
        shown(
            "an organ of linear tetrahedra at ν = 0.49",
            "lock" in note,
            f"runs, and its summary states: {note}",
            conduct=Conduct.FALLS_BACK,
        ),
        shown("an organ with the default order", Organ().order == 2, "quadratic tetrahedra"),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Draw the ratio of the deflection to the beam's deflection, over 1 - 2 nu."""
    bar = data["bar"]
    gap = 1.0 - 2.0 * bar["poisson_ratio"]
    limit = gap[bar["quadratic_trusted"] > 0.0].min()
    curves: list[Curve] = [("theory: Timoshenko beam", 1.0, "-", GREY)]
    for name in [each for each in LOOKS if f"{each}_m" in bar]:
        order, (a, b, c) = MESHES[name]
        label = f"{'quadratic (engine)' if order == 2 else 'linear'}, {a} × {b} × {c} bricks of 6"
        curves.append((label, bar[f"{name}_m"] / bar["timoshenko_m"], *LOOKS[name]))
    conduct = [(Conduct.HOLDS, limit, gap[0])]
    if limit > gap[-1]:
        conduct.append((Conduct.REFUSES, gap[-1], limit))
    panel(
        chart.subplots(),
        gap,
        ("1 − 2ν  (0: incompressible)", "deflection / that of the beam"),
        curves,
        conduct=conduct,
        log="x",
        xlim=gap[[0, -1]],
        ylim=(0.0, 1.15),
        legend="center right",
    )


PAGE = Page(
    "locking",
    "ν → 0.5: do linear tetrahedra lock?",
    "A cantilever of a nearly incompressible material under a force at its end. How far does "
    "it bend with linear and "
    "with quadratic tetrahedra?",
    (
        "Timoshenko's beam with κ = 5/6; Benzley et al. (1995) report 71.7 % error of linear "
        "tetrahedra at ν = 0.49"
    ),
    measure,
    judge,
    ask,
    draw,
)
