"""Build the soft tissue that a probe, a needle or a blade touches, and the virtual test wall."""

from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from meshes.base.cache import RecentResults
from meshes.base.errors import InputError, by, names_of_caller
from meshes.base.progress import Progress
from meshes.base.text_tables import shown
from meshes.paths.toolpath import kept_corners
from meshes.tets.tetrahedra import TetMesh
from tissue.materials.scene_constants import Materials
from tissue.models.organ.probe import (
    AREA_EDGE,
    CylinderProbe,
    ProbeShape,
    ShellProbe,
    SphereProbe,
)
from tissue.models.tissue_model import WallModel
from tissue.motion.motion import Motion
from tissue.scene.coupling import WallAnatomy
from tissue.scene.organ import IncisedAnatomy, LayersAnatomy, LiverFile, SoftAnatomy
from tissue.scene.registry import NEEDLES, PROBES
from tissue.scene.scene import Scene
from tissue.scene.tool import Blade, Needle, PathMotion, Probe
from tissue.simulation.builders.organ import OF_ORGAN, HeldMesh, held_mesh, material_of, organ_law
from tissue.simulation.builders.parts import FILE_WORDS, Parts, poses_along

if TYPE_CHECKING:
    from tissue.models.incision.parameters import Blade as IncisionBlade
    from tissue.models.needle.fields import Track
    from tissue.models.needle.parameters import NeedleTissue

ASIDE_DEG = 10.0
"""Largest angle between a needle and its path in the organ without a note [degrees]; chosen."""
POSES_TRIED = 200
"""Number of poses along a motion at which contact is searched for; chosen.

With more poses, the preparation of a run takes longer. With fewer poses, contact between two poses
may be missed.

The margin `tissue.models.organ.soft_organ.MARGIN_EDGES` is added around the triangles in contact.
"""
PATH_TOLERANCE = 0.01
"""Largest distance of a path's corners from the simplified path [edge lengths].

A path is simplified because a recorded path has one corner per tick.
"""
HAND_M = 0.01
"""Largest distance of a needle from its planned track at which fields are drawn [m].

The distance is measured at the entry point of the needle. If a hand inserts the needle farther
away, the drawn tissue is undeformed. Otherwise, displacement and stress are drawn as if the needle
were on the planned track. The value is an eighth of the width of the drawn block.
"""


_meshes: RecentResults[HeldMesh] = RecentResults(2)
"""Cached meshes of procedural organs, keyed by the organ's parameters and the tool's path."""


def pierced(scene: Scene, motion: Motion, *, report: Progress, **settings: object) -> Parts:
    """Build the objects that simulate a scene in which a needle pierces layers of tissue.

    Raises
    ------
    InputError
        If the wall of the vessel is not deeper than the capsule of the organ.
    """
    from tissue.models.needle.fields import NeedleFields, Track
    from tissue.models.needle.model import NeedleModel

    assert isinstance(scene.anatomy, LayersAnatomy) and isinstance(scene.tool, Needle)
    diameter = 1e-3 * scene.tool.diameter_mm
    tissue = pierced_tissue(scene)
    notes = {"needle": _needle_note(scene, tissue)}
    track = Track.first_of(motion.sweep_m(), motion.rotations()[:, :, 2], diameter_m=diameter)
    if track is not None and isinstance(scene.motion, PathMotion):
        notes |= _axis_note(scene.motion, track)
    fields = None
    if track is not None and scene.anatomy.interval_ms > 0.0:
        report("solving a block of the organ around the needle", 0.0)
        near = diameter if scene.device is None else HAND_M
        fields = NeedleFields.of_liver(
            track,
            near_m=near,
            interval_s=1e-3 * scene.anatomy.interval_ms,
            constants=scene.constants,
        )
        notes["fields"] = fields.note
        if scene.device is not None:
            notes["fields"] += (
                f"; if a hand enters at most {1e3 * near:g} mm from the track, the picture shows "
                "the needle on the track"
            )
    return Parts(motion, NeedleModel(tissue, diameter_m=diameter, fields=fields), notes=notes)


