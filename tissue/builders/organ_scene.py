"""Build what a probe presses or a needle pierces: soft organs, and a stiff wall."""

from math import inf

from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from tissue.builders.organ import elasticity_of, held_mesh
from tissue.builders.organ_body import Factor, compliance_of, held_body, prony_of, weight_of
from tissue.builders.parts import Parts
from tissue.builders.probe import require_outside, shell_note, touchable_surface
from tissue.models.organ.probe import ShellProbe, SphereProbe
from tissue.models.wall import WallModel
from tissue.motion.motion import Motion
from tissue.scene.coupling import WallAnatomy
from tissue.scene.named_parts import loaded
from tissue.scene.organ import LayersAnatomy, LiverAnatomy, SlabAnatomy
from tissue.scene.registry import NEEDLES, PROBES
from tissue.scene.scene import Scene
from tissue.scene.tool import Needle, Probe

__all__ = ["pierced", "pressed", "wall"]

HAND_M = 0.01
"""How far from the planned track a hand's entry is still shown on it [m]: an eighth of its block."""


def pierced(scene: Scene, motion: Motion, *, step_s: float, compute: str, cores: int | None, report: Progress) -> Parts:
    """Parts of a scene in which a needle meets layers of tissue.

    Raises
    ------
    InputError
        If the vessel's wall does not lie below the capsule.
    """
    from tissue.models.needle.fields import NeedleFields, Track
    from tissue.models.needle.model import NeedleModel

    assert isinstance(scene.anatomy, LayersAnatomy) and isinstance(scene.tool, Needle)
    depth_mm, diameter = scene.anatomy.vessel_wall_depth_mm, 1e-3 * scene.tool.diameter_mm
    tissue = NEEDLES[scene.tool.kind](vessel_wall_depth_m=None if depth_mm is None else 1e-3 * depth_mm)
    notes = {
        "needle": "bovine liver of Okamura 2004, fitted to one needle in one organ; the vessel wall's numbers have no "
        "source; forces across the needle's axis are not modelled"
    }
    track, fields = Track.first_of(motion.sweep_m(), motion.rotations()[:, :, 2], diameter_m=diameter), None
    if track is not None and scene.anatomy.interval_ms > 0.0:
        report("solving a block of the organ around the needle", 0.0)
        near = diameter if scene.device == "none" else HAND_M
        fields = NeedleFields.of_liver(track, near_m=near, interval_s=1e-3 * scene.anatomy.interval_ms)
        notes["fields"] = fields.note(tissue)
        if scene.device != "none":
            notes["fields"] += f"; a hand that enters up to {1e3 * near:g} mm from the track is drawn as on it"
    return Parts(motion, NeedleModel(tissue, diameter_m=diameter, fields=fields), notes=notes)


def pressed(scene: Scene, motion: Motion, *, step_s: float, compute: str, cores: int | None, report: Progress) -> Parts:
    """Parts of a scene in which a probe presses a meshed organ.

    Raises
    ------
    InputError
        If the organ cannot be meshed or held, the probe never touches it, or starts inside.
    """
    anatomy, organ = scene.anatomy, scene.organ
    assert isinstance(anatomy, LiverAnatomy | SlabAnatomy) and isinstance(scene.tool, Probe)
    notes: dict[str, str] = {}
    prony = prony_of(organ, notes)
    report("meshing the organ", 0.0)
    edge_mm = anatomy.touch_edge_mm or 0.25 * scene.tool.diameter_mm
    found = held_mesh(anatomy, path_m=motion.sweep_m(), touch_edge_m=1e-3 * edge_mm, report=report)
    elasticity, note = elasticity_of(found.mesh, anatomy, organ)
    probe = loaded(PROBES[scene.tool.kind].make)(scene.tool)
    notes |= found.notes | {"modulus": note}
    if isinstance(probe, ShellProbe):
        notes["tool"] = shell_note(scene.tool, probe)
    report("compiling kernels (the first time on a machine)", 0.0)
    from tissue.fem.space import Space
    from tissue.models.organ.contact import SurfaceContact
    from tissue.models.organ.fields import OrganFields
    from tissue.models.organ.model import LiverModel

    require_outside(found.mesh, motion)
    space = Space(found.mesh, organ.order, device=compute)
    report("assembling the stiffness", 0.0)
    body = held_body(space, elasticity, organ, found.held, notes)
    touchable, faces = touchable_surface(space, probe, motion)
    if body.fixed[touchable].all():
        raise InputError(
            "motion must bring the tool to tissue that can move, got a tool that touches only what is held: move it, "
            "or change what holds the organ"
        )
    solver = Factor(body)
    load, rest = weight_of(space, organ, body, solver, notes)
    report("condensing the compliance to the surface that can be touched", 0.0)
    compliance, lazy = compliance_of(body, touchable, organ, solver, report)
    with names_of_caller({"nodes_m must lie closer to each other": "anatomy.touch_edge_mm must give shorter edges"}):
        contact = SurfaceContact(
            space.nodes_m[touchable] + rest[touchable],
            faces,
            compliance,
            probe,
            friction=organ.friction,
            device=compute,
            cores=cores,
        )
    fields = OrganFields(
        space,
        elasticity,
        solve=solver.solve_all,
        product=lambda moved: (body.stiffness @ moved.ravel()).reshape(-1, 3),
        touchable=touchable,
        rest_m=rest,
        rest_load_N=load,
        held=found.held,
        interval_s=1e-3 * organ.interval_ms if organ.interval_ms > 0.0 else inf,
    )
    notes["solved"] = (
        f"{len(found.mesh.cells)} tetrahedra of order {organ.order}, {len(body.free)} unknowns; "
        f"{len(touchable)} touchable nodes, compliance {organ.path}"
    )
    model = LiverModel(
        contact,
        space=space,
        touchable=touchable,
        fields=fields,
        prony=prony,
        lazy=lazy,
        ball_radius_m=probe.radius_m if isinstance(probe, SphereProbe) else None,
        step_s=step_s,
    )
    return Parts(motion, model, placement=found.placement, notes=notes)


def wall(scene: Scene, motion: Motion, *, step_s: float, compute: str, cores: int | None, report: Progress) -> Parts:
    """Parts of a scene in which a ball is pushed against a wall."""
    assert isinstance(scene.anatomy, WallAnatomy) and isinstance(scene.tool, Probe)
    radius_m = 0.5e-3 * scene.tool.diameter_mm
    return Parts(motion, WallModel(1e3 * scene.anatomy.stiffness_kN_m, radius_m=radius_m))
