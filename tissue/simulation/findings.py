"""Findings of a finished run: targets that the tool did not reach, and break-throughs."""

from dataclasses import replace
from math import floor, log10
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from meshes.paths.toolpath import path_distance
from meshes.voxels.volume import FULL, VoxelVolume
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand_motion import HandMotion
from tissue.models.tissue_model import TICK_S
from tissue.motion.motion import Events, Motion, frame_along
from tissue.scene.anatomy import Bone, MolarAnatomy, Tooth
from tissue.scene.coupling import SMALLEST_MOTION_SCALE
from tissue.scene.organ import LayersAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, ReplayMotion, ThrustMotion, Tool
from tissue.simulation.bone_surface import tool_axes
from tissue.simulation.builders.force_scale import chosen_scale, expected_force
from tissue.simulation.builders.parts import Parts
from tissue.simulation.trace import Table

MOSTLY = 0.5
"""Smallest share of the caries within the tool's reach that a run must remove.

If less is removed, the run contains a note on missed caries. The share was chosen by judgement.
"""
TOLERANCE_MM = 0.05
"""Requested minus reached depth of a thrust [mm], above which a run has a note.

The value is half the default edge of a voxel.
"""
FAR_RADII = 2.0
"""Distance of a tool in contact from its path, above which a smaller force scale is suggested.

The unit is the radius of the tool. With small force scales and a bur of 1 mm, simulated hands
reached largest distances of 1.0 to 1.4 radii, in the scene `molar` and in a scanned molar.
"""
STEADY_SCALE = 0.2
"""Suggested motion scale, divided by the motion scale of a run whose tool left its path.

The value was chosen by judgement.
"""
RISING_S = 0.1
"""Last part of a run [s] in which a maximum of the temperature counts as still rising.

The temperature in the trace changes every 20 ms and has a delay of 20 ms. The value was chosen by
judgement.
"""
LEAST_DENSE = 0.001
"""Share of cortical and subchondral bone below which a run with a density image has a note.

The share was chosen by judgement.
"""
SHORTEST_RECORDING_MM = 0.5
"""Extent of a recorded motion along an axis [mm] below which a note suggests to check the unit.

A hand moves a tool farther, and 0.5 m of a motion read in mm instead of m has this extent. The
value was chosen by judgement.
"""
FORWARD = 0.5
"""Smallest ratio of axial travel to travel in a tick that counts as forward motion.

The limit excludes a tool that leaves the bone sideways.
"""


def findings(
    scene: Scene, parts: Parts, trace: Table, *, path_s: float
) -> tuple[dict[str, Any], Events]:
    """Return the findings of a run as summary entries, and the break-throughs as events.

    Notes on the findings are added to the notes of `parts`. For ``path_s``, see `shortfalls`.
    """
    apart_mm = path_distance_mm(scene, parts.motion, trace)
    parts.notes |= shortfalls(scene, parts, trace, path_s=path_s)
    parts.notes |= path_note(scene, parts, apart_mm)
    parts.notes |= region_note(parts, trace)
    found: dict[str, Any] = {}
    if apart_mm is not None:
        found["path_distance_mm"] = apart_mm
    if "insertion_mm" in trace.columns:
        found["largest_insertion_mm"] = float(trace["insertion_mm"].max())
    if rise := largest_rise(trace):
        found["largest_rise"] = rise
    cutter = parts.cutter
    if parts.volume is None or cutter is None or cutter.spin_rad_s == 0.0:
        return found, []
    # The trace is only valid while the tool is in the simulated region.
    left = None if parts.region_end is None else parts.region_end.left_tick
    valid = replace(trace, rows=trace.rows[:left])
    broke = break_throughs(parts.volume, valid, radius_m=cutter.profile.radius_m)
    if broke:
        found["break_through"] = broke
    return found, [
        (each["time_s"], f"broke through, {each['plunge_mm']:.2f} mm of plunge") for each in broke
    ]


def thrust_depth_mm(motion: ThrustMotion, trace: Table) -> Array:
    """Return the depth of the tip along the direction of a thrust [mm], shape (ticks,)."""
    direction = -frame_along(motion.axis)[:, 2]
    return trace.vectors("tool", "mm") @ direction