def incised(scene: Scene, motion: Motion, *, report: Progress, **settings: object) -> Parts:
    """Build the objects that simulate a scene in which a blade cuts a soft tissue."""
    from tissue.models.incision.fields import IncisionFields, Track
    from tissue.models.incision.model import IncisionModel
    from tissue.models.incision.parameters import incised_tissue

    anatomy = scene.anatomy
    assert isinstance(anatomy, IncisedAnatomy)
    blade = blade_of(scene)
    tissue = incised_tissue(anatomy.material, blade, constants=scene.constants)
    notes = {
        "blade": f"{tissue.toughness_J_m2:g} J/m2 of cut area in {tissue.name}; the blade's back "
        "and sides cut too; relaxation, speed and layers are not modelled"
    }
    track = Track.first_of(tissue, blade, motion.sweep_m(), motion.rotations())
    fields = None
    if track is not None and anatomy.interval_ms > 0.0:
        report("solving a block of the tissue around the cut", 0.0)
        fields = IncisionFields(track, tissue, interval_s=1e-3 * anatomy.interval_ms)
        notes["fields"] = fields.note
    return Parts(motion, IncisionModel(tissue, blade, fields=fields), notes=notes)


def pressed(
    scene: Scene,
    motion: Motion,
    *,
    step_s: float,
    compute: str,
    cores: int | None,
    report: Progress,
) -> Parts:
    """Build the objects that simulate a scene in which a probe presses a meshed organ.

    Raises
    ------
    InputError
        If the organ cannot be meshed, if no node of the organ is held, or if the probe never
        touches the organ or starts inside it.
    """
    from tissue.models.organ.model import ContactSolution, OrganModel
    from tissue.models.organ.soft_organ import ToolPath

    anatomy = scene.anatomy
    organ = scene.organ
    assert isinstance(anatomy, SoftAnatomy) and isinstance(scene.tool, Probe)
    material, notes = material_of(anatomy, organ, scene.constants)
    report("meshing the organ", 0.0)
    # The edges are a quarter of the tool's diameter. The force of a ball then differs by 0.14 %
    # from the force with an eighth (docs/verification.md).
    edge_mm = anatomy.touch_edge_mm or 0.25 * scene.tool.size_mm
    edge_m = 1e-3 * edge_mm
    kept = kept_corners(motion.sweep_m(), 1e-3 * PATH_TOLERANCE * edge_mm)
    path = motion.sweep_m()[kept]
    meshed = partial(held_mesh, anatomy, path_m=path, touch_edge_m=edge_m, report=report)
    if isinstance(anatomy, LiverFile):
        # The mesh of a file is not kept, because the file may change between two runs.
        found = meshed()
    else:
        found = _meshes.of((anatomy.model_dump_json(), path.tobytes(), edge_mm), meshed)
    probe = probe_of(scene.tool)
    notes |= found.notes
    if isinstance(probe, ShellProbe):
        sides = by(1e3 * np.ptp(probe.points_m, axis=0), ".3g")
        file = Path(scene.tool.file_name).name
        notes["tool"] = f"{file} taken at {scene.tool.scale:g} mm per unit: {sides} mm"
    with names_of_caller(OF_ORGAN):
        elasticity = material.elasticity(found.mesh)
    law = organ_law(scene, elasticity)
    report("compiling kernels (the first time on a machine)", 0.0)
    require_outside(found.mesh, motion)
    soft = material.organ(found.mesh, found.held, law=law, compute=compute)
    report("assembling the stiffness", 0.0)
    tips, turns = poses_along(motion, kept, POSES_TRIED)
    with names_of_caller({"touch_edge_m": "anatomy.touch_edge_mm"}):
        model = OrganModel(
            soft,
            ToolPath(probe, tips, turns),
            ContactSolution(organ.path, basis_size=organ.basis_size, cores=cores),
            step_s=step_s,
            interval_s=1e-3 * organ.interval_ms if organ.interval_ms > 0.0 else inf,
            report=report,
        )
    if isinstance(probe, SphereProbe):
        touched = np.isin(found.mesh.surface, model.touchable).all(axis=1)
        corners = found.mesh.nodes_m[found.mesh.surface[touched]]
        # quadratic tetrahedra have a node in the middle of an edge
        notes |= _area_note(corners, tips, probe.radius_m, edge_m=edge_m, order=organ.order)
    if organ.gravity:
        sag = 1e3 * np.linalg.norm(soft.rest[1], axis=1).max()
        notes["gravity"] = f"the organ sags by up to {sag:.3g} mm before it is touched"
    if law is not None:
        notes["law"] = f"{organ.law}, solved every {organ.law_interval_ms:g} ms"
    notes["solved"] = (
        f"{len(found.mesh.cells)} tetrahedra of order {organ.order}, {len(soft.body.free)} "
        f"unknowns; {len(model.touchable)} touchable nodes, compliance {organ.path}"
    )
    return Parts(motion, model, placement=found.placement, notes=notes)


