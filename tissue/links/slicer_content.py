"""What 3D Slicer is sent of a run: messages of its rows, its tool, its tissue and its image, in
RAS and mm.
"""

from time import time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tissue.links import igtl_messages as igtl
from tissue.links.slicer_frame import SlicerFrame
from tissue.motion.motion import matrix_of
from tissue.scene.scene import Scene
from tissue.show.figures.faces import faces_of
from tissue.show.figures.tool_mesh import tool_surface
from tissue.simulation.bone_surface import with_layers
from tissue.simulation.live.surfaces import BoneSurface, OrganSurface, Start

if TYPE_CHECKING:
    import pyvista

__all__ = ["SlicerContent"]

Array = NDArray[np.float64]
TOOL, SHAPE, TISSUE, IMAGE = "tissue-tool", "tissue-tool-shape", "tissue-anatomy", "tissue-image"
FORCE, TORQUE, WRENCH, WORDS, STATE = (
    "tissue-force",
    "tissue-torque",
    "tissue-wrench",
    "tissue-force-text",
    "tissue",
)
"""Names of what is sent, as 3D Slicer names its nodes."""


class SlicerContent:
    """Makes the messages of a run.

    Parameters
    ----------
    scene
        What is run.
    columns
        Names of the values of a row.
    frame
        Where the scene lies in RAS.
    start
        What the ticks have given to begin with.
    """

    def __init__(
        self, scene: Scene, columns: tuple[str, ...], frame: SlicerFrame, start: Start
    ) -> None:
        self._scene = scene
        self._frame = frame
        self._start = start
        places = {name: place for place, name in enumerate(columns)}
        at = lambda *names: np.array([places[name] for name in names])  # noqa: E731
        self._tip = at(*(f"tool_{c}_mm" for c in "xyz"))
        self._turn = at(*(f"tool_q{c}" for c in "xyzw"))
        self._force = at(*(f"model_force_{c}_N" for c in "xyz"))
        self._torque = at(*(f"model_torque_{c}_Nm" for c in "xyz"))
        self._time = places["time_s"]
        self._missed = places["missed"]
        self._number = 0

    def scene_messages(self) -> list[bytes]:
        """What does not change: the tool's shape in its own frame, the voxels as an image, faces
        without a body.
        """
        messages = []
        tool = tool_surface(self._scene.tool)
        if tool is not None:
            triangles = tool.triangulate()
            body = igtl.polydata_body(triangles.points, triangles.regular_faces)
            messages.append(self._packed("POLYDATA", SHAPE, body))
        density = self._start.get("density_kg_m3")
        if density is not None:
            spacing_mm = 1e3 * float(self._start["spacing_m"])
            voxels = np.eye(4)
            voxels[:3, :3] *= spacing_mm
            voxels[:3, 3] = 1e3 * self._start["origin_m"].astype(float) + 0.5 * spacing_mm
            messages.append(
                self._packed("IMAGE", IMAGE, igtl.image_body(density, self._frame.matrix @ voxels))
            )
        for name, face in faces_of(self._scene).items():
            messages.append(
                self._packed("POLYDATA", f"tissue-{name}"[:20], self._mesh(face.triangulate()))
            )
        return messages

    def surface_message(self, tissue: BoneSurface | OrganSurface) -> bytes:
        """The tissue's surface as it is now, with the layer of a bone as values at the points."""
        surface = tissue.surface
        if not isinstance(tissue, BoneSurface) or not surface.n_cells:
            return self._packed("POLYDATA", TISSUE, self._mesh(surface.triangulate()))
        layers = np.zeros(surface.n_points)
        layers[surface.regular_faces] = with_layers(surface, tissue.volume).cell_data["layer"][
            :, None
        ]
        return self._packed("POLYDATA", TISSUE, self._mesh(surface, layer=layers))

    def pose_message(self, row: Array) -> bytes | None:
        """The pose of the tool's tip; None before it has one."""
        if not row[self._turn].any():
            return None
        pose = self._frame.pose(row[self._tip], matrix_of(row[self._turn]))
        return self._packed("TRANSFORM", TOOL, igtl.transform_body(pose))

    def force_messages(self, row: Array, kind: str) -> list[bytes]:
        """The tissue's load on the tool, as SENSOR of force and of torque or as one NDARRAY,
        with simulated time.
        """
        force, torque = self._load(row)
        self._number += 1
        options: dict[str, Any] = {
            "metadata": {"time_s": f"{row[self._time]:.3f}"},
            "number": self._number,
        }
        if kind == "NDARRAY":
            body = igtl.ndarray_body(np.concatenate([force, torque]))
            return [self._packed("NDARRAY", WRENCH, body, **options)]
        sensors = (
            (FORCE, force, igtl.si_unit(("N", 1))),
            (TORQUE, torque, igtl.si_unit(("N", 1), ("m", 1))),
        )
        return [
            self._packed("SENSOR", name, igtl.sensor_body(load, unit), **options)
            for name, load, unit in sensors
        ]

    def words_message(self, row: Array) -> bytes:
        """The same in words, which 3D Slicer shows."""
        force, torque = self._load(row)
        x, y, z = force
        text = (
            f"{row[self._time]:.2f} s: force {np.linalg.norm(force):.2f} N, to the right "
            f"{x:.2f}, to the front {y:.2f}"
            f", up {z:.2f} N; torque {1e3 * np.linalg.norm(torque):.1f} mN m"
        )
        return self._packed("STRING", WORDS, igtl.string_body(text))

    def status_message(self, row: Array) -> bytes:
        """That the run goes on, and how well the ticks keep up; an empty row is that of a run
        before its first tick.
        """
        text = f"{self._scene.name}: begins"
        if row.size:
            text = (
                f"{self._scene.name}: {row[self._time]:.2f} s, {row[self._missed]:.0f} deadlines "
                "of 1 ms missed"
            )
        return self._packed("STATUS", STATE, igtl.status_body(igtl.STATUS_OK, text, name="OK"))

    def event_message(self, text: str) -> bytes:
        """What has happened."""
        return self._packed("STRING", "tissue-events", igtl.string_body(text))

    def end_message(self) -> bytes:
        """That the run has ended."""
        body = igtl.status_body(
            igtl.STATUS_SHUT_DOWN, f"{self._scene.name}: the run has ended", name="SHUT_DOWN"
        )
        return self._packed("STATUS", STATE, body)

    def _load(self, row: Array) -> tuple[Array, Array]:
        """Force [N] and torque [N m] in RAS."""
        return self._frame.vector(row[self._force]), self._frame.vector(row[self._torque])

    def _mesh(self, mesh: "pyvista.PolyData", **scalars: Array) -> bytes:
        triangles = mesh.regular_faces.reshape(-1, 3)  # of a mesh without any the shape is lost
        return igtl.polydata_body(self._frame.points(mesh.points), triangles, scalars=scalars)

    def _packed(self, kind: str, name: str, body: bytes, **options: Any) -> bytes:
        return igtl.packed(kind, name, body, time_s=time(), **options)
