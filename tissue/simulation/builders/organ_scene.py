"""Build the tissue that a probe presses or a needle pierces: soft organs and a stiff wall."""

from functools import partial
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.cache import Kept
from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from meshes.paths.toolpath import kept_corners
from tissue.materials.scene_constants import Materials
from tissue.models.organ.probe import ShellProbe
from tissue.models.tissue_model import WallModel
from tissue.motion.motion import Motion
from tissue.scene.coupling import WallAnatomy
from tissue.scene.organ import LayersAnatomy, LiverFile, Organ, SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Needle, Probe
from tissue.simulation.builders.organ import HeldMesh, elasticity_of, held_mesh
from tissue.simulation.builders.organ_law import organ_law
from tissue.simulation.builders.parts import Parts
from tissue.simulation.builders.pierced_tissue import pierced_tissue
from tissue.simulation.builders.probe import poses_along, probe_of, require_outside, shell_note

if TYPE_CHECKING:
    from tissue.materials.prony import Prony
    from tissue.models.organ.soft_organ import Membrane

__all__ = ["pierced", "pressed", "wall"]


KEPT = 0.01
"""Largest distance of an omitted path corner from the remaining path, in edges of the mesh.

A log has one corner each tick.
"""
HAND_M = 0.01
"""Largest distance of a hand's entry from the planned track at which it is drawn there [m].

It is an eighth of the track's block.
"""


_meshes: Kept[HeldMesh] = Kept(2)
"""Meshes of procedural organs, by their parameters and the tool's path."""


def pierced(
    scene: Scene,
    motion: Motion,
    *,
    step_s: float,
    compute: str,
    cores: int | None,
    report: Progress,
) -> Parts:
    """Return the parts of a scene in which a needle meets layers of tissue.

    Raises
    ------
    InputError
        If the vessel's wall does not lie below the capsule.
    """
    from tissue.models.needle.fields import NeedleFields, Track
    from tissue.models.needle.model import NeedleModel

    assert isinstance(scene.anatomy, LayersAnatomy) and isinstance(scene.tool, Needle)
    diameter = 1e-3 * scene.tool.diameter_mm
    tissue = pierced_tissue(scene)
    notes = {
        "needle": "bovine liver of Okamura 2004, fitted to one needle in one organ; the vessel "
        "wall's "
        "numbers have no "
        "source; forces across the needle's axis are not modelled"
    }
    track = Track.first_of(motion.sweep_m(), motion.rotations()[:, :, 2], diameter_m=diameter)
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
                f"; a hand that enters up to {1e3 * near:g} mm from the track is drawn as on it"
            )
    return Parts(motion, NeedleModel(tissue, diameter_m=diameter, fields=fields), notes=notes)


def pressed(
    scene: Scene,
    motion: Motion,
    *,
    step_s: float,
    compute: str,
    cores: int | None,
    report: Progress,
) -> Parts:
    """Return the parts of a scene in which a probe presses a meshed organ.

    Raises
    ------
    InputError
        If the organ cannot be meshed or held, the probe never touches it, or starts inside.
    """
    anatomy = scene.anatomy
    organ = scene.organ
    assert isinstance(anatomy, SoftAnatomy) and isinstance(scene.tool, Probe)
    notes: dict[str, str] = {}
    prony = _prony_of(organ, notes, scene.constants)
    report("meshing the organ", 0.0)
    edge_mm = anatomy.touch_edge_mm or 0.25 * scene.tool.size_mm
    within_m = 1e-3 * KEPT * edge_mm
    path = motion.sweep_m()
    path = path[kept_corners(path, within_m)]
    meshed = partial(held_mesh, anatomy, path_m=path, touch_edge_m=1e-3 * edge_mm, report=report)
    from_file = isinstance(anatomy, LiverFile)
    found = (
        meshed()
        if from_file
        else _meshes.of((anatomy.model_dump_json(), path.tobytes(), edge_mm), meshed)
    )
    elasticity, note = elasticity_of(found.mesh, anatomy, organ, scene.constants)
    probe = probe_of(scene.tool)
    notes |= found.notes | {"modulus": note}
    if isinstance(probe, ShellProbe):
        notes["tool"] = shell_note(scene.tool, probe)
    law = organ_law(
        scene, elasticity, path_m=path, touch_edge_m=1e-3 * edge_mm, compute=compute, report=report
    )
    capsule = _capsule_of(organ, notes, scene.constants)
    density = _density_of(organ, scene.constants)
    report("compiling kernels (the first time on a machine)", 0.0)
    from tissue.models.organ.model import ContactSolution, LiverModel
    from tissue.models.organ.soft_organ import SoftOrgan, ToolPath

    require_outside(found.mesh, motion)
    soft = SoftOrgan(
        found.mesh,
        elasticity,
        found.held,
        order=organ.order,
        capsule=capsule,
        density_kg_m3=density,
        prony=prony,
        friction=organ.friction,
        device=compute,
        law=law,
    )
    report("assembling the stiffness", 0.0)
    tips, turns = poses_along(motion, within_m)
    with names_of_caller({"touch_edge_m": "anatomy.touch_edge_mm"}):
        model = LiverModel(
            soft,
            ToolPath(probe, tips, turns),
            ContactSolution(organ.path, basis_size=organ.basis_size, cores=cores),
            step_s=step_s,
            interval_s=1e-3 * organ.interval_ms if organ.interval_ms > 0.0 else inf,
            report=report,
        )
    if organ.gravity:
        sag = 1e3 * np.linalg.norm(soft.rest[1], axis=1).max()
        notes["gravity"] = f"the organ sags by up to {sag:.3g} mm before it is touched"
    if law is not None:
        on = soft if law.coarser is None else law.coarser[0]
        notes["law"] = (
            f"{organ.law}, solved every {organ.law_interval_ms:g} ms on {len(on.body.free)} "
            "unknowns"
        )
    notes["solved"] = (
        f"{len(found.mesh.cells)} tetrahedra of order {organ.order}, {len(soft.body.free)} "
        "unknowns; "
        f"{len(model.touchable)} touchable nodes, compliance {organ.path}"
    )
    return Parts(motion, model, placement=found.placement, notes=notes)


