"""Build the soft organ of a scene: mesh, supports, material and hyperelastic law."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, enumerated, names_of_caller
from meshes.base.placement import Placement
from meshes.base.progress import Progress
from meshes.base.text_tables import shown
from meshes.organs.liver import Nodule, liver, liver_region, onto_liver, slab, slab_base
from meshes.paths.toolpath import path_distance
from meshes.surfaces.site import axes_along
from meshes.tets.files import read_tets
from meshes.tets.regions import Nodes, nodes_of_part
from meshes.tets.stuffing import Move, bisected
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import nearest_on_triangles
from tissue.materials.constants import listed
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.materials.scene_constants import Materials
from tissue.motion.motion import frame_along
from tissue.scene.organ import (
    LAW_SHAPES,
    Held,
    LiverAnatomy,
    LiverFile,
    Organ,
    SlabAnatomy,
    SoftAnatomy,
    WithNodule,
)
from tissue.scene.part import is_given
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe
from tissue.simulation.builders.arguments import unusual_modulus
from tissue.simulation.builders.organ_given import SoftMaterial, hold_of
from tissue.simulation.builders.parts import FILE_WORDS

if TYPE_CHECKING:
    from tissue.models.organ.soft_organ import OrganLaw

PART_NODULE = "nodule"
NODULE_KPA = 50.0
"""Young's modulus of a nodule if the scene does not give one [kPa]."""
KEYS = {
    **dict.fromkeys(FILE_WORDS, "anatomy.file"),
    "nodule.radius_m": "anatomy.nodule_diameter_mm",
    "nodule.centre_m": "anatomy.nodule_centre_mm",
    "spacing_m": "anatomy.edge_mm",
    "edge_m": "anatomy.edge_mm",
    "nodule_diameter_mm": "anatomy.nodule_diameter_mm",
    "held_part": "anatomy.held_part",
    "part": "anatomy.held_part",
    "unit_mm": "anatomy.scale_mm",
    "support": "anatomy.held",
}
"""Keys of a scene, keyed by the names that mesh functions use in error messages."""
OF_ORGAN = {
    **{name: f"organ.{name}" for name in ("parts", "poisson_ratio", "friction")},
    "modulus_kPa": "organ.young_kPa",
}
"""Keys of a scene, keyed by the fields of `SoftMaterial`."""
LOCKING_RATIO = 0.45
"""Poisson's ratio above which a run notes that linear tetrahedra lock.

The error of linear tetrahedra in a cantilever is 32 % at a Poisson's ratio of 0.3, and 72 % at 0.49
(Aycock 2020).
"""


REGION = 2.0
"""Radius of the region in which a hyperelastic law is solved, divided by the tool's radius.

With a Yeoh law that doubles the linear force, the error of the force at rest is 2.0 % with this
ratio, and 5.2 % with a ratio of 1.5. The error is measured against Newton's method at a depth of
0.8 of the radius (`tests/verification/test_organ_laws.py`). In the scene `liver-press` with a
neo-Hookean law, the RMS error over ticks is 0.5 % with a ratio of 1.5, and 1.3 % with a ratio of
1.0. This error is measured against the law in the whole liver, with `python
tests/bench/bench_law_region.py`.
"""
NOT_WITH = ("gravity", "fibre_direction")
"""Keys of an organ that a hyperelastic law does not support."""


@dataclass(frozen=True, eq=False)
class HeldMesh:
    """Mesh of an organ in the frame of the scene, where the tool moves down to the origin from +z.

    Attributes
    ----------
    mesh
        Tetrahedra of the organ.
    held
        Indices of nodes that do not move, in increasing order.
    notes
        Notes on findings and assumptions, keyed by subject.
    placement
        Pose of the scene in the frame of the organ's file; None for an organ without a file.
    """

    mesh: TetMesh
    held: Nodes
    notes: dict[str, str]
    placement: Placement | None = None


