"""Excess force over a stiff nodule: error of meshes of `palpation`, and detectability.

Run: `python tests/bench/bench_nodule.py [--quick] [--parts meshes felt] [--out FILE.png]`.

The ball, the depths, the nodule and the cells of `palpation` are used in a wider slab (160 mm) of
one modulus, 20 kPa, which the scene has at its nodule. On the axis of the nodule the problem is then
axisymmetric, and the reference is `tissue.fem.axisymmetric` with a stiff ball in its layer
(`tests/fixtures/nodule_layer.py`). The law is linear, without friction. Excess force is the force
over the nodule minus the force on the same mesh with the nodule as soft as the tissue.

meshes: error of force, excess and displacement for edges under the ball. The displacement is that of
the corners of the top face within 25 mm of the axis (L2 over the area, relative to the reference).
Its excess is the change that the nodule makes. The first rows are of cells that are not softened
(`tissue.fem.assembly`), the last rows of coarser meshes of the reference.

felt: excess force by diameter of the nodule and depth of its top. It is compared with the force
difference that is felt in 75 % of comparisons, kappa (F + offset) of `perception.toml`. `--out` draws
the ratio of both as a map, with the values of the organ of `palpation` at some points.
"""

import argparse
import os
from dataclasses import replace
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from harness import machine, table  # noqa: E402
from nodule_layer import NoduleLayer, Phantom, phantom_mesh  # noqa: E402

import tissue  # noqa: E402
from meshes.base.arrays import Array  # noqa: E402
from meshes.base.progress import silent  # noqa: E402
from tissue.fem import assembly  # noqa: E402
from tissue.materials.constants import constants  # noqa: E402
from tissue.scene.load import load_scene  # noqa: E402
from tissue.simulation.builders.organ import held_mesh  # noqa: E402

SIDE_MM = 160.0
"""Sides of the slab, 4 times its thickness."""
WIDTH_M = 90e-3
"""Radius of the axisymmetric layer, of nearly the area of the slab (90.3 mm)."""
DEPTHS_M = np.array([1e-3, 2e-3, 3e-3, 4e-3])
NEAR_MM = 25.0
SHIPPED_MM = load_scene("palpation").anatomy.touch_edge_mm
"""Edge under the ball in `palpation`."""
EDGES_MM = (5.0, 4.0, 3.0, 2.0)
AXIAL_M = (2e-3, 1.4e-3, 1e-3)
"""Edges of the reference; the last one is exact here.

From 2 to 0.7 mm the excess at 4 mm is 74.8, 73.9, 73.6 and 73.4 mN.
"""
DIAMETERS_MM = (5.0, 8.0, 12.0, 18.0, 24.0)
COVERS_MM = (2.0, 3.0, 5.0, 8.0, 12.0)
FELT_M = 2e-3
"""Edge of the cells in the map of detectability."""
ORGANS = ((18.0, 8.0, 8.0), (24.0, 8.0, 8.0), (18.0, 12.0, 8.0), (12.0, 6.0, 6.0))
"""Diameter and depth of the nodules in the organ of `palpation`, and its edges [mm]."""

Pressed = tuple[Array, Array]
"""Forces at the depths [N], and the surface at the last one, with radius and displacement [m]."""


def reference(
    phantom: Phantom, edge_m: float, depths_m: Array = DEPTHS_M
) -> tuple[Pressed, Pressed]:
    """Press the axisymmetric phantom with its nodule, and with the nodule as soft as the tissue."""
    mesh = phantom_mesh(phantom, edge_m)
    soft = replace(phantom, nodule_ratio=1.0)
    return NoduleLayer(phantom, mesh).press(depths_m), NoduleLayer(soft, mesh).press(depths_m)