def shortfalls(scene: Scene, parts: Parts, trace: Table, *, path_s: float) -> dict[str, str]:
    """Return notes, keyed by subject, on targets that a run did not reach or remove.

    There is also a note if the bone has a density image, but almost no bone in the simulated region
    is dense enough to be cortical bone. ``path_s`` is the duration of the run [s], or infinity if a
    user decides when the run ends. A duration that is shorter than the scripted motion also causes
    a note.
    """
    found = {}
    wanted_s = parts.motion.duration_s - parts.motion.after_s
    if isinstance(scene.motion, ThrustMotion):
        wanted = scene.motion.depth_mm
        came = float(thrust_depth_mm(scene.motion, trace).max())
        if came < wanted - TOLERANCE_MM:
            found["path"] = (
                f"not finished: the tip reached a depth of {came:.3g} mm, and motion.depth_mm is "
                f"{wanted:g}; raise motion.thrust_N or duration_s"
            )
    # The tolerance is half a tick, because durations are rounded to ticks.
    elif wanted_s >= path_s + 5e-4:
        found["path"] = (
            f"not finished: the run ends at {path_s:g} s, but the motion ends at {wanted_s:.6g} "
            f"s; set duration_s = {wanted_s:.6g}, or leave duration_s out to run the "
            "whole motion"
        )
    if isinstance(scene.anatomy, LayersAnatomy):
        # an oblique needle is inserted farther than it is deep
        cosines = tool_axes(trace.quaternions())[:, 2]
        deepest = (trace["insertion_mm"] * cosines).max()
        # 1e-9 mm for rounding
        beyond = [
            f"the {name} at {depth:g} mm"
            for name, depth in scene.anatomy.membranes
            if depth > deepest + 1e-9
        ]
        if beyond:
            found["membranes"] = (
                f"not all reached: the needle tip went {deepest:.3g} mm deep into the tissue, "
                "measured from the deflected surface, and these lie deeper: "
                f"{', '.join(beyond)}; see anatomy.membrane_depths_mm"
            )
    if isinstance(scene.anatomy, Bone) and scene.anatomy.density_file is not None:
        start = dict(zip(parts.tissue.layer_names, parts.tissue.start_m3.tolist(), strict=True))
        # A few dense voxels, which depend on the voxel size, are not cortical bone.
        if start["cortical"] + start["subchondral"] < LEAST_DENSE * sum(start.values()):
            dense = scene.anatomy.cortical_above_kg_m3
            found["cortical bone"] = (
                f"less than {100.0 * LEAST_DENSE:g} % of the bone in the region reaches {dense:g} "
                "kg/m3. Thick voxels of a CT blur thin cortical bone; lower "
                "anatomy.cortical_above_kg_m3, or import a finer CT"
            )
    if isinstance(scene.motion, ReplayMotion):
        extent_mm = 1e3 * float(np.ptp(parts.motion.sweep_m(), axis=0).max())
        if 0.0 < extent_mm < SHORTEST_RECORDING_MM:
            found["length of the path"] = (
                f"the recorded positions span only {extent_mm:.2g} mm; check that the columns of "
                "motion.file have the units of their names"
            )
    if parts.cutter is None or parts.cutter.spin_rad_s == 0.0:
        return found
    if isinstance(scene.motion, PathMotion | ReplayMotion) and isinstance(scene.tool, Tool):
        points_mm = 1e3 * parts.motion.sweep_m()
        check = "that the columns of motion.file have the units of their names"
        if isinstance(scene.motion, PathMotion):
            points_mm = np.array(scene.motion.points_mm)
            check = "that motion.points_mm is in mm"
        length_mm = float(np.linalg.norm(np.diff(points_mm, axis=0), axis=1).sum())
        # a path in metres is a thousand times shorter
        if 0.0 < length_mm < 0.01 * scene.tool.diameter_mm:
            found["length of the path"] = (
                f"only {length_mm:.3g} mm, which is less than 1 % of the tool's diameter; check "
                f"{check}"
            )
    if not np.any(parts.tissue.removed_m3):
        found["removed"] = (
            "nothing: the tool cut no tissue; move it deeper, or let the run last longer"
        )
    elif isinstance(scene.anatomy, Tooth) and (missed := _missed_caries(scene.anatomy, parts)):
        found["removed"] = missed
    return found


def region_note(parts: Parts, trace: Table) -> dict[str, str]:
    """Return a note that suggests a larger voxel margin if the tool left the simulated region."""
    end = parts.region_end
    if end is None or end.left_s is None:
        return {}
    axes = tool_axes(trace.quaternions())
    margin_mm = end.sufficient_margin_mm(1e-3 * trace.vectors("tool", "mm"), axes)
    return {
        "simulated region": f"the tool left it at {end.left_s:.3f} s. Forces, temperatures, "
        "removed volumes and the distance from the path are not valid after this time. With "
        f"voxels.margin_mm = {margin_mm:g}, the region contains the motion of this run. The "
        "hand then also feels the tissue that is now missing, so it may move differently"
    }