def held_mesh(
    anatomy: SoftAnatomy, *, path_m: Array, touch_edge_m: float, report: Progress
) -> HeldMesh:
    """Return a mesh of a scene's organ that is finer along the path of the tool.

    Parameters
    ----------
    anatomy
        Organ of the scene, procedural or from a file. The edge length increases by `edge_growth`
        times the distance from the path.
    path_m
        Corners of the path of the tool's tip [m], shape (k, 3).
    touch_edge_m
        Largest edge length on the path [m].
    report
        Function that is called with the name of the current work.

    Raises
    ------
    InputError
        If a file cannot be used, a nodule does not fit, or the support of the organ touches no
        node.
    """

    def fine(mesh: TetMesh, onto: Move | None = None) -> TetMesh:
        return bisected(
            mesh,
            lambda points: touch_edge_m + anatomy.edge_growth * path_distance(points, path_m),
            onto=onto,
        )

    with names_of_caller(KEYS):
        if isinstance(anatomy, SlabAnatomy):
            size = tuple(1e-3 * side for side in anatomy.size_mm)
            block = slab(
                size_m=(size[0], size[1], size[2]),
                spacing_m=1e-3 * anatomy.edge_mm,
                nodule=_nodule(anatomy),
            )
            mesh = fine(block)
            return HeldMesh(mesh, slab_base(mesh), {"held": "the lower face, bonded to the ground"})
        if isinstance(anatomy, LiverAnatomy):
            mesh = fine(
                liver(spacing_m=1e-3 * anatomy.edge_mm, nodule=_nodule(anatomy)), onto_liver
            )
            litres = 1e3 * float(mesh.volumes_m3.sum())
            held, note = _held(anatomy, mesh)
            found = f"procedural, {litres:.2f} l; no vessels and no ligaments"
            return HeldMesh(mesh, held, {"liver": found, "held": note})
        assert isinstance(anatomy, LiverFile)
        return _from_file(anatomy, fine, report)


def material_of(
    anatomy: SoftAnatomy, organ: Organ, constants: Materials
) -> tuple[SoftMaterial, dict[str, str]]:
    """Return the material of a scene's organ, and notes keyed by subject.

    For constants that the scene does not give, the built-in values are used.

    Raises
    ------
    InputError
        If the organ is viscous and its material has no relaxation constants.
    """
    cited = constants.constants("soft", organ.material)
    young_kPa = organ.young_kPa or cited["modulus_kPa"].value
    ratio = cited["poisson_ratio"].value if organ.poisson_ratio is None else organ.poisson_ratio
    parts: dict[str, float] = {PART_NODULE: NODULE_KPA} if anatomy.nodule_mm else {}
    parts |= organ.parts or {}
    notes = {"modulus": _modulus_note(organ, constants, young_kPa, parts, ratio)}
    capsule = capsule_ratio = density = None
    if organ.capsule:
        if f"{organ.material}_capsule" not in listed("soft"):
            raise InputError(
                "organ.capsule",
                f"be false for {organ.material}",
                "true",
                (
                    f"set it to false: the constants of {organ.material} were fitted to "
                    "tissue with its capsule"
                ),
            )
        table = constants.constants("soft", f"{organ.material}_capsule")
        thick = table["thickness_um"]
        stiff = table["modulus_kPa"]
        notes["capsule"] = (
            f"{thick.value:g} ({thick.low:g}-{thick.high:g}) um of {1e-3 * stiff.value:g} "
            f"({1e-3 * stiff.low:g}-{1e-3 * stiff.high:g}) MPa, confidence {stiff.confidence}"
        )
        capsule = thick.value, stiff.value
        capsule_ratio = table["poisson_ratio"].value
    if organ.gravity:
        density = cited["density_kg_m3"].value
    relaxation: list[tuple[float, float]] = []
    if organ.viscous:
        # The file of constants numbers the terms of the series.
        numbers = [k for k in range(1, 10) if f"prony_g{k}" in cited]
        if not numbers:
            raise InputError(
                "organ.viscous",
                f"be false for {organ.material}",
                "true",
                f"set it to false: the sources of {organ.material} give no relaxation constants",
            )
        relaxation = [(cited[f"prony_g{k}"].value, cited[f"prony_tau{k}_s"].value) for k in numbers]
        notes["relaxation"] = (
            "; ".join(f"{share:g} in {time_s:g} s" for share, time_s in relaxation)
            + "; the modulus is the instantaneous modulus; confidence "
            + cited["prony_g1"].confidence
        )
    with names_of_caller(OF_ORGAN):
        material = SoftMaterial(
            young_kPa,
            ratio,
            parts=parts,
            order=organ.order,
            friction=organ.friction,
            capsule=capsule,
            capsule_poisson_ratio=capsule_ratio,
            density_kg_m3=density,
            relaxation=relaxation,
            graded_kPa=organ.young_end_kPa,
            grading_exponent=organ.grading_exponent,
            fibre_direction=organ.fibre_direction,
            fibre_modulus_ratio=organ.fibre_modulus_ratio,
        )
    return material, notes


