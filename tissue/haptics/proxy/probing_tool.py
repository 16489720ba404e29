"""Tool that does not spin or cut, in contact with rigid bone."""

from math import inf, sqrt

import numpy as np

from kernels.bricks import FULL
from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.voxels.volume import VoxelVolume
from tissue.haptics.proxy.held_tool import HeldTool, HeldTurn
from tissue.haptics.proxy.proxy import ContactField, Proxy, ToolShell
from tissue.models.bone.bricks import BrickStore
from tissue.models.bone.smooth_surface import FRICTION
from tissue.models.tissue_model import FreeSpace, Response, ToolMotion
from tissue.motion.quaternion import Quaternion

RIGID_LEVER_M = 10.0
"""Lever (see `Proxy`) of the rotational spring for a device that imposes its rotation [m].

The value is a hundred times the lever of any tool. The rotational compliance is 1 / lever^2.
Contacts therefore turn the tool by only 1e-4 of the rotation that would result from a lever of the
tool's own size.
"""


class ProbingTool(HeldTool):
    """Tool of any shape in contact with rigid bone; as a god-object, it never penetrates the bone.

    The contact forces at points of the tool's surface are in balance with the forces of the
    coupling springs; see :class:`tissue.haptics.proxy.proxy.Proxy`. The tool uses the voxels of the
    bone without copying them, so another tool may carve the bone.
    """

    def __init__(self, stiffness_N_m: float, tip_m: Array, turn: HeldTurn | None = None) -> None:
        super().__init__(stiffness_N_m, tip_m, turn)
        stiffness_Nm_rad = self._turn.stiffness_Nm_rad
        self.lever_m = (
            RIGID_LEVER_M if stiffness_Nm_rad == inf else sqrt(stiffness_Nm_rad / stiffness_N_m)
        )
        self.proxy: Proxy | None = None

    def create_proxy(self, shell: ToolShell, field: ContactField) -> Proxy:
        """Set the objects that the tool may touch, and place the tool at its first pose.

        At this pose, the axes of the shell are parallel to the axes of the world.

        Raises
        ------
        InputError
            If the tool would lie in a solid.
        """
        self.proxy = Proxy(shell, field, lever_m=self.lever_m, friction=FRICTION)
        self.proxy.place(self.tip_m, np.array(self.quaternion))
        return self.proxy

    def follow(
        self,
        device_m: Array,
        device: Quaternion,
        velocity: Array,
        response: Response,
        step_s: float,
    ) -> Array:
        """Move as close to the device as the contacts allow, and return the tip position."""
        assert self.proxy is not None, "a probing tool has no proxy yet"
        result = self.proxy.advance(device_m, np.array(device))
        self.tip_m[:] = result.position_m
        x, y, z, w = result.quaternion.tolist()
        self._turn.quaternion = x, y, z, w
        return self.tip_m


class ProbedBone(FreeSpace):
    """Tissue model of rigid bone that a tool touches but does not cut.

    The model writes two measures to the trace. The first measure is the number of contacts with
    force. The second measure is 1 if the god-object did not settle within a tick, and otherwise 0.
    The contact area ``engaged_m2`` is the area per surface point times the number of contacts. It
    is assigned to the layer at the centre of pressure.

    Parameters
    ----------
    volume
        Voxels of the bone.
    shell
        Surface of the tool, in its own frame.
    area_m2
        Area of the tool's surface [m2].
    tool
        Tool that is pressed against the bone.
    device
        Warp device name.
    """

    measure_names = ("contacts", "behind")

    def __init__(
        self,
        volume: VoxelVolume,
        shell: ToolShell,
        *,
        area_m2: float,
        tool: ProbingTool,
        device: str = "cpu",
    ) -> None:
        super().__init__()
        self.layer_names = volume.layer_names
        self._volume = volume
        self.store = BrickStore.from_volume(volume, device=device)
        self.start_m3, self.removed_m3 = np.zeros((2, len(self.layer_names)))
        self.start_m3[:] = self.store.start_steps * (volume.spacing_m**3 / FULL)
        self._response = Response.empty(len(self.layer_names), 2)
        self._tool = tool
        self._shell = shell
        self._area = area_m2 / len(shell.points_m)
        self._field = ContactField(store=self.store)

    def place(self, motion: ToolMotion) -> None:
        """Place the tool at its first pose.

        Raises
        ------
        InputError
            If the first pose is inside the bone.
        """
        turn = motion.rotation.T
        shell = ToolShell(self._shell.points_m @ turn, self._shell.normals @ turn)
        try:
            self._tool.create_proxy(shell, self._field)
        except InputError as error:
            raise InputError(
                "motion",
                "start outside the bone",
                f"a tool at {error.value}",
                "start higher",
            ) from error

    def respond(self, motion: ToolMotion) -> Response:
        """Return the contact force on the tool, and the torque of the contacts about the tip."""
        response = self._response
        proxy = self._tool.proxy
        assert proxy is not None, "a tool must be placed before it is asked"
        result = proxy.result
        stiffness = self._tool.stiffness_N_m
        response.wrench[:3] = stiffness * result.push_m
        response.wrench[3:] = stiffness * result.push_moment_m2
        response.edge[:] = response.wrench
        response.measures[:] = result.contacts, not result.settled
        response.engaged_m2[:] = 0.0
        if result.contacts:
            response.engaged_m2[self._layer_under(motion.tip_m + result.arm_m, result.push_m)] = (
                self._area * result.contacts
            )
        return response

    def _layer_under(self, point_m: Array, push_m: Array) -> int:
        """Return the layer of the voxel that is half a voxel behind a surface point.

        ``push_m`` is an outward vector at the point: the contact force divided by the coupling
        stiffness [m].
        """
        volume = self._volume
        size = float(np.sqrt(push_m @ push_m))
        # The point itself is on the surface and may lie in a voxel without bone.
        inward = -0.5 * volume.spacing_m / size * push_m if size > 0.0 else 0.0
        at = np.floor((point_m + inward - volume.origin_m) / volume.spacing_m).astype(int)
        return int(volume.layer[tuple(np.clip(at, 0, np.array(volume.shape) - 1))])