def _area_note(
    corners_m: Array, tips_m: Array, radius_m: float, *, edge_m: float, order: int
) -> dict[str, str]:
    """Return a note if edges under a ball are too long for an accurate contact area.

    `corners_m` contains the corners of the touchable triangles [m], shape (n, 3, 3).
    `edge_m` is the edge length for which the mesh was made [m].
    """
    from scipy.spatial import cKDTree

    below_m, _ = cKDTree(tips_m).query(corners_m.mean(axis=1))
    near = corners_m[below_m <= max(0.5 * radius_m, below_m.min())]
    # at the spacing of the contact points, longer edges are divided, and their corners have no area
    apart_m = float(np.linalg.norm(near - np.roll(near, 1, axis=1), axis=2).max()) / order
    limit_m = AREA_EDGE * radius_m
    if apart_m <= limit_m:
        return {}
    wanted_m = edge_m * limit_m / apart_m
    return {
        "contact area": "contact_mm2 may be wrong by 10 % or more: nodes under the ball are "
        f"up to {1e3 * apart_m:.3g} mm apart, and the ball has a radius of {1e3 * radius_m:.3g} "
        f"mm. Set anatomy.touch_edge_mm to {1e3 * wanted_m:.2g} or less"
    }


def wall(scene: Scene, motion: Motion, **settings: object) -> Parts:
    """Build the objects that simulate a scene in which a ball is pushed against a virtual wall."""
    assert isinstance(scene.anatomy, WallAnatomy) and isinstance(scene.tool, Probe)
    radius_m = 0.5e-3 * scene.tool.size_mm
    return Parts(motion, WallModel(1e3 * scene.anatomy.stiffness_kN_m, radius_m=radius_m))


def pierced_tissue(scene: Scene) -> "NeedleTissue":
    """Return the tissue that a scene's needle pierces.

    A needle registered by the user supplies its own tissue.
    """
    from tissue.models.needle.parameters import needle_tissue, vessel_wall

    anatomy = scene.anatomy
    kind = scene.tool.kind
    assert isinstance(anatomy, LayersAnatomy)
    punctures_N = anatomy.membrane_punctures_N or {}
    holds_N = anatomy.membrane_holds_N or {}
    walls = tuple(
        vessel_wall(
            1e-3 * depth_mm,
            name=name,
            puncture_N=punctures_N.get(name),
            hold_N=holds_N.get(name),
            constants=scene.constants,
        )
        for name, depth_mm in anatomy.membranes
    )
    outside = NEEDLES[kind]
    if outside is None:
        return needle_tissue(walls=walls, constants=scene.constants)
    found: NeedleTissue = outside(walls=walls)
    return found


