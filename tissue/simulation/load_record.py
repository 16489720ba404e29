"""Geometry of one run, from which loads for other cutting coefficients follow.

No further run is needed.

The force on a cutter is linear in the coefficients of each layer. On a given path of the tool, the
engaged bone does not depend on the coefficients. So one run finds the loads of a unit of each
coefficient at every tick, and::

    loads = sum over layers and density nodes of
            strength * (K_tc, K_rc, K_ac, K_te, K_re, K_ae) . unit loads

equals ``model_force`` and ``model_torque`` of a run with those coefficients, within 1e-6.
"""

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.materials.constants import CuttingCoefficients
from tissue.models.bone.engagement import COEFFICIENTS, DensityNodes, EngagedBone
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import TICK_S
from tissue.models.tooth.model import ToothModel
from tissue.motion.motion import Motion
from tissue.scene.anatomy import CutAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import ReplayMotion, Tool
from tissue.simulation.builders.parts import motion_of
from tissue.simulation.loop import Loop, undisturbed
from tissue.simulation.simulate import builder_of, tick_count
from tissue.simulation.trace import Table

__all__ = ["SENSITIVITIES", "LoadRecord", "record_loads", "why_not_linear"]


SENSITIVITIES = (
    *CuttingCoefficients.CHIP,
    *CuttingCoefficients.EDGE,
    "density_exponent",
    "density_factor",
)
"""Variables of each layer for the derivatives of `LoadRecord.jacobian`."""
MOST_BYTES = 1_000_000_000
"""Largest size of a record [bytes].

It holds 60 s of every tick in two layers with varying density, or an hour in one layer with
constant density.
"""


@dataclass(frozen=True, eq=False)
class LayerLoads:
    """Unit loads of an engaged layer, shape (nodes, 6, n, 6), and the densities of the nodes."""

    nodes: DensityNodes
    unit: Array


