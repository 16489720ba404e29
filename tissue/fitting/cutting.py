"""Loads on a cutter along the poses of a log, for any cutting coefficients.

The geometry of the cut is recorded only once.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from tissue.fitting.log import MeasuredLog
from tissue.fitting.log_files import CHANNELS
from tissue.fitting.posterior import require_signs
from tissue.fitting.problem import MeasuredLoads, Parameter, Problem, chosen, shift_operators
from tissue.materials.constants import CUT_AS, N_MM, N_MM2, UM, CuttingCoefficients, Prior
from tissue.models.bone.engagement import DensityNodes
from tissue.models.tissue_model import TICK_S
from tissue.motion.motion import FollowPath
from tissue.motion.replay import ReplayPoses
from tissue.scene.anatomy import BlockAnatomy
from tissue.scene.scene import Cutting, Scene, Voxels
from tissue.scene.tool import Tool
from tissue.simulation.load_record import SENSITIVITIES, LayerLoads, LoadRecord, record_loads

DENSITY = Prior(1.0, 0.85, 1.18)
"""Prior of a density factor, by which a layer's density is multiplied.

The standard deviation is 10 %. It is an assumption: laws that convert CT numbers to density differ
by this amount between scanners and authors.
"""
FACTOR = "density_factor"
"""Value of `FreeConstant.field` for a density factor."""
FIELDS = {
    **{field.removesuffix("_Pa") + "_N_mm2": (field, N_MM2) for field in CuttingCoefficients.CHIP},
    **{field.removesuffix("_N_m") + "_N_mm": (field, N_MM) for field in CuttingCoefficients.EDGE},
    "density_exponent": ("density_exponent", 1.0),
    "size_exponent": ("size_exponent", 1.0),
    "minimum_chip_um": ("minimum_chip_m", UM),
}
"""For each constant: field of `CuttingCoefficients`, and factor to the unit of that field."""


@dataclass(frozen=True)
class FreeConstant:
    """A free constant of one layer.

    Attributes
    ----------
    parameter
        Name and prior of the constant.
    layer
        Index of the layer.
    field
        Field of `CuttingCoefficients`, or ``density_factor``.
    unit
        Factor that converts the parameter's unit to the field's unit.
    """

    parameter: Parameter
    layer: int
    field: str
    unit: float


@dataclass(frozen=True, eq=False)
class CuttingForward:
    """Loads of a recorded cut as a function of free constants, see `Forward`.

    Attributes
    ----------
    record
        Geometry of the cut.
    coefficients
        Cutting coefficients of each layer. In `loads`, the values of the free constants replace the
        corresponding coefficients.
    free
        Free constants.
    times_s
        Times of the loads on the same clock as the poses [s], shape (n,).
    notes
        Assumptions, in words.
    """

    record: LoadRecord
    coefficients: tuple[CuttingCoefficients, ...]
    free: tuple[FreeConstant, ...]
    times_s: Array
    notes: tuple[str, ...] = ()
    channels: tuple[str, ...] = CHANNELS

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See `Forward`."""
        return tuple(each.parameter for each in self.free)

    def loads(self, x: Array) -> Array:
        """Return the loads, see `Forward`."""
        return self.record.loads(*self._with(x))

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of the loads, see `Forward`."""
        slopes = self.record.jacobian(*self._with(x))
        columns = [
            slopes[:, :, each.layer, SENSITIVITIES.index(each.field)] * each.unit
            for each in self.free
        ]
        return np.stack(columns, axis=-1)

    def averaged_as(self, log: MeasuredLoads) -> tuple["CuttingForward", MeasuredLoads]:
        """Return the cut with block-averaged loads, and a log that matches these loads.

        A sample of the log is a mean over a block of time. The loads of the cut are averaged over
        overlapping blocks of the same duration, with three blocks per duration. The returned log
        treats its samples as values at one time, because the loads of the cut are already averages
        over blocks.

        A fit computes loads thousands of times, so the averages are computed once, before the fit.
        """
        span_s = log.within_s[-1] - log.within_s[0]
        # with three points per block, the interpolation error is 0.1 to 0.4 % of a milling force
        # (root mean square); with one point it is 1 to 2 %
        every = max(round(span_s / TICK_S / 3.0), 1)
        times_s = self.times_s[::every]
        means, _ = shift_operators(self.times_s, times_s, 0.0, log.within_s)
        layers = {}
        for at, each in self.record.layers.items():
            by_time = means @ np.moveaxis(each.unit, 2, 0).reshape(len(self.times_s), -1)
            shape = (len(times_s), *each.unit.shape[:2], each.unit.shape[3])
            layers[at] = replace(
                each, unit=np.ascontiguousarray(np.moveaxis(by_time.reshape(shape), 0, 2))
            )
        record = replace(self.record, times_s=self.record.times_s[::every], layers=layers)
        return replace(self, record=record, times_s=times_s), replace(log, within_s=(0.0,))

    def _with(self, x: Array) -> tuple[tuple[CuttingCoefficients, ...], Array]:
        """Return the cutting coefficients and the density factor of each layer.

        `x` contains the values of the free constants, shape (p,).
        """
        found = list(self.coefficients)
        factors = np.ones(len(found))
        for each, value in zip(self.free, np.asarray(x, dtype=float).tolist(), strict=True):
            # a density factor belongs to the layer, all others are fields of its coefficients
            if each.field == FACTOR:
                factors[each.layer] = value
            else:
                found[each.layer] = replace(found[each.layer], **{each.field: value * each.unit})
        return tuple(found), factors


def cutting_forward(
    scene: Scene,
    times_s: Array,
    tips_m: Array,
    quaternions: Array,
    *,
    free: Sequence[str] = (),
    cores: int | None = None,
    progress: Progress | None = None,
) -> CuttingForward:
    """Record the cut along the poses of a log, and return its loads as a function of constants.

    Parameters
    ----------
    scene
        Scene with the bone or tooth and the tool. The motion and the device of the scene are
        ignored.
    times_s
        Times of the poses, increasing [s], shape (n,).
    tips_m, quaternions
        Positions of the tool's tip [m], shape (n, 3), and orientations (x, y, z, w), shape (n, 4),
        in the scene's frame.
    free
        Free constants: full names, or a table name followed by parts of the constant's name, such
        as ``cutting.trabecular``, ``cutting.edge`` or ``cutting.trabecular.radial``. Default: all
        constants that have a range and are not set by the scene. These are also the constants that
        an uncertainty band varies. The density exponent is free only if a layer's density differs
        from the reference density of its cutting coefficients. The factor on each layer's density
        is always free.
    cores
        Processor cores to use; default all.
    progress
        Called with a description of the current step.

    Raises
    ------
    InputError
        If the scene has no bone or tooth, the tool never touches the bone or tooth along the poses,
        or `free` names an unknown constant.
    """
    motion = ReplayPoses(times_s, tips_m, quaternions)
    record = record_loads(scene, motion=motion, cores=cores, progress=progress)
    if not record.layers:
        raise InputError(
            "measured",
            "contain poses at which the tool cuts",
            "a log whose tool only moves through air",
            "give the log of a cut, with poses in the frame of the scene",
        )
    notes = [f"{subject}: {each}" for subject, each in record.notes.items()]
    if (inside := float(record.trace["removed_mm3"][0])) > 0.0:
        notes.append(
            f"at the first pose of the log, the tool overlaps {inside:.3g} mm3 of bone. This bone "
            "was removed without a force, because earlier cuts are not known"
        )
    forward = forward_of(scene, record, free)
    return replace(forward, times_s=float(times_s[0]) + record.times_s, notes=tuple(notes))


def forward_of(scene: Scene, record: LoadRecord, free: Sequence[str]) -> CuttingForward:
    """Return the loads of a recorded cut as a function of free constants, see `cutting_forward`."""
    changes = scene.cutting.model_dump(exclude={"material"}, exclude_none=True)
    return CuttingForward(
        record,
        scene.constants.coefficients(record.layer_names, changes, bone=scene.cutting.material),
        _free_constants(scene, record, free, stated=changes.keys()),
        record.times_s,
    )


def _free_constants(
    scene: Scene, record: LoadRecord, free: Sequence[str], *, stated: Collection[str]
) -> tuple[FreeConstant, ...]:
    """Return the free constants of the layers that the tool touched, see `cutting_forward`."""
    possible = []
    usual = set[str]()
    tags: dict[str, str] = {}
    for at, layer in record.layers.items():
        name = record.layer_names[at]
        known = scene.constants.layer_constants(name, bone=scene.cutting.material)
        # the exponent has no effect where the density is the reference density
        is_scaled = (layer.nodes.densities_kg_m3 != known[REFERENCE].value).any()
        for constant, (field, unit) in FIELDS.items():
            if known[constant].low == known[constant].high:
                continue
            parameter = Parameter.of(
                f"cutting.{name}.{constant}", Prior.of(known[constant], constant)
            )
            possible.append(FreeConstant(parameter, at, field, unit))
            tags[parameter.name] = CUT_AS.get(name, scene.cutting.material)
            if constant not in stated and (is_scaled or constant != "density_exponent"):
                usual.add(parameter.name)
    factors = [
        FreeConstant(Parameter(f"density.{record.layer_names[at]}", DENSITY), at, FACTOR, 1.0)
        for at in record.layers
    ]
    wanted = {
        each.name for each in chosen(free, [each.parameter for each in possible + factors], tags)
    }
    # without patterns, keys that the scene states and exponents without effect stay fixed
    if not free:
        wanted = usual
    return (*(each for each in possible if each.parameter.name in wanted), *factors)


REFERENCE = "reference_density_kg_m3"
"""Key of the density at which the cutting coefficients are valid."""
FEEDS = (0.25, 1.0, 4.0)
SPINS = (0.5, 1.0, 2.0)
DEPTHS = (0.25, 0.5, 1.0)
"""Depths of cut in logs that could be measured next, relative to the radius of the tool.