def _needle_note(scene: Scene, tissue: "NeedleTissue") -> str:
    """Describe the origin of a needle's built-in constants and the limits of the model."""
    anatomy = scene.anatomy
    constants = scene.constants
    assert isinstance(anatomy, LayersAnatomy)
    remarks = []
    liver = Materials.cited.constants("needle", "liver")
    cited = [name for name, entry in liver.items() if "Okamura" in entry.source]
    kept = [name for name in cited if f"needle.liver.{name}" not in constants.given]
    if kept and NEEDLES[scene.tool.kind] is None:
        which = "" if kept == cited else f"{', '.join(kept)}: "
        remarks.append(f"{which}bovine liver of Okamura 2004, fitted to one needle in one organ")
    stated = {
        "puncture_N": anatomy.membrane_punctures_N or {},
        "hold_N": anatomy.membrane_holds_N or {},
    }
    unsourced = [
        name
        for name, forces in stated.items()
        if f"needle.vessel_wall.{name}" not in constants.given
        and any(wall not in forces for wall, _ in anatomy.membranes)
    ]
    if unsourced:
        remarks.append(f"no source for {' and '.join(unsourced)} of the vessel wall")
    remarks += [
        f"the {each.name} holds the shaft with {each.hold_N:g} N, more than its puncture force of "
        f"{each.puncture_N:g} N, so the force does not drop at its puncture"
        for each in tissue.membranes
        if each.hold_N > each.puncture_N
    ]
    remarks.append("forces across the needle's axis are not modelled")
    return "; ".join(remarks)


def _axis_note(motion: PathMotion, track: "Track") -> dict[str, str]:
    """Return a note if the path into the organ and the needle have different directions."""
    inward_m = -float(track.arm_m @ track.outward)
    aside_m = float(np.linalg.norm(track.arm_m + inward_m * track.outward))
    angle_deg = float(np.degrees(np.arctan2(aside_m, inward_m)))
    if angle_deg <= ASIDE_DEG:
        return {}
    outward = -track.arm_m / np.linalg.norm(track.arm_m)
    # 0.0 is added to turn -0.0 into 0.0
    axis = (np.round(outward, 3) + 0.0).tolist()
    return {
        "axis": f"motion.axis is {shown(motion.axis)}, and the path leads into the organ at "
        f"{angle_deg:.0f} degrees to it. The needle moves {1e3 * aside_m:.3g} mm sideways, and "
        "forces across its axis are not modelled. For a needle along its path, set motion.axis = "
        f"{shown(axis)}"
    }


def blade_of(scene: Scene) -> "IncisionBlade":
    """Return the blade of a scene."""
    from tissue.models.incision.parameters import Blade as IncisionBlade

    tool = scene.tool
    assert isinstance(tool, Blade)
    return IncisionBlade(
        width_m=1e-3 * tool.width_mm,
        thickness_m=1e-3 * tool.thickness_mm,
        edge_rad=float(np.radians(tool.edge_deg)),
    )


def probe_of(tool: Probe) -> ProbeShape:
    """Return the shape of the probe that the tool table of a scene describes.

    Raises
    ------
    InputError
        If the file of a shape is missing, or contains no closed surface.
    """
    make = PROBES[tool.kind].make
    radius = 0.5e-3 * tool.size_mm
    if make is not None:
        shape: ProbeShape = make(tool)
        return shape
    if tool.kind == "sphere-probe":
        return SphereProbe(radius)
    if tool.kind == "cylinder-probe":
        # The radius of the rounded edge is a tenth of the tool's radius, at most 0.5 mm. At a sharp
        # edge the pressure would be infinite.
        return CylinderProbe(radius, min(0.1 * radius, 5e-4))
    with names_of_caller(dict.fromkeys(("mesh", *FILE_WORDS), "tool.file")):
        return ShellProbe.from_mesh(tool.file_name, scale=1e-3 * tool.scale)


def require_outside(mesh: TetMesh, motion: Motion) -> None:
    """Raise an error if a motion starts with the tip of the tool inside the organ.

    If the tip is outside but another part of the probe overlaps the organ, the contact model raises
    an error later.
    """
    tip = motion.sweep_m()[0]
    corners = mesh.nodes_m[mesh.cells]
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    weights = np.linalg.solve(edges, (tip - corners[:, 0])[:, :, None])[:, :, 0]
    if ((weights >= 0.0).all(axis=1) & (weights.sum(axis=1) <= 1.0)).any():
        at = ", ".join(f"{1e3 * value:.4g}" for value in tip)
        raise InputError(
            "motion",
            "start outside the organ",
            f"a tip inside the organ at ({at}) mm",
            "start higher",
        )