def pressed(
    edge_mm: float, *, diameter_mm: float = 18.0, cover_mm: float = 8.0, cells_mm: float = 8.0
) -> tuple[Pressed, Pressed, Array]:
    """Press the tetrahedra of `palpation` with the nodule, and with it as soft as the tissue.

    Return the areas of the corners of the top face too [m2].
    """
    changes = {
        "anatomy.size_mm": [SIDE_MM, SIDE_MM, 40.0],
        "anatomy.edge_mm": cells_mm,
        "anatomy.nodule_diameter_mm": diameter_mm,
        "anatomy.nodule_centre_mm": [0, 0, -cover_mm - 0.5 * diameter_mm],
        "motion.points_mm": [[0, 0, 1], [0, 0, -4]],
    }
    scene = load_scene("palpation", changes)
    path = 1e-3 * np.array(scene.motion.points_mm)
    found = held_mesh(scene.anatomy, path_m=path, touch_edge_m=1e-3 * edge_mm, report=silent)
    nodes, surface = found.mesh.nodes_m, found.mesh.surface
    upper = surface[(nodes[surface, 2] > -1e-9).all(axis=1)]
    sides = nodes[upper[:, 1:]] - nodes[upper[:, :1]]
    third = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 6.0
    area = np.bincount(upper.ravel(), np.repeat(third, 3), len(nodes))
    ball = tissue.ball(diameter_mm=scene.tool.diameter_mm)
    both = []
    for nodule_kPa in (100.0, 20.0):
        organ = tissue.Organ.from_tetrahedra(
            found.mesh,
            modulus_kPa=20.0,
            poisson_ratio=0.49,
            parts={"nodule": nodule_kPa},
            held=found.held,
            friction=0.0,
        )
        press = organ.press(ball, depth_mm=4.0, at_mm=(0, 0, 0), along=(0, 0, -1))
        tip = press.tip_mm[2] + press.depth_mm[-1] - press.depth_mm
        force = np.interp(1e3 * DEPTHS_M, -tip, press.forces_N[:, 2])
        moved = np.asarray(press.mesh["displacement_mm"])[: len(nodes)]
        radius = np.hypot(nodes[:, 0], nodes[:, 1])
        top = (area > 0.0) & (radius < 1e-3 * NEAR_MM)
        both.append((force, np.column_stack([radius[top], 1e-3 * moved[top, 2]])))
    return both[0], both[1], area[top]


def errors(
    found: tuple[Pressed, Pressed], area_m2: Array, exact: tuple[Pressed, Pressed]
) -> list[float]:
    """Return errors in percent: force and excess at 3 and 4 mm, displacement and its excess."""
    (stiff, over), (plain, aside) = found
    (exact_stiff, exact_over), (exact_plain, exact_aside) = exact
    share = [stiff / exact_stiff, (stiff - plain) / (exact_stiff - exact_plain)]
    values = [100.0 * (each[k] - 1.0) for k in (2, 3) for each in share]
    at = over[:, 0]
    true_over = np.interp(at, exact_over[:, 0], exact_over[:, 2])
    true_aside = np.interp(at, exact_aside[:, 0], exact_aside[:, 2])
    changed = true_over - true_aside
    off = over[:, 1] - true_over
    off_change = over[:, 1] - aside[:, 1] - changed
    for error, true in ((off, true_over), (off_change, changed)):
        values.append(100.0 * float(np.sqrt((area_m2 * error**2).sum() / (area_m2 * true**2).sum())))
    return values


def meshes(quick: bool) -> None:
    """Print the errors of the scene's mesh and of finer ones."""
    phantom = Phantom(width_m=WIDTH_M)
    axial = {edge: reference(phantom, edge) for edge in (AXIAL_M[:1] if quick else AXIAL_M)}
    exact = axial[[*axial][-1]]
    (stiff, _), (plain, _) = exact
    print(f"reference: force {stiff[2:]} N, excess {stiff[2:] - plain[2:]} N at 3 and 4 mm")
    rows = []

    def add(name: str, found: tuple[Pressed, Pressed], area_m2: Array) -> None:
        rows.append((name, *(f"{each:+.1f}" for each in errors(found, area_m2, exact))))
        print(rows[-1], flush=True)

    softened = assembly.SOFTENED_RATIO
    for edge in EDGES_MM[:1] if quick else EDGES_MM:
        for ratio, name in ((np.inf, "not softened"), (softened, "softened")):
            assembly.SOFTENED_RATIO = ratio
            stiff_press, plain_press, area = pressed(edge)
            add(f"{edge:g} mm, {name}", (stiff_press, plain_press), area)
    for edge, ((over_N, over), (aside_N, aside)) in axial.items():
        near = over[:, 0] < 1e-3 * NEAR_MM
        # Rings around the nodes.
        ring = np.gradient(over[near, 0] ** 2)
        found = (over_N, over[near][:, ::2]), (aside_N, aside[near][:, ::2])
        add(f"axial, {1e3 * edge:g} mm", found, ring)
    head = ("edge", "F 3 mm %", "excess %", "F 4 mm %", "excess %", "surface %", "its excess %")
    print(table(rows, head))


