"""Bone that a rotating cutter mills: removal of voxels, and forces on the cutting elements."""

import numpy as np
import warp as wp

from kernels.bricks import FULL
from kernels.cutting import AREA, MOTION_ROWS, RATE
from kernels.engagement import DENSITIES, FOUND, POSE_ROWS, Coefficients
from kernels.mirror import Mirror, filled
from meshes.base.arrays import Array, Bytes
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.materials.constants import CuttingCoefficients
from tissue.models.bone.bricks import BrickStore
from tissue.models.bone.carver import Carver, Removal
from tissue.models.bone.elements import CREEP_M_S, CuttingForces, elements_of
from tissue.models.bone.law_limits import LawLimits
from tissue.models.bone.recent_poses import RecentPoses
from tissue.models.bone.smooth_surface import SmoothSurface
from tissue.models.state import State, copied, put_back
from tissue.models.tissue_model import Response, ToolMotion

__all__ = ["BoneModel", "MilledTissue", "Removal"]

SHELL_ELEMENTS = 6000
"""Number of cutting elements of a cutter; on a ball their distance is 1/20 of the radius.

The error of the force in a slot in flat bone is below 0.5 % at a depth of 0.5 mm, and below 3 % at
a depth of 0.1 mm, see `tests/verification`.
"""