def path_distance_mm(scene: Scene, motion: Motion, trace: Table) -> dict[str, float] | None:
    """Return the largest distances [mm] between tool and scripted path in a run with a hand.

    The keys are ``largest_in_contact`` and ``largest``. The result is None if no simulated hand
    moves the tool.
    """
    is_led = isinstance(motion, HandMotion) and isinstance(motion.device, SimulatedDevice)
    if not is_led or not isinstance(scene.motion, PathMotion):
        return None
    apart_mm = path_distance(trace.vectors("tool", "mm"), np.array(scene.motion.points_mm))
    touching_mm = apart_mm[trace["contact_mm2"] > 0.0]
    return {
        "largest_in_contact": float(touching_mm.max(initial=0.0)),
        "largest": float(apart_mm.max()),
    }


def path_note(scene: Scene, parts: Parts, apart_mm: dict[str, float] | None) -> dict[str, str]:
    """Return a note that suggests smaller force and motion scales if a hand left its path.

    The note also appears if the tool came too close to a structure and the distance from the path
    can be the reason. ``apart_mm`` is the result of `path_distance_mm`.
    """
    cutter = parts.cutter
    if apart_mm is None or cutter is None or cutter.spin_rad_s == 0.0:
        return {}
    radius_mm = 1e3 * cutter.profile.radius_m
    is_far = apart_mm["largest_in_contact"] > FAR_RADII * radius_mm
    close_mm = _too_close_mm(parts, apart_mm["largest"])
    if not is_far and not close_mm:
        return {}
    note = f"the tool left the path by {apart_mm['largest']:.3g} mm"
    for name, distance_mm in close_mm.items():
        note += f". The smallest distance to {name} was {distance_mm:.3f} mm"
    if is_far:
        note += _force_scale_note(scene, apart_mm["largest"], radius_mm)
    scale = scene.motion_scale
    steadier = max(STEADY_SCALE * scale, SMALLEST_MOTION_SCALE)
    if steadier < scale:
        note += (
            f". With a smaller coupling.motion_scale, such as {steadier:g} instead of {scale:g}, "
            "the tool moves less than the hand and stays closer to the path"
        )
    return {"distance from the path": note}


def _too_close_mm(parts: Parts, apart_mm: float) -> dict[str, float]:
    """Return the smallest distances [mm] to structures that the tool came too close to.

    ``apart_mm`` is the largest distance of the tool from its path. A structure is included if the
    tool came closer than the margin by at most ``apart_mm``. The distance from the path can then be
    the reason.
    """
    found = {}
    kept = {} if parts.keep_clear is None else parts.keep_clear.summary()
    for name, each in kept.items():
        least_mm = each["least_distance_mm"]
        assert least_mm is not None
        if 0.0 < (each.get("margin_mm") or 0.0) - least_mm <= apart_mm:
            found[name] = least_mm
    return found


def _force_scale_note(scene: Scene, apart_mm: float, radius_mm: float) -> str:
    """Return sentences that suggest a smaller force scale for a distance from the path [mm]."""
    scale = chosen_scale(scene).factor
    # The distance is the force at the device times the compliance of grip and coupling. Therefore
    # it is proportional to the scale. The largest distance of the whole run counts, because a
    # stretched grip drives the tool out of the tissue.
    smaller = scale * radius_mm / apart_mm
    digits = -floor(log10(smaller))
    smaller = floor(smaller * 10.0**digits) / 10.0**digits
    note = (
        ". The force at the device deflects the grip of the simulated hand. "
        f"Set coupling.force_scale = {smaller:g} instead of {scale:g}"
    )
    friction_N = device_parameters(scene.held.kind, scene.constants).friction_N
    felt_N = smaller * expected_force(scene).force_N
    if 0.0 < felt_N < friction_N:
        note += (
            f". The largest force at the device is then {felt_N:.2g} N. The friction of "
            f"{scene.held.kind}, {friction_N:g} N, hides this force: use another device"
        )
    return note


def largest_rise(trace: Table) -> dict[str, str | float | bool]:
    """Return the largest temperature rise of pulp or bone; empty if a trace has no temperatures.

    The keys are ``tissue``, ``rise_K``, ``time_s`` and ``rising_at_end``.
    """
    for tissue in ("pulp", "bone"):
        if (column := f"{tissue}_rise_K") not in trace.columns:
            continue
        tick = int(trace[column].argmax())
        rise_K = float(trace[column][tick])
        time_s = float(trace["time_s"][tick])
        is_rising = rise_K > 0.0 and time_s > trace["time_s"][-1] - RISING_S
        return {
            "tissue": tissue,
            "rise_K": rise_K,
            "time_s": time_s,
            "rising_at_end": bool(is_rising),
        }
    return {}