def _modulus_note(
    organ: Organ,
    constants: Materials,
    young_kPa: float,
    parts: dict[str, float],
    ratio: float,
) -> str:
    """Return a note on the moduli of an organ."""
    note = f"{young_kPa:g} kPa"
    modulus = constants.constants("soft", organ.material)["modulus_kPa"]
    if organ.young_kPa is None:
        origin = constants.origin("soft", organ.material, "modulus_kPa")
        note += f" ({origin} {modulus.low:g}-{modulus.high:g}, confidence {modulus.confidence})"
    if organ.young_end_kPa is not None:
        note += (
            f" to {organ.young_end_kPa:g} kPa along x (distance to the power "
            f"{organ.grading_exponent:g})"
        )
    for name, stated in parts.items():
        note += f"; {'part ' * name.isdecimal()}{name} {stated:g} kPa"
    note += f"; Poisson's ratio {ratio:g}"
    if organ.order == 1 and ratio > LOCKING_RATIO:
        note += ", at which linear tetrahedra lock and forces are too large: set organ.order = 2"
    if organ.fibre_direction is not None:
        note += (
            f"; {organ.fibre_modulus_ratio:g} times as stiff along its fibres, with an unchanged "
            "bulk modulus"
        )
    if question := unusual_modulus("organ.young_kPa", young_kPa, modulus, organ.material):
        note += f". {question}"
    return note


def _nodule(anatomy: WithNodule) -> Nodule | None:
    if anatomy.nodule_diameter_mm == 0.0:
        return None
    # With fewer edges across a nodule, the mesh is not a ball.
    if anatomy.nodule_diameter_mm < 2.0 * anatomy.edge_mm:
        raise InputError(
            "anatomy.nodule_diameter_mm",
            f"be at least twice anatomy.edge_mm ({anatomy.edge_mm:g})",
            f"{anatomy.nodule_diameter_mm:g}",
            (
                f"use {2.0 * anatomy.edge_mm:g}, or set anatomy.edge_mm = "
                f"{0.5 * anatomy.nodule_diameter_mm:g}"
            ),
        )
    x, y, z = (1e-3 * value for value in anatomy.nodule_centre_mm)
    return Nodule(0.5e-3 * anatomy.nodule_diameter_mm, (x, y, z))


def _from_file(
    anatomy: LiverFile, fine: Callable[[TetMesh, Move | None], TetMesh], report: Progress
) -> HeldMesh:
    """Read a mesh from a file, and move and rotate it into the frame of the scene."""
    found = read_tets(
        anatomy.file, unit_mm=anatomy.scale_mm, edge_m=1e-3 * anatomy.edge_mm, report=report
    )
    if found.surface is None and is_given(anatomy, "edge_mm"):
        raise InputError(
            "anatomy.edge_mm",
            "be left out for tetrahedra from a file",
            f"{anatomy.edge_mm:g}",
            "set anatomy.touch_edge_mm to divide them near the tool, or remove anatomy.edge_mm",
        )
    mesh = found.mesh
    turn = frame_along(anatomy.normal)
    if anatomy.along is not None:
        turn = axes_along(turn[:, 2], anatomy.along)
    surface = (
        mesh.nodes_m[mesh.surface_nodes] if found.surface is None else found.surface.vertices_m
    )
    # If no site is given, the tool comes down on the highest point.
    if anatomy.centre_mm is None:
        origin = surface[np.argmax(surface @ turn[:, 2])]
    else:
        origin = surface[
            np.argmin(np.linalg.norm(surface - 1e-3 * np.array(anatomy.centre_mm), axis=1))
        ]
    onto = None
    if found.surface is not None:
        vertices = (found.surface.vertices_m - origin) @ turn
        faces = found.surface.faces

        def onto(points: Array) -> Array:
            return nearest_on_triangles(vertices, faces, points)

    placed = fine(replace(mesh, nodes_m=(mesh.nodes_m - origin) @ turn), onto)
    held, note = _held(anatomy, placed)
    at = ", ".join(f"{1e3 * value:.4g}" for value in origin)
    notes = {
        "mesh": f"{len(mesh.cells)} tetrahedra, {1e6 * float(mesh.volumes_m3.sum()):.4g} ml. "
        + " ".join(found.sentences),
        "site": f"origin at ({at}) mm of the file",
        "held": note,
    }
    return HeldMesh(placed, held, notes, Placement(1e3 * origin, turn, found.unit_mm))


