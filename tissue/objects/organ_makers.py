"""Constructors of a soft organ: tetrahedra, a surface, labels, a block or the liver.

The labels come from a segmentation; the liver is built in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal, Self, Unpack

from numpy.typing import ArrayLike

from meshes.base.errors import names_of_caller, require_vector
from meshes.base.progress import Progress, silent

if TYPE_CHECKING:
    from os import PathLike
    from pathlib import Path

    from meshes.ct.labels import Labels
    from tissue.materials.scene_constants import Materials
    from tissue.simulation.builders.organ_made import MadeOrgan, OrganOptions

__all__ = ["OrganMakers"]


class OrganMakers:
    """Constructors of an organ, as class methods of `tissue.Organ`."""

    def __init__(self, made: MadeOrgan) -> None:
        self._made = made

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
    ) -> Self:
        """Make an organ of tetrahedra.

        Parameters
        ----------
        mesh
            pyvista UnstructuredGrid, a mesh of meshio, points and cells as a pair of arrays, or a
            file (.vtu .vtk .msh .mesh). Its parts are a cell array of numbers or names, called
            ``part`` or by a mesher's usual name.
        modulus_kPa, poisson_ratio
            Young's modulus [kPa] and Poisson's ratio.
        parts
            Young's moduli of parts that differ, by name or number [kPa].
        part_names
            Names of numbered parts.
        scale_mm
            Millimetres per unit of the mesh. Without it the mesh must be in millimetres, and is
            refused if its size contradicts that.
        held
            Points that do not move: a side of the surface, the name of a part, a mask of the mesh's
            points, or their numbers. A side is ``bottom`` (-z), ``top``, ``-x``, ``+x`` and so on;
            it holds the faces within 60 degrees of that direction.
        held_below_mm
            Height z below which the surface is held instead [mm].
        order
            Order of the tetrahedra; linear ones are faster, but lock near incompressibility.
        friction
            Coulomb's coefficient between tool and organ.
        capsule
            Thickness [um] and Young's modulus [kPa] of a membrane on the whole surface.
        density_kg_m3
            Density [kg/m3]; where it is given, gravity along -z acts on the organ before it is
            touched.
        relaxation
            Pairs of a share of the modulus that relaxes and its relaxation time [s]; `modulus_kPa`
            is the instantaneous modulus.

        Raises
        ------
        InputError
            If the mesh cannot be used, is not in millimetres, or lacks a part.
        """
        from tissue.simulation.builders.organ_made import of_tetrahedra

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
    ) -> Self:
        """Make an organ inside a closed surface, filled with tetrahedra once and kept on disk.

        Parameters
        ----------
        surface
            Surface of pyvista or trimesh, vertices and triangles as a pair of arrays, or a file
            (.stl .obj .ply .vtk).
        modulus_kPa, poisson_ratio, parts, scale_mm, options
            As for `from_tetrahedra`.
        edge_mm
            Edge of the tetrahedra [mm]; default a fourteenth of the longest side.
        inclusions
            Closed surfaces inside the organ, by name. Each becomes a part, whose modulus `parts`
            gives.
        progress
            Called with the present work.

        Raises
        ------
        InputError
            If a surface is not closed or not in millimetres, or an inclusion sticks out or overlaps
            another one.
        """
        from tissue.simulation.builders.organ_filled import of_surface
        from tissue.simulation.builders.organ_made import require_known

        require_known(options)
        stated = {
            "modulus_kPa": modulus_kPa,
            "poisson_ratio": poisson_ratio,
            "parts": parts,
            **options,
        }
        inner = inclusions or {}
        return cls(
            of_surface(
                surface,
                stated,
                edge_mm=edge_mm,
                inclusions=inner,
                scale_mm=scale_mm,
                report=progress,
            )
        )

    @classmethod
    def from_labels(
        cls,
        labels: str | Path | Labels,
        *,
        organ: str,
        modulus_kPa: float,
        poisson_ratio: float,
        parts: Mapping[str | int, float] | None = None,
        names: str | Path | None = None,
        edge_mm: float | None = None,
        progress: Progress = silent,
        **options: Unpack[OrganOptions],
    ) -> Self:
        """Make an organ from a segmentation.

        Structures in it or on it, such as a tumour or a vessel, become parts.

        Its surface follows the labels without the steps of their voxels, and keeps their volume.
        The organ lies in the frame of the image: LPS, x to the patient's left, y to the back, z to
        the head.

        Parameters
        ----------
        labels
            Label image (.seg.nrrd .nrrd .nii.gz), a folder of masks, or labels already read.
        organ
            Name or number of the organ's label.
        modulus_kPa, poisson_ratio, options
            As for `from_tetrahedra`.
        parts
            Young's moduli of additional labels, by name or number [kPa]. Each label becomes a part.
        names
            Names of the labels for a file without names: ``totalsegmentator``, ``verse``, or a TOML
            file.
        edge_mm
            Edge of the tetrahedra [mm]; default a fourteenth of the longest side.
        progress
            Called with the present work.

        Raises
        ------
        InputError
            If there is no such label, or a part lies apart from the organ or is too small.
        """
        from tissue.simulation.builders.organ_filled import of_labels
        from tissue.simulation.builders.organ_made import require_known

        require_known(options)
        stated = {
            "modulus_kPa": modulus_kPa,
            "poisson_ratio": poisson_ratio,
            "parts": parts,
            **options,
        }
        return cls(
            of_labels(
                labels, stated, organ=str(organ), names=names, edge_mm=edge_mm, report=progress
            )
        )

    @classmethod
    def block(
        cls,
        size_mm: Sequence[float],
        *,
        modulus_kPa: float,
        poisson_ratio: float,
        edge_mm: float | None = None,
        **options: Unpack[OrganOptions],
    ) -> Self:
        """Make a block of tissue bonded to the ground, with z up.

        The origin is at the middle of its top face.

        Parameters
        ----------
        size_mm
            Sides along x, y and z [mm].
        modulus_kPa, poisson_ratio, options
            As for `from_tetrahedra`.
        edge_mm
            Edges at the top face [mm], which grow downwards; default a fourteenth of the longest
            side.
        """
        from meshes.organs.liver import slab
        from meshes.tets.tetrahedralise import FILL_EDGES
        from tissue.simulation.builders.organ_made import made_of

        x, y, z = require_vector("size_mm", size_mm)
        edge = max(x, y, z) / FILL_EDGES if edge_mm is None else edge_mm
        with names_of_caller({"spacing_m": "edge_mm", "size_m": "size_mm"}):
            mesh = slab(size_m=(1e-3 * x, 1e-3 * y, 1e-3 * z), spacing_m=1e-3 * edge)
        return cls(
            made_of(
                mesh, {}, {"modulus_kPa": modulus_kPa, "poisson_ratio": poisson_ratio, **options}
            )
        )

    @classmethod
    def liver(
        cls,
        *,
        modulus_kPa: float | None = None,
        poisson_ratio: float | None = None,
        materials: str | PathLike[str] | Materials | None = None,
        edge_mm: float = 20.0,
        **options: Unpack[OrganOptions],
    ) -> Self:
        """Make the procedural liver of the scenes.

        The origin is on top of the right lobe, with z to the head and x to the left.

        Parameters
        ----------
        modulus_kPa, poisson_ratio, options
            As for `from_tetrahedra`; the defaults are the cited values, 5.4 kPa and 0.49.
        materials
            File of constants in place of the cited ones, as `tissue fit` writes it.
        edge_mm
            Edge of the tetrahedra [mm].

        Raises
        ------
        InputError
            If the file cannot be used, or holds neither modulus nor Poisson's ratio of the liver.
        """
        from meshes.organs.liver import liver
        from tissue.simulation.builders.organ_made import made_of
        from tissue.simulation.builders.own_constants import soft_constants

        stated = {"modulus_kPa": modulus_kPa, "poisson_ratio": poisson_ratio}
        with names_of_caller(
            {"organ.young_kPa": "modulus_kPa", "organ.poisson_ratio": "poisson_ratio"}
        ):
            taken, notes = soft_constants(materials, "liver", stated)
        with names_of_caller({"spacing_m": "edge_mm"}):
            mesh = liver(spacing_m=1e-3 * edge_mm)
        return cls(made_of(mesh, notes, {**taken, **options}))
