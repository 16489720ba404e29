"""Soft organ object: made from tetrahedra, a surface or a shape, and pressed by tools."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.errors import InputError, require_positive, require_range, require_vector
from meshes.base.progress import Progress, silent
from meshes.tets.tetrahedra import grid_of
from tissue.objects.organ_makers import OrganMakers
from tissue.objects.press import Press, html_table

if TYPE_CHECKING:
    import pyvista

    from tissue.models.organ.soft_organ import SoftOrgan
    from tissue.objects.tools import PressingTool
    from tissue.simulation.builders.organ_made import MadeOrgan

__all__ = ["Organ"]

SPEED_MM_S = 10.0
"""Default speed of a press [mm/s]."""


class Organ(OrganMakers):
    """Soft organ that may be pressed.

    `from_tetrahedra`, `from_surface`, `from_labels`, `block` and `liver` make one.

    It is linear elastic, in the frame of its mesh, with lengths in millimetres. Its stiffness is
    factorised once, at the first press.
    """

    def __init__(self, made: MadeOrgan) -> None:
        super().__init__(made)
        self.notes = made.notes
        """Notes on findings and assumptions, by subject."""
        self.moduli_kPa = made.material.moduli_kPa(made.mesh.part_names)
        """Young's modulus of each part by its name [kPa]."""

    def refined(self, *, edge_mm: float, near_mm: ArrayLike | None = None) -> Organ:
        """Return the organ with shorter edges near the tool.

        A press needs edges of a quarter of the tool's diameter.

        Parameters
        ----------
        edge_mm
            Longest edge near the tool [mm]; edges grow by half the distance from there.
        near_mm
            Points [mm], shape (k, 3) or (3,), each moved to the nearest point of the surface;
            default the whole surface. Presses at these points are fast from the second one on.
            Presses elsewhere take some seconds longer each.
        """
        return Organ(self._made.refined(edge_mm, near_mm))

    @cached_property
    def mesh(self) -> pyvista.UnstructuredGrid:
        """Tetrahedra [mm], with ``part`` over the cells and ``held`` over the points."""
        grid = grid_of(self._made.mesh)
        grid.point_data["held"] = np.isin(np.arange(grid.n_points), self._made.held)
        return grid

    def surface(self) -> pyvista.PolyData:
        """Return the organ's surface [mm]."""
        return self.mesh.extract_surface(algorithm="dataset_surface")

    @property
    def soft(self) -> SoftOrgan:
        """Organ ready to be solved."""
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
        """Press a tool into the organ at rest, step by step from its first contact.

        Parameters
        ----------
        tool
            `tissue.ball`, `tissue.flat_punch` or `tissue.probe_from_file`.
        depth_mm
            Depth of the press from the first contact [mm].
        at_mm
            Point [mm]; the nearest point of the surface is used, and refused if it is far away.
        along
            Direction of the tool's motion; default straight into the surface.
        speed_mm_s, hold_s
            Speed [mm/s] and holding time [s], only for an organ with `relaxation`.
        progress
            Called with the present work and its completed share (0 to 1).

        Raises
        ------
        InputError
            If the point is far from the surface or cannot move, or the tool has no free path to it.
        """
        from tissue.simulation.builders.organ_press import press_at

        if self.soft.prony is None and (speed_mm_s is not None or hold_s):
            given = "hold_s" if hold_s else "speed_mm_s"
            raise InputError(
                f"{given} must be left out for an organ that does not relax: make it with "
                "relaxation"
            )
        depth = require_positive("depth_mm", depth_mm, "use a third of the tool's radius")
        stated = press_at(
            self.soft,
            tool.shape,
            1e-3 * require_vector("at_mm", np.asarray(at_mm, dtype=np.float64)),
            None if along is None else require_vector("along", np.asarray(along, dtype=np.float64)),
            depth_m=1e-3 * depth,
            speed_m_s=1e-3 * require_positive("speed_mm_s", speed_mm_s or SPEED_MM_S, "use 10"),
            hold_s=require_range("hold_s", hold_s, 0.0, 3600.0, "use 0 for none"),
            report=progress,
        )
        return Press(
            tool, 1e3 * stated.point_m, stated.along, stated.notes, stated.curve, self._made.mesh
        )

    def plot(self, **options: Any) -> Any:
        """Show the parts, cut open, and the supports.

        `options` are options of ``pyvista.Plotter.show``.
        """
        from tissue.objects.organ_picture import plot_organ

        return plot_organ(self, **options)

    def _repr_html_(self) -> str:
        return html_table("Organ", self._made.facts | self.notes)

    def __repr__(self) -> str:
        return f"Organ({'; '.join(self._made.facts.values())}; held: {self.notes['held']})"
