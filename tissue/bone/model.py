"""Bone that a rotating cutter mills: carving over bricks and the force on the cutter's elements."""

from math import ceil, sqrt
from typing import Any, Literal

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.bricks import BRICK, FULL
from kernels.carving import PHASES, carve
from kernels.cutting import AREA, CHUNK, DENSITIES, RATE, Coefficients, Elements, cutting_forces
from kernels.launcher import SplitLaunch
from kernels.mirror import Mirror
from kernels.revolution import Revolution
from meshes.volume import VoxelVolume
from tissue.bone.bricks import BrickStore
from tissue.cutters import Cutter, DistanceTable, PointShell, Profile
from tissue.fields import FieldSeries
from tissue.materials import CuttingCoefficients
from tissue.model import Response, ToolMotion

__all__ = ["BoneModel", "Removal"]

Removal = Literal["subvoxel", "binary"]

CARVE_LAG_M = 2.0e-5
"""How far the tool may move between two visits of a brick, at most a quarter voxel [m]."""
LONGEST_STEP_VOXELS = 0.5
"""Longest step between two carvings; a faster tool is carved in parts of a tick."""
TURN = 0.9
"""The tool turns where its heading keeps less than this share of its last one."""
SHELL_ELEMENTS = 1600
"""Elements wanted over the cutting surface where the voxels would allow more."""
WORKERS_CPU, WORKERS_GPU = 32, 2048
"""Workers that share a carving launch."""


