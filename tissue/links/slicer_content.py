"""Messages for 3D Slicer: rows, tool, tissue and image of a run, in RAS and mm."""

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
from tissue.simulation.live.shared import BoneSurface, OrganSurface, Start

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
"""Names of the messages, used by 3D Slicer as names of its nodes."""


class SlicerContent:
    """Builder of the messages of a run.

    Parameters
    ----------
    scene
        Scene of the run.
    columns
        Names of the values of a row.
    frame
        Frame of the scene in RAS.
    start
        Initial data from the ticks.
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
        """Return the constant messages: tool shape, voxel image, and faces without a body.

        The tool shape is in its own frame.
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
        """Return the current surface of the tissue.

        The surface of a bone has the layer as values at the points.
        """
        surface = tissue.surface
        if not isinstance(tissue, BoneSurface) or not surface.n_cells:
            return self._packed("POLYDATA", TISSUE, self._mesh(surface.triangulate()))
        layers = np.zeros(surface.n_points)
        layers[surface.regular_faces] = with_layers(surface, tissue.volume).cell_data["layer"][
            :, None
        ]
        return self._packed("POLYDATA", TISSUE, self._mesh(surface, layer=layers))

    def pose_message(self, row: Array) -> bytes | None:
        """Return the pose of the tool tip; None if the row has no pose yet."""
        if not row[self._turn].any():
            return None
        pose = self._frame.pose(row[self._tip], matrix_of(row[self._turn]))
        return self._packed("TRANSFORM", TOOL, igtl.transform_body(pose))

    def force_messages(self, row: Array, kind: str) -> list[bytes]:
        """Return the load of the tissue on the tool, with the simulated time.

        The load is a SENSOR of force and a SENSOR of torque, or one NDARRAY.
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
        """Return the load of the tissue on the tool as a text that 3D Slicer shows."""
        force, torque = self._load(row)
        x, y, z = force
        text = (
            f"{row[self._time]:.2f} s: force {np.linalg.norm(force):.2f} N, to the right "
            f"{x:.2f}, to the front {y:.2f}"
            f", up {z:.2f} N; torque {1e3 * np.linalg.norm(torque):.1f} mN m"
        )
        return self._packed("STRING", WORDS, igtl.string_body(text))

    def status_message(self, row: Array) -> bytes:
        """Return a status message with the simulated time and the number of missed deadlines.

        An empty row means that the first tick has not run yet.
        """
        text = f"{self._scene.name}: begins"
        if row.size:
            text = (
                f"{self._scene.name}: {row[self._time]:.2f} s, {row[self._missed]:.0f} deadlines "
                "of 1 ms missed"
            )
        return self._packed("STATUS", STATE, igtl.status_body(igtl.STATUS_OK, text, name="OK"))

    def event_message(self, text: str) -> bytes:
        """Return the message of an event."""
        return self._packed("STRING", "tissue-events", igtl.string_body(text))

    def end_message(self) -> bytes:
        """Return the message that the run has ended."""
        body = igtl.status_body(
            igtl.STATUS_SHUT_DOWN, f"{self._scene.name}: the run has ended", name="SHUT_DOWN"
        )
        return self._packed("STATUS", STATE, body)

    def _load(self, row: Array) -> tuple[Array, Array]:
        """Return force [N] and torque [N m] in RAS."""
        return self._frame.vector(row[self._force]), self._frame.vector(row[self._torque])

    def _mesh(self, mesh: "pyvista.PolyData", **scalars: Array) -> bytes:
        triangles = mesh.regular_faces.reshape(-1, 3)  # an empty mesh loses its shape
        return igtl.polydata_body(self._frame.points(mesh.points), triangles, scalars=scalars)

    def _packed(self, kind: str, name: str, body: bytes, **options: Any) -> bytes:
        return igtl.packed(kind, name, body, time_s=time(), **options)
