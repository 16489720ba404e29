"""Press of a tool on an organ, with force over depth and the deformed organ as results."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError, in_brackets, names_of_caller, require_direction
from meshes.base.hints import suggests_arguments
from meshes.base.progress import Progress
from meshes.tets.regions import place_on_surface
from meshes.tets.tetrahedra import TetMesh, grid_of
from tissue.models.organ.probe import AREA_EDGE, ProbeShape, SphereProbe
from tissue.motion.motion import frame_along
from tissue.objects.html import table_html
from tissue.objects.tools import PressingTool
from tissue.objects.trace import needed
from tissue.system.offscreen import quiet_without_display

if TYPE_CHECKING:
    import pandas as pd
    import pyvista

    from tissue.models.organ.model import OrganModel
    from tissue.models.organ.press import PressCurve
    from tissue.models.organ.soft_organ import SoftOrgan

SLOPE_SHARE = 0.1
"""Share of the depth over which the stiffness is computed: the last 10 of 100 steps."""
LARGEST_OFFSET_RATIO = 0.1
"""Largest accepted ratio of a point's distance from the surface to the organ's longest side.

A point farther away is treated as a mistake, for example in the unit. The value is a design choice.
"""
NEAR_M = 1e-4
"""Distance from the surface below which a point counts as a point of the surface [m]."""
TOOL_EDGES = 4.0
"""Recommended number of mesh edges across the diameter of the tool; also the default in scenes."""
FALLS = 0.05
"""Accepted relative decrease of the force with depth; it occurs when nodes enter the contact."""
LONG = 1.25
"""Ratio of edge length to recommended edge length, above which a note is added to the result.

The force error of a press is 4 % if the edges are twice as long as recommended, and 0.1 % if they
have the recommended length.
"""
WORDS = {"point_m": "at_mm", "motion": "at_mm", "touch_edge_m": "edges of the mesh"}
"""Arguments of the public method that replace arguments of `press` in messages."""
ACROSS = 7
"""Number of tool positions along each axis of the region in which a loop can touch the organ.

