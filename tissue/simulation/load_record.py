"""Record of a run's geometry, to compute its loads for other cutting coefficients.

Loads are the force and the torque on the tool. Loads for other coefficients are computed without
another run.

The force on a cutter is the sum of the forces on its cutting elements. The force on a cutting
element is proportional to the length of its edge. On a given path of the tool, the engaged bone and
the chip thickness do not depend on the coefficients. One run therefore records unit loads: the
loads of a unit force per length, at sampled values (nodes) of density and chip thickness. Then::

    loads = sum over layers, density nodes and chip nodes h of
            strength * ((K_tc, K_rc, K_ac) effective(h) + (K_te, K_re, K_ae) share(h)) . unit loads

Here K are the tangential, radial and axial chip and edge coefficients, and ``strength`` is the
weight of a density node (`DensityNodes.strengths`). For ``effective`` and ``share``, see
`tissue.materials.constants.effective_chip`. Compared with ``model_force`` and ``model_torque`` of a
run with the same coefficients, the relative error is at most 1e-6 for a law that is linear in the
chip thickness, and at most 0.3 % for other laws.
"""

from copy import deepcopy
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.cutters.cutter import Cutter
from tissue.materials.constants import CuttingCoefficients, effective_chip
from tissue.models.bone.engagement import (
    DIRECTIONS,
    LINEAR_CHIPS_M,
    DensityNodes,
    EngagedBone,
    chip_nodes,
)
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import TICK_S, Response, ToolMotion
from tissue.models.tooth.model import ToothModel
from tissue.motion.motion import Motion
from tissue.scene.anatomy import CutAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import ReplayMotion, Tool
from tissue.simulation.builders.parts import motion_of
from tissue.simulation.loop import Loop, undisturbed
from tissue.simulation.simulate import builder_of, tick_count
from tissue.simulation.trace import Table

SENSITIVITIES = (
    *CuttingCoefficients.CHIP,
    *CuttingCoefficients.EDGE,
    "density_exponent",
    "density_factor",
    "size_exponent",
    "minimum_chip_m",
)
"""Variables of each layer by which `LoadRecord.jacobian` differentiates."""
MOST_BYTES = 1_000_000_000
"""Largest size of a `LoadRecord` [bytes].

This size is enough to record every tick of a run of 60 s in two layers of varying density, or of a
run of an hour in one layer of constant density.
"""


@dataclass(frozen=True, eq=False)
class LayerLoads:
    """Loads on the tool under unit forces per edge length, in one layer that the tool engaged.

    Attributes
    ----------
    nodes
        Values of density at which loads are recorded (density nodes).
    chips_m
        Values of chip thickness at which loads are recorded (chip nodes) [m], shape (k,).
    unit
        Force and torque under a unit force per edge length, shape (nodes, 3 k, n, 6). The axes are
        the density nodes, three directions at each of k chip nodes, n ticks, and the components of
        force and torque.
    """

    nodes: DensityNodes
    chips_m: Array
    unit: Array

    def values(self, coefficients: CuttingCoefficients) -> Array:
        """Return the force per edge length at the chip nodes [N/m], shape (3 k,); see `chips_m`."""
        basis, values = self._basis(coefficients)
        return values @ basis

    def slopes(self, coefficients: CuttingCoefficients) -> Array:
        """Return the derivatives of `values`, shape (8, 3 k).

        The rows are the derivatives with respect to the six coefficients, the size exponent and the
        minimum chip thickness.
        """
        basis, values = self._basis(coefficients)
        minimum = coefficients.minimum_chip_m
        if minimum == 0.0:
            return np.vstack([basis, np.zeros((2, basis.shape[1]))])
        cut = np.maximum(self.chips_m, minimum)
        below = self.chips_m < minimum
        effective = basis[0, ::DIRECTIONS]
        share = basis[DIRECTIONS, ::DIRECTIONS]
        chips = values[:DIRECTIONS]
        edges = values[DIRECTIONS:]
        by_exponent = -np.log(cut / coefficients.reference_chip_m) * effective
        chip_by_minimum = np.where(below, -coefficients.size_exponent / minimum * effective, 0.0)
        edge_by_minimum = np.where(below, -share / minimum, 0.0)
        by_minimum = np.multiply.outer(chip_by_minimum, chips)
        by_minimum += np.multiply.outer(edge_by_minimum, edges)
        return np.vstack([basis, np.multiply.outer(by_exponent, chips).ravel(), by_minimum.ravel()])

    def _basis(self, coefficients: CuttingCoefficients) -> tuple[Array, Array]:
        """Return the derivatives of `values` by the six coefficients, and the six coefficients.

        The shapes are (6, 3 k) and (6,).
        """
        names = CuttingCoefficients.CHIP + CuttingCoefficients.EDGE
        values = np.array([getattr(coefficients, name) for name in names])
        effective, share = effective_chip(
            self.chips_m,
            coefficients.size_exponent,
            coefficients.minimum_chip_m,
            coefficients.reference_chip_m,
        )
        parts = [np.kron(each, np.eye(DIRECTIONS)) for each in (effective, share)]
        return np.vstack(parts), values


