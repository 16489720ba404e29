"""Soft organ of a scene: its mesh at the site, its supports and its materials."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, names_of_caller
from meshes.base.placement import Placement
from meshes.base.progress import Progress
from meshes.organs.liver import Nodule, liver, liver_region, onto_liver, slab, slab_base
from meshes.surfaces.site import axes_along
from meshes.tets.files import read_tets
from meshes.tets.regions import nodes_behind_plane, nodes_facing, nodes_of_part
from meshes.tets.stuffing import Move, bisected
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import nearest_on_triangles
from tissue.materials.elasticity import (
    fibre_ratio_range,
    lame,
    rotated,
    transversely_isotropic,
    volume_preserving_ratio,
)
from tissue.materials.scene_constants import Materials
from tissue.motion.motion import frame_along
from tissue.scene.named_parts import nearest
from tissue.scene.organ import (
    Held,
    LiverAnatomy,
    LiverFile,
    Organ,
    SlabAnatomy,
    SoftAnatomy,
    WithNodule,
)
from tissue.scene.part import is_given
from tissue.simulation.builders.parts import FILE_WORDS

__all__ = ["HeldMesh", "elasticity_of", "held_mesh"]

PART_NODULE = "nodule"
NODULE_KPA = 50.0
"""Young's modulus of a nodule where a scene states none [kPa]."""
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
"""Keys of a scene, by the names that mesh functions use for them."""
LOCKING_RATIO = 0.45
"""Poisson's ratio above which a run notes that linear tetrahedra lock."""


@dataclass(frozen=True, eq=False)
class HeldMesh:
    """Organ at its site, with the tool coming down from +z to the origin.

    Attributes
    ----------
    mesh
        Tetrahedra.
    held
        Nodes that do not move, in rising order.
    notes
        Notes on findings and assumptions, by subject.
    placement
        Pose of the scene's frame in the frame of the organ's file; None without a file.
    """

    mesh: TetMesh
    held: NDArray[np.int64]
    notes: dict[str, str]
    placement: Placement | None = None