The nodes that can get into contact are searched with a margin around each position, so the
positions need not be close together. The number is a design choice.
"""
LAW_INTERVAL_S = 0.025
"""Time between two solutions of the hyperelastic deformation in a loop [s]."""
TOOL = (0.45, 0.48, 0.52)
COLOURS = "YlOrRd"
"""Colour map of the displacement; small displacements are light."""
MATTE: Any = {
    "show_edges": True,
    "edge_opacity": 0.2,
    "ambient": 0.35,
    "diffuse": 0.7,
    "specular": 0.0,
}


class Moves(TypedDict):
    """Arguments for the motion of a press; see `tissue.models.organ.press.press`."""

    depth_m: float
    speed_m_s: float
    hold_s: float
    report: Progress


@suggests_arguments
@dataclass(frozen=True, eq=False)
class Press:
    """Result of a press of a tool on an organ, returned by `Organ.press`.

    Forces act on the tool and are given in the frame of the mesh.

    Attributes
    ----------
    tool
        Tool of the press.
    at_mm, along
        Point of the surface at which the tool presses [mm], and unit vector of the tool's motion,
        each of shape (3,).
    notes
        Notes on assumptions and on limits of the model, keyed by subject. For a ball, the note
        ``linear`` gives the depth up to which linear elasticity is valid.
    """

    tool: PressingTool
    at_mm: Array
    along: Array
    notes: dict[str, str]
    _curve: PressCurve
    _mesh: TetMesh

    @property
    def depth_mm(self) -> Array:
        """Depth of the tool below its first contact [mm] at every step, shape (n,)."""
        return 1e3 * self._curve.depth_m

    @property
    def time_s(self) -> Array:
        """Time since the first contact [s] at every step, shape (n,)."""
        return self._curve.time_s

    @property
    def forces_N(self) -> Array:
        """Force on the tool [N] at every step, shape (n, 3)."""
        return self._curve.force_N

    @property
    def areas_mm2(self) -> Array:
        """Area of the contact [mm2] at every step, shape (n,)."""
        return 1e6 * self._curve.area_m2

    @property
    def force_N(self) -> Array:
        """Force on the tool at the end [N], shape (3,)."""
        return self.forces_N[-1]

    @property
    def force_magnitude_N(self) -> float:
        """Magnitude of the force at the end [N]."""
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
        """Slope of the force in the press direction over the last tenth of the depth [N/mm]."""
        depth = self.depth_mm
        force = -self.forces_N @ self.along
        last = int(np.argmax(depth >= depth[-1]))
        first = int(np.searchsorted(depth[: last + 1], (1.0 - SLOPE_SHARE) * depth[-1]))
        first = min(first, last - 1)
        return float((force[last] - force[first]) / (depth[last] - depth[first]))

    @cached_property
    def mesh(self) -> pyvista.UnstructuredGrid:
        """Undeformed mesh [mm], with displacement, stress and strain at the end of the press.

        The point arrays are ``displacement_mm`` and ``reaction_N``. The cell arrays are
        ``von_mises_kPa``, ``principal_stress_kPa``, ``strain_percent`` and ``part``. The array
        ``part`` holds indices into the field array ``part_names``.
        """
        grid = grid_of(self._mesh)
        for name, values in self._curve.frame.points.items():
            grid.point_data[name] = values
        for name, values in self._curve.frame.cells.items():
            grid.cell_data[name] = values
        return grid

    @quiet_without_display()
    def plot(self, *, scalars: str = "displacement_mm", **options: Any) -> Any:
        """Show the deformed organ in cross-section, with the tool.

        Parameters
        ----------
        scalars
            Array of `mesh` that sets the colour. For a vector array the magnitude is shown.
        options
            Options of ``pyvista.Plotter.show``; ``off_screen``, ``notebook`` and ``window_size``
            are passed to the plotter.

        Raises
        ------
        InputError
            If the mesh does not have this array.
        """
        from matplotlib import colormaps

        from tissue.show.figures.figure import field_words

        moved = self.mesh.copy()
        known = [*moved.point_data, *moved.cell_data]
        if scalars not in known:
            raise InputError(
                "scalars", f"be one of {', '.join(known)}", scalars, "use displacement_mm"
            )
        moved.points = moved.points + moved.point_data["displacement_mm"]
        data = moved.point_data if scalars in moved.point_data else moved.cell_data
        values = np.asarray(data[scalars])
        title = field_words(scalars)
        data[title] = values if values.ndim == 1 else np.linalg.norm(values, axis=1)
        across = _across(self.along)
        half = shaded(moved.clip(normal=across, origin=self.at_mm))
        plotter = new_plotter(options)
        bar: Any = {
            "title": title,
            "n_labels": 3,
            "vertical": True,
            "position_x": 0.86,
            "position_y": 0.2,
            "height": 0.6,
        }
        plotter.add_mesh(half, scalars=title, cmap=colormaps[COLOURS], scalar_bar_args=bar, **MATTE)
        part = np.asarray(moved.cell_data["part"])
        for number in np.unique(part[part > 0]):
            outline = (
                moved.extract_cells(part == number)
                .extract_surface(algorithm="dataset_surface")
                .slice(normal=across, origin=self.at_mm)
            )
            if outline.n_cells:
                outline.points = outline.points + 0.1 * across  # in front of the cut
                plotter.add_mesh(outline, color="black", line_width=2)
        plotter.add_mesh(self.tool_mesh, color=TOOL, smooth_shading=True)
        middle = np.asarray(moved.center)
        size = float(np.linalg.norm(np.ptp(moved.points, axis=0)))
        # The camera looks from the cut side and from above, and shows the whole body.
        plotter.camera_position = [
            middle + size * (1.9 * across - 0.5 * self.along),
            middle,
            -self.along,
        ]
        plotter.add_text(
            f"{self.force_magnitude_N:.3g} N at {self.depth_mm[-1]:.3g} mm\n{self.tool}",
            font_size=11,
            color="black",
        )
        plotter.add_axes()  # type: ignore[call-arg]
        return plotter.show(**options)

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with depth, force and contact area, one row per step.

        The column names contain the units.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        x, y, z = self.forces_N.T
        columns = {
            "time_s": self.time_s,
            "depth_mm": self.depth_mm,
            "force_x_N": x,
            "force_y_N": y,
            "force_z_N": z,
        }
        size = np.linalg.norm(self.forces_N, axis=1)
        table: pd.DataFrame = needed("pandas", extra="pandas").DataFrame(
            columns | {"force_N": size, "area_mm2": self.areas_mm2}
        )
        return table

    @property
    def tool_mesh(self) -> pyvista.PolyData:
        """Surface of the tool at the end of the press [mm]."""
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
        return table_html((rows | self.notes).items(), caption="Press")

    def __repr__(self) -> str:
        facts = f"{self.stiffness_N_mm:.4g} N/mm, {self.area_mm2:.4g} mm2"
        return (
            f"Press({self.tool} at {self._place} mm: {self.force_magnitude_N:.4g} N at "
            f"{self.depth_mm[-1]:g} mm, "
            f"{'; '.join((facts, *self.notes.values()))})"
        )


def press_at(
    mesh: TetMesh,
    organ: SoftOrgan,
    tool: PressingTool,
    at_m: Array,
    along: ArrayLike | None,
    **moves: Unpack[Moves],
) -> Press:
    """Press a tool on the surface point that is nearest to a given point.

    Parameters
    ----------
    mesh, organ, tool
        Mesh of the organ, finite-element model of the organ, and the tool.
    at_m
        The given point [m], shape (3,).
    along
        Direction of the tool's motion, shape (3,). If None, the tool moves into the organ, opposite
        to the mean surface normal under the tool.
    moves
        Depth, speed, holding time and progress, as for `tissue.models.organ.press.press`.

    Raises
    ------
    InputError
        If the point is far from the surface, the direction points out of the organ, or the path of
        the tool to the point is blocked.
    """
    from tissue.models.organ.press import press

    probe = tool.shape
    size = float(np.ptp(mesh.nodes_m, axis=0).max())
    point, normal = place_on_surface(mesh, at_m, probe.size_m[0])
    away = float(np.linalg.norm(point - at_m))
    notes = {}
    # Adding 0.0 turns -0.0 into 0.0.
    nearest = in_brackets(np.round(1e3 * point, 3) + 0.0)
    found = f"use the nearest point of the surface, {nearest} mm, which is {1e3 * away:.3g} mm away"
    if away > LARGEST_OFFSET_RATIO * size:
        raise InputError("at_mm", "lie on the surface", in_brackets(1000.0 * at_m, ".4g"), found)
    if away > NEAR_M:
        notes["place"] = (
            f"at_mm lies {1e3 * away:.3g} mm from the surface, so the nearest point of the "
            f"surface is used: {nearest} mm"
        )
    direction = -normal if along is None else require_direction("along", along)
    if direction @ normal >= 0.0:
        inward = in_brackets(0.0 - normal, ".2g")
        raise InputError(
            "along", "point into the organ", in_brackets(direction, ".3g"), f"use {inward}"
        )
    with names_of_caller(WORDS):
        curve = press(organ, probe, point, frame_along(-direction), **moves)
    _require_growing(curve, relaxes=organ.prony is not None)
    notes |= _resolution(mesh, probe, point, order=organ.space.order)
    if organ.law is None:
        notes |= _linear(probe, moves["depth_m"])
    other = [each for each in curve.notices if "linear elasticity" not in each]
    if other:
        notes["contact"] = "; ".join(other)
    return Press(tool, 1e3 * point, direction, notes, curve, mesh)


def _require_growing(curve: PressCurve, *, relaxes: bool) -> None:
    """Raise an error if the force of a press decreases with depth.

    The force decreases if the surface wraps around the tool, which the linear law does not model.
    """
    size = np.linalg.norm(curve.force_N, axis=1)
    falls = np.flatnonzero(size < (1.0 - FALLS) * np.maximum.accumulate(size))
    # The force also decreases in tissue that relaxes.
    if relaxes or not (falls.size or not size.any()):
        return
    most = (
        1e3 * float(curve.depth_m[int(np.argmax(size[: falls[0] + 1]))])
        if falls.size and size.any()
        else 0.0
    )
    remedy = f"use at most {most:.2g} mm" if most else "use a smaller depth"
    raise InputError(
        "depth_mm",
        "be a depth up to which the force increases",
        f"{1e3 * curve.depth_m[-1]:.3g}, where the computed force decreases, unlike in real tissue",
        f"{remedy}, or refine the organ near the contact",
    )


def _resolution(mesh: TetMesh, probe: ProbeShape, point_m: Array, *, order: int) -> dict[str, str]:
    """Return a note if mesh edges are too long for the force or for the contact area of a ball.

    Only the edges under the tool count. `order` is the order of the tetrahedra.
    """
    corners = mesh.nodes_m[mesh.surface]
    near = np.linalg.norm(corners.mean(axis=1) - point_m, axis=1)
    radius = probe.size_m[0]
    # Triangles under the middle of the tool; at least the nearest triangle is used.
    chosen = corners[near <= max(0.5 * radius, float(near.min()))]
    edge = float(np.linalg.norm(chosen - np.roll(chosen, 1, axis=1), axis=2).max())
    wanted = 2.0 * radius / TOOL_EDGES
    if edge <= LONG * wanted:
        # Quadratic tetrahedra have a node in the middle of an edge.
        limit = AREA_EDGE * radius * order
        if not isinstance(probe, SphereProbe) or edge <= limit:
            return {}
        # Half of the limit, because the longest edges of a mesh are up to 1.5 times edge_mm.
        return {
            "contact area": "area_mm2 may be wrong by 10 % or more: nodes under the ball "
            f"are up to {1e3 * edge / order:.3g} mm apart, and the ball has a radius of "
            f"{1e3 * radius:.3g} mm. Refine the organ there with edge_mm={0.5e3 * limit:.2g} or "
            "less"
        }
    return {
        "mesh": f"the edges under the tool are up to {1e3 * edge:.3g} mm long, but a tool of "
        f"{2e3 * radius:.3g} mm needs edges of {1e3 * wanted:.3g} mm or less: refine the organ "
        "there"
    }


def _linear(probe: ProbeShape, depth_m: float) -> dict[str, str]:
    """Return a note on the depth up to which the linear law is valid.

    This depth is known only for balls.
    """
    from tissue.models.organ.model import LINEAR_ERROR

    if not isinstance(probe, SphereProbe):
        return {"linear": "the depth up to which the linear law is valid is known only for balls"}
    limits = [(1e3 * share * probe.radius_m, error) for share, error in LINEAR_ERROR]
    passed = [(depth, error) for depth, error in limits if 1e3 * depth_m > depth]
    depth, error = passed[-1] if passed else limits[0]
    note = (
        f"the linear law is within {error:.0%} of a hyperelastic law up to a depth of "
        f"{depth:.2g} mm"
    )
    if passed:
        note = (
            f"pressed {1e3 * depth_m:.3g} mm deep: beyond {depth:.2g} mm, the force of the linear "
            f"law differs by more than {error:.0%} from the force of a hyperelastic law"
        )
    return {"linear": note}


def _across(along: Any) -> Any:
    """Return a direction perpendicular to a press.

    The direction is the component of -y that is perpendicular to the press. If the press is nearly
    parallel to y, the component of x is used.
    """
    # A press nearly parallel to y leaves no usable perpendicular component of y.
    first = np.array([0.0, -1.0, 0.0]) if abs(along[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    first = first - (first @ along) * along
    return first / np.linalg.norm(first)


def shaded(body: pyvista.DataSet) -> pyvista.PolyData:
    """Return a body's surface, with outward normals for smooth shading and with sharp edges."""
    surface = body.extract_surface(algorithm="dataset_surface").triangulate()
    # 40 degrees is more than the angles between triangles of a round surface, and less than the
    # angle at an edge.
    return surface.compute_normals(
        auto_orient_normals=True, split_vertices=True, feature_angle=40.0
    )