@dataclass(frozen=True, eq=False)
class LoadRecord:
    """Recorded geometry of one run, from which its loads are computed.

    Attributes
    ----------
    scene
        Scene of the run.
    times_s
        Times of the recorded ticks, shape (n,).
    layer_names
        Names of all layers of the bone, including layers that the tool did not engage.
    layers
        Unit loads of the engaged layers, keyed by the index of the layer in `layer_names`.
    engaged_m2
        Engaged area of the tool in each layer [m2], shape (n, layers).
    trace
        Rows of the trace for the recorded ticks, with 0 in the columns of force and torque.
    notes
        Notes on assumptions and findings from the build of the scene, keyed by subject.
    """

    scene: Scene
    times_s: Array
    layer_names: tuple[str, ...]
    layers: dict[int, LayerLoads]
    engaged_m2: Array
    trace: Table
    notes: dict[str, str]

    def loads(
        self, coefficients: tuple[CuttingCoefficients, ...], density_factors: Array | None = None
    ) -> Array:
        """Return the loads on the tool in the world frame, shape (n, 6).

        The loads are the force [N], followed by the torque about the tip [N m].

        Parameters
        ----------
        coefficients
            Coefficients of each layer, in the order of `layer_names`.
        density_factors
            Factors, shape (layers,), by which the density of each layer is multiplied; if None, all
            factors are 1.
        """
        loads = np.zeros((len(self.times_s), 6))
        for at, weights in self.weights(coefficients, density_factors).items():
            unit = self.layers[at].unit
            loads += (weights @ unit.reshape(len(weights), -1)).reshape(loads.shape)
        return loads

    def weights(
        self, coefficients: tuple[CuttingCoefficients, ...], density_factors: Array | None = None
    ) -> dict[int, Array]:
        """Return the factors that multiply the unit loads of each layer, shape (nodes * 3 k,).

        The result has the same keys as the attribute `layers`.

        For the arguments, see `loads`.
        """
        found = {}
        for at, layer in self.layers.items():
            factor = 1.0 if density_factors is None else float(density_factors[at])
            strengths = _strengths(layer, coefficients[at], factor)
            found[at] = np.multiply.outer(strengths, layer.values(coefficients[at])).ravel()
        return found

    def jacobian(
        self, coefficients: tuple[CuttingCoefficients, ...], density_factors: Array | None = None
    ) -> Array:
        """Return the derivatives of the loads with respect to the `SENSITIVITIES` of each layer.

        The result has shape (n, 6, layers, 10). For the arguments, see `loads`.
        """
        found = np.zeros((len(self.times_s), 6, len(self.layer_names), len(SENSITIVITIES)))
        for at, layer in self.layers.items():
            factor = 1.0 if density_factors is None else float(density_factors[at])
            each = coefficients[at]
            strengths = _strengths(layer, each, factor)
            values = layer.values(each)
            grown = strengths * layer.nodes.logarithms(
                reference_kg_m3=each.reference_density_kg_m3, factor=factor
            )
            unit, unit_grown = np.tensordot(np.stack([strengths, grown]), layer.unit, 1)
            slopes = np.moveaxis(np.tensordot(layer.slopes(each), unit, 1), 0, -1)
            found[:, :, at, :6] = slopes[..., :6]
            found[:, :, at, 6] = np.tensordot(values, unit_grown, 1)
            found[:, :, at, 7] = np.tensordot(values, unit, 1) * (each.density_exponent / factor)
            found[:, :, at, 8:] = slopes[..., 6:]
        return found


def _strengths(layer: LayerLoads, coefficients: CuttingCoefficients, factor: float) -> Array:
    reference = coefficients.reference_density_kg_m3
    return layer.nodes.strengths(
        coefficients.density_exponent, reference_kg_m3=reference, factor=factor
    )


def why_not_linear(scene: Scene) -> str:
    """Return the reason why loads are nonlinear in the cutting coefficients, or an empty text.

    For linear loads, one run of the scene is enough to compute the loads for other coefficients.
    """
    if not isinstance(scene.anatomy, CutAnatomy) or not isinstance(scene.tool, Tool):
        return (
            f"a {scene.tool.kind} in the anatomy {scene.anatomy.kind} has no cutting coefficients"
        )
    if scene.device is not None:
        return (
            f"the device {scene.held.kind} yields to the force, so that the tool's path depends "
            "on the coefficients"
        )
    if scene.motion.kind not in ("path", "replay"):
        return (
            f"the path of a motion of kind {scene.motion.kind} may depend on the force and "
            "therefore on the coefficients"
        )
    if scene.tool.spin_rpm == 0.0:
        return "a tool that does not turn cuts nothing"
    return ""