def felt(quick: bool, out: Path | None) -> None:
    """Print excess force and its ratio to the felt difference, by diameter and cover."""
    law = constants("perception", "force")
    kappa, offset = law["kappa"].value, law["offset_N"].value
    depths = DEPTHS_M[1::2]
    rows = []
    ratios = []
    diameters = DIAMETERS_MM[-1:] if quick else DIAMETERS_MM
    for diameter in diameters:
        row = [f"{diameter:g} mm"]
        for cover in COVERS_MM[:2] if quick else COVERS_MM:
            radius = 5e-4 * diameter
            phantom = Phantom(
                width_m=WIDTH_M, nodule_m=radius, nodule_depth_m=1e-3 * cover + radius
            )
            (stiff, _), (plain, _) = reference(phantom, FELT_M, depths)
            excess = float(stiff[-1] - plain[-1])
            ratios.append(excess / (kappa * (plain[-1] + offset)))
            row.append(f"{1e3 * excess:.1f} mN, {100 * excess / plain[-1]:.1f} %, {ratios[-1]:.2f}")
        rows.append(tuple(row))
        print(rows[-1], flush=True)
    print(f"4 mm deep in 20 kPa: {plain[-1]:.3f} N; felt: {kappa * (plain[-1] + offset):.3f} N")
    print(table(rows, ("diameter", *(f"{cover:g} mm deep" for cover in COVERS_MM[: len(row) - 1]))))
    points = []
    for diameter, cover, cells in ORGANS[:1] if quick else ORGANS:
        (stiff, _), (plain, _), _ = pressed(
            SHIPPED_MM, diameter_mm=diameter, cover_mm=cover, cells_mm=cells
        )
        ratio = float((stiff[-1] - plain[-1]) / (kappa * (plain[-1] + offset)))
        points.append((cover, diameter, ratio))
        print(f"organ of palpation, {diameter:g} mm, {cover:g} mm deep: {ratio:.2f}", flush=True)
    if out is not None:
        draw(np.reshape(ratios, (len(diameters), -1)), points, out)


def draw(ratios: Array, points: list[tuple[float, float, float]], out: Path) -> None:
    """Draw the map of detectability: lines of equal ratio, and the organ's values."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from scipy.interpolate import RectBivariateSpline

    figure, axes = pyplot.subplots(figsize=(6.5, 5.0), layout="constrained")
    covers, diameters = COVERS_MM[: ratios.shape[1]], DIAMETERS_MM[-len(ratios) :]
    if min(ratios.shape) > 3:
        # The logarithm of the ratio is nearly bilinear in the logarithm of the diameter.
        smooth = RectBivariateSpline(np.log(diameters), covers, np.log(ratios), kx=2, ky=2)
        fine_d = np.geomspace(diameters[0], diameters[-1], 200)
        fine_c = np.linspace(covers[0], covers[-1], 200)
        values = np.exp(smooth(np.log(fine_d), fine_c))
        filled = axes.contourf(
            fine_c, fine_d, values, levels=[0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0], cmap="Blues"
        )
        figure.colorbar(filled, label="excess force / felt difference")
        axes.contour(fine_c, fine_d, values, levels=[1.0], colors="black", linewidths=2.0)
    for cover, diameter, ratio in points:
        axes.plot(cover, diameter, "o", color="tab:orange")
        axes.annotate(f"{ratio:.2f}", (cover, diameter), (5, 5), textcoords="offset points")
    axes.set(
        xlabel="depth of the top of the nodule (mm)",
        ylabel="diameter of the nodule (mm)",
        title="Ball of 16 mm, 4 mm deep; nodule 5 times as stiff.\n"
        "Black line: felt in 75 % of comparisons. Dots: palpation's organ",
    )
    axes.title.set_fontsize(10)
    figure.savefig(out, dpi=110)


def main() -> None:
    """Print the chosen tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="coarse cells, one case of each")
    parser.add_argument(
        "--parts", nargs="+", choices=("meshes", "felt"), default=["meshes", "felt"]
    )
    parser.add_argument("--out", type=Path, help="draw the map of detectability as this picture")
    given = parser.parse_args()
    print(machine())
    if "meshes" in given.parts:
        meshes(given.quick)
    if "felt" in given.parts:
        felt(given.quick, given.out)


if __name__ == "__main__":
    main()
