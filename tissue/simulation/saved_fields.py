"""Fields of a saved run, such as stress: names, units, colour scales, and meshes over time."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.base.arrays import Singles
from meshes.base.isolated_parser import parse_isolated
from tissue.simulation.run_folder import SavedRun, saved_placement
from tissue.simulation.vtk_files import in_scene, read_collection

if TYPE_CHECKING:
    import pyvista

PEAK = 99.8
"""Percentile of a field's cell values that is the upper end of its colour scale.

Only single cells at the tool have larger values.
"""
SPAN = 1e-3
"""Smallest ratio of lower to upper end of a logarithmic colour scale (three decades)."""
FAINT = 5.0
"""Percentile of the stress that is the lower end of a logarithmic colour scale.

The percentile is computed in the frame with the largest stress. The value was chosen by judgement.
"""
UNITS = {
    "mm3_s": "mm³/s",
    "mm_s": "mm/s",
    "rad_s": "rad/s",
    "N_mm2": "N/mm²",
    "N_mm": "N/mm",
    "kN_m": "kN/m",
    "N_m": "N/m",
    "kg_m3": "kg/m³",
    "Nm": "N m",
    "um": "µm",
    "us": "µs",
    "mm2": "mm²",
    "mm3": "mm³",
    "percent": "%",
    "C": "°C",
    "degC": "°C",
    **{unit: unit for unit in ("mm", "m", "Pa", "kPa", "MPa", "mN", "N", "J", "mJ", "K")},
    **{unit: unit for unit in ("s", "ms", "W", "Hz", "rpm")},
}
"""Notation of units, keyed by the end of a field name or column name.

Compound units come first, because their names end with the names of simple units.
"""
IN_MM = {"um": 1e-3, "mm": 1.0, "m": 1e3}
DISPLACEMENT = "displacement_"
STRESS = "von_mises_"


def field_label(name: str) -> tuple[str, str]:
    """Return readable name and unit of a field or column, such as ``("von Mises", "kPa")``.

    The example is for the name ``von_mises_kPa``. For a name without a unit, the unit is an empty
    text.
    """
    unit = next((unit for unit in UNITS if name.endswith(f"_{unit}")), "")
    words = name.removesuffix(f"_{unit}") if unit else name
    return words.replace("_", " ").replace("mises", "Mises"), UNITS.get(unit, "")


def field_names(folder: Path) -> list[str]:
    """Return the names of the fields in the folder of a run; empty for a run without fields.

    See `SavedFields.names`.
    """
    if not (folder / "fields.pvd").is_file():
        return []
    fields = SavedFields(folder)
    return fields.names if len(fields.times_s) else []


def require_whole(saved: SavedRun, *, surfaces: bool = False) -> None:
    """Check that the files with the bone and the frames of a run are not damaged.

    If `surfaces` is True, the files with surfaces are also checked. The check is needed because a
    damaged file can make VTK end this process.

    Raises
    ------
    InputError
        If a file is damaged or incomplete. The message names the file.
    """
    wanted = {"bone.vti": ["remaining", "layer", "density_kg_m3"]} if saved.complete else {}
    if (saved.path / "fields.pvd").is_file():
        wanted |= {name: [] for *_, name in read_collection(saved.path / "fields.pvd")}
    if surfaces:
        carving = (saved.path / "carving").glob("*.vtp")
        names = ("bone.vtp", *(f"carving/{path.name}" for path in carving))
        wanted |= {name: ["layer"] for name in names}
    there = {name: arrays for name, arrays in wanted.items() if (saved.path / name).is_file()}
    if there:
        parse_isolated(
            "meshes.surfaces.vtk_files:check_vtk",
            saved.path,
            what="folder of a run",
            remedy="run the scene again",
            arrays_by_file=there,
        )


class SavedFields:
    """Fields over time, read from ``fields.pvd`` and the files that it lists.

    Parameters
    ----------
    folder
        Folder of a run.

    Attributes
    ----------
    times_s
        Times of the frames [s], in increasing order.
    names
        Names of the fields that can be drawn. These fields have one number or one vector per cell
        or node. Von Mises stress comes first, then the other cell fields, then the node fields. For
        a vector, the magnitude is drawn.
    layer_names
        Names of the layers or parts to which cells belong.
    displacement
        Name of the field of nodal displacements, or None.
    unit_mm
        Unit of the displacement [mm]: 1 if the displacement is stored in mm, 1000 if in m.

    Raises
    ------
    InputError
        As for `tissue.simulation.vtk_files.read_collection`.
    """

    def __init__(self, folder: Path) -> None:
        import pyvista

        self._placement = saved_placement(folder)
        frames = read_collection(folder / "fields.pvd")
        self._files = [folder / file for *_, file in frames]
        self.times_s = np.array([time for time, *_ in frames])
        first: Any = pyvista.read(self._files[0]) if frames else pyvista.UnstructuredGrid()
        cells, points = (_shown(data) for data in (first.cell_data, first.point_data))
        cells.sort(key=lambda name: not name.startswith(STRESS))
        self.names = [*cells, *points]
        self.layer_names = tuple(str(name) for name in first.field_data.get("layer_names", ()))
        vectors = [
            name
            for name in points
            if name.startswith(DISPLACEMENT) and name.removeprefix(DISPLACEMENT) in IN_MM
        ]
        self.displacement = vectors[0] if vectors else None
        self.unit_mm = IN_MM[vectors[0].removeprefix(DISPLACEMENT)] if vectors else 1.0
        self._frames: list[Any] = []
        self._same: list[bool] = []
        self._limits: dict[str, tuple[float, float]] = {}

    @property
    def frames(self) -> list[Any]:
        """Undeformed meshes of all frames [mm], in the coordinate frame of the scene.

        The meshes are read at their first use.
        """
        if not self._frames:
            import pyvista

            frames = self._frames = [
                in_scene(pyvista.read(file), self._placement) for file in self._files
            ]
            self._same = [_same_mesh(a, b) for a, b in pairwise(frames)]
        return self._frames

    @property
    def size_mm(self) -> float:
        """Diagonal of the box around the first frame [mm]."""
        return float(self.frames[0].length) if self.frames else 0.0

    def at(self, time_s: float) -> "tuple[pyvista.UnstructuredGrid, float]":
        """Return the mesh at a time [s], and the time to which the values of the mesh belong [s].

        Values are interpolated linearly between two frames of the same mesh. If cells were removed
        between the frames, the earlier frame is returned.
        """
        frames = self.frames
        times = self.times_s
        # 1e-9 s allows for the rounding of the time of a frame.
        index = int(np.clip(np.searchsorted(times, time_s + 1e-9) - 1, 0, len(times) - 1))
        if index + 1 == len(times) or time_s <= times[index] + 1e-9 or not self._same[index]:
            return frames[index], float(times[index])
        early = frames[index]
        late = frames[index + 1]
        share = np.float32((time_s - times[index]) / (times[index + 1] - times[index]))
        mesh: pyvista.UnstructuredGrid = early.copy(deep=False)
        for kept, first, second in (
            (mesh.cell_data, early.cell_data, late.cell_data),
            (mesh.point_data, early.point_data, late.point_data),
        ):
            for name in first:
                if name in second and np.issubdtype(first[name].dtype, np.floating):
                    kept[name] = np.asarray(first[name]) + share * (
                        np.asarray(second[name]) - np.asarray(first[name])
                    )
        return mesh, float(time_s)

    def moved_mm(self, mesh: "pyvista.DataSet") -> Singles:
        """Return the displacement of the nodes, shape (nodes, 3), in mm.

        The displacement is zero if the run has no displacement field.
        """
        if self.displacement is None or self.displacement not in mesh.point_data:
            return np.zeros((mesh.n_points, 3), dtype=np.float32)
        moved: Singles = np.float32(self.unit_mm) * np.asarray(mesh.point_data[self.displacement])
        return moved

    def largest_mm(self) -> float:
        """Return the largest displacement over the whole run [mm]."""
        return max(
            (
                float(np.linalg.norm(self.moved_mm(one), axis=1).max(initial=0.0))
                for one in self.frames
            ),
            default=0.0,
        )

    def limits(self, name: str) -> tuple[float, float]:
        """Return the two ends of a field's colour scale for the whole run; see `field_limits`."""
        if name not in self._limits:
            values = [
                one for frame in self.frames if (one := field_values(frame, name)) is not None
            ]
            self._limits[name] = field_limits(name, values)
        return self._limits[name]