def _held(anatomy: Held, mesh: TetMesh) -> tuple[Nodes, str]:
    """Return the nodes that the support of the scene holds, and a note on the support."""
    if anatomy.held == "part":
        if anatomy.held_part is None:
            raise InputError(
                "held_part", "be given", "nothing", f"use {enumerated(mesh.part_names, 'or')}"
            )
        numbered = f"part {anatomy.held_part}"
        name = numbered if numbered in mesh.part_names else anatomy.held_part
        return nodes_of_part(mesh, name), f"the part {name}"
    if anatomy.held == "plane":
        hold, note = hold_of("bottom", anatomy.held_below_mm, mesh)
        return hold(mesh), note
    note = f"the surface that faces {'down' if anatomy.held == 'below' else 'back'}"
    if isinstance(anatomy, LiverAnatomy):
        return liver_region(mesh, anatomy.held), note
    hold, _ = hold_of("bottom" if anatomy.held == "below" else "+y", None, mesh)
    return hold(mesh), note


def hindrance(organ: Organ) -> str | None:
    """Return the organ's first key that hyperelastic laws do not support, or None."""
    if organ.path != "condensed":
        return "path"
    return next((name for name in NOT_WITH if getattr(organ, name)), None)


def with_cited_shape(organ: Organ, constants: Materials) -> Organ:
    """Return an organ in which the rate is set if its law is exponential.

    If the scene gives no rate, the rate is taken from the constants of the material.
    """
    if organ.law != "exponential" or organ.exponential_rate is not None:
        return organ
    cited = constants.constants("soft", organ.material).get("exponential_rate")
    return organ if cited is None else organ.model_copy(update={"exponential_rate": cited.value})


def law_of(organ: Organ, lame_Pa: Array) -> tuple[Hyperelastic, Array] | None:
    """Return the hyperelastic law of the first cell, and relative moduli of all cells, shape (m,).

    The relative modulus of a cell is its modulus divided by the modulus of the first cell.

    The result is None for the linear law.

    Parameters
    ----------
    organ
        Organ parameters of the scene.
    lame_Pa
        Lame constants at small strains [Pa], shape (m, 2), as returned by
        `SoftMaterial.elasticity`. The ratio of the two constants must be the same in all cells.

    Raises
    ------
    InputError
        If the scene has a key that the law does not support, or lacks a parameter that the law
        needs.
    """
    if organ.law == "linear":
        return None
    if name := hindrance(organ):
        raise InputError(
            f"organ.law and organ.{name}",
            "not be combined",
            f"{organ.law} and {shown(getattr(organ, name))}",
            (
                f"set organ.law = linear or remove organ.{name}: a law of large strains "
                "supports only an isotropic organ without weight and the condensed "
                "compliance"
            ),
        )
    first, shear = lame_Pa[0].tolist()
    bulk = first + 2.0 / 3.0 * shear
    return _law(organ, shear, bulk), np.asarray(lame_Pa[:, 1] / shear)


def organ_law(scene: Scene, lame_Pa: Array) -> "OrganLaw | None":
    """Return the law of a scene's organ; None for the linear law.

    `lame_Pa` contains the Lame constants of the cells of the mesh [Pa], shape (m, 2).

    Raises
    ------
    InputError
        As for `law_of`.
    """
    from tissue.models.organ.soft_organ import OrganLaw

    organ = with_cited_shape(scene.organ, scene.constants)
    found = law_of(organ, lame_Pa)
    if found is None:
        return None
    assert isinstance(scene.tool, Probe)
    region_m = REGION * 0.5e-3 * scene.tool.size_mm
    return OrganLaw(*found, 1e-3 * organ.law_interval_ms, region_m)


def _law(organ: Organ, shear_Pa: float, bulk_Pa: float) -> Hyperelastic:
    if organ.law == "neo-hookean":
        return Hyperelastic.neo_hookean(shear_Pa, bulk_Pa=bulk_Pa)
    if organ.law == "mooney-rivlin" and (share := organ.second_share) is not None:
        return Hyperelastic.mooney_rivlin(
            0.5 * (1.0 - share) * shear_Pa, 0.5 * share * shear_Pa, bulk_Pa=bulk_Pa
        )
    if organ.law == "yeoh" and organ.square_ratio is not None:
        first = 0.5 * shear_Pa
        return Hyperelastic.yeoh(
            first, organ.square_ratio * first, organ.cube_ratio * first, bulk_Pa=bulk_Pa
        )
    if organ.law == "ogden" and organ.exponent is not None:
        return Hyperelastic(bulk_Pa, ((shear_Pa, organ.exponent),))
    if organ.law == "exponential" and organ.exponential_rate is not None:
        return Hyperelastic.exponential(shear_Pa, organ.exponential_rate, bulk_Pa=bulk_Pa)
    raise InputError(
        f"organ.{LAW_SHAPES[organ.law][0]}",
        f"be given with organ.law = {organ.law}",
        "none",
        "set it, or set organ.law = linear",
    )