`FEEDS` and `SPINS` are the feeds and spindle speeds of these logs, relative to the measured log.

Feed and spindle speed change the chip force but not the edge force. Logs at several feeds and
speeds therefore separate the coefficients of the two forces. The depth changes the directions of
the forces of the cutting elements.
"""
UP = (0.0, 0.0, 1.0)
TICKS = 60
STEADY = slice(30, 60)
"""Ticks of a recorded cut over which the steady load is averaged.

The first pose lies inside bone, so the tool begins in a cavity of its own shape. The tool has left
this cavity before tick 30. `TICKS` is the number of ticks of a recorded cut.
"""
TRAVEL = {"slot": 1.0, "plunge": 0.1}
"""Travel of the tool in each kind of recorded cut, relative to the radius of the tool.

A plunge is so short that the depth of cut hardly changes.
"""
VOXELS = 20
"""Number of voxels along a radius of the tool.

With 10, 20 and 40 voxels, the steady loads of a ball burr agree within 0.12 %.
"""
AIR = 250
LASTS = 1250
"""Number of ticks of a log that could be measured next.

The first `AIR` ticks are in air and show the bias of the sensor.
"""


def cutting_problem(
    scene: Scene, log: MeasuredLog, free: Sequence[str], *, cores: int | None, progress: Progress
) -> Problem:
    """Return the data for fitting a cut through bone or a tooth, see `fit_scene`."""
    progress("recording the geometry of the log", 0.0)
    with names_of_caller({"motion": "measured"}):
        forward = cutting_forward(
            scene,
            log.times_s,
            log.tips_m,
            log.quaternions_of(scene),
            free=free,
            cores=cores,
            progress=progress,
        )
    measured, ticks = log.averaged()
    forward, measured = forward.averaged_as(measured)
    require_signs(forward, measured)
    return Problem(
        forward,
        measured,
        ticks * TICK_S,
        lambda: cutting_candidates(forward),
        forward.notes,
        fixed_densities(scene, forward),
    )


def fixed_densities(scene: Scene, forward: CuttingForward) -> dict[str, float]:
    """Return the reference densities at which the free coefficients are valid, keyed by name."""
    fixed = {}
    for at in sorted({each.layer for each in forward.free if each.field != FACTOR}):
        layer = forward.record.layer_names[at]
        known = scene.constants.layer_constants(layer, bone=scene.cutting.material)
        fixed[f"cutting.{layer}.{REFERENCE}"] = known[REFERENCE].value
    return fixed


def cutting_candidates(like: CuttingForward) -> dict[str, CuttingForward]:
    """Return forward models of cuts that could be measured next, keyed by a description.

    Parameters
    ----------
    like
        Cut of the log. The candidates use the tool, the touched layers, the feed and the free
        constants of this cut.
    """
    tool = like.record.scene.tool
    assert isinstance(tool, Tool)
    feed_m_s = _feed_m_s(like)
    radius_m = 0.5e-3 * tool.diameter_mm
    found = {}
    for kind, depth in product(TRAVEL, DEPTHS):
        steady, recorded_m_s = _steady(like.record.scene, tool, kind, depth * radius_m)
        for at, feed, spin in product(like.record.layers, FEEDS, SPINS):
            # The chip thickness is proportional to feed over spin.
            chips_m = steady.chips_m * (feed * feed_m_s / recorded_m_s / spin)
            name = (
                f"a {kind} {1e3 * depth * radius_m:.3g} mm deep in "
                f"{like.record.layer_names[at]} at "
                f"{1e3 * feed * feed_m_s:.3g} mm/s and {spin * abs(tool.spin_rpm):.6g} rpm"
            )
            found[name] = _second_of(like, at, replace(steady, chips_m=chips_m))
    return found


def _second_of(like: CuttingForward, layer: int, steady: LayerLoads) -> CuttingForward:
    """Return a cut with no load for 0.25 s, followed by 1 s of steady loads in one layer."""
    density = round(like.record.layers[layer].nodes.middle_kg_m3)
    ticks = np.repeat(steady.unit, LASTS, axis=2)
    ticks[:, :, :AIR] = 0.0
    loads = LayerLoads(DensityNodes.of(density, density), steady.chips_m, ticks)
    times_s = TICK_S * np.arange(LASTS, dtype=np.float64)
    return replace(
        like, record=replace(like.record, times_s=times_s, layers={layer: loads}), times_s=times_s
    )


def _feed_m_s(like: CuttingForward) -> float:
    """Return the median speed of the tip during cutting [m/s]."""
    trace = like.record.trace
    speed = (
        1e-3
        * np.linalg.norm(np.diff(trace.vectors("tool", "mm"), axis=0), axis=1)
        / np.diff(trace["time_s"])
    )
    return float(np.median(speed[(trace["contact_mm2"][1:] > 0.0) & (speed > 0.0)]))


def _steady(scene: Scene, tool: Tool, kind: str, depth_m: float) -> tuple[LayerLoads, float]:
    """Return the mean `LayerLoads` of a steady cut through a block, and the feed [m/s]."""
    radius_m = 0.5e-3 * tool.diameter_mm
    travel_m = TRAVEL[kind] * radius_m
    deep = np.array([0.0, 0.0, -depth_m])
    along = np.array([travel_m, 0.0, 0.0]) if kind == "slot" else np.array([0.0, 0.0, -travel_m])
    feed_m_s = travel_m / (TICKS * TICK_S)
    # the averaged ticks are the second half of the record: a quarter of the travel to either side
    # of the depth
    motion = FollowPath(
        np.stack([deep - 0.75 * along, deep + 0.25 * along]), feed_m_s=feed_m_s, axis=UP
    )
    # the block holds the tool, its travel and the deepest plunge, with a radius of bone around them
    wide_mm = 3.0 * tool.diameter_mm
    size_mm = 2.0 * tool.diameter_mm
    block = scene.model_copy(
        update={
            "anatomy": BlockAnatomy(size_mm=(wide_mm, wide_mm, size_mm)),
            "voxels": Voxels(spacing_mm=1e3 * radius_m / VOXELS),
            "tool": tool.without_peg(),
            "cutting": Cutting(),
        }
    )
    record = record_loads(block, motion=motion)
    (layer,) = record.layers.values()
    unit = layer.unit[:1, :, STEADY].mean(axis=2, keepdims=True)
    return replace(layer, unit=unit), feed_m_s