def wall(
    scene: Scene,
    motion: Motion,
    *,
    step_s: float,
    compute: str,
    cores: int | None,
    report: Progress,
) -> Parts:
    """Return the parts of a scene in which a ball is pushed against a wall."""
    assert isinstance(scene.anatomy, WallAnatomy) and isinstance(scene.tool, Probe)
    radius_m = 0.5e-3 * scene.tool.size_mm
    return Parts(motion, WallModel(1e3 * scene.anatomy.stiffness_kN_m, radius_m=radius_m))


def _capsule_of(organ: Organ, notes: dict[str, str], constants: Materials) -> "Membrane | None":
    """Return the capsule of the organ's material and add a note, if the scene requests one."""
    if not organ.capsule:
        return None
    from tissue.models.organ.soft_organ import Membrane

    table = constants.constants("soft", f"{organ.material}_capsule")
    thickness = table["thickness_um"]
    young = table["modulus_kPa"]
    notes["capsule"] = (
        f"{thickness.value:g} ({thickness.low:g}-{thickness.high:g}) um of {1e-3 * young.value:g} "
        f"({1e-3 * young.low:g}-{1e-3 * young.high:g}) MPa, confidence {young.confidence}"
    )
    return Membrane(1e-6 * thickness.value, 1e3 * young.value, table["poisson_ratio"].value)


def _density_of(organ: Organ, constants: Materials) -> float | None:
    """Return the density of the organ's material [kg/m3]; None without gravity."""
    return (
        constants.constants("soft", organ.material)["density_kg_m3"].value
        if organ.gravity
        else None
    )


def _prony_of(organ: Organ, notes: dict[str, str], constants: Materials) -> "Prony | None":
    """Return the relaxation of the organ's material, if the scene requests it.

    Raises
    ------
    InputError
        If the organ's compliance is lazy, or no relaxation is cited for its material.
    """
    if not organ.viscous:
        return None
    if organ.path == "lazy":
        raise InputError("organ.path", "not be lazy for a viscous organ", "lazy", "use condensed")
    from tissue.materials.prony import Prony

    table = constants.constants("soft", organ.material)
    numbers = [k for k in range(1, 10) if f"prony_g{k}" in table]
    if not numbers:
        raise InputError(
            "organ.viscous",
            f"be false for {organ.material}",
            "true",
            "no relaxation is cited for it",
        )
    shares = tuple(table[f"prony_g{k}"].value for k in numbers)
    times = tuple(table[f"prony_tau{k}_s"].value for k in numbers)
    notes["relaxation"] = (
        "; ".join(f"{g:g} in {t:g} s" for g, t in zip(shares, times, strict=True))
        + f"; the modulus is that of the first instant; confidence {table['prony_g1'].confidence}"
    )
    return Prony(shares, times)