@dataclass(frozen=True, eq=False)
class LoadRecord:
    """Geometry of one run.

    Attributes
    ----------
    scene
        Scene of the run.
    times_s
        Times of the recorded ticks, shape (n,).
    layer_names
        All layers of the bone, including layers that the tool did not engage.
    layers
        Unit loads of the engaged layers, by the index of the layer in `layer_names`.
    engaged_m2
        Engaged area of the tool in each layer [m2], shape (n, layers).
    trace
        Recorded ticks of the run's trace, with loads of 0.
    notes
        Notes on assumptions and findings while the scene was built, by subject.
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
        """Return force [N] and torque about the tip [N m] on the tool in the world, shape (n, 6).

        Parameters
        ----------
        coefficients
            Coefficients of each layer, in the order of `layer_names`.
        density_factors
            Factors of the density of each layer, shape (layers,); None for 1.
        """
        loads = np.zeros((len(self.times_s), 6))
        for at, weights in self.weights(coefficients, density_factors).items():
            unit = self.layers[at].unit
            loads += (weights @ unit.reshape(len(weights), -1)).reshape(loads.shape)
        return loads

    def weights(
        self, coefficients: tuple[CuttingCoefficients, ...], density_factors: Array | None = None
    ) -> dict[int, Array]:
        """Return factors of each layer's unit loads, shape (nodes * 6,).

        Arguments are as for `loads`.
        """
        found = {}
        for at, layer in self.layers.items():
            factor = 1.0 if density_factors is None else float(density_factors[at])
            strengths = _strengths(layer, coefficients[at], factor)
            found[at] = np.multiply.outer(strengths, _values(coefficients[at])).ravel()
        return found

    def jacobian(
        self, coefficients: tuple[CuttingCoefficients, ...], density_factors: Array | None = None
    ) -> Array:
        """Return derivatives of the loads by each layer's `SENSITIVITIES`, shape (n, 6, layers, 8).

        Arguments are as for `loads`.
        """
        found = np.zeros((len(self.times_s), 6, len(self.layer_names), COEFFICIENTS + 2))
        for at, layer in self.layers.items():
            factor = 1.0 if density_factors is None else float(density_factors[at])
            each = coefficients[at]
            strengths = _strengths(layer, each, factor)
            values = _values(each)
            grown = strengths * layer.nodes.logarithms(
                reference_kg_m3=each.reference_density_kg_m3, factor=factor
            )
            unit, unit_grown = np.tensordot(np.stack([strengths, grown]), layer.unit, 1)
            found[:, :, at, :COEFFICIENTS] = np.moveaxis(unit, 0, -1)
            found[:, :, at, -2] = np.tensordot(values, unit_grown, 1)
            found[:, :, at, -1] = np.tensordot(values, unit, 1) * (each.density_exponent / factor)
        return found


def _strengths(layer: LayerLoads, coefficients: CuttingCoefficients, factor: float) -> Array:
    reference = coefficients.reference_density_kg_m3
    return layer.nodes.strengths(
        coefficients.density_exponent, reference_kg_m3=reference, factor=factor
    )


def _values(coefficients: CuttingCoefficients) -> Array:
    """Return the six coefficients in SI units."""
    return np.array(
        [
            getattr(coefficients, name)
            for name in CuttingCoefficients.CHIP + CuttingCoefficients.EDGE
        ]
    )


def why_not_linear(scene: Scene) -> str:
    """Return the reason for which a scene's loads are not linear in coefficients; else "".

    With linear loads, one run gives the loads for other coefficients.
    """
    if not isinstance(scene.anatomy, CutAnatomy) or not isinstance(scene.tool, Tool):
        return (
            f"a {scene.tool.kind} in a {scene.anatomy.kind} has no cutting coefficients to be "
            "linear in"
        )
    if scene.device is not None:
        return (
            f"the device {scene.held.kind} yields to the force, so that the tool's path depends "
            "on the coefficients"
        )
    if scene.motion.kind not in ("path", "replay"):
        return (
            f"the path of a motion of kind {scene.motion.kind} may depend on the force, and so "
            "on the coefficients"
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
    """Run a scene's geometry once and record its unit loads.

    The bone is carved at every tick as in a run, without stress, heat and keep clear.

    Parameters
    ----------
    scene
        A bone or tooth that a cutter mills on a given path.
    motion
        Motion of the tool in place of the scene's motion, for its whole duration. It must not
        depend on the force.
    every
        Ticks between two recorded ticks.
    compute, cores, progress
        As for `tissue.simulation.simulate.simulate`.

    Raises
    ------
    InputError
        If the loads are not linear, see `why_not_linear`, the record would not fit in `MOST_BYTES`,
        or as for `simulate`.
    """
    report = progress or silent
    if motion is not None:
        stands_in = ReplayMotion(kind="replay", file="poses that were given")
        scene = scene.model_copy(update={"motion": stands_in, "device": None, "duration_s": None})
    if why := why_not_linear(scene):
        raise InputError(
            "scene", "have a force that is linear in the coefficients", f"one where {why}", "run it"
        )
    scene = scene.model_copy(update={"stress": None, "heat": False, "keep_clear": None})
    motion = motion or motion_of(scene, step_s=TICK_S)
    build = builder_of(scene.anatomy.kind)
    parts = build(scene, motion, step_s=TICK_S, compute=compute, cores=cores, report=report)
    model = parts.tissue.milling if isinstance(parts.tissue, ToothModel) else parts.tissue
    assert isinstance(model, BoneModel)
    bone = EngagedBone(model, device=compute, cores=cores)
    loop = Loop(replace(parts, tissue=bone), ticks=tick_count(scene, motion), output=scene.output)
    unit, engaged = _recorded(loop, bone, every, report)
    rows = loop.trace.rows[::every]
    return LoadRecord(
        scene=scene,
        times_s=loop.trace["time_s"][::every],
        layer_names=bone.layer_names,
        layers={at: LayerLoads(bone.nodes[at], each) for at, each in enumerate(unit) if each.any()},
        engaged_m2=engaged,
        trace=replace(loop.trace, rows=rows),
        notes=parts.notes,
    )


def _recorded(
    loop: Loop, bone: EngagedBone, every: int, report: Progress
) -> tuple[list[Array], Array]:
    """Record unit loads and engaged areas of a loop.

    One tick in `every` is recorded. The unit loads of each layer have shape (nodes, 6, n, 6).
    """
    ticks = len(loop.trace.rows)
    count = -(-ticks // every)
    needed = sum(each.nbytes for each in bone.unit_loads) * count
    if needed > MOST_BYTES:
        raise InputError(
            "every",
            f"leave the record within {MOST_BYTES / 1000000000.0:g} GB",
            f"{every} for {ticks} ticks, which need {needed / 1000000000.0:.1f} GB",
            f"use {every * -(-needed // MOST_BYTES)}",
        )
    unit = [np.zeros((*each.shape[:2], count, 6)) for each in bone.unit_loads]
    engaged = np.zeros((count, len(unit)))
    reported_s = 0.0
    loop.place()
    with undisturbed():
        for tick in range(ticks):
            bone.asked = tick % every == 0
            loop.step()
            if bone.asked:
                engaged[tick // every] = bone.engaged_m2
                for all_ticks, each in zip(unit, bone.unit_loads, strict=True):
                    all_ticks[:, :, tick // every] = each
            # Ten reports a second are enough for a reader.
            if perf_counter() - reported_s > 0.1:
                reported_s = perf_counter()
                report("recording the geometry", tick / ticks)
    loop.finish()
    return unit, engaged
