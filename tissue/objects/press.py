"""Result of a press: force over depth, and the organ at the end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, in_brackets
from meshes.tets.tetrahedra import grid_of

if TYPE_CHECKING:
    import pandas as pd
    import pyvista

    from meshes.tets.tetrahedra import TetMesh
    from tissue.models.organ.press import PressCurve
    from tissue.objects.tools import PressingTool

__all__ = ["Press", "html_table"]

SLOPE_SHARE = 0.1
"""Share of the depth, at its end, over which the stiffness is computed."""


@dataclass(frozen=True, eq=False)
class Press:
    """Press of a tool on an organ, made by `Organ.press`.

    Forces act on the tool, in the mesh's frame.

    Attributes
    ----------
    tool
        Tool that pressed.
    at_mm, along
        Target point of the surface [mm] and unit direction of the tool's motion, shape (3,) each.
    notes
        Notes on findings and assumptions, by subject. Read `linear` before using the force of a
        deep press.
    """

    tool: PressingTool
    at_mm: Array
    along: Array
    notes: dict[str, str]
    _curve: PressCurve
    _mesh: TetMesh

    @property
    def depth_mm(self) -> Array:
        """Depth of the tool from its first contact at every step [mm], shape (n,)."""
        return 1e3 * self._curve.depth_m

    @property
    def time_s(self) -> Array:
        """Time since the first contact at every step [s], shape (n,)."""
        return self._curve.time_s

    @property
    def forces_N(self) -> Array:
        """Force on the tool at every step [N], shape (n, 3)."""
        return self._curve.force_N

    @property
    def areas_mm2(self) -> Array:
        """Area of the contact at every step [mm2], shape (n,)."""
        return 1e6 * self._curve.area_m2

    @property
    def force_N(self) -> Array:
        """Force on the tool at the end [N], shape (3,)."""
        return self.forces_N[-1]

    @property
    def force_magnitude_N(self) -> float:
        """Size of the force at the end [N]."""
        return float(np.linalg.norm(self.force_N))

    @property
    def area_mm2(self) -> float:
        """Area of the contact at the end [mm2]."""
        return float(self.areas_mm2[-1])

    @property
    def tip_mm(self) -> Array:
        """Position of the tool's tip at the end [mm], shape (3,)."""
        return 1e3 * self._curve.tip_m

    @property
    def stiffness_N_mm(self) -> float:
        """Slope of the force along the press over the last tenth of the depth [N/mm]."""
        depth = self.depth_mm
        force = -self.forces_N @ self.along
        last = int(np.argmax(depth >= depth[-1]))
        first = int(np.searchsorted(depth[: last + 1], (1.0 - SLOPE_SHARE) * depth[-1]))
        first = min(first, last - 1)
        return float((force[last] - force[first]) / (depth[last] - depth[first]))

    @cached_property
    def mesh(self) -> pyvista.UnstructuredGrid:
        """Organ at rest with its fields at the end of the press, in the mesh's frame [mm].

        The point arrays are ``displacement_mm`` and ``reaction_N``. The cell arrays are
        ``von_mises_kPa``, ``principal_stress_kPa``, ``strain_percent`` and ``part``, which is an
        index into the field ``part_names``.
        """
        grid = grid_of(self._mesh)
        for name, values in self._curve.frame.points.items():
            grid.point_data[name] = values
        for name, values in self._curve.frame.cells.items():
            grid.cell_data[name] = values
        return grid

    def plot(self, **options: Any) -> Any:
        """Show the pressed organ, coloured by its displacement, and the tool.

        Parameters
        ----------
        options
            ``scalars``, another field of `mesh`, and options of ``pyvista.Plotter.show``, such as
            ``screenshot``.
        """
        from tissue.objects.organ_picture import plot_press

        return plot_press(self, **options)

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row per step: depth, force and contact area.

        Units are in the names.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as problem:
            raise InputError(
                "pandas", "be installed for a table", "none", "pip install 'tissue-sim[pandas]'"
            ) from problem
        x, y, z = self.forces_N.T
        columns = {
            "time_s": self.time_s,
            "depth_mm": self.depth_mm,
            "force_x_N": x,
            "force_y_N": y,
            "force_z_N": z,
        }
        size = np.linalg.norm(self.forces_N, axis=1)
        return pd.DataFrame(columns | {"force_N": size, "area_mm2": self.areas_mm2})

    @property
    def tool_mesh(self) -> pyvista.PolyData:
        """Tool at the end of the press [mm]."""
        place = np.eye(4)
        place[:3, :3] = self._curve.rotation
        place[:3, 3] = self.tip_mm
        return self.tool.surface.transform(place, inplace=False)

    @property
    def _place(self) -> str:
        return in_brackets(np.round(self.at_mm, 3) + 0.0)

    def _repr_html_(self) -> str:
        rows = {
            "tool": str(self.tool),
            "place": f"{self._place} mm",
            "depth": f"{self.depth_mm[-1]:g} mm",
            "force": f"{self.force_magnitude_N:.4g} N",
            "stiffness": f"{self.stiffness_N_mm:.4g} N/mm",
            "contact": f"{self.area_mm2:.4g} mm²",
        }
        return html_table("Press", rows | self.notes)

    def __repr__(self) -> str:
        return (
            f"Press({self.tool} at {self._place} mm: {self.force_magnitude_N:.4g} N at "
            f"{self.depth_mm[-1]:g} mm, "
            f"{self.stiffness_N_mm:.4g} N/mm, {self.area_mm2:.4g} mm2; "
            f"{'; '.join(self.notes.values())})"
        )


def html_table(title: str, rows: Mapping[str, str]) -> str:
    """Return names and values as a table for a notebook."""
    lines = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows.items()
    )
    return f"<table><caption>{escape(title)}</caption>{lines}</table>"
