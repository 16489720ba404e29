"""Soft organ made from tetrahedra, from a surface with inclusions, or from a label image."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import PRESENT, InputError, by, names_of_caller, require_positive
from meshes.base.progress import Progress
from meshes.surfaces.surface import Surface
from meshes.tets.quality import describe
from meshes.tets.regions import Nodes
from meshes.tets.stuffing import EDGE_GROWTH, bisected, with_inclusion
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import nearest_on_triangles, triangle_distance
from tissue.materials.constants import constants
from tissue.scene.organ import LAW_SHAPES
from tissue.scene.organ import Organ as LawTable
from tissue.simulation.builders.arguments import require_known, stated, surface_of, unusual_modulus
from tissue.simulation.builders.organ_given import Hold, SoftMaterial, hold_of

if TYPE_CHECKING:
    from meshes.ct.labels import Labels
    from tissue.models.organ.soft_organ import SoftOrgan

LAW_KEYS = ("name", *chain.from_iterable(LAW_SHAPES.values()))
"""Keys of a hyperelastic law that a caller gives as a mapping."""
ENVELOPE = 0.1
"""Allowed overlap of two inclusions, or of an inclusion and the space around the organ.

The overlap is a depth, divided by the edge length. The mesh generator moves a surface by up to this
distance.
"""
FINE_EDGES = 1.0
"""Distance from a given point within which all edges have the shortest length [edge lengths].

Farther away, the edges are longer. The value was chosen by judgement.
"""
PLAUSIBLE_ML = (1.0, 10_000.0)
"""Range of plausible volumes of an organ [ml]; outside it, a note asks for the unit.

The values were chosen by judgement.
"""
TOUCHED_EDGES = 3.0
"""Radius around a point, in edge lengths, within which a tool is expected to touch the surface.

