"""The stress in the window of `tissue view`: the frame of the moment, cut open at the tool."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyvista

__all__ = ["FieldsShown", "field_names"]

PEAK = 99.8
"""Percentile of the stress that ends its scale: single cells at the tool stand out from it."""
SPAN = 1e-3
"""Lowest stress of a logarithmic scale, as a share of its highest."""


def field_names(folder: Path) -> list[str]:
    """Names of the cell fields that a run's folder holds, one number a cell; von Mises stress comes first."""
    if not (folder / "fields.pvd").is_file():
        return []
    reader = _reader(folder)
    if not reader.time_values:
        return []
    return _names(_frame(reader, 0))


class FieldsShown:
    """Fields over time in a plotter; nothing is shown until `show` is called.

    Parameters
    ----------
    plotter
        Where they are shown.
    folder
        A run's folder with ``fields.pvd``.
    cut_mm
        Coordinate y of the plane that the mesh is cut open at; what lies before it is left out [mm].

    Attributes
    ----------
    name
        The field that is shown, or None.
    """

    def __init__(self, plotter: Any, folder: Path, *, cut_mm: float) -> None:
        self._plotter, self._cut_mm = plotter, cut_mm
        self._reader = _reader(folder)
        self._times = np.array(self._reader.time_values)
        self._frames: list[Any] = []
        self._limits: dict[str, tuple[float, float]] = {}
        self._index = 0
        self.names = field_names(folder)
        self.name: str | None = None
        self._title = ""

    def next(self) -> str | None:
        """Show the next field, after the last one none; its name."""
        choices = [*self.names, None]
        self.show(choices[0] if self.name is None else choices[choices.index(self.name) + 1])
        return self.name

    def show(self, name: str | None) -> None:
        """Show a field, or none."""
        self.name = name
        self._draw()

    def at(self, time_s: float) -> None:
        """Show the moment: the last frame up to it."""
        index = int(np.clip(np.searchsorted(self._times, time_s + 1e-9) - 1, 0, len(self._times) - 1))
        if index != self._index:
            self._index = index
            if self.name is not None:
                self._draw()

    def _draw(self) -> None:
        plotter = self._plotter
        plotter.remove_actor("field", reset_camera=False, render=False)
        if self._title in plotter.scalar_bars:
            plotter.remove_scalar_bar(self._title, render=False)
        if self.name is None:
            return
        if not self._frames:
            self._frames = [_frame(self._reader, index) for index in range(len(self._times))]
        frame = self._frames[self._index]
        if self.name not in frame.cell_data:
            return
        mesh = frame.clip(normal=(0.0, -1.0, 0.0), origin=(0.0, self._cut_mm + 1e-4, 0.0))
        if not mesh.n_cells:
            return
        if self.name not in self._limits:
            self._limits[self.name] = self._limit(self.name)
        low, high = self._limits[self.name]
        signed = low < 0.0
        actor = plotter.add_mesh(
            mesh,
            scalars=self.name,
            preference="cell",
            cmap="coolwarm" if signed else "inferno",
            clim=(low, high),
            log_scale=not signed,
            name="field",
            ambient=0.6,
            diffuse=0.45,
            show_scalar_bar=False,
            reset_camera=False,
            render=False,
        )
        words, _, unit = self.name.rpartition("_")
        words = words.replace("_", " ").replace("mises", "Mises")
        self._title = f"{words} / {unit}\nat {self._times[self._index]:.3f} s"
        plotter.add_scalar_bar(
            self._title,
            mapper=actor.mapper,
            vertical=True,
            position_x=0.88,
            position_y=0.42,
            height=0.42,
            width=0.06,
            color="black",
            fmt="%.2g",
            title_font_size=14,
            label_font_size=14,
            render=False,
        )

    def _limit(self, name: str) -> tuple[float, float]:
        """Ends of a field's scale over the whole run; symmetric about 0 where it has two signs."""
        values: list[NDArray[np.float32]] = [frame.cell_data[name] for frame in self._frames if name in frame.cell_data]
        peak = max((float(np.percentile(np.abs(one), PEAK)) for one in values if one.size), default=0.0) or 1.0
        signed = any(float(one.min(initial=0.0)) < 0.0 for one in values)
        return (-peak, peak) if signed else (SPAN * peak, peak)


def _reader(folder: Path) -> Any:
    import pyvista

    return pyvista.get_reader(folder / "fields.pvd")


def _frame(reader: Any, index: int) -> "pyvista.UnstructuredGrid":
    reader.set_active_time_point(index)
    mesh: pyvista.UnstructuredGrid = reader.read()[0]
    return mesh


def _names(mesh: "pyvista.UnstructuredGrid") -> list[str]:
    names = [name for name, values in mesh.cell_data.items() if name != "layer" and values.ndim == 1]
    return sorted(names, key=lambda name: (not name.startswith("von_mises"), names.index(name)))
