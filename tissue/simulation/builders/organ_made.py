"""Organ with its mesh, material and supports."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.errors import InputError, by, names_of_caller, require_positive
from meshes.surfaces.surface import Surface
from meshes.tets.files import given_tets
from meshes.tets.regions import Nodes
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import nearest_on_triangles
from tissue.simulation.builders.organ_given import SoftMaterial, refined
from tissue.simulation.builders.organ_held import Hold, hold_of

if TYPE_CHECKING:
    from tissue.models.organ.soft_organ import SoftOrgan

__all__ = ["MadeOrgan", "OrganOptions", "made_of", "material_of", "of_tetrahedra", "require_known"]

TOUCHED_EDGES = 3.0
"""Radius around a point, in edges, that a tool of four edges is expected to touch."""


class OrganOptions(TypedDict, total=False):
    """Options that every organ takes; see `tissue.Organ.from_tetrahedra`."""

    held: str | ArrayLike
    held_below_mm: float | None
    order: Literal[1, 2]
    friction: float
    capsule: tuple[float, float] | None
    density_kg_m3: float | None
    relaxation: Sequence[tuple[float, float]]


@dataclass(frozen=True, eq=False)
class MadeOrgan:
    """Organ with its mesh, material and supports.

    Attributes
    ----------
    mesh, material
        Tetrahedra [m], and their material.
    hold
        Function that returns the held nodes of a mesh.
    notes
        Notes on findings and assumptions, by subject.
    surface
        Surface that the mesh represents; None for given tetrahedra.
    near
        Region that will be pressed: points [m], shape (k, 3), and the distance around them [m].
        None where unknown.
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
        """Organ at rest, ready to be solved."""
        organ = self.material.organ(self.mesh, self.held)
        if self.near is not None:
            organ.expect(*self.near)
        return organ

    @property
    def facts(self) -> dict[str, str]:
        """Size, mesh and moduli as text."""
        mesh = self.mesh
        material = self.material
        moduli = material.moduli_kPa(mesh.part_names).items()
        return {
            "size": (
                f"{by(1e3 * np.ptp(mesh.nodes_m, axis=0), '.3g')} mm, "
                f"{1e6 * float(mesh.volumes_m3.sum()):.4g} ml"
            ),
            "cells": f"{len(mesh.cells)} tetrahedra of order {material.order}",
            "moduli": ", ".join(f"{name} {value:g} kPa" for name, value in moduli),
            "compressibility": f"Poisson's ratio {material.poisson_ratio:g}",
        }

    def refined(self, edge_mm: float, near_mm: ArrayLike | None) -> "MadeOrgan":
        """Return the organ with shorter edges near some points, or on the whole surface.

        The points `near_mm` have shape (k, 3); each stands for the nearest point of the surface.

        Raises
        ------
        InputError
            If the edge is not positive, or the points do not have shape (k, 3).
        """
        edge = require_positive("edge_mm", edge_mm, "use a quarter of the tool's diameter")
        near = None
        if near_mm is not None:
            near = 1e-3 * np.atleast_2d(np.asarray(near_mm, dtype=np.float64))
            if near.ndim != 2 or near.shape[1] != 3 or not np.isfinite(near).all():
                raise InputError(
                    "near_mm",
                    "be points of shape (k, 3)",
                    f"shape {np.shape(near_mm)}",
                    "give x, y, z",
                )
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
    """Return an organ of a mesh.

    Parameters
    ----------
    mesh, notes
        Tetrahedra [m], and notes on them; a note on the supports is added.
    stated
        Fields of `SoftMaterial`, ``held`` and ``held_below_mm``; an entry of None counts as not
        stated.
    points_mm
        Points that ``held`` refers to [mm]; None for the mesh's nodes.
    surface
        Surface that the mesh represents.

    Raises
    ------
    InputError
        If a value is out of its range, the mesh lacks a part, or the support is not found.
    TypeError
        If something else is stated.
    """
    material = material_of(stated, mesh.part_names)
    held = "bottom" if stated.get("held") is None else stated["held"]
    below = stated.get("held_below_mm")
    hold, notes["held"] = hold_of(
        held, below, mesh, 1e3 * mesh.nodes_m if points_mm is None else points_mm
    )
    made = MadeOrgan(mesh, material, hold, notes, surface)
    with names_of_caller({"support": "held" if below is None else "held_below_mm"}):
        made.held  # noqa: B018 - what is not there is refused here
    return made


def of_tetrahedra(
    mesh: object,
    stated: dict[str, Any],
    *,
    scale_mm: float | None,
    part_names: Mapping[int, str] | None,
) -> MadeOrgan:
    """Return an organ of tetrahedra.

    Arguments are as for `meshes.tets.files.given_tets` and `made_of`.
    """
    given = given_tets(mesh, scale_mm=scale_mm, part_names=part_names)
    notes = {"mesh": " ".join(given.sentences)} if given.sentences else {}
    return made_of(given.mesh, notes, stated, points_mm=given.points_mm)


def require_known(stated: Iterable[str]) -> None:
    """Refuse an argument that no organ takes, as Python does for a listed signature."""
    known = {field.name for field in fields(SoftMaterial)} | set(OrganOptions.__annotations__)
    unknown = [name for name in stated if name not in known]
    if unknown:
        raise TypeError(
            f"Organ got an unexpected keyword argument {unknown[0]!r}. Beyond the arguments "
            "of its maker it takes "
            f"{', '.join(sorted(known))}."
        )


def material_of(stated: dict[str, Any], part_names: Sequence[str]) -> SoftMaterial:
    """Return the material of an organ of these parts; raises as `made_of`."""
    require_known(stated)
    of_material = {field.name for field in fields(SoftMaterial)}
    material = SoftMaterial(
        **{
            name: value
            for name, value in stated.items()
            if name in of_material and value is not None
        }
    )
    material.moduli_kPa(part_names)
    return material