The expected tool has a diameter of four edge lengths. A press that touches a larger region takes
more time; see `SoftOrgan.expect`.
"""


class OrganOptions(TypedDict, total=False):
    """Options that all functions for making an organ accept; see `tissue.Organ.from_tetrahedra`."""

    parts: Mapping[str | int, float] | None
    held: str | ArrayLike
    held_below_mm: float | None
    order: Literal[1, 2]
    friction: float
    capsule: tuple[float, float] | None
    density_kg_m3: float | None
    relaxation: Sequence[tuple[float, float]]
    law: str | Mapping[str, str | float] | None


@dataclass(frozen=True, eq=False)
class MadeOrgan:
    """Organ with its mesh, material and supports.

    Attributes
    ----------
    mesh, material
        Tetrahedra [m], and the material of the organ.
    hold
        Function that returns the held nodes of a mesh.
    notes
        Notes on findings and assumptions, keyed by subject.
    surface
        Surface that the mesh represents; None if the tetrahedra were given.
    near
        Region that a tool will press: points, shape (k, 3), in metres, and the radius around each
        point [m]. None if the region is not known.
    law
        Scene table of the hyperelastic law; None for the linear law.
    """

    mesh: TetMesh
    material: SoftMaterial
    hold: Hold
    notes: dict[str, str]
    surface: Surface | None = None
    near: tuple[Array, float] | None = None
    law: LawTable | None = None

    @cached_property
    def held(self) -> Nodes:
        """Nodes that do not move."""
        return self.hold(self.mesh)

    @cached_property
    def soft(self) -> "SoftOrgan":
        """Undeformed organ with its assembled finite-element equations."""
        law = None
        if self.law is not None:
            from tissue.models.organ.soft_organ import OrganLaw
            from tissue.simulation.builders.organ import law_of

            found = law_of(self.law, self.material.elasticity(self.mesh))
            law = None if found is None else OrganLaw(*found, 0.0)
        organ = self.material.organ(self.mesh, self.held, law=law)
        if self.near is not None:
            organ.expect(*self.near)
        return organ

    @property
    def facts(self) -> dict[str, str]:
        """Texts on the size, the mesh and the moduli of the organ, keyed by subject."""
        mesh = self.mesh
        material = self.material
        moduli = material.moduli_kPa(mesh.part_names).items()
        facts = {
            "size": (
                f"{by(1e3 * np.ptp(mesh.nodes_m, axis=0), '.3g')} mm, "
                f"{1e6 * float(mesh.volumes_m3.sum()):.4g} ml"
            ),
            "cells": f"{len(mesh.cells)} tetrahedra of order {material.order}",
            "moduli": ", ".join(f"{name} {value:g} kPa" for name, value in moduli),
            "compressibility": f"Poisson's ratio {material.poisson_ratio:g}",
        }
        if self.law is not None:
            facts["law"] = self.law.law
        return facts

    def refined(self, edge_mm: float, near_mm: ArrayLike | None) -> "MadeOrgan":
        """Return the organ with a finer mesh near some points, or on the whole surface.

        The points `near_mm` have shape (k, 3). Each point is moved to the nearest point of the
        surface.

        Raises
        ------
        InputError
            If the edge is not positive, or the points do not have shape (k, 3).
        """
        from scipy.spatial import cKDTree

        edge_m = 1e-3 * require_positive("edge_mm", edge_mm, "use a quarter of the tool's diameter")
        mesh = self.mesh
        near = None
        if near_mm is not None:
            near = 1e-3 * np.atleast_2d(np.asarray(near_mm, dtype=np.float64))
            if near.ndim != 2 or near.shape[1] != 3 or not np.isfinite(near).all():
                is_shaped = near.ndim == 2 and near.shape[1] == 3
                raise InputError(
                    "near_mm",
                    "be finite coordinates of shape (k, 3)",
                    "NaN or infinity" if is_shaped else f"shape {np.shape(near_mm)}",
                    "give x, y and z of each point",
                )
            near = nearest_on_triangles(mesh.nodes_m, mesh.surface, near)

        def wanted(points: Array) -> Array:
            """Return the longest wanted edge at each point [m]."""
            if near is None:
                away = np.abs(triangle_distance(mesh.nodes_m, mesh.surface, points))
                return edge_m + EDGE_GROWTH * away
            away = np.asarray(cKDTree(near).query(points)[0], dtype=np.float64)
            return edge_m + EDGE_GROWTH * np.maximum(away - FINE_EDGES * edge_m, 0.0)

        outer = self.surface
        onto = None
        if outer is not None:
            onto = lambda points: nearest_on_triangles(outer.vertices_m, outer.faces, points)  # noqa: E731
        with names_of_caller({"size_m": "edge_mm"}):
            finer = bisected(mesh, wanted, onto=onto)
        expected = None if near is None else (near, TOUCHED_EDGES * edge_m)
        notes = self.notes | {"refined mesh": " ".join(describe(finer))}
        return replace(self, mesh=finer, near=expected, notes=notes)


@dataclass(frozen=True, eq=False)
class StatedOrgan:
    """Material and supports of an organ, as given by a caller; see `OrganOptions`."""

    material: SoftMaterial
    held: str | ArrayLike = "bottom"
    held_below_mm: float | None = None
    law: LawTable | None = None

    @classmethod
    def of(cls, modulus_kPa: float, poisson_ratio: float, options: OrganOptions) -> "StatedOrgan":
        """Return material and supports from the arguments of a call; None values are left out.

        Raises
        ------
        InputError
            If a value is out of range.
        TypeError
            If an option is unknown.
        """
        require_known(options, OrganOptions, of="Organ")
        given: dict[str, Any] = {
            name: value for name, value in options.items() if value is not None
        }
        held = given.pop("held", "bottom")
        below = given.pop("held_below_mm", None)
        law = given.pop("law", None)
        table = None if law is None else _law_table(law)
        if table is not None and "density_kg_m3" in given:
            raise InputError(
                "law and density_kg_m3",
                "not be combined",
                f"{table.law} and {given['density_kg_m3']}",
                "remove one of the two: a law of large strains supports no weight",
            )
        return cls(SoftMaterial(modulus_kPa, poisson_ratio, **given), held, below, table)


def _law_table(law: object) -> LawTable | None:
    """Return the scene table of a hyperelastic law, which is given as a name or a mapping.

    The result is None for the linear law.

    Raises
    ------
    InputError
        If the law is unknown, or a constant is missing, unknown or out of range.
    """
    given = dict(law) if isinstance(law, Mapping) else {"name": law}
    unknown = [key for key in given if key not in LAW_KEYS]
    if unknown:
        raise InputError(
            "law", "have only known keys", repr(unknown[0]), f"use keys among {', '.join(LAW_KEYS)}"
        )
    if given.get("name") is None:
        raise InputError("law", "have a name", f"{law}", "add for example 'name': 'neo-hookean'")
    given["law"] = given.pop("name")
    table = stated(LawTable, given, prefix="law: ")
    needed = next(iter(LAW_SHAPES.get(table.law, ())), None)
    if needed is not None and getattr(table, needed) is None:
        example = LawTable.model_fields[needed].examples
        raise InputError(
            f"law {table.law}",
            f"have the key {needed}",
            PRESENT,
            f"use for example law={{'name': {table.law!r}, {needed!r}: {(example or [1.0])[0]}}}",
        )
    return None if table.law == "linear" else table


def made_of(
    mesh: TetMesh,
    notes: dict[str, str],
    stated: StatedOrgan,
    *,
    points_mm: Array | None = None,
    surface: Surface | None = None,
) -> MadeOrgan:
    """Return an organ from a mesh and from given material and supports.

    Parameters
    ----------
    mesh, notes
        Tetrahedra [m], and a dict of notes on the mesh, to which a note on the supports is added.
    stated
        Material and supports.
    points_mm
        Points to which a mask or indices of held points refer [mm]. If None, they refer to the
        nodes of the mesh.
    surface
        Surface that the mesh represents.

    Raises
    ------
    InputError
        If the mesh does not have a named part, or the support is not found.
    """
    stated.material.moduli_kPa(mesh.part_names)
    modulus_kPa = stated.material.modulus_kPa
    cited = constants("soft", "liver")["modulus_kPa"]
    if question := unusual_modulus("modulus_kPa", modulus_kPa, cited, "liver"):
        notes["modulus"] = f"{modulus_kPa:g} kPa. {question}"
    below = stated.held_below_mm
    hold, notes["held"] = hold_of(stated.held, below, mesh, points_mm)
    made = MadeOrgan(mesh, stated.material, hold, notes, surface, law=stated.law)
    with names_of_caller({"support": "held" if below is None else "held_below_mm"}):
        made.held  # noqa: B018 - what is not there is refused here
    return made


def size_note(volume_m3: float, scale_mm: float | None) -> dict[str, str]:
    """Return a note if the volume of an organ is implausible and the unit was not given."""
    volume_ml = 1e6 * volume_m3
    if scale_mm is not None or PLAUSIBLE_ML[0] <= volume_ml <= PLAUSIBLE_ML[1]:
        return {}
    return {
        "unit": f"an organ of {volume_ml:.3g} ml, if its unit is 1 mm. For another unit, give "
        "scale_mm, the millimetres per unit"
    }


def of_surface(
    surface: object,
    stated: StatedOrgan,
    *,
    edge_mm: float | None,
    inclusions: Mapping[str, object],
    scale_mm: float | None,
    report: Progress,
) -> MadeOrgan:
    """Return an organ inside a closed surface, with its inclusions as parts.

    Raises
    ------
    InputError
        If a surface is not closed or not in millimetres, or an inclusion extends beyond the organ,
        overlaps another inclusion or has no modulus.
    """
    from meshes.tets.tetrahedralise import FILL_EDGES, tetrahedralise

    without = [name for name in inclusions if name not in stated.material.parts]
    if without:
        raise InputError(
            "parts",
            "give a modulus for every inclusion",
            f"none for {without[0]}",
            "add the modulus in kPa",
        )
    # Refuse invalid materials before meshing, which takes minutes.
    stated.material.moduli_kPa(("body", *inclusions))
    outer = surface_of("surface", surface, scale_mm)
    usual = max(outer.report.size_mm) / FILL_EDGES
    edge = (
        usual
        if edge_mm is None
        else require_positive("edge_mm", edge_mm, f"use a value such as {usual:.2g}")
    )
    inner = {
        name: surface_of(f"inclusions[{name!r}]", each, scale_mm)
        for name, each in inclusions.items()
    }
    _require_apart(outer, inner, 1e-3 * ENVELOPE * edge)
    with names_of_caller({"edge_m": "edge_mm"}):
        mesh, sentences = tetrahedralise(outer, edge_m=1e-3 * edge, report=report)
    notes = {"mesh": " ".join((*outer.report.repairs, *sentences))}
    notes |= size_note(1e-9 * outer.report.volume_mm3, scale_mm)
    for name, each in inner.items():
        with names_of_caller({name: f"inclusions[{name!r}]"}):
            mesh, notes[name] = with_inclusion(
                mesh, name, each.vertices_m, each.faces, volume_m3=1e-9 * each.report.volume_mm3
            )
    return made_of(mesh, notes, stated, surface=outer)


def of_labels(
    labels: "Labels",
    stated: StatedOrgan,
    *,
    organ: str,
    edge_mm: float | None,
    report: Progress,
) -> MadeOrgan:
    """Return an organ made from a label image; its parts are the labels that have a modulus.

    Raises
    ------
    InputError
        If a label does not exist, a part does not touch the organ, or a value is out of range.
    """
    from meshes.organs.from_labels import labelled_organ

    organ = labels.names[labels.number(organ)]
    given = stated.material.parts.items()
    parts = {labels.names[labels.number(str(name))]: modulus for name, modulus in given}
    stated = replace(stated, material=replace(stated.material, parts=parts))
    stated.material.moduli_kPa((organ, *parts))
    found = labelled_organ(labels, organ, [name for name in parts if name != organ])
    mesh, notes = found.mesh(edge_mm, report=report)
    return made_of(mesh, notes, stated, surface=found.surface)


def _require_apart(outer: Surface, inclusions: Mapping[str, Surface], off_m: float) -> None:
    """Raise an error if an inclusion overlaps another, or leaves the organ, by over `off_m` [m]."""
    for name, each in inclusions.items():
        key = f"inclusions[{name!r}]"
        out = triangle_distance(outer.vertices_m, outer.faces, each.vertices_m)
        if out.min() > 0.0:
            raise InputError(
                key, "lie inside the surface", "an inclusion outside", "move the inclusion"
            )
        if out.max() > off_m:
            raise InputError(
                key,
                "lie inside the surface",
                f"an inclusion that extends {1e3 * float(out.max()):.3g} mm outside",
                "move the inclusion, or cut it off at the surface",
            )
        for other, before in inclusions.items():
            if other == name:
                break
            pairs = ((before, each), (each, before))
            deep = max(
                -float(triangle_distance(a.vertices_m, a.faces, b.vertices_m).min())
                for a, b in pairs
            )
            if deep > off_m:
                raise InputError(
                    key,
                    f"not overlap inclusions[{other!r}]",
                    f"an overlap {1e3 * deep:.3g} mm deep",
                    "subtract one inclusion from the other",
                )