class BoneModel:
    """Voxelised bone and one cutter.

    Parameters
    ----------
    bone
        The bone: a volume, or a store of bricks (blocks of voxels). The bricks may have been cut
        before, and bricks may be added later.
    cutter
        The tool.
    coefficients
        Cutting coefficients for each layer of the bone.
    removal
        ``subvoxel`` removes the part of a voxel that is inside the tool. ``binary`` removes each
        voxel whose centre is inside the tool.
    shell_spacing_m
        Distance between the cutting elements [m]; the default gives 6000 elements.
    device
        Warp device name.
    cores
        Number of processor cores that share large kernel launches; default: all cores. The result
        does not depend on the number of cores.

    Attributes
    ----------
    limits
        Check of the cutting law's validity. The check reports chips that are too thick, and bone in
        contact with a part of the tool that does not cut.
    """

    def __init__(
        self,
        bone: VoxelVolume | BrickStore,
        cutter: Cutter,
        coefficients: tuple[CuttingCoefficients, ...],
        *,
        removal: Removal = "subvoxel",
        shell_spacing_m: float | None = None,
        device: str = "cpu",
        cores: int | None = None,
    ) -> None:
        self.store = store = (
            bone if isinstance(bone, BrickStore) else BrickStore.from_volume(bone, device=device)
        )
        grid = store.grid
        self.layer_names = grid.layer_names
        self.measure_names: tuple[str, ...] = ()
        self.cutter = cutter
        self.shell_spacing_m = shell_spacing_m or (cutter.cutting_area_m2 / SHELL_ELEMENTS) ** 0.5
        self.carver = Carver(self.store, cutter, removal=removal, device=device, cores=cores)
        layers = len(self.layer_names)
        spacing = grid.spacing_m
        self.removed_steps = self.carver.removed_steps
        """Material removed from each layer so far, in units of `step_m3`, shape (layers,)."""
        self.step_m3 = spacing**3 / FULL
        """Volume of one step of a voxel's stored 16-bit fraction [m3]."""
        self._origin = grid.origin_m
        self._spacing = spacing
        self.shell = cutter.shell(spacing_m=self.shell_spacing_m)
        self._parts = np.zeros((4, 3))  # chip force and torque, edge force and torque
        self._response = Response(
            self._parts[:2].reshape(6), self._parts[2:].reshape(6), np.zeros(6), np.zeros(layers)
        )
        self._pose = Mirror(POSE_ROWS, wp.vec3d, device)
        self.motion_rows = self._pose.device
        """Device array of the pose and motion of the last `take`, see `find_bone`."""
        self._tip = self._pose.host[0]
        self._axes = self._pose.host[1:4]
        self._velocities = self._pose.host[4:6]
        self._motion = Mirror(MOTION_ROWS, wp.vec3d, device)
        lever_m = float(np.abs(cutter.profile.height_range_m).max())
        self._recent = RecentPoses(lever_m, device=device)
        self.elements = elements_of(self.shell, cutter, spacing_m=spacing, device=device)
        self.coefficients = coefficients
        on_device = _on_device(coefficients, device=device)
        self._forces = CuttingForces(
            store,
            self.carver.tool,
            self.elements,
            on_device,
            self._pose,
            self._recent.mirror,
            self._motion,
            chip_per_speed_s=cutter.chip_per_speed_s,
            cores=cores,
        )
        self._smooth: SmoothSurface | None = None
        if cutter.has_smooth_surface:
            self._smooth = SmoothSurface(
                cutter,
                store,
                self.carver.tool,
                self._pose,
                self._recent.mirror,
                self._motion,
                on_device.strength,
            )
        self.limits = LawLimits(cutter, self._smooth)
        self.notices = self.limits.notices
        self._is_linear = not any(each.minimum_chip_m for each in coefficients)
        # pose and state of the bone in the last search, and motion in the last sum
        self._found: tuple[bytes, int] | None = None
        self._summed = b""
        self._sums = np.zeros(AREA + layers + 6)

    def record(self) -> None:
        """Record all kernel launches again after the store's arrays have grown."""
        self._found = None
        self.carver.record()
        self._forces.record()
        if self._smooth is not None:
            self._smooth.forces.record()

    @property
    def start_m3(self) -> Array:
        """Volume of each layer before the first cut [m3], shape (layers,)."""
        return np.asarray(self.store.start_steps * self.step_m3)

    @property
    def removed_m3(self) -> Array:
        """Volume removed from each layer so far [m3], shape (layers,)."""
        return np.asarray(self.removed_steps * self.step_m3)

    def place(self, motion: ToolMotion) -> None:
        """Carve all bone inside the tool at its first pose."""
        self._found = None
        self.carver.place(motion)
        self._recent.place(motion)

    def advance(self, motion: ToolMotion) -> None:
        """Carve the bone that the tool reaches at its new pose.

        If the tool is slow, the carving is spread over several ticks.
        """
        self.carver.advance(motion)
        self._recent.add(motion)

    def state(self) -> State:
        """Return a copy of the state on which later ticks depend."""
        return {
            "carver": self.carver.state(),
            "removed_steps": self.removed_steps.copy(),
            "recent": copied(self._recent, RecentPoses.STATE),
            "limits": copied(self.limits, LawLimits.STATE),
        }

    def restore(self, state: State) -> None:
        """Restore a state that `state` has returned."""
        self.carver.restore(state["carver"])
        self._found = None
        self._summed = b""
        self.removed_steps[:] = state["removed_steps"]
        put_back(self._recent, state["recent"])
        put_back(self.limits, state["limits"])

    def send_pose(self, motion: ToolMotion) -> None:
        """Send the tool's pose to the device, and store the tool's direction of motion."""
        self._write_pose(motion.tip_m, motion.rotation)
        np.dot(motion.heading, motion.rotation, out=self._velocities)
        self._pose.host[6] = 0.0, self._recent.turns, 0.0
        self._pose.push()

    def _write_pose(self, tip_m: Array, rotation: Array) -> None:
        """Write a pose to the host copy of `motion_rows`, without sending it to the device."""
        np.subtract(tip_m, self._origin, out=self._tip)
        self._tip /= self._spacing
        self._axes[:] = rotation.T

    def find_bone(self, tip_m: Array, rotation: Array, velocity: Array, step_s: float) -> None:
        """Find the bone around all elements of the tool at a pose, for later calls of `forces`.

        Parameters
        ----------
        tip_m, rotation
            Pose of the tool.
        velocity
            Velocity of the tip [m/s] and angular velocity [rad/s], with components along the tool's
            axes, shape (6,). A tool with this velocity reaches the pose in one step.
        step_s
            Length of the step [s].
        """
        self._found = None
        self._write_pose(tip_m, rotation)
        self._velocities[:] = 0.0
        self._pose.host[6] = 1.0, self._recent.turns, CREEP_M_S * self.cutter.chip_per_speed_s
        self._pose.push()
        rows = self._motion.host
        rows[2:4] = velocity.reshape(2, 3)
        rows[4, 1:] = step_s, 1.0
        self._recent.seen_from(tip_m, rotation)
        self._forces.find_bone()
        if self._smooth is not None:
            self._smooth.forces.find_bone()

    def forces(self, velocity: Array, *, unknowns: int) -> tuple[Array, Array]:
        """Linearise the force and torque on the tool at a velocity.

        The components of all vectors are along the axes of the tool at the pose of `find_bone`.

        Parameters
        ----------
        velocity
            Velocity of the tip [m/s] and angular velocity [rad/s] in the step given to `find_bone`,
            shape (6,).
        unknowns
            Number of velocity components with respect to which the derivatives are taken, 3 or 6.

        Returns
        -------
        tuple
            Force [N] and torque about the tip [N m] that the linearised law gives at zero velocity,
            shape (6,), and their derivatives, shape (6, unknowns). The wrench at the given velocity
            is the wrench at zero velocity plus the derivatives times the velocity. With 3 unknowns,
            only the force is linearised. The returned torque is then the torque at the given
            velocity.
        """
        rows = self._motion.host
        rows[:2] = velocity.reshape(2, 3)
        rows[4, 0] = unknowns
        self._motion.push()
        self._summed = b""
        self._sums = sums = self._forces.sums()
        if self._smooth is not None:
            rubbing = self._smooth.forces.sums()
            # The smooth surface adds to the forces, not to the removal rate and the engaged area.
            sums[:RATE] += rubbing[:RATE]
            sums[self._forces.slopes :] += rubbing[self._forces.slopes :]
        return sums[:RATE], sums[self._forces.slopes :].reshape(unknowns, 6).T

    def respond(self, motion: ToolMotion) -> Response:
        """Return the cutting force, and its derivative with respect to the speed."""
        response = self._response
        speed = motion.speed_m_s
        is_new = True
        if motion.balanced is None:
            is_new = self._sum_along(motion)
            sums = self._sums
            by_speed = sums[self._forces.slopes :].reshape(2, 3)
            np.dot(by_speed, motion.rotation.T, out=self._parts[:2])
            np.dot(sums[:RATE].reshape(2, 3), motion.rotation.T, out=self._parts[2:])
            np.multiply(response.resistance, speed, out=response.wrench)
            response.wrench += response.edge if speed > 0.0 else motion.pressed * response.edge
            response.removal_rate_m3_s = float(sums[RATE]) * speed
        else:
            sums = self._sums
            response.wrench[:] = motion.balanced
            response.removal_rate_m3_s = float(sums[RATE])
        response.engaged_m2[:] = sums[AREA : self._forces.slopes]
        # The smooth surface of a tool on a haptic device carries force. Its contact is reported
        # only for a tool on a prescribed path.
        looks = is_new and motion.balanced is None
        self.limits.check(motion, float(np.add.reduce(response.engaged_m2)), is_new=looks)
        return response

    def _sum_along(self, motion: ToolMotion) -> bool:
        """Find the bone and sum the forces for a motion.

        Return False if pose, velocity and bone have not changed, so that the last sums are valid.
        """
        is_new = self._find_along(motion)
        speed = motion.speed_m_s if motion.tangent_m_s is None else motion.tangent_m_s
        rows = self._motion.host
        rows[:2] = self._velocities
        # The sums of a linear law hold for any speed.
        rows[4] = 1.0, 0.0, 0.0 if self._is_linear else speed
        asked = rows.tobytes()
        is_new = is_new or asked != self._summed
        if is_new:  # the forces on a resting tool do not change
            self._summed = asked
            self._motion.push()
            self._sums = self._forces.sums()
        return is_new

    def _find_along(self, motion: ToolMotion) -> bool:
        """Find the bone in front of the elements that move outwards.

        Return True after a new search, or False if the last result is still valid.
        """
        self.send_pose(motion)
        asked = self._pose.host.tobytes(), self.carver.changes
        is_new = asked != self._found
        if is_new:
            self._found = asked
            self._recent.seen_from(motion.tip_m, motion.rotation)
            self._forces.find_bone()
        return is_new

    def found_along(self, motion: ToolMotion) -> Array:
        """Return data on the bone ahead of outward-moving elements, shape (FOUND, elements).

        The rows are listed at `kernels.engagement.DISTANCE`. The number of elements is padded to a
        multiple of `LANES`.
        """
        self._find_along(motion)
        found = self._forces.found.numpy()
        return found.transpose(1, 0, 2).reshape(FOUND, -1)

    def finish(self) -> None:
        """Complete the carving that was postponed to later ticks."""
        self.carver.finish()

    def remaining(self) -> Bytes:
        """Return the amount of bone left in every voxel, from 0 to 255 (full voxel).

        The array has the same shape as the voxel volume.
        """
        return self.store.fraction()


