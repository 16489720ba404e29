"""Bone that a rotating cutter mills: carving over bricks and the force on the cutter's elements."""

from typing import Any

import numpy as np
import warp as wp

from kernels.bricks import FULL
from kernels.cutting import AREA, DENSITIES, RATE, Coefficients
from kernels.elements import lever16
from kernels.mirror import Mirror, put
from meshes.base.arrays import Array, Bytes
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.materials.constants import CuttingCoefficients
from tissue.models.bone.bricks import BrickStore
from tissue.models.bone.carver import Carver, Removal
from tissue.models.bone.elements import ForceSums, LawLimits, SmoothSurface, elements_of
from tissue.models.tissue_model import Response, ToolMotion

__all__ = ["BoneModel", "Removal"]

SHELL_ELEMENTS = 6000
"""Number of elements over the cutting surface: a twentieth of a ball's radius apart.

The force of a slot in flat bone is within 0.5 % where it is half a millimetre deep, and within 3 %
where it is 0.1 mm deep, see `tests/verification`.
"""


class BoneModel:
    """Voxelised bone and one cutter.

    Parameters
    ----------
    bone
        The bone: a volume, or a store of bricks, which may have been cut before and may grow.
    cutter
        The tool.
    coefficients
        Cutting coefficients of each of the bone's layers, in their order.
    removal
        ``subvoxel`` removes the part of a voxel inside the tool; ``binary`` removes whole voxels by
        their centres.
    shell_spacing_m
        Distance between the cutter's elements [m]; the default gives 6000 elements.
    device
        Warp device name.
    cores
        Processor cores to split large launches over; default all. The result does not depend on it.

    Attributes
    ----------
    limits
        Check of the cutting law's validity: chips that are too thick, smooth surfaces in bone.
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
        """Stored steps removed from each layer so far, shape (layers,)."""
        self.step_m3 = spacing**3 / FULL
        """Volume of one stored step [m3]."""
        self._origin = grid.origin_m
        self._spacing = spacing
        self.shell = cutter.shell(spacing_m=self.shell_spacing_m)
        self._parts = np.zeros((4, 3))  # chip force and torque, edge force and torque
        self._response = Response(
            self._parts[:2].reshape(6), self._parts[2:].reshape(6), np.zeros(6), np.zeros(layers)
        )
        self._motion = Mirror((7, 3), dtype=wp.float64, device=device)
        self.motion_rows = self._motion.device
        """Device array of the pose and motion of the last `take`, see the force kernel."""
        self._rows = self._motion.host[0], self._motion.host[1:4], self._motion.host[4:6]
        self.elements = elements_of(self.shell, cutter, spacing_m=spacing, device=device)
        self.coefficients = coefficients
        self._forces = ForceSums(
            store,
            self.carver.tool,
            self.elements,
            _on_device(coefficients, device=device),
            self._motion.device,
            chip_per_speed_s=cutter.chip_per_speed_s,
            cores=cores,
        )
        smooth = None
        if cutter.has_smooth_surface:
            smooth = SmoothSurface(cutter, store, self.carver.tool, self._motion.device)
        self.limits = LawLimits(cutter, smooth)
        self.notices = self.limits.notices
        self._is_linear = not any(each.minimum_chip_m for each in coefficients)
        # motion, and state of the bone, that the sums are for
        self._answered: tuple[bytes, int] | None = None

    def record(self) -> None:
        """Record all launches anew, after the store's arrays have grown."""
        self._answered = None
        self.carver.record()
        self.limits.record()
        self._forces.record()

    @property
    def start_m3(self) -> Array:
        """Volume of each layer before the first cut [m3], shape (layers,)."""
        return np.asarray(self.store.start_steps * self.step_m3, np.float64)

    @property
    def removed_m3(self) -> Array:
        """Volume removed from each layer so far [m3], shape (layers,)."""
        return np.asarray(self.removed_steps * self.step_m3, np.float64)

    def place(self, motion: ToolMotion) -> None:
        """Carve all bone inside the tool at its first pose."""
        self._answered = None
        self.carver.place(motion)

    def advance(self, motion: ToolMotion) -> None:
        """Carve the bone that the tool reaches at its new pose.

        A slow tool's carving is spread over ticks.
        """
        self.carver.advance(motion)

    def take(self, motion: ToolMotion) -> None:
        """Write a pose and motion to `motion_rows`."""
        tip, axes, velocities = self._rows
        np.subtract(motion.tip_m, self._origin, out=tip)
        tip /= self._spacing
        axes[:] = motion.rotation.T
        np.dot(motion.heading, motion.rotation, out=velocities)
        # The sums of a linear law hold for any speed.
        linearised = max(motion.speed_m_s, motion.tangent_m_s)
        self._motion.host[6, 0] = 0.0 if self._is_linear else linearised
        self._motion.push()

    def respond(self, motion: ToolMotion) -> Response:
        """Return the cutting force at the motion's pose, and its tangent in the speed."""
        self.take(motion)
        asked = self._motion.host.tobytes(), self.carver.changes
        is_new = asked != self._answered
        if is_new:  # the contact of a resting tool does not change
            self._answered = asked
            self._forces.launch()
            self._forces.sums.pull()
        sums = np.add.reduce(self._forces.sums.host, axis=0)
        np.dot(sums[:RATE].reshape(4, 3), motion.rotation.T, out=self._parts)
        response = self._response
        speed = motion.speed_m_s
        response.engaged_m2[:] = sums[AREA:]
        response.removal_rate_m3_s = float(sums[RATE]) * speed
        self.limits.check(motion, float(np.add.reduce(response.engaged_m2)), is_new=is_new)
        if speed == 0.0 and any(motion.push.tolist()):
            np.negative(motion.push, out=response.wrench)
            return response
        np.multiply(response.resistance, speed, out=response.wrench)
        response.wrench += response.edge if speed > 0.0 else motion.pressed * response.edge
        return response

    def finish(self) -> None:
        """Complete the carving that was spread over ticks."""
        self.carver.finish()

    def remaining(self) -> Bytes:
        """Return the remaining bone in every voxel, 255 = full, shape of the volume."""
        return self.store.fraction()


def _on_device(coefficients: tuple[CuttingCoefficients, ...], *, device: str) -> Coefficients:
    """Return cutting coefficients on a device, one entry a layer."""
    arrays = Coefficients()

    def at_levers(names: tuple[str, ...]) -> Any:
        """Return the coefficients of each layer at their positions in a lever.

        They are tangential, radial and axial.
        """
        parts = [[getattr(layer, name) for name in names] for layer in coefficients]
        values = np.pad(np.repeat(parts, (5, 6, 3), axis=1), ((0, 0), (0, 2)))
        return put(values, lever16, device)

    arrays.chip = at_levers(CuttingCoefficients.CHIP)
    arrays.edge = at_levers(CuttingCoefficients.EDGE)
    density = np.arange(DENSITIES)
    strength = [
        (density / layer.reference_density_kg_m3) ** layer.density_exponent
        for layer in coefficients
    ]
    arrays.strength = put(np.array(strength), wp.float32, device)
    size = [
        (layer.size_exponent, layer.minimum_chip_m, layer.reference_chip_m)
        for layer in coefficients
    ]
    arrays.size = put(np.array(size), wp.vec3, device)
    return arrays
