"""Excess force over a stiff nodule: error of meshes of `palpation`, and detectability.

Run: `python tests/bench/bench_nodule.py [--quick] [--parts meshes felt]`.

The ball, the depths, the nodule and the cells of `palpation` are used in a wider slab (160 mm) of
one modulus, 20 kPa, which the scene has at its nodule. On the axis of the nodule the problem is then
axisymmetric, and the reference is `tissue.fem.axisymmetric` with a stiff ball in its layer
(`tests/fixtures/nodule_layer.py`). The law is linear, without friction. Excess force is the force
over the nodule minus the force on the same mesh with the nodule as soft as the tissue.

meshes: error of force, excess and displacement for edges under the ball. The displacement is that of
the top face within 25 mm of the axis (L2, over the L2 norm of the reference). Its excess is the
change that the nodule makes. Forces of the reference are extrapolated to zero edges. The
last rows are the errors of its meshes.

felt: excess force by diameter of the nodule and depth of its top, and its ratio to the force
difference that is felt in 75 % of comparisons, kappa (F + offset) of `perception.toml`.
"""

import argparse
import os
from dataclasses import replace

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from harness import machine, table  # noqa: E402
from nodule_layer import NoduleLayer, Phantom, phantom_mesh  # noqa: E402

import tissue  # noqa: E402
from meshes.base.arrays import Array  # noqa: E402
from meshes.base.progress import silent  # noqa: E402
from tissue.materials.constants import constants  # noqa: E402
from tissue.scene.load import load_scene  # noqa: E402
from tissue.simulation.builders.organ import held_mesh  # noqa: E402

SIDE_MM = 160.0
"""Sides of the slab, 4 times its thickness."""
WIDTH_M = 90e-3
"""Radius of the axisymmetric layer, of nearly the area of the slab (90.3 mm)."""
DEPTHS_M = np.array([1e-3, 2e-3, 3e-3, 4e-3])
NEAR_MM = 25.0
SHIPPED_MM = 5.0
"""Edge under the ball in `palpation`."""
EDGES_MM = (SHIPPED_MM, 3.0, 2.0, 1.5)
AXIAL_M = (1.4e-3, 1e-3, 0.7e-3, 0.5e-3, 0.35e-3)
"""Edges of the reference. The last two are extrapolated."""
DIAMETERS_MM = (5.0, 8.0, 12.0, 18.0)
COVERS_MM = (3.0, 5.0, 8.0, 12.0)
FELT_M = 0.8e-3
"""Edge of the cells in the table of detectability."""

Pressed = tuple[Array, Array]
"""Forces at the depths [N], and the surface at the last one, with radius and displacement [m]."""


def reference(phantom: Phantom, edge_m: float) -> tuple[Pressed, Pressed]:
    """Press the axisymmetric phantom with its nodule, and with the nodule as soft as the tissue."""
    mesh = phantom_mesh(phantom, edge_m)
    soft = replace(phantom, nodule_ratio=1.0)
    return NoduleLayer(phantom, mesh).press(DEPTHS_M), NoduleLayer(soft, mesh).press(DEPTHS_M)


def pressed(edge_mm: float) -> tuple[Pressed, Pressed]:
    """Press the tetrahedra of `palpation` with the nodule, and with it as soft as the tissue."""
    changes = {
        "anatomy.size_mm": [SIDE_MM, SIDE_MM, 40.0],
        "anatomy.nodule_centre_mm": [0, 0, -17],
        "motion.points_mm": [[0, 0, 1], [0, 0, -4]],
    }
    scene = load_scene("palpation", changes)
    path = 1e-3 * np.array(scene.motion.points_mm)
    found = held_mesh(scene.anatomy, path_m=path, touch_edge_m=1e-3 * edge_mm, report=silent)
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
        points, moved = press.mesh.points, np.asarray(press.mesh["displacement_mm"])
        radius = np.hypot(points[:, 0], points[:, 1])
        top = (points[:, 2] > -1e-6) & (radius < NEAR_MM)
        both.append((force, 1e-3 * np.column_stack([radius[top], moved[top, 2]])))
    return both[0], both[1]


