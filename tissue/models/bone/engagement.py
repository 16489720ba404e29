"""Bone model that gives the loads of a unit of each cutting coefficient in place of a force."""

import numpy as np
import warp as wp

from kernels.bricks import corner8f
from kernels.elements import CHUNK, LANES
from kernels.engagement import engaged_elements
from kernels.launcher import SplitLaunch
from kernels.mirror import Mirror
from kernels.older_cuts import SLOTS
from meshes.base.arrays import Array
from tissue.models.bone.density_nodes import DensityNodes, densities_of
from tissue.models.bone.elements import edge_lengths_m, levers_of
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import Response, ToolMotion

__all__ = ["COEFFICIENTS", "EngagedBone", "EngagedElements"]

COEFFICIENTS = 6
"""Number of coefficients: tangential, radial and axial chip, then edge coefficients."""


class EngagedElements:
    """Search for the elements of a cutter that engage bone, and the bone they engage.

    Parameters
    ----------
    bone
        Bone model with the cutter and the bone.
    device
        Warp device name.
    cores
        Processor cores to split large launches over; default all.
    """

    def __init__(self, bone: BoneModel, *, device: str = "cpu", cores: int | None = None) -> None:
        self.bone = bone
        self._edges = edge_lengths_m(bone.shell, bone.cutter)
        chunks = -(-len(self._edges) // CHUNK)
        padded = -(-len(self._edges) // LANES) * LANES
        kinds = wp.float32, wp.float32, wp.int32, wp.int32
        self._found = [Mirror(padded, dtype=kind, device=device) for kind in kinds]
        store = bone.store
        self._launch = SplitLaunch(
            engaged_elements,
            dim=chunks,
            inputs=[
                bone.carver.tool,
                bone.elements,
                bone.motion_rows,
                store.grid.spacing_m,
                0,
                store.brick_of,
                store.material,
                store.nearby,
                store.older,
                store.alive,
            ],
            outputs=[
                wp.zeros((chunks, SLOTS + 1), dtype=corner8f, device=device),
                *(each.device for each in self._found),
            ],
            offset_index=4,
            device=device,
            cores=cores,
        )

    @property
    def nowhere(self) -> tuple[Array, Array, Array]:
        """Result of `cutting` for a cutter without contact."""
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)

    def find(self, motion: ToolMotion) -> tuple[Array, ...]:
        """Return the share that cuts, the advance per unit of speed, the layer and the density.

        Each array has a value for every element.
        """
        self.bone.take(motion)
        self._launch()
        for each in self._found:
            each.pull()
        return tuple(each.host for each in self._found)

    def cutting(self, motion: ToolMotion) -> tuple[Array, Array, Array]:
        """Return points where the cutter cuts, normals out of the cutter, and relative powers.

        Points [m] are in the world frame. The power of an element is its tangential force times its
        speed, which is the spin times its radius.
        """
        share, advance, layer, density = self.find(motion)
        met = np.flatnonzero(share)
        shell = self.bone.shell
        cutter = self.bone.cutter
        coefficients = self.bone.coefficients
        chip = np.array([each.tangential_chip_Pa for each in coefficients])[layer[met]]
        edge = np.array([each.tangential_edge_N_m for each in coefficients])[layer[met]]
        reference = np.array([each.reference_density_kg_m3 for each in coefficients])[layer[met]]
        exponent = np.array([each.density_exponent for each in coefficients])[layer[met]]
        thickness = cutter.chip_per_speed_s * motion.speed_m_s * advance[met].astype(np.float64)
        strength = (density[met] / reference) ** exponent
        powers = (
            shell.radii_m[met]
            * self._edges[met]
            * share[met]
            * strength
            * (chip * thickness + edge)
        )
        points = motion.tip_m + shell.points_m[met] @ motion.rotation.T
        return points, shell.normals[met] @ motion.rotation.T, powers


class EngagedBone:
    """Bone model that gives loads for any coefficients in place of a force.

    It is carved like the given model.

    Parameters
    ----------
    bone
        The model; its own coefficients are not used.
    device
        Warp device name.
    cores
        Processor cores to split large launches over; default all.

    Attributes
    ----------
    nodes
        Densities of each layer at which loads are given.
    unit_loads
        For each layer: force [N] and torque about the tip [N m] on the tool in the world frame for
        a unit of each coefficient [Pa, then N/m], weighed as by `DensityNodes`, shape (nodes, 6,
        6), of the last `respond`.
    asked
        True if `respond` is to compute them.
    """

    def __init__(self, bone: BoneModel, *, device: str = "cpu", cores: int | None = None) -> None:
        self.bone = bone
        self.layer_names = bone.layer_names
        self.measure_names: tuple[str, ...] = ()
        self.asked = True
        material = bone.store.material.numpy()
        self.nodes = [
            DensityNodes.of(*densities_of(material, layer))
            for layer in range(len(self.layer_names))
        ]
        self.unit_loads = [
            np.zeros((len(each.densities_kg_m3), COEFFICIENTS, 6)) for each in self.nodes
        ]
        self._response = Response.empty(len(self.layer_names))
        shell = bone.shell
        cutter = bone.cutter
        self._areas = shell.areas_m2
        self._edges = edge_lengths_m(shell, cutter)
        self._levers = levers_of(shell, cutter)
        self._elements = EngagedElements(bone, device=device, cores=cores)

    @property
    def engaged_m2(self) -> Array:
        """Area of the tool in contact with each layer at the last `respond` [m2], (layers,)."""
        return self._response.engaged_m2

    @property
    def start_m3(self) -> Array:
        """Volume of each layer before the first cut [m3], shape (layers,)."""
        return self.bone.start_m3

    @property
    def removed_m3(self) -> Array:
        """Volume removed from each layer so far [m3], shape (layers,)."""
        return self.bone.removed_m3

    def place(self, motion: ToolMotion) -> None:
        """Put the tool at its first pose."""
        self.bone.place(motion)

    def advance(self, motion: ToolMotion) -> None:
        """Carve the bone that the tool reaches at its new pose."""
        self.bone.advance(motion)

    def finish(self) -> None:
        """Complete the carving that was spread over ticks."""
        self.bone.finish()

    def respond(self, motion: ToolMotion) -> Response:
        """Return engaged areas and rate of removal, without a force.

        `unit_loads` are computed at the motion's speed.
        """
        response = self._response
        if not self.asked:
            return response
        share, advance, layer, density = self._elements.find(motion)
        met = np.flatnonzero(share)
        engaged = self._areas[met] * share[met]
        lengths = self._edges[met] * share[met]
        speeds = advance[met].astype(np.float64)
        layers = layer[met]
        response.engaged_m2[:] = np.bincount(layers, engaged, minlength=len(self.layer_names))
        response.removal_rate_m3_s = float(engaged @ speeds) * motion.speed_m_s
        chip = self.bone.cutter.chip_per_speed_s * motion.speed_m_s * speeds
        edge = np.full(len(met), 1.0 if motion.speed_m_s > 0.0 else motion.pressed)
        weights = -lengths[:, None] * np.stack([chip, edge], axis=1)
        levers = self._levers[met]
        for at, nodes in enumerate(self.nodes):
            here = layers == at
            self.unit_loads[at][:] = _sums(
                weights[here], levers[here], nodes.shares[density[met][here]], motion
            )
        return response


def _sums(weights: Array, levers: Array, shares: Array, motion: ToolMotion) -> Array:
    """Return the loads of elements, summed by node density.

    `weights` of chip and edge have shape (n, 2), `levers` (n, 18) and `shares` at nodes (n, nodes).
    """
    columns = (weights[:, :, None] * levers[:, None, :]).reshape(len(weights), 2 * levers.shape[1])
    sums = (shares.T @ columns).reshape(shares.shape[1], COEFFICIENTS, 2, 3)
    return np.asarray(sums @ motion.rotation.T).reshape(shares.shape[1], COEFFICIENTS, 6)
