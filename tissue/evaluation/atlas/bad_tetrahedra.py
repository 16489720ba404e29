"""Inverted and sliver tetrahedra: what they do to a stiffness matrix, and what is done about them."""

import numpy as np
from matplotlib.figure import Figure
from scipy.linalg import eigvalsh

from meshes.base.arrays import Array, Ints
from meshes.tets.checks import mean_ratio, signed_volumes
from meshes.tets.quality import SLIVER, repair_tets
from meshes.tets.structured import box
from meshes.tets.tetrahedra import TetMesh
from tissue.evaluation.atlas.drawing import BLUE, GREY, RED, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, log_slope, refused, shown, sweep
from tissue.fem.assembly import assemble
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

__all__ = ["PAGE"]

SIZE_M = 0.1


def squashed(height: float) -> tuple[Array, Ints]:
    """A cube of 4 x 4 x 4 bricks whose middle node lies so much of its old height over the face below it."""
    good = box((SIZE_M,) * 3, (4, 4, 4))
    nodes = good.nodes_m.copy()
    inner = int(np.argmin(np.linalg.norm(nodes - 0.5 * SIZE_M, axis=1)))
    around = good.cells[(good.cells == inner).any(axis=1)]
    foot = nodes[around[0][around[0] != inner]].mean(axis=0)
    nodes[inner] = foot + height * (nodes[inner] - foot)
    return nodes, good.cells


def condition(nodes_m: Array, cells: Ints) -> float:
    """Condition number of the cube's stiffness with its base held."""
    space = Space(TetMesh(nodes_m, cells))
    free = np.repeat(nodes_m[:, 2] > 1e-9, 3)
    values = eigvalsh(assemble(space, lame(5e3, 0.3)).toarray()[np.ix_(free, free)])
    return float(values[-1] / values[0])


def at_height(height: float) -> dict[str, float]:
    """Quality and condition with so much of the height left, as it is and repaired."""
    nodes, cells = squashed(height)
    mesh, report = repair_tets(nodes, cells)
    return {
        "quality": mean_ratio(nodes, cells).min(),
        "condition": condition(nodes, cells),
        "repaired_quality": mean_ratio(mesh.nodes_m, mesh.cells).min(),
        "repaired_condition": condition(mesh.nodes_m, mesh.cells),
        "slivers_left": report.slivers_left,
    }


def measure(quick: bool) -> Data:
    """Quality and condition over the height that is left."""
    return {"sliver": sweep("height", np.geomspace(1.0, 1e-5, 4 if quick else 11), at_height)}


def judge(data: Data) -> Verdict:
    """Growth of the condition number with one over the height; what repair leaves of it."""
    table = data["sliver"]
    flat = table["height"] < 0.03
    slope = log_slope(table["height"][flat], table["condition"][flat])
    worst, quality = float(table["repaired_condition"].max()), float(table["repaired_quality"].min())
    return Verdict(
        -1.15 < slope < -0.85 and table["condition"].max() > 100.0 * table["condition"][0],
        # Cells just better than a sliver are left as they are: a tenth of the quality is a tenth of the height.
        worst < 10.0 * table["condition"][0] and quality > SLIVER,
        f"As a cell is squashed the condition number grows as its height to the power {slope:.2f} (theory −1), from "
        f"{table['condition'][0]:.0f} to {table['condition'].max():.1e}. Repaired, it is {worst:.0f} at most and the "
        f"worst quality {quality:.2f}.",
    )


def ask() -> list[Answer]:
    """Meshes with inverted cells, to the mesh, to the repair, and one that no repair can mend."""
    nodes, cells = squashed(1.0)
    turned = cells.copy()
    turned[[17, 200, 301]] = turned[[17, 200, 301]][:, [1, 0, 2, 3]]
    mended, report = repair_tets(nodes, turned)
    folded = nodes.copy()
    folded[int(np.argmin(np.linalg.norm(nodes - 0.5 * SIZE_M, axis=1)))] += [0.4 * SIZE_M, 0.0, 0.0]
    volume = float(signed_volumes(mended.nodes_m, mended.cells).sum())
    sliver = repair_tets(*squashed(1e-4))[1]
    return [
        refused("three inverted cells, as a mesh", lambda: TetMesh(nodes, turned)),
        shown("the same, from a file", report.inverted == 3 and abs(volume / SIZE_M**3 - 1.0) < 1e-12,
              " ".join(report.sentences()), conduct=Conduct.FALLS_BACK),
        refused("a mesh that folds over itself", lambda: repair_tets(folded, cells)),
        shown("a sliver", sliver.slivers > 0 and sliver.slivers_left == 0, " ".join(sliver.sentences()),
              conduct=Conduct.FALLS_BACK),
        refused("a node that is nowhere", lambda: repair_tets(np.where(nodes > 0.09, np.nan, nodes), cells)),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """Condition and quality over the height."""
    left, right = chart.subplots(1, 2)
    table = data["sliver"]
    height, label = table["height"], "height left of a cell / its own"
    bad = height[table["quality"] < SLIVER].max()
    conduct = [(Conduct.HOLDS, bad, height[0]), (Conduct.FALLS_BACK, height[-1], bad)]
    panel(left, height, label, "condition number of the stiffness", [
        ("theory: one over the height", table["condition"][-1] * height[-1] / height, "-", GREY),
        ("as it is", table["condition"], "s", RED),
        ("repaired (ours)", table["repaired_condition"], "o", BLUE),
    ], conduct=conduct, ylim=(0.3 * table["repaired_condition"].min(), 5.0 * table["condition"].max()))  # fmt: skip
    panel(right, height, label, "worst mean ratio", [
        ("as it is", table["quality"], "s", RED),
        ("repaired (ours)", table["repaired_quality"], "o", BLUE),
        ("sliver: mean ratio below 0.1", SLIVER, ":", GREY),
    ], conduct=conduct)  # fmt: skip


PAGE = Page(
    "bad_tetrahedra",
    "Inverted and sliver tetrahedra",
    "One node of a good mesh is moved towards the face opposite it. What becomes of the stiffness matrix, and what is "
    "done with cells that are flat or inside out?",
    "Mean ratio of Liu and Joe (1994); rules of the repair in meshes.tets.quality",
    measure,
    judge,
    ask,
    draw,
)