class BoneModel:
    """Voxelised bone and one cutter.

    Parameters
    ----------
    volume
        The bone.
    cutter
        The tool.
    coefficients
        Cutting coefficients of each of the volume's layers, in their order.
    removal
        ``subvoxel`` removes the part of a voxel inside the tool; ``binary`` whole voxels by their centres.
    shell_spacing_m
        Distance between the cutter's elements [m]; by default two voxels, or wider where that gives more than 1600.
    device
        Warp device name.
    cores
        Processor cores to split large launches over; default all. The result does not depend on it.
    """

    def __init__(
        self,
        volume: VoxelVolume,
        cutter: Cutter,
        coefficients: tuple[CuttingCoefficients, ...],
        *,
        removal: Removal = "subvoxel",
        shell_spacing_m: float | None = None,
        device: str = "cpu",
        cores: int | None = None,
    ) -> None:
        self.layer_names = volume.layer_names
        self.measure_names: tuple[str, ...] = ()
        self.notices: list[str] = []
        self.fields: FieldSeries | None = None
        self.cutter = cutter
        self.store = BrickStore.from_volume(volume, device=device)
        self.start_steps = self.store.steps_by_layer()
        self.removed_steps = np.zeros_like(self.start_steps)
        self._binary = int(removal == "binary")
        layers = len(self.layer_names)
        spacing = volume.spacing_m
        self._origin, self._spacing = volume.origin_m, spacing
        self.shell = cutter.shell(
            spacing_m=shell_spacing_m or max(2.0 * spacing, (cutter.cutting_area_m2 / SHELL_ELEMENTS) ** 0.5)
        )
        table = cutter.table(spacing_m=spacing)
        self._lag = min(CARVE_LAG_M / spacing, 0.25)
        self._lever = max(abs(table.low), abs(table.high))
        self._parts = np.zeros((4, 3))  # chip force and torque, edge force and torque
        self._response = Response(self._parts[:2].reshape(6), self._parts[2:].reshape(6), np.zeros(6), np.zeros(layers))
        self._next_group = 0
        # Groups follow the world's lattice, so that the same cut in a larger region is visited at the same ticks.
        self._first_group = int(np.rint(self._origin / (BRICK * spacing)).sum()) % PHASES
        self._debt = 0.0  # visits owed for the way made so far
        self._behind = 0  # groups that have not seen the present pose
        self._heading = np.zeros((2, 3))
        self._now = np.zeros(6)
        workers = WORKERS_CPU if device == "cpu" else WORKERS_GPU
        chunks = -(-len(self.shell.areas_m2) // CHUNK)
        self._pose = Mirror((1 + PHASES, 6), dtype=wp.float64, device=device)
        self._plan = Mirror(5, dtype=wp.int32, device=device)
        self._removed = Mirror((workers, layers), dtype=wp.int64, device=device)
        self._motion = Mirror((6, 3), dtype=wp.float64, device=device)
        self._rows = self._motion.host[0], self._motion.host[1:4], self._motion.host[4:6]
        self._sums = Mirror((chunks, AREA + layers), dtype=wp.float64, device=device)
        store = self.store
        self._carve = SplitLaunch(
            carve,
            dim=workers,
            inputs=[
                _revolution(table, cutter.profile, device=device),
                self._pose.device,
                self._plan.device,
                1.5 * self._lag,
                0,
                workers,
                store.brick_of,
            ],
            outputs=[store.remaining, store.material, store.alive, store.touched, self._removed.device],
            offset_index=4,
            device=device,
            cores=cores,
        )
        self.elements = _elements(self.shell, cutter, device=device)
        self._forces = SplitLaunch(
            cutting_forces,
            dim=chunks,
            inputs=[
                self.elements,
                _on_device(coefficients, device=device),
                self._motion.device,
                cutter.chip_per_speed_s,
                spacing,
                0,
                store.brick_of,
                store.material,
            ],
            outputs=[self._sums.device],
            offset_index=5,
            device=device,
            cores=cores,
        )

    @property
    def motion_rows(self) -> Any:
        """Device array of the pose and motion that `respond` was last asked about, see the force kernel."""
        return self._motion.device

    @property
    def step_m3(self) -> float:
        """Volume of one stored step [m3]."""
        return self._spacing**3 / FULL

    @property
    def start_m3(self) -> NDArray[np.float64]:
        """Volume of each layer before the first cut [m3], shape (layers,)."""
        return np.asarray(self.start_steps * self.step_m3, dtype=np.float64)

    @property
    def removed_m3(self) -> NDArray[np.float64]:
        """Volume removed from each layer so far [m3], shape (layers,)."""
        return np.asarray(self.removed_steps * self.step_m3, dtype=np.float64)

    def place(self, motion: ToolMotion) -> None:
        """Carve all that lies inside the tool at its first pose."""
        self._pose.host[:] = self._pose_of(motion)
        self._heading[:] = motion.heading
        self._visit(PHASES, every_side=True)

    def advance(self, motion: ToolMotion) -> None:
        """Carve what the tool reaches at its new pose; a slow tool's carving is spread over ticks."""
        now = self._pose_of(motion)
        if self._behind > 0 and np.vdot(motion.heading, self._heading) < TURN * np.vdot(self._heading, self._heading):
            self._visit(PHASES)  # the tool turns: first complete what it cut on its old way
        self._heading[:] = motion.heading
        moved = now - self._pose.host[0]
        step = sqrt(moved[:3].dot(moved[:3])) + self._lever * sqrt(moved[3:].dot(moved[3:]))
        if step > LONGEST_STEP_VOXELS:
            self._sweep(now, parts=ceil(step / LONGEST_STEP_VOXELS))
        elif step > 0.0:
            self._pose.host[0] = now
            self._behind = PHASES
            self._debt += PHASES * step / self._lag
            groups = min(int(self._debt), PHASES)
            if groups > 0:
                self._visit(groups)
        elif self._behind > 0:
            self._visit(1)  # the tool rests: bring the other bricks to its pose, one group a tick

    def _pose_of(self, motion: ToolMotion) -> NDArray[np.float64]:
        """Tip [voxel] and axis of a motion, in an array that the next call overwrites."""
        now = self._now
        np.subtract(motion.tip_m, self._origin, out=now[:3])
        now[:3] /= self._spacing
        now[3:] = motion.rotation[:, 2]
        return now

    def _sweep(self, now: NDArray[np.float64], *, parts: int) -> None:
        """Carve a fast tool at several poses on its way."""
        before = self._pose.host[0].copy()
        for part in range(1, parts + 1):
            pose = before + part / parts * (now - before)
            pose[3:] /= np.linalg.norm(pose[3:])
            self._pose.host[0] = pose
            self._visit(PHASES)

    def respond(self, motion: ToolMotion) -> Response:
        """Cutting force at the motion's pose, as a part that grows with speed and a part that does not."""
        tip, axes, velocities = self._rows
        np.subtract(motion.tip_m, self._origin, out=tip)
        tip /= self._spacing
        axes[:] = motion.rotation.T
        np.dot(motion.heading, motion.rotation, out=velocities)
        self._motion.push()
        self._forces()
        self._sums.pull()
        sums = np.add.reduce(self._sums.host, axis=0)
        np.dot(sums[:RATE].reshape(4, 3), motion.rotation.T, out=self._parts)
        response, speed = self._response, motion.speed_m_s
        response.engaged_m2[:] = sums[AREA:]
        response.removal_rate_m3_s = float(sums[RATE]) * speed
        np.multiply(response.resistance, speed, out=response.wrench)
        response.wrench += response.edge if speed > 0.0 else motion.pressed * response.edge
        return response

    def settle(self, time_s: float) -> None:
        """Bone has nothing beside the ticks."""

    def catch_up(self, time_s: float, motion: ToolMotion) -> None:
        """Bone has no slower rate."""

    def finish(self) -> None:
        """Complete the carving that was spread over ticks."""
        if self._behind > 0:
            self._visit(PHASES)

    def remaining(self) -> NDArray[np.uint8]:
        """Bone left in every voxel, 255 = full, shape of the volume."""
        return self.store.fraction()

    def _visit(self, groups: int, *, every_side: bool = False) -> None:
        """Carve ``groups`` groups of bricks at the current pose and book what they lost."""
        first = self._next_group
        self._plan.host[:] = (first, groups, self._binary, every_side, self._first_group)
        self._plan.push()
        self._pose.push()
        self._carve()
        self._removed.pull()
        self.removed_steps += np.add.reduce(self._removed.host, axis=0)
        for visit in range(groups):
            self._pose.host[1 + (first + visit) % PHASES] = self._pose.host[0]
        self._next_group = (first + groups) % PHASES
        self._debt = 0.0 if groups == PHASES else max(self._debt - groups, 0.0)
        self._behind -= min(groups, self._behind)


def _revolution(table: DistanceTable, profile: Profile, *, device: str) -> Revolution:
    """The cutter's distance table on a device."""
    tool: Any = Revolution()
    tool.distance = wp.array(table.distance, dtype=wp.float32, device=device)
    tool.bend = wp.array(table.bend, dtype=wp.float32, device=device)
    tool.height_min, tool.cells_per_voxel = table.height_min, table.cells_per_voxel
    tool.radius, tool.low, tool.high = table.radius, table.low, table.high
    tool.convex, tool.round = int(profile.convex), int(len(profile.pieces) == 1)
    return tool


def _elements(shell: PointShell, cutter: Cutter, *, device: str) -> Elements:
    """The cutter's point shell on a device."""
    elements = Elements()
    elements.point = wp.array(shell.points_m, dtype=wp.vec3, device=device)
    elements.normal = wp.array(shell.normals, dtype=wp.vec3, device=device)
    around = np.column_stack([-shell.points_m[:, 1], shell.points_m[:, 0], np.zeros(len(shell.radii_m))])
    around *= np.sign(cutter.spin_rad_s) / shell.radii_m[:, None]
    elements.around = wp.array(around, dtype=wp.vec3, device=device)
    elements.area = wp.array(shell.areas_m2, dtype=wp.float32, device=device)
    edge_length = cutter.flute_count * shell.areas_m2 / (2.0 * np.pi * shell.radii_m)
    elements.edge_length = wp.array(edge_length, dtype=wp.float32, device=device)
    return elements


def _on_device(coefficients: tuple[CuttingCoefficients, ...], *, device: str) -> Coefficients:
    """Cutting coefficients on a device, one entry a layer."""
    arrays = Coefficients()
    for name, source in CuttingCoefficients.KERNEL_NAMES.items():
        values = [getattr(layer, source) for layer in coefficients]
        setattr(arrays, name, wp.array(values, dtype=wp.float32, device=device))
    density = np.arange(DENSITIES)
    strength = [(density / layer.reference_density_kg_m3) ** layer.density_exponent for layer in coefficients]
    arrays.strength = wp.array(np.array(strength), dtype=wp.float32, device=device)
    return arrays