def _missed_caries(anatomy: Tooth, parts: Parts) -> str:
    """Return a note on missed caries: its place, if known, and how the tool can reach it.

    The note is empty if there is no lesion or the removal is sufficient. Caries is missed if no
    caries was removed or, in a tooth from files, if most of the caries within reach is left.
    """
    at = parts.notes.get("lesion")
    has_lesion = "caries" in anatomy.layer_files or at is not None
    if isinstance(anatomy, MolarAnatomy):
        has_lesion = anatomy.caries_depth_mm > 0.0
    if not has_lesion:
        return ""
    tissue = parts.tissue
    volumes = zip(tissue.layer_names, tissue.removed_m3, tissue.start_m3, strict=True)
    removed_m3, there_m3 = next((v for name, *v in volumes if name == "caries"), (0.0, 0.0))
    missed = "no caries: the tool never touched the lesion"
    if removed_m3 > 0.0:
        # In a tooth from files, the place of the lesion is not known, so the path may only graze
        # it.
        if parts.placement is None or removed_m3 >= MOSTLY * there_m3:
            return ""
        missed = (
            f"only {1e9 * removed_m3:.3g} of {1e9 * there_m3:.3g} mm3 of the caries within reach"
        )
    place = f" ({at})" if at else ""
    is_aimed = getattr(anatomy, "site", "") == "caries" or parts.placement is None
    how = "" if is_aimed else "set anatomy.site = caries, or "
    return f"{missed}{place}; {how}move motion.points_mm to it"


def break_throughs(volume: VoxelVolume, trace: Table, *, radius_m: float) -> list[dict[str, float]]:
    """Return the break-throughs: points where the tool's tip moves forward out of the bone.

    The entry ``time_s`` is the time of the first break-through in a hole [s]. The entry
    ``plunge_mm`` is the distance travelled along the axis from the break-through until the tool
    reached bone again or the run ended [mm]. If the tool passes through the hole several times, the
    largest distance is used.

    The surface of the bone is where the interpolated content of voxels before the run is one half.
    The time of an exit is interpolated between ticks. Each hole counts as one break-through. An
    exit belongs to an earlier hole if its position was inside the tool before. This means that it
    was behind the tip, and closer to the tool's axis than the tool's radius.

    Parameters
    ----------
    volume
        Bone before any cut.
    trace
        Trace of the run.
    radius_m
        Radius of the tool [m].
    """
    from scipy.ndimage import map_coordinates

    tips = trace.vectors("tool", "mm")
    at = (1e-3 * tips - volume.origin_m) / volume.spacing_m - 0.5
    share = (
        map_coordinates(volume.fraction, at.T, output=np.float32, order=1, mode="constant") / FULL
    )
    axes = tool_axes(trace.quaternions())
    steps = np.diff(tips, axis=0)
    forward = -np.einsum("ij,ij->i", steps, axes[1:])
    travel = np.concatenate([[0.0], np.cumsum(forward)])
    leaves = (
        (share[:-1] >= 0.5)
        & (share[1:] < 0.5)
        & (forward > FORWARD * np.linalg.norm(steps, axis=1))
    )
    found: list[dict[str, float]] = []
    exits_mm: list[Array] = []
    for row in np.flatnonzero(leaves):
        part = float((share[row] - 0.5) / (share[row] - share[row + 1]))
        exit_mm = tips[row] + part * steps[row]
        start = travel[row] + part * forward[row]
        again = np.flatnonzero(share[row + 1 :] >= 0.5)
        end = row + 1 + (int(again[0]) if len(again) else len(share))
        plunge_mm = float(travel[row + 1 : end].max() - start)
        # A tool comes back through a hole if the exit lies within its radius and behind its tip at
        # an earlier pose.
        away = exit_mm - tips[: row + 1]
        along = np.einsum("ij,ij->i", away, axes[: row + 1])
        across = np.linalg.norm(away - along[:, None] * axes[: row + 1], axis=1)
        if found and ((along > 0.0) & (across < 1e3 * radius_m)).any():
            hole = int(np.argmin([np.linalg.norm(exit_mm - each) for each in exits_mm]))
            found[hole]["plunge_mm"] = max(found[hole]["plunge_mm"], plunge_mm)
            continue
        found.append({"time_s": float(row + part) * TICK_S, "plunge_mm": plunge_mm})
        exits_mm.append(exit_mm)
    return found