class MilledTissue:
    """Base class of tissues that a bone model carves, and that compute further results.

    Parameters
    ----------
    milling
        Model with the voxels and the tool.
    """

    def __init__(self, milling: BoneModel) -> None:
        self.milling = milling
        self.layer_names = milling.layer_names

    @property
    def start_m3(self) -> Array:
        """Volume of each layer before the first cut [m3], shape (layers,)."""
        return self.milling.start_m3

    @property
    def removed_m3(self) -> Array:
        """Volume removed from each layer so far [m3], shape (layers,)."""
        return self.milling.removed_m3

    def place(self, motion: ToolMotion) -> None:
        """Put the tool at its first pose."""
        self.milling.place(motion)

    def advance(self, motion: ToolMotion) -> None:
        """Carve the material that the tool reaches at its new pose."""
        self.milling.advance(motion)

    def finish(self) -> None:
        """Complete the carving that was postponed to later ticks."""
        self.milling.finish()


def _on_device(coefficients: tuple[CuttingCoefficients, ...], *, device: str) -> Coefficients:
    """Return cutting coefficients on a device, one entry for each layer."""
    density = np.arange(DENSITIES)
    strength = [
        (density / layer.reference_density_kg_m3) ** layer.density_exponent
        for layer in coefficients
    ]

    def rows(*keys: str) -> Array:
        return np.array([[getattr(layer, key) for key in keys] for layer in coefficients])

    return filled(
        Coefficients,
        device,
        chip=rows(*CuttingCoefficients.CHIP),
        edge=rows(*CuttingCoefficients.EDGE),
        strength=np.array(strength),
        size=rows("size_exponent", "minimum_chip_m", "reference_chip_m"),
        has_size_effect=int(any(layer.size_exponent for layer in coefficients)),
    )