def field_limits(name: str, values: Sequence[Singles]) -> tuple[float, float]:
    """Return the two ends of a field's colour scale, computed from arrays of its values.

    The scale is symmetric about 0 if there are negative values. For von Mises stress the scale is
    logarithmic and begins above 0, because the stress decreases by several powers of ten with the
    distance from the tool.
    """
    values = [one[np.isfinite(one)] for one in values]
    values = [one for one in values if one.size]
    # Displacements are continuous, so no single values are much larger than the others.
    share = 100.0 if name.startswith(DISPLACEMENT) else PEAK
    peak = max((float(np.percentile(np.abs(one), share)) for one in values), default=0.0)
    # If the percentile is 0, the maximum is used; in a field of zeros, 1 is used.
    peak = peak or max((float(np.abs(one).max()) for one in values), default=0.0) or 1.0
    if any(float(one.min()) < 0.0 for one in values):
        return -peak, peak
    if not name.startswith(STRESS):
        return 0.0, peak
    widest = max(values, key=lambda one: float(one.max()), default=np.zeros(1, dtype=np.float32))
    # The scale covers at least one decade.
    return max(SPAN * peak, min(float(np.percentile(widest, FAINT)), 0.1 * peak)), peak


def field_values(mesh: "pyvista.DataSet", name: str) -> Singles | None:
    """Return the values of a field (magnitudes of vectors), or None if the mesh lacks the field."""
    data = mesh.cell_data if name in mesh.cell_data else mesh.point_data
    if name not in data:
        return None
    values = np.asarray(data[name])
    return values if values.ndim == 1 else np.linalg.norm(values, axis=1)


def _shown(data: "pyvista.DataSetAttributes") -> list[str]:
    return [
        n
        for n, values in data.items()
        if n != "layer" and (values.ndim == 1 or values.shape[1] == 3)
    ]


def _same_mesh(a: "pyvista.UnstructuredGrid", b: "pyvista.UnstructuredGrid") -> bool:
    return (
        a.n_points == b.n_points
        and a.n_cells == b.n_cells
        and np.array_equal(a.cell_connectivity, b.cell_connectivity)
        and np.array_equal(a.points, b.points)
    )