def record_loads(
    scene: Scene,
    *,
    motion: Motion | None = None,
    every: int = 1,
    compute: str = "cpu",
    cores: int | None = None,
    progress: Progress | None = None,
) -> LoadRecord:
    """Run a scene once, and record the unit loads from which its loads can be computed.

    The bone is carved in every tick, as in a run. Stress, heat, and distances to structures that
    must not be touched are not computed.

    Parameters
    ----------
    scene
        Scene in which a cutter mills bone or tooth on a given path.
    motion
        Tool motion that is used, up to its end, instead of the motion of the scene. The motion must
        not depend on the force.
    every
        Interval between two recorded ticks [ticks].
    compute, cores, progress
        As for `tissue.simulation.simulate.simulate`.

    Raises
    ------
    InputError
        If the loads are not linear (see `why_not_linear`), the record would be larger than
        `MOST_BYTES`, or `simulate` would raise an error.
    """
    report = progress or silent
    if motion is not None:
        stands_in = ReplayMotion(kind="replay", file="poses that were given")
        scene = scene.model_copy(update={"motion": stands_in, "device": None, "duration_s": None})
    if why := why_not_linear(scene):
        raise InputError(
            "scene",
            "have a force that is linear in the cutting coefficients",
            f"a scene where {why}",
            "simulate the scene instead",
        )
    scene = scene.model_copy(update={"stress": None, "heat": False, "keep_clear": None})
    motion = motion or motion_of(scene)
    build = builder_of(scene.anatomy.kind)
    parts = build(scene, motion, step_s=TICK_S, compute=compute, cores=cores, report=report)
    model = parts.tissue.milling if isinstance(parts.tissue, ToothModel) else parts.tissue
    assert isinstance(model, BoneModel)
    chips_m = LINEAR_CHIPS_M
    if not _is_linear(scene, model.layer_names):
        fastest_m_s = _fastest_m_s(motion, tick_count(scene, motion), model.cutter)
        chips_m = chip_nodes(fastest_m_s * model.cutter.chip_per_speed_s)
    bone = EngagedBone(model, chips_m)
    loop = Loop(replace(parts, tissue=bone), ticks=tick_count(scene, motion), output=scene.output)
    unit, engaged = _recorded(loop, bone, every, report)
    rows = loop.trace.rows[::every]
    return LoadRecord(
        scene=scene,
        times_s=loop.trace["time_s"][::every],
        layer_names=bone.layer_names,
        layers={
            at: LayerLoads(bone.nodes[at], chips_m, each)
            for at, each in enumerate(unit)
            if each.any()
        },
        engaged_m2=engaged,
        trace=replace(loop.trace, rows=rows),
        notes=parts.notes,
    )


def _is_linear(scene: Scene, layer_names: tuple[str, ...]) -> bool:
    """Return True if the cutting laws of all layers are linear in the chip thickness."""
    changes = scene.cutting.model_dump(exclude={"material"}, exclude_none=True)
    for layer in layer_names:
        known = scene.constants.layer_constants(layer, bone=scene.cutting.material)
        highest = known["minimum_chip_um"].high if "minimum_chip_um" in known else 0.0
        if changes.get("minimum_chip_um", highest) > 0.0:
            return False
    return True


def _fastest_m_s(motion: Motion, ticks: int, cutter: Cutter) -> float:
    """Return an upper bound [m/s] of the speed of points on a cutter, without its spin.

    The motion must not depend on the force.
    """
    motion = deepcopy(motion)
    reach_m = cutter.profile.radius_m + float(np.abs(cutter.profile.height_range_m).max())
    tool = ToolMotion()
    motion.begin(tool)
    fastest = 0.0
    for tick in range(ticks):
        motion.advance(TICK_S * tick, TICK_S, Response.empty(1), tool)
        velocity, turning = np.linalg.norm(tool.heading, axis=1).tolist()
        fastest = max(fastest, tool.speed_m_s * (velocity + turning * reach_m))
    return fastest


def _recorded(
    loop: Loop, bone: EngagedBone, every: int, report: Progress
) -> tuple[list[Array], Array]:
    """Run a loop, and record its unit loads and engaged areas.

    Every tick whose index is a multiple of `every` is recorded. The unit loads of each layer have
    shape (nodes, 3 k, n, 6).
    """
    ticks = len(loop.trace.rows)
    count = -(-ticks // every)
    needed = sum(each.nbytes for each in bone.unit_loads) * count
    if needed > MOST_BYTES:
        raise InputError(
            "every",
            f"limit the record to {MOST_BYTES / 1e9:g} GB",
            f"{every} for {ticks} ticks, which need {needed / 1000000000.0:.1f} GB",
            f"use {every * -(-needed // MOST_BYTES)}",
        )
    unit = [np.zeros((*each.shape[:2], count, 6)) for each in bone.unit_loads]
    engaged = np.zeros((count, len(unit)))
    reported_s = 0.0
    loop.place()
    with undisturbed():
        for tick in range(ticks):
            bone.computes_loads = tick % every == 0
            loop.step()
            if bone.computes_loads:
                engaged[tick // every] = bone.engaged_m2
                for all_ticks, each in zip(unit, bone.unit_loads, strict=True):
                    all_ticks[:, :, tick // every] = each
            # Ten reports per second are enough for a reader.
            if perf_counter() - reported_s > 0.1:
                reported_s = perf_counter()
                report("recording the geometry", tick / ticks)
    loop.finish()
    return unit, engaged