def held_mesh(
    anatomy: SoftAnatomy, *, path_m: NDArray[np.float64], touch_edge_m: float, report: Progress
) -> HeldMesh:
    """Mesh a scene's organ, procedural or from a file, and refine it along the tool's path.

    Parameters
    ----------
    anatomy
        The scene's organ; its edges grow by `edge_growth` times the distance from the path.
    path_m
        Corners of the path of the tool's tip [m], shape (k, 3).
    touch_edge_m
        Longest edge on it [m].
    report
        Called with the current stage.

    Raises
    ------
    InputError
        If a file cannot be used, a nodule does not fit, or the support of the organ touches no
        node.
    """

    def fine(mesh: TetMesh, onto: Move | None = None) -> TetMesh:
        return bisected(
            mesh,
            lambda points: touch_edge_m + anatomy.edge_growth * _away(points, path_m),
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
            notes = {
                "liver": f"procedural, {litres:.2f} l; no vessels and no ligaments",
                "held": _held_note(anatomy),
            }
            return HeldMesh(mesh, _held(anatomy, mesh), notes)
        assert isinstance(anatomy, LiverFile)
        return _from_file(anatomy, fine, report)


def elasticity_of(
    mesh: TetMesh, anatomy: SoftAnatomy, organ: Organ, constants: Materials = Materials.cited
) -> tuple[NDArray[np.float64], str]:
    """Return the elasticity of the cells [Pa] and a note.

    The elasticity holds Lame constants, shape (m, 2), or with fibres stiffness matrices, shape (m,
    6, 6).
    """
    cited = constants.constants("soft", organ.material)
    modulus = cited["modulus_kPa"]
    first = organ.young_kPa or modulus.value
    ratio = cited["poisson_ratio"].value if organ.poisson_ratio is None else organ.poisson_ratio
    note = f"{first:g} kPa"
    if organ.young_kPa is None:
        origin = constants.origin("soft", organ.material, "modulus_kPa")
        note += f" ({origin} {modulus.low:g}-{modulus.high:g}, confidence {modulus.confidence})"
    young = np.full(len(mesh.cells), first)
    if organ.young_end_kPa is not None:
        x = mesh.nodes_m[mesh.cells].mean(axis=1)[:, 0]
        share = (x - x.min()) / np.ptp(x)
        young += (organ.young_end_kPa - first) * share**organ.grading_exponent
        note += (
            f" to {organ.young_end_kPa:g} kPa along x, by the distance to the power "
            f"{organ.grading_exponent:g}"
        )
    for part, stated in _moduli_kPa(mesh, anatomy, organ).items():
        young[mesh.part == part] = stated
        note += f"; {mesh.part_names[part]} {stated:g} kPa"
    note += f"; Poisson's ratio {ratio:g}"
    if organ.order == 1 and ratio > LOCKING_RATIO:
        note += ", at which linear tetrahedra lock: forces come out too great, take organ.order = 2"
    if organ.fibre_direction is None:
        return lame(1e3 * young, ratio), note
    along = organ.fibre_modulus_ratio
    turned = rotated(_fibrous(ratio, along), np.array([organ.fibre_direction]))
    note += f"; {along:g} times as stiff along its fibres, its bulk modulus as without them"
    return young[:, None, None] * turned, note


def _fibrous(poisson_ratio: float, along: float) -> NDArray[np.float64]:
    """Return the stiffness of tissue with fibres along axis 3 [Pa], shape (6, 6).

    Young's modulus across the fibres is 1 kPa.

    Raises
    ------
    InputError
        If fibres of this ratio would leave the tissue unstable.
    """
    low, high = fibre_ratio_range(poisson_ratio)
    if not low < along < high:
        bound = f"more than {low:.3g}" if along <= low else f"less than {high:.3g}"
        raise InputError(
            f"organ.fibre_modulus_ratio is {along:g}, but tissue of Poisson's ratio "
            f"{poisson_ratio:g} is stable only "
            f"with {bound}. Change it or organ.poisson_ratio"
        )
    return transversely_isotropic(
        young_fibre_Pa=1e3 * along,
        young_across_Pa=1e3,
        shear_fibre_Pa=1e3 * (0.5 + 0.5 * along) / (2.0 * (1.0 + poisson_ratio)),
        poisson_fibre=poisson_ratio,
        poisson_across=volume_preserving_ratio(poisson_ratio=poisson_ratio, modulus_ratio=along),
    )


def _moduli_kPa(mesh: TetMesh, anatomy: SoftAnatomy, organ: Organ) -> dict[int, float]:
    """Return Young's moduli of parts that differ, by their numbers in the mesh [kPa].

    Raises
    ------
    InputError
        If the mesh has no part of that name, or a part is named twice.
    """
    from_file = isinstance(anatomy, LiverFile)
    names = mesh.part_names
    found = {names.index(PART_NODULE): NODULE_KPA} if PART_NODULE in names and not from_file else {}
    given: dict[int, str] = {}
    for name, modulus in (organ.parts or {}).items():
        known = next((each for each in (name, f"part {name}") if each in names), None)
        if known is None:
            have = "has one part alone" if len(names) == 1 else f"has {', '.join(names)}"
            close = nearest(name, names)
            raise InputError(
                "organ.parts", "name parts of the organ", f"{name}{close}", f"it {have}"
            )
        number = names.index(known)
        if number in given:
            raise InputError(
                "organ.parts",
                "name each part once",
                f"{given[number]} and {name}",
                "remove one of them",
            )
        given[number] = name
        found[number] = modulus
    return found


def _nodule(anatomy: WithNodule) -> Nodule | None:
    if anatomy.nodule_diameter_mm == 0.0:
        return None
    if anatomy.nodule_diameter_mm < 2.0 * anatomy.edge_mm:
        raise InputError(
            "anatomy.nodule_diameter_mm",
            f"be at least twice anatomy.edge_mm ({anatomy.edge_mm:g})",
            f"{anatomy.nodule_diameter_mm:g}",
            (
                f"use {2.0 * anatomy.edge_mm:g}, or anatomy.edge_mm = "
                f"{0.5 * anatomy.nodule_diameter_mm:g}"
            ),
        )
    x, y, z = (1e-3 * value for value in anatomy.nodule_centre_mm)
    return Nodule(0.5e-3 * anatomy.nodule_diameter_mm, (x, y, z))


def _away(points_m: NDArray[np.float64], path_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances of points from the path of the tip [m], shape (n,)."""
    nearest = np.full(len(points_m), np.inf)
    for start, end in pairwise(path_m):
        along = end - start
        share = np.clip((points_m - start) @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
        nearest = np.minimum(
            nearest, np.linalg.norm(points_m - start - share[:, None] * along, axis=1)
        )
    return nearest


def _from_file(
    anatomy: LiverFile, fine: Callable[[TetMesh, Move | None], TetMesh], report: Progress
) -> HeldMesh:
    """Read the mesh of a file and move and rotate it to its site."""
    found = read_tets(
        anatomy.file, unit_mm=anatomy.scale_mm, edge_m=1e-3 * anatomy.edge_mm, report=report
    )
    if found.surface is None and is_given(anatomy, "edge_mm"):
        raise InputError(
            "anatomy.edge_mm",
            "be left out for tetrahedra from a file",
            f"{anatomy.edge_mm:g}",
            (
                "set anatomy.touch_edge_mm, by which they are divided where the tool goes, or "
                "remove it"
            ),
        )
    mesh = found.mesh
    turn = frame_along(anatomy.normal)
    if anatomy.along is not None:
        turn = axes_along(turn[:, 2], anatomy.along)
    surface = (
        mesh.nodes_m[mesh.surface_nodes] if found.surface is None else found.surface.vertices_m
    )
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

        def onto(points: NDArray[np.float64]) -> NDArray[np.float64]:
            return nearest_on_triangles(vertices, faces, points)

    placed = fine(replace(mesh, nodes_m=(mesh.nodes_m - origin) @ turn), onto)
    at = ", ".join(f"{1e3 * value:.4g}" for value in origin)
    notes = {
        "mesh": f"{len(mesh.cells)} tetrahedra, {1e6 * float(mesh.volumes_m3.sum()):.4g} ml. "
        + " ".join(found.sentences),
        "site": f"origin at ({at}) mm of the file",
        "held": _held_note(anatomy),
    }
    return HeldMesh(
        placed, _held(anatomy, placed), notes, Placement(1e3 * origin, turn, found.unit_mm)
    )


def _held(anatomy: Held, mesh: TetMesh) -> NDArray[np.int64]:
    """Return the nodes that the scene's support holds."""
    if anatomy.held == "plane":
        height = 1e-3 * anatomy.held_below_mm
        return nodes_behind_plane(mesh, point_m=(0.0, 0.0, height), normal=(0.0, 0.0, 1.0))
    if anatomy.held == "part":
        if anatomy.held_part is None:
            raise InputError(
                "held_part", "be given", "nothing", f"use one of {', '.join(mesh.part_names)}"
            )
        numbered = f"part {anatomy.held_part}"
        return nodes_of_part(mesh, numbered if numbered in mesh.part_names else anatomy.held_part)
    if isinstance(anatomy, LiverAnatomy):
        return liver_region(mesh, anatomy.held)
    return nodes_facing(
        mesh, direction=(0.0, 0.0, -1.0) if anatomy.held == "below" else (0.0, 1.0, 0.0)
    )


def _held_note(anatomy: Held) -> str:
    note = {
        "below": "the surface that faces down",
        "back": "the surface that faces back",
        "plane": f"the surface below z = {anatomy.held_below_mm:g} mm",
        "part": f"the part {anatomy.held_part}",
    }
    return note[anatomy.held]