def errors(found: tuple[Pressed, Pressed], exact: tuple[Pressed, Pressed]) -> list[float]:
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
    values.append(100.0 * float(np.linalg.norm(off) / np.linalg.norm(true_over)))
    values.append(100.0 * float(np.linalg.norm(off_change) / np.linalg.norm(changed)))
    return values


def extrapolated(coarse: Pressed, fine: Pressed) -> Pressed:
    """Return the forces at zero edges, at second order, and the surface of the fine mesh.

    The errors of the excess with edges of 1.4 to 0.35 mm decrease by the second power.
    """
    share = AXIAL_M[-1] ** 2 / (AXIAL_M[-2] ** 2 - AXIAL_M[-1] ** 2)
    return fine[0] + share * (fine[0] - coarse[0]), fine[1]


def meshes(quick: bool) -> None:
    """Print the errors of the scene's mesh and of finer ones."""
    phantom = Phantom(width_m=WIDTH_M)
    axial = {edge: reference(phantom, edge) for edge in (AXIAL_M[:1] if quick else AXIAL_M)}
    exact = axial[[*axial][-1]]
    if not quick:
        coarse = axial[AXIAL_M[-2]]
        exact = extrapolated(coarse[0], exact[0]), extrapolated(coarse[1], exact[1])
    (stiff, _), (plain, _) = exact
    print(f"reference: force {stiff[2:]} N, excess {stiff[2:] - plain[2:]} N at 3 and 4 mm")
    rows = []
    for edge in EDGES_MM[:1] if quick else EDGES_MM:
        values = errors(pressed(edge), exact)
        rows.append((f"{edge:g} mm", *(f"{each:+.1f}" for each in values)))
    for edge, ((over_N, over), (aside_N, aside)) in axial.items():
        near = over[:, 0] < 1e-3 * NEAR_MM
        values = errors(((over_N, over[near][:, ::2]), (aside_N, aside[near][:, ::2])), exact)
        rows.append((f"axial, {1e3 * edge:g} mm", *(f"{each:+.1f}" for each in values)))
    head = ("edge", "F 3 mm %", "excess %", "F 4 mm %", "excess %", "surface %", "its excess %")
    print(table(rows, head))


def felt(quick: bool) -> None:
    """Print excess force and its ratio to the felt difference, by diameter and cover."""
    law = constants("perception", "force")
    kappa, offset = law["kappa"].value, law["offset_N"].value
    largest = Phantom(
        width_m=WIDTH_M,
        nodule_m=5e-4 * DIAMETERS_MM[-1],
        nodule_depth_m=1e-3 * COVERS_MM[-1] + 5e-4 * DIAMETERS_MM[-1],
    )
    mesh = phantom_mesh(largest, 2e-3 if quick else FELT_M)
    depths = DEPTHS_M[1::2]
    plain = NoduleLayer(replace(largest, nodule_ratio=1.0), mesh).press(depths)[0][-1]
    threshold = kappa * (plain + offset)
    print(f"4 mm deep in 20 kPa: {plain:.3f} N; felt in 75 % of comparisons: {threshold:.3f} N")
    rows = []
    for diameter in DIAMETERS_MM[-1:] if quick else DIAMETERS_MM:
        row = [f"{diameter:g} mm"]
        for cover in COVERS_MM:
            radius = 5e-4 * diameter
            phantom = replace(largest, nodule_m=radius, nodule_depth_m=1e-3 * cover + radius)
            excess = NoduleLayer(phantom, mesh).press(depths)[0][-1] - plain
            row.append(
                f"{1e3 * excess:.1f} mN, {100 * excess / plain:.1f} %, {excess / threshold:.2f}"
            )
        rows.append(tuple(row))
        print(rows[-1], flush=True)
    print(table(rows, ("diameter", *(f"{cover:g} mm deep" for cover in COVERS_MM))))


def main() -> None:
    """Print the chosen tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="coarse cells, one case of each")
    parser.add_argument(
        "--parts", nargs="+", choices=("meshes", "felt"), default=["meshes", "felt"]
    )
    given = parser.parse_args()
    print(machine())
    if "meshes" in given.parts:
        meshes(given.quick)
    if "felt" in given.parts:
        felt(given.quick)


if __name__ == "__main__":
    main()
