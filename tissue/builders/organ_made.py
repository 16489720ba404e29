"""An organ made from what a caller has: tetrahedra, or a surface with what lies in it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.errors import InputError, by, names_of_caller, require_positive
from meshes.base.progress import Progress
from meshes.surfaces.surface import Surface
from meshes.tets.given import given_tets
from meshes.tets.regions import Nodes
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import nearest_on_triangles
from tissue.builders.organ_given import SoftMaterial, refined, surface_of, with_inclusion
from tissue.builders.organ_held import Hold, hold_of

if TYPE_CHECKING:
    from tissue.models.organ.soft_organ import SoftOrgan

__all__ = ["FILL_EDGES", "MadeOrgan", "OrganOptions", "made_of", "of_surface", "of_tetrahedra"]

FILL_EDGES = 14.0
"""Edges along the longest side where no edge is given."""

TOUCHED_EDGES = 3.0
"""Edges around a place that a tool of four edges is expected to touch."""


class OrganOptions(TypedDict, total=False):
    """Options that every organ takes; `tissue.Organ.from_tetrahedra` states what they are."""

    held: str | ArrayLike
    held_below_mm: float | None
    order: Literal[1, 2]
    friction: float
    capsule: tuple[float, float] | None
    density_kg_m3: float | None
    relaxation: Sequence[tuple[float, float]]


@dataclass(frozen=True, eq=False)
class MadeOrgan:
    """An organ as it was made.

    Attributes
    ----------
    mesh, material
        Tetrahedra [m], and what they are made of.
    hold
        What is held of a mesh.
    notes
        What was found and assumed, by what it is about.
    surface
        The surface that the mesh stands for; None of tetrahedra that were given.
    near
        Where it will be pressed: points [m], shape (k, 3), and the distance around them [m]; None where unknown.
    """

    mesh: TetMesh
    material: SoftMaterial
    hold: Hold
    notes: dict[str, str]
    surface: Surface | None = None
    near: tuple[NDArray[np.float64], float] | None = None

    @cached_property
    def held(self) -> Nodes:
        """Nodes that do not move."""
        return self.hold(self.mesh)

    @cached_property
    def soft(self) -> "SoftOrgan":
        """The organ at rest, as it is solved."""
        organ = self.material.organ(self.mesh, self.held)
        if self.near is not None:
            organ.expect(*self.near)
        return organ

    @property
    def facts(self) -> dict[str, str]:
        """Size, mesh and moduli in words."""
        mesh, material = self.mesh, self.material
        moduli = material.moduli_kPa(mesh).items()
        return {
            "size": f"{by(1e3 * np.ptp(mesh.nodes_m, axis=0), '.3g')} mm, {1e6 * float(mesh.volumes_m3.sum()):.4g} ml",
            "cells": f"{len(mesh.cells)} tetrahedra of order {material.order}",
            "moduli": ", ".join(f"{name} {value:g} kPa" for name, value in moduli),
            "compressibility": f"Poisson's ratio {material.poisson_ratio:g}",
        }

    def refined(self, edge_mm: float, near_mm: ArrayLike | None) -> "MadeOrgan":
        """The same organ with shorter edges where the surface is nearest to some points, shape (k, 3), or on all of it.

        Raises
        ------
        InputError
            If the edge is not positive, or the points are none.
        """
        edge, near = require_positive("edge_mm", edge_mm, "use a quarter of the tool's diameter"), None
        if near_mm is not None:
            near = 1e-3 * np.atleast_2d(np.asarray(near_mm, dtype=np.float64))
            if near.ndim != 2 or near.shape[1] != 3 or not np.isfinite(near).all():
                raise InputError(f"near_mm must be points of shape (k, 3), got shape {np.shape(near_mm)}: give x, y, z")
            near = nearest_on_triangles(self.mesh.nodes_m, self.mesh.surface, near)
        mesh = refined(self.mesh, self.surface, edge_m=1e-3 * edge, near_m=near)
        expected = None if near is None else (near, TOUCHED_EDGES * 1e-3 * edge)
        return MadeOrgan(mesh, self.material, self.hold, self.notes, self.surface, expected)


def made_of(
    mesh: TetMesh,
    notes: dict[str, str],
    stated: dict[str, Any],
    *,
    points_mm: NDArray[np.float64] | None = None,
    surface: Surface | None = None,
) -> MadeOrgan:
    """An organ of a mesh.

    Parameters
    ----------
    mesh, notes
        Tetrahedra [m], and what is known of them; what is held is added.
    stated
        Fields of `SoftMaterial`, ``held`` and ``held_below_mm``; None is as if it were not there.
    points_mm
        Points that ``held`` numbers [mm]; None: the mesh's nodes.
    surface
        The surface that the mesh stands for.

    Raises
    ------
    InputError
        If a value is out of its range, the mesh lacks a part, or what should be held is not there.
    TypeError
        If something else is stated.
    """
    known = {field.name for field in fields(SoftMaterial)} | set(OrganOptions.__annotations__)
    unknown = [name for name in stated if name not in known]
    if unknown:
        raise TypeError(f"Organ got an unexpected keyword argument {unknown[0]!r}: it takes {', '.join(sorted(known))}")
    rest = {name: value for name, value in stated.items() if value is not None}
    held, below = rest.pop("held", "bottom"), rest.pop("held_below_mm", None)
    hold, notes["held"] = hold_of(held, below, mesh, 1e3 * mesh.nodes_m if points_mm is None else points_mm)
    made = MadeOrgan(mesh, SoftMaterial(**rest), hold, notes, surface)
    made.material.moduli_kPa(mesh)
    with names_of_caller({"support": "held" if below is None else "held_below_mm"}):
        made.held  # noqa: B018 - what is not there is refused here
    return made


def of_tetrahedra(
    mesh: object, stated: dict[str, Any], *, scale_mm: float | None, part_names: Mapping[int, str] | None
) -> MadeOrgan:
    """An organ of tetrahedra; arguments as of `meshes.tets.given.given_tets` and `made_of`."""
    given = given_tets(mesh, scale_mm=scale_mm, part_names=part_names)
    notes = {"mesh": " ".join(given.sentences)} if given.sentences else {}
    return made_of(given.mesh, notes, stated, points_mm=given.points_mm)


def of_surface(
    surface: object,
    stated: dict[str, Any],
    *,
    edge_mm: float | None,
    inclusions: Mapping[str, object],
    scale_mm: float | None,
    report: Progress,
) -> MadeOrgan:
    """An organ inside a closed surface, what lies in the inclusions being parts.

    Raises
    ------
    InputError
        If a surface is not closed or not in millimetres, an inclusion lies outside or has no modulus.
    """
    from meshes.tets.tetrahedralise import tetrahedralise

    without = [name for name in inclusions if name not in (stated.get("parts") or {})]
    if without:
        raise InputError(f"parts must give a modulus of every inclusion, got none of {without[0]}: add it in kPa")
    outer = surface_of("surface", surface, scale_mm)
    longest = max(outer.report.size_mm)
    edge = (
        longest / FILL_EDGES
        if edge_mm is None
        else require_positive("edge_mm", edge_mm, f"use {longest / FILL_EDGES:.2g}")
    )
    words = {
        "edge_m": "edge_mm",
        "surface must enclose a solid, got none of edge": "edge_mm must fill the surface, got",
    }
    with names_of_caller(words):
        mesh, sentences = tetrahedralise(outer, edge_m=1e-3 * edge, report=report)
    notes = {"mesh": " ".join((*outer.report.repairs, *sentences))}
    for name, each in inclusions.items():
        mesh, notes[name] = with_inclusion(mesh, name, surface_of(f"inclusions[{name!r}]", each, scale_mm))
    return made_of(mesh, notes, stated, surface=outer)