def new_plotter(options: dict[str, Any]) -> pyvista.Plotter:
    """Return a plotter with a white background, and remove the plotter's options from `options`."""
    import pyvista

    mine = {
        name: options.pop(name)
        for name in ("off_screen", "notebook", "window_size")
        if name in options
    }
    plotter = pyvista.Plotter(**mine)
    plotter.background_color = pyvista.Color("white")
    return plotter


def organ_around(
    organ: SoftOrgan, tool: PressingTool, start_m: Array, axis: Array, *, reach_m: float
) -> OrganModel:
    """Return the model of an organ for a loop, prepared for presses near the start of the tool.

    The tip may move up to `reach_m` [m] from `start_m` in each direction perpendicular to `axis`,
    and up to `reach_m` into the organ (opposite to `axis`).
    """
    from tissue.models.organ.model import ContactSolution, OrganModel
    from tissue.models.organ.soft_organ import ToolPath
    from tissue.simulation.builders.organ import REGION

    law = organ.law
    if law is not None:
        organ = copy(organ)
        region_m = REGION * tool.shape.size_m[0]
        organ.law = replace(law, interval_s=LAW_INTERVAL_S, region_m=region_m)
    turn = frame_along(axis)
    across = np.linspace(-reach_m, reach_m, ACROSS)
    x, y, z = (
        each.ravel() for each in np.meshgrid(across, across, np.linspace(0.0, -reach_m, ACROSS))
    )
    tips = start_m + np.column_stack([x, y, z]) @ turn.T
    path = ToolPath(tool.shape, tips, np.broadcast_to(turn, (len(tips), 3, 3)))
    return OrganModel(organ, path, ContactSolution("condensed"))
