"""Inverted and sliver tetrahedra: condition number of the stiffness matrix, and repair."""

import numpy as np
from matplotlib.figure import Figure
from scipy.linalg import eigvalsh

from meshes.base.arrays import Array, Ints
from meshes.tets.quality import SLIVER, describe, repair_tets
from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh, mean_ratio, signed_volumes
from tissue.evaluation.atlas.page import (
    BLUE,
    GREY,
    RED,
    Answer,
    Conduct,
    Data,
    Page,
    Verdict,
    log_slope,
    panel,
    refused,
    shown,
    sweep,
)
from tissue.fem.assembly import assemble
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

__all__ = ["PAGE"]

SIZE_M = 0.1


def middle_node(nodes_m: Array) -> int:
    """Return the node in the middle of the cube."""
    return int(np.argmin(np.linalg.norm(nodes_m - 0.5 * SIZE_M, axis=1)))


def squashed(height: float) -> tuple[Array, Ints]:
    """Return a cube of 4 x 4 x 4 bricks with a middle node lowered to a fraction of its height."""
    good = box((SIZE_M,) * 3, (4, 4, 4))
    nodes = good.nodes_m.copy()
    inner = middle_node(nodes)
    cell = good.cells[(good.cells == inner).any(axis=1)][0]
    foot = nodes[cell[cell != inner]].mean(axis=0)
    nodes[inner] = foot + height * (nodes[inner] - foot)
    return nodes, good.cells


def condition(nodes_m: Array, cells: Ints) -> float:
    """Compute the condition number of the stiffness with the base held."""
    space = Space(TetMesh(nodes_m, cells))
    free = np.repeat(nodes_m[:, 2] > 1e-9, 3)
    values = eigvalsh(assemble(space, lame(5e3, 0.3)).toarray()[np.ix_(free, free)])
    return float(values[-1] / values[0])


def at_height(height: float) -> dict[str, float]:
    """Measure quality and condition number at a height, before and after repair."""
    nodes, cells = squashed(height)
    mesh, _ = repair_tets(nodes, cells)
    return {
        "quality": mean_ratio(nodes, cells).min(),
        "condition": condition(nodes, cells),
        "repaired_quality": mean_ratio(mesh.nodes_m, mesh.cells).min(),
        "repaired_condition": condition(mesh.nodes_m, mesh.cells),
    }


def measure(quick: bool) -> Data:
    """Sweep the remaining height of the cell."""
    return {"sliver": sweep("height", np.geomspace(1.0, 1e-5, 4 if quick else 11), at_height)}


def judge(data: Data) -> Verdict:
    """Compare the growth of the condition number with 1 / height, before and after repair."""
    table = data["sliver"]
    flat = table["height"] < 0.03
    slope = log_slope(table["height"][flat], table["condition"][flat])
    worst = float(table["repaired_condition"].max())
    quality = float(table["repaired_quality"].min())
    return Verdict(
        -1.15 < slope < -0.85 and table["condition"].max() > 100.0 * table["condition"][0],
        # Cells just above the sliver limit stay as they are: a tenth of the quality is a tenth of
        # the height.
        worst < 10.0 * table["condition"][0] and quality > SLIVER,
        f"The condition number grows as the height of the cell to the power {slope:.2f} "
        "(theory: −1), from "
        f"{table['condition'][0]:.0f} to {table['condition'].max():.1e}. After repair it is "
        f"at most {worst:.0f}, and "
        f"the worst quality is {quality:.2f}.",
    )


def ask() -> list[Answer]:
    """Give the engine meshes with inverted, folded, flat and missing nodes."""
    nodes, cells = squashed(1.0)
    turned = cells.copy()
    turned[[17, 200, 301]] = turned[[17, 200, 301]][:, [1, 0, 2, 3]]
    repaired, repairs = repair_tets(nodes, turned)
    volume = float(signed_volumes(repaired.nodes_m, repaired.cells).sum())
    whole = "Turned 3 inverted" in repairs[0] and abs(volume / SIZE_M**3 - 1.0) < 1e-12
    folded = nodes.copy()
    folded[middle_node(nodes)] += [0.4 * SIZE_M, 0.0, 0.0]
    mesh, sliver = repair_tets(*squashed(1e-4))
    flat = len(sliver) > 0 and bool(mean_ratio(mesh.nodes_m, mesh.cells).min() >= SLIVER)
    return [
        refused("three inverted cells, as a mesh", lambda: TetMesh(nodes, turned)),
        shown(
            "three inverted cells, from a file",
            whole,
            " ".join((*describe(repaired), *repairs)),
            conduct=Conduct.FALLS_BACK,
        ),
        refused("a mesh that folds over itself", lambda: repair_tets(folded, cells)),
        shown("a sliver", flat, " ".join((*describe(mesh), *sliver)), conduct=Conduct.FALLS_BACK),
        refused(
            "nodes with NaN coordinates",
            lambda: repair_tets(np.where(nodes > 0.09, np.nan, nodes), cells),
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Draw condition number and quality over the height."""
    left, right = chart.subplots(1, 2)
    table = data["sliver"]
    height = table["height"]
    label = "remaining height of a cell / original height"
    bad = height[table["quality"] < SLIVER].max()
    conduct = [(Conduct.HOLDS, bad, height[0]), (Conduct.FALLS_BACK, height[-1], bad)]
    limits = (0.3 * table["repaired_condition"].min(), 5.0 * table["condition"].max())
    panel(
        left,
        height,
        (label, "condition number of the stiffness"),
        [
            ("theory: 1 / height", table["condition"][-1] * height[-1] / height, "-", GREY),
            ("not repaired", table["condition"], "s", RED),
            ("repaired (engine)", table["repaired_condition"], "o", BLUE),
        ],
        conduct=conduct,
        ylim=limits,
    )
    panel(
        right,
        height,
        (label, "worst mean ratio"),
        [
            ("not repaired", table["quality"], "s", RED),
            ("repaired (engine)", table["repaired_quality"], "o", BLUE),
            ("sliver: mean ratio below 0.1", SLIVER, ":", GREY),
        ],
        conduct=conduct,
    )


PAGE = Page(
    "bad_tetrahedra",
    "Inverted and sliver tetrahedra",
    "One node of a good mesh is moved towards the opposite face. How does the condition "
    "number of the stiffness matrix "
    "grow, and how are flat or inverted cells repaired?",
    "Mean ratio of Liu and Joe (1994); rules of the repair in meshes.tets.quality",
    measure,
    judge,
    ask,
    draw,
)
