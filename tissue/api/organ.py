"""A soft organ in the hand: from tetrahedra, a surface or a shape, pressed at any number of places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.errors import InputError, names_of_caller, require_positive, require_range, require_vector
from meshes.base.progress import Progress, silent
from tissue.api.press import Press, grid_of, html_table

if TYPE_CHECKING:
    import pyvista

    from tissue.api.tools import PressingTool
    from tissue.builders.organ_made import MadeOrgan, OrganOptions
    from tissue.models.organ.soft_organ import SoftOrgan

__all__ = ["Organ"]

SPEED_MM_S = 10.0
"""Speed of a press where none is given [mm/s]."""


class Organ:
    """A soft organ that may be pressed; `from_tetrahedra`, `from_surface`, `block` and `liver` make one.

    Linear elastic, in the frame of its mesh, lengths in millimetres. Its stiffness is factorised at the first press,
    for all that follow.
    """

    def __init__(self, made: MadeOrgan) -> None:
        self._made = made
        self.notes = made.notes
        """What was found and assumed, by what it is about."""
        self.moduli_kPa = made.material.moduli_kPa(made.mesh)
        """Young's modulus of each part by its name [kPa]."""

    @classmethod
    def from_tetrahedra(
        cls,
        mesh: object,
        *,
        modulus_kPa: float,
        poisson_ratio: float,
        parts: Mapping[str | int, float] | None = None,
        part_names: Mapping[int, str] | None = None,
        scale_mm: float | None = None,
        held: str | ArrayLike = "bottom",
        held_below_mm: float | None = None,
        order: Literal[1, 2] = 2,
        friction: float = 0.3,
        capsule: tuple[float, float] | None = None,
        density_kg_m3: float | None = None,
        relaxation: Sequence[tuple[float, float]] = (),
    ) -> Organ:
        """An organ of tetrahedra.

        Parameters
        ----------
        mesh
            pyvista UnstructuredGrid, a mesh of meshio, points and cells as a pair of arrays, or a file (.vtu .vtk .msh
            .mesh). Its parts are an array over the cells named ``part`` (or as meshers name them), of numbers or names.
        modulus_kPa, poisson_ratio
            Young's modulus [kPa] and Poisson's ratio.
        parts
            Young's moduli of parts that differ, by name or number [kPa].
        part_names
            Names of numbered parts.
        scale_mm
            Millimetres per unit of the mesh; without it the mesh is in millimetres, and refused where its size is not.
        held
            What does not move: a side of the surface, which is what faces ``bottom`` (-z), ``top``, ``-x``, ``+x`` and
            so on within 60 degrees; the name of a part; a mask of the mesh's points, or their numbers.
        held_below_mm
            Instead, the surface below this height z [mm].
        order
            Order of the tetrahedra; linear ones are quicker and lock near incompressibility.
        friction
            Coulomb's coefficient between tool and organ.
        capsule
            Thickness [um] and Young's modulus [kPa] of a membrane on the whole surface.
        density_kg_m3
            With it the organ lies in its own weight, along -z, before it is touched.
        relaxation
            Pairs of the share of the modulus that relaxes and its time [s]; `modulus_kPa` is that of the first instant.

        Raises
        ------
        InputError
            If the mesh cannot be used, is not in millimetres, or lacks a part.
        """
        from tissue.builders.organ_made import of_tetrahedra

        stated = {
            "modulus_kPa": modulus_kPa,
            "poisson_ratio": poisson_ratio,
            "parts": parts,
            "held": held,
            "held_below_mm": held_below_mm,
            "order": order,
            "friction": friction,
            "capsule": capsule,
            "density_kg_m3": density_kg_m3,
            "relaxation": relaxation,
        }
        return cls(of_tetrahedra(mesh, stated, scale_mm=scale_mm, part_names=part_names))

    @classmethod
    def from_surface(
        cls,
        surface: object,
        *,
        modulus_kPa: float,
        poisson_ratio: float,
        edge_mm: float | None = None,
        inclusions: Mapping[str, object] | None = None,
        parts: Mapping[str | int, float] | None = None,
        scale_mm: float | None = None,
        progress: Progress = silent,
        **options: Unpack[OrganOptions],
    ) -> Organ:
        """An organ inside a closed surface, filled with tetrahedra once and kept on disk.

        Parameters
        ----------
        surface
            Surface of pyvista or trimesh, vertices and triangles as a pair of arrays, or a file (.stl .obj .ply .vtk).
        modulus_kPa, poisson_ratio, parts, scale_mm, options
            As of `from_tetrahedra`.
        edge_mm
            Edge of the tetrahedra [mm]; without it a fourteenth of the longest side.
        inclusions
            Closed surfaces of what lies inside, by name: each is a part, whose modulus `parts` gives.
        progress
            Called with what is being done.

        Raises
        ------
        InputError
            If a surface is not closed or not in millimetres, or an inclusion lies outside.
        """
        from tissue.builders.organ_made import of_surface

        stated = {"modulus_kPa": modulus_kPa, "poisson_ratio": poisson_ratio, "parts": parts, **options}
        inner = inclusions or {}
        return cls(of_surface(surface, stated, edge_mm=edge_mm, inclusions=inner, scale_mm=scale_mm, report=progress))

    @classmethod
    def block(
        cls,
        size_mm: Sequence[float],
        *,
        modulus_kPa: float,
        poisson_ratio: float,
        edge_mm: float | None = None,
        **options: Unpack[OrganOptions],
    ) -> Organ:
        """A block of tissue: the origin at the middle of its top face, z up, bonded to the ground.

        Parameters
        ----------
        size_mm
            Sides along x, y and z [mm].
        modulus_kPa, poisson_ratio, options
            As of `from_tetrahedra`.
        edge_mm
            Edges at the top face [mm], which grow downwards; without it a fourteenth of the longest side.
        """
        from meshes.organs.liver import slab
        from tissue.builders.organ_made import FILL_EDGES, made_of

        x, y, z = require_vector("size_mm", size_mm)
        edge = max(x, y, z) / FILL_EDGES if edge_mm is None else edge_mm
        with names_of_caller({"spacing_m": "edge_mm", "size_m": "size_mm"}):
            mesh = slab(size_m=(1e-3 * x, 1e-3 * y, 1e-3 * z), spacing_m=1e-3 * edge)
        return cls(made_of(mesh, {}, {"modulus_kPa": modulus_kPa, "poisson_ratio": poisson_ratio, **options}))

    @classmethod
    def liver(
        cls,
        *,
        modulus_kPa: float = 5.4,
        poisson_ratio: float = 0.49,
        edge_mm: float = 20.0,
        **options: Unpack[OrganOptions],
    ) -> Organ:
        """The procedural liver of the scenes: the origin on top of the right lobe, z to the head, x to the left.

        Parameters
        ----------
        modulus_kPa, poisson_ratio, options
            As of `from_tetrahedra`; the defaults are the cited values.
        edge_mm
            Edge of the tetrahedra [mm].
        """
        from meshes.organs.liver import liver
        from tissue.builders.organ_made import made_of

        with names_of_caller({"spacing_m": "edge_mm"}):
            mesh = liver(spacing_m=1e-3 * edge_mm)
        return cls(made_of(mesh, {}, {"modulus_kPa": modulus_kPa, "poisson_ratio": poisson_ratio, **options}))

    def refined(self, *, edge_mm: float, near_mm: ArrayLike | None = None) -> Organ:
        """The same organ with shorter edges where a tool goes; a press wants a quarter of the tool's diameter.

        Parameters
        ----------
        edge_mm
            Longest edge there [mm]; edges grow by half the distance from there.
        near_mm
            Places [mm], shape (k, 3) or (3,), each moved to the nearest point of the surface; without them all of it.
            Presses at these places are quick from the second on; elsewhere each takes some seconds more.
        """
        return Organ(self._made.refined(edge_mm, near_mm))

    @cached_property
    def mesh(self) -> pyvista.UnstructuredGrid:
        """The tetrahedra [mm], with ``part`` over the cells and ``held`` over the points."""
        grid = grid_of(self._made.mesh)
        grid.point_data["held"] = np.isin(np.arange(grid.n_points), self._made.held)
        return grid

    def surface(self) -> pyvista.PolyData:
        """The organ's surface [mm]."""
        return self.mesh.extract_surface(algorithm="dataset_surface")

    @property
    def soft(self) -> SoftOrgan:
        """The organ as it is solved."""
        return self._made.soft

    def press(
        self,
        tool: PressingTool,
        *,
        depth_mm: float,
        at_mm: ArrayLike,
        along: ArrayLike | None = None,
        speed_mm_s: float | None = None,
        hold_s: float = 0.0,
    ) -> Press:
        """Press a tool into the organ at rest, step by step from where it first touches.

        Parameters
        ----------
        tool
            `tissue.ball`, `tissue.flat_punch` or `tissue.probe_from_file`.
        depth_mm
            How far it goes on from its first touch [mm].
        at_mm
            Place [mm]; the nearest point of the surface is taken, and refused where it is far.
        along
            Direction that the tool comes along; without it straight into the surface.
        speed_mm_s, hold_s
            Speed [mm/s] and time that it stays [s], of an organ with `relaxation` alone.

        Raises
        ------
        InputError
            If the place is far from the surface, cannot move, or the tool has no free path to it.
        """
        from tissue.builders.organ_press import press_at

        if self.soft.prony is None and (speed_mm_s is not None or hold_s):
            given = "hold_s" if hold_s else "speed_mm_s"
            raise InputError(f"{given} must be left out for an organ that does not relax: make it with relaxation")
        depth = require_positive("depth_mm", depth_mm, "use a third of the tool's radius")
        stated = press_at(
            self.soft,
            tool.shape,
            1e-3 * require_vector("at_mm", np.asarray(at_mm, dtype=np.float64)),
            None if along is None else require_vector("along", np.asarray(along, dtype=np.float64)),
            depth_m=1e-3 * depth,
            speed_m_s=1e-3 * require_positive("speed_mm_s", speed_mm_s or SPEED_MM_S, "use 10"),
            hold_s=require_range("hold_s", hold_s, 0.0, 3600.0, "use 0 for none"),
        )
        return Press(tool, 1e3 * stated.point_m, stated.along, stated.notes, stated.curve, self._made.mesh)

    def plot(self, **options: Any) -> Any:
        """Show the parts, cut open, and what is held; `options` are those of ``pyvista.Plotter.show``."""
        from tissue.api.organ_picture import plot_organ

        return plot_organ(self, **options)

    def _repr_html_(self) -> str:
        return html_table("Organ", self._made.facts | self.notes)

    def __repr__(self) -> str:
        return f"Organ({'; '.join(self._made.facts.values())}; held: {self.notes['held']})"
