"""Soft organ that tools can press, made from tetrahedra, a surface, a segmentation or a shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.errors import (
    InputError,
    names_of_caller,
    require_positive,
    require_range,
    require_vector,
)
from meshes.base.hints import suggests_arguments
from meshes.base.progress import Progress, silent
from meshes.tets.tetrahedra import grid_of
from tissue.objects.html import table_html
from tissue.objects.press import MATTE, Press, new_plotter, press_at, shaded
from tissue.objects.tools import PressingTool
from tissue.system.offscreen import quiet_without_display

if TYPE_CHECKING:
    from os import PathLike
    from pathlib import Path

    import pyvista

    from meshes.ct.labels import Labels
    from meshes.images.reading import Spacing
    from tissue.materials.scene_constants import Materials
    from tissue.models.organ.soft_organ import SoftOrgan
    from tissue.simulation.builders.organ_made import MadeOrgan, OrganOptions

SPEED_MM_S = 10.0
"""Default speed of a press [mm/s]; it has an effect only on an organ with relaxation."""
TISSUE = (0.93, 0.78, 0.72)
HELD = (0.35, 0.45, 0.6)


@suggests_arguments
class Organ:
    """Soft organ that tools can press.

    `from_tetrahedra`, `from_surface`, `from_labels`, `block` and `liver` make an organ.

    The organ is linear elastic or hyperelastic. Positions are in the frame of its mesh, in
    millimetres. The stiffness matrix is factorised once, at the first press.
    """

    def __init__(self, made: MadeOrgan) -> None:
        self._made = made
        self.notes = made.notes
        """Notes on findings and assumptions, keyed by subject."""
        self.moduli_kPa = made.material.moduli_kPa(made.mesh.part_names)
        """Young's modulus of each part [kPa], keyed by the name of the part."""

    @classmethod
    def from_tetrahedra(
        cls,
        mesh: object,
        *,
        modulus_kPa: float,
        poisson_ratio: float,
        part_names: Mapping[int, str] | None = None,
        scale_mm: float | None = None,
        **options: Unpack[OrganOptions],
    ) -> Organ:
        """Make an organ of tetrahedra.

        Parameters
        ----------
        mesh
            A pyvista UnstructuredGrid, a meshio mesh, a pair of arrays (points, cells), or a file
            (.vtu .vtk .msh .mesh). If the mesh has a cell array of part numbers or names, it
            assigns the tetrahedra to parts. This array must be named ``part``, or have a name that
            common mesh generators use.
        modulus_kPa, poisson_ratio
            Young's modulus [kPa] and Poisson's ratio.
        parts
            Young's moduli [kPa] of parts whose modulus differs from `modulus_kPa`, keyed by the
            name or number of the part.
        part_names
            Names of parts, keyed by the number of the part in the mesh.
        scale_mm
            Millimetres per unit of the mesh; default 1. A mesh with an implausible size is refused.
        held
            Points that do not move: a side of the surface, the name of a part, a mask over the
            points of the mesh, or point indices. A side is ``bottom`` (-z), ``top`` (+z), ``-x``,
            ``+x`` and so on. A side consists of the faces whose outward normals are within 60
            degrees of its direction.
        held_below_mm
            Height z below which points of the surface do not move [mm]; an alternative to `held`.
        order
            Order of the tetrahedra, 1 or 2. Linear tetrahedra (1) are faster, but too stiff
            (locking) for a Poisson's ratio near 0.5.
        friction
            Coulomb friction coefficient between tool and organ.
        capsule
            Thickness [um] and Young's modulus [kPa] of a membrane on the whole surface.
        density_kg_m3
            Density [kg/m3]. With a density, gravity along -z deforms the organ before the first
            contact.
        relaxation
            Terms of a Prony series: pairs of a share of the modulus and a relaxation time [s]. With
            `relaxation`, `modulus_kPa` is the instantaneous modulus.
        law
            Hyperelastic law, written as in the scene key `organ.law`: ``"neo-hookean"`` or
            ``{"name": "yeoh", "square_ratio": 0.5}``. A hyperelastic law cannot be combined with a
            density. The default is the linear law.

        Raises
        ------
        InputError
            If the mesh cannot be used or has an implausible size, or a named part does not exist.
        """
        from meshes.tets.files import given_tets
        from tissue.simulation.builders.organ_made import StatedOrgan, made_of, size_note

        stated = StatedOrgan.of(modulus_kPa, poisson_ratio, options)
        given = given_tets(mesh, scale_mm=scale_mm, part_names=part_names)
        notes = {"mesh": " ".join(given.sentences)} if given.sentences else {}
        notes |= size_note(float(given.mesh.volumes_m3.sum()), scale_mm)
        return cls(made_of(given.mesh, notes, stated, points_mm=given.points_mm))

    @classmethod
    def from_surface(
        cls,
        surface: object,
        *,
        modulus_kPa: float,
        poisson_ratio: float,
        edge_mm: float | None = None,
        inclusions: Mapping[str, object] | None = None,
        scale_mm: float | None = None,
        progress: Progress = silent,
        **options: Unpack[OrganOptions],
    ) -> Organ:
        """Make an organ that fills a closed surface; its mesh is kept in a cache on disk.

        Parameters
        ----------
        surface
            A pyvista or trimesh surface, a pair of arrays (vertices, triangles), or a file (.stl
            .obj .ply .vtk).
        modulus_kPa, poisson_ratio, parts, scale_mm, options
            As for `from_tetrahedra`.
        edge_mm
            Edge length of the tetrahedra [mm]; default 1/14 of the longest side of the organ's
            bounding box. Edges at the surface may be much shorter: the mesh deviates from the
            surface by at most a tenth of this length, and by at most 0.4 mm.
        inclusions
            Closed surfaces inside the organ, keyed by name. The volume inside each surface becomes
            a part with the name of the surface; `parts` gives its modulus.
        progress
            Function that is called with the name of the current work and its completed share (0 to
            1).

        Raises
        ------
        InputError
            If a surface is not closed or not in millimetres, or an inclusion extends beyond the
            organ or overlaps another inclusion.
        """
        from tissue.simulation.builders.organ_made import StatedOrgan, of_surface

        stated = StatedOrgan.of(modulus_kPa, poisson_ratio, options)
        return cls(
            of_surface(
                surface,
                stated,
                edge_mm=edge_mm,
                inclusions=inclusions or {},
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
        names: str | Path | None = None,
        spacing_mm: Spacing | None = None,
        edge_mm: float | None = None,
        progress: Progress = silent,
        **options: Unpack[OrganOptions],
    ) -> Organ:
        """Make an organ from a segmentation.

        Structures listed in `parts`, such as a tumour or a vessel, become parts of the organ with
        their own moduli.

        The surface of the organ is smooth, and encloses the same volume as the voxels of the label.
        The organ lies in the frame of the image (LPS): x points to the patient's left, y to the
        back, z to the head.

        Parameters
        ----------
        labels
            Label image (.seg.nrrd .nrrd .nii.gz), DICOM segmentation, folder of masks, folder of
            slices, or a `Labels` object.
        organ
            Name or number of the label of the organ.
        modulus_kPa, poisson_ratio, options
            As for `from_tetrahedra`.
        parts
            Young's moduli [kPa] of labels other than `organ`, keyed by name or number. Each of
            these labels becomes a part.
        names
            Source of the label names if the file has none: ``totalsegmentator``, ``verse``, or a
            TOML file.
        spacing_mm
            Spacing of the voxels [mm], one or three numbers; needed if the file does not contain
            it.
        edge_mm
            Edge length of the tetrahedra [mm]; default 1/14 of the longest side.
        progress
            Function that is called with the name of the current work and its completed share (0 to
            1).

        Raises
        ------
        InputError
            If a label does not exist, or a part does not touch the organ or is too small.
        """
        from meshes.ct.labels import Labels, read_labels
        from tissue.simulation.builders.organ_made import StatedOrgan, of_labels

        stated = StatedOrgan.of(modulus_kPa, poisson_ratio, options)
        with names_of_caller({"path": "labels", "anatomy.spacing_mm": "spacing_mm"}):
            known = (
                labels
                if isinstance(labels, Labels)
                else read_labels(labels, names=names, spacing_mm=spacing_mm)
            )
        return cls(of_labels(known, stated, organ=str(organ), edge_mm=edge_mm, report=progress))

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
        """Make a block of tissue with a fixed bottom face; z points up.

        The origin is at the middle of the top face.

        Parameters
        ----------
        size_mm
            Sides along x, y and z [mm].
        modulus_kPa, poisson_ratio, options
            As for `from_tetrahedra`.
        edge_mm
            Edge length of the tetrahedra at the top face [mm]; default 1/14 of the longest side.
            The edge length increases downwards.
        """
        from meshes.organs.liver import slab
        from meshes.tets.tetrahedralise import FILL_EDGES
        from tissue.simulation.builders.organ_made import StatedOrgan, made_of

        x, y, z = require_vector("size_mm", size_mm)
        edge = max(x, y, z) / FILL_EDGES if edge_mm is None else edge_mm
        with names_of_caller({"spacing_m": "edge_mm", "size_m": "size_mm"}):
            mesh = slab(size_m=(1e-3 * x, 1e-3 * y, 1e-3 * z), spacing_m=1e-3 * edge)
        stated = StatedOrgan.of(modulus_kPa, poisson_ratio, options)
        return cls(made_of(mesh, {}, stated))

    @classmethod
    def liver(
        cls,
        *,
        modulus_kPa: float | None = None,
        poisson_ratio: float | None = None,
        materials: str | PathLike[str] | Materials | None = None,
        edge_mm: float = 20.0,
        **options: Unpack[OrganOptions],
    ) -> Organ:
        """Make the liver of the built-in scenes; formulas define its shape.

        The origin is on top of the right lobe. The z axis points to the head, and x to the left.

        Parameters
        ----------
        modulus_kPa, poisson_ratio, options
            As for `from_tetrahedra`. The defaults are the built-in values from the literature, 5.4
            kPa and 0.49.
        materials
            File of constants that replace the built-in values, in the format that `tissue fit`
            writes.
        edge_mm
            Edge length of the tetrahedra [mm].

        Raises
        ------
        InputError
            If the file cannot be used, or contains neither the modulus nor Poisson's ratio of the
            liver.
        """
        from meshes.organs.liver import liver
        from tissue.materials.scene_constants import Materials
        from tissue.scene.used_constants import Used
        from tissue.simulation.builders.arguments import given_note
        from tissue.simulation.builders.organ_made import StatedOrgan, made_of

        given = Materials.of(materials)
        cited = given.constants("soft", "liver")
        stated = {"modulus_kPa": modulus_kPa, "poisson_ratio": poisson_ratio}
        used = [
            Used("soft, liver", name, cited[name], f"soft.liver.{name}", value)
            for name, value in stated.items()
        ]
        with names_of_caller(
            {"organ.young_kPa": "modulus_kPa", "organ.poisson_ratio": "poisson_ratio"}
        ):
            notes = given_note(given, used, layers=(), by="organ")
        taken = {
            name: cited[name].value if value is None else value for name, value in stated.items()
        }
        with names_of_caller({"spacing_m": "edge_mm"}):
            mesh = liver(spacing_m=1e-3 * edge_mm)
        return cls(made_of(mesh, notes, StatedOrgan.of(**taken, options=options)))

    def refined(self, *, edge_mm: float, near_mm: ArrayLike | None = None) -> Organ:
        """Return a copy of the organ with a finer mesh near points where a tool will press.

        For a press, the length of the edges under the tool should be a quarter of the tool's
        diameter.

        Parameters
        ----------
        edge_mm
            Longest edge at the points `near_mm` [mm]. Elsewhere, the longest edge is `edge_mm` plus
            half of the distance to the nearest of these points.
        near_mm
            Points [mm], shape (k, 3) or (3,), near which the mesh is refined; default the whole
            surface. Each point is moved to the nearest point of the surface. Presses at these
            points are fast, except for the first press. Each press elsewhere takes some seconds
            longer.
        """
        return Organ(self._made.refined(edge_mm, near_mm))

    @cached_property
    def mesh(self) -> pyvista.UnstructuredGrid:
        """Mesh of the organ [mm], with the parts of cells (``part``) and held points (``held``)."""
        grid = grid_of(self._made.mesh)
        grid.point_data["held"] = np.isin(np.arange(grid.n_points), self._made.held)
        return grid

    def surface(self) -> pyvista.PolyData:
        """Return the organ's surface [mm]."""
        return self.mesh.extract_surface(algorithm="dataset_surface")

    @property
    def soft(self) -> SoftOrgan:
        """Finite-element model of the organ, with the assembled system of equations."""
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
        progress: Progress = silent,
    ) -> Press:
        """Press a tool into the undeformed organ in steps of depth, starting at first contact.

        Parameters
        ----------
        tool
            Tool that `tissue.ball`, `tissue.flat_punch` or `tissue.probe_from_file` returned.
        depth_mm
            Depth of the press from the first contact [mm].
        at_mm
            Target point [mm], shape (3,). The tool presses at the nearest point of the surface. A
            target far from the surface is refused.
        along
            Direction of the tool's motion; default perpendicular to the surface, into the organ.
        speed_mm_s, hold_s
            Speed of the press [mm/s], and time for which the tool stays at the final depth [s].
            Both have an effect only for an organ with `relaxation`.
        progress
            Function that is called with the name of the current work and its completed share (0 to
            1).

        Raises
        ------
        InputError
            If the target point is far from the surface or is a held point, or if the organ blocks
            the tool's path to it.
        """
        if self.soft.prony is None and (speed_mm_s is not None or hold_s):
            given = "hold_s" if hold_s else "speed_mm_s"
            raise InputError(
                given,
                "be left out for an organ that does not relax",
                hold_s or speed_mm_s,
                "remove it, or make the organ with relaxation",
            )
        depth = require_positive("depth_mm", depth_mm, "use a third of the tool's radius")
        return press_at(
            self._made.mesh,
            self.soft,
            tool,
            1e-3 * require_vector("at_mm", at_mm),
            along,
            depth_m=1e-3 * depth,
            speed_m_s=1e-3
            * require_positive("speed_mm_s", speed_mm_s or SPEED_MM_S, "use a value such as 10"),
            hold_s=require_range("hold_s", hold_s, 0.0, 3600.0, "use 0 for no hold"),
            report=progress,
        )

    @quiet_without_display()
    def plot(self, **options: Any) -> Any:
        """Show the organ with a translucent surface, its parts and its held points.

        `options` are options of ``pyvista.Plotter.show``; ``off_screen`` and ``notebook`` are
        passed to the plotter.
        """
        from tissue.show.figures.figure import OTHER_LAYERS

        grid = self.mesh
        names = list(self.moduli_kPa)
        plotter = new_plotter(options)
        # An organ with a single part needs no translucent surface.
        alone = len(names) == 1
        plotter.add_mesh(shaded(grid), color=TISSUE, opacity=1.0 if alone else 0.35, **MATTE)
        for number, name in enumerate(names[1:], 1):
            part = grid.extract_cells(np.asarray(grid.cell_data["part"]) == number)
            colour = OTHER_LAYERS[-number % len(OTHER_LAYERS)]
            plotter.add_mesh(
                shaded(part), color=colour, label=f"{name}: {self.moduli_kPa[name]:g} kPa"
            )
        held = np.asarray(grid.points)[np.asarray(grid.point_data["held"])]
        plotter.add_points(
            held, color=HELD, point_size=7, render_points_as_spheres=True, label="held"
        )
        # The text fills the height of the legend: 4 % of the picture for each line.
        plotter.add_legend(loc="upper left", face="circle", size=(0.3, 0.04 * len(names)))  # type: ignore[call-arg]
        plotter.add_axes()  # type: ignore[call-arg]
        return plotter.show(**options)

    def _repr_html_(self) -> str:
        return table_html((self._made.facts | self.notes).items(), caption="Organ")

    def __repr__(self) -> str:
        return f"Organ({'; '.join(self._made.facts.values())}; held: {self.notes['held']})"
