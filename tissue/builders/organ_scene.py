"""Build what a probe presses or a needle pierces: soft organs, and a stiff wall."""

from functools import cached_property
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from tissue.builders.organ import elasticity_of, held_mesh
from tissue.builders.parts import Parts
from tissue.builders.probe import require_outside, shell_note, touchable_surface
from tissue.materials.constants import constants
from tissue.models.organ.probe import ShellProbe, SphereProbe
from tissue.models.wall import WallModel
from tissue.motion.motion import Motion
from tissue.scene.coupling import WallAnatomy
from tissue.scene.named_parts import loaded
from tissue.scene.organ import LayersAnatomy, LiverAnatomy, Organ, SlabAnatomy
from tissue.scene.registry import NEEDLES, PROBES
from tissue.scene.scene import Scene
from tissue.scene.tool import Needle, Probe

if TYPE_CHECKING:
    from tissue.fem.solvers.direct import DirectSolver
    from tissue.fem.solvers.held_body import HeldBody
    from tissue.fem.solvers.lazy_compliance import LazyCompliance
    from tissue.fem.solvers.multigrid import MultigridSolver
    from tissue.fem.space import Space
    from tissue.materials.prony import Prony

__all__ = ["pierced", "pressed", "wall"]

HAND_M = 0.01
"""How far from the planned track a hand's entry is still shown on it [m]: an eighth of its block."""
FACTOR_UNKNOWNS = 200_000
"""Above this, frames are solved by multigrid: a factor would take gigabytes."""


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
    prony = _prony(organ, notes)
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
    body = _body(space, elasticity, organ, found.held, notes)
    touchable, faces = touchable_surface(space, probe, motion)
    if body.fixed[touchable].all():
        raise InputError(
            "motion must bring the tool to tissue that can move, got a tool that touches only what is held: move it, "
            "or change what holds the organ"
        )
    solver = _Factor(body)
    load, rest = _weight(space, organ, body, solver, notes)
    report("condensing the compliance to the surface that can be touched", 0.0)
    compliance, lazy = _compliance(body, touchable, organ, solver, report)
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


class _Factor:
    """A sparse factor that is made when it is first needed; where it would be too large, multigrid."""

    def __init__(self, body: "HeldBody") -> None:
        self._body = body

    @cached_property
    def solver(self) -> "DirectSolver | MultigridSolver":
        """The solver."""
        from tissue.fem.solvers.direct import DirectSolver
        from tissue.fem.solvers.multigrid import MultigridSolver

        return (MultigridSolver if len(self._body.free) > FACTOR_UNKNOWNS else DirectSolver)(self._body)

    def solve_all(self, loads_N: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacements [m] under several loads [N], shape (loads, n, 3) both."""
        return np.stack([self.solve(load) for load in loads_N])

    def solve(self, load_N: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement [m] under a load [N], shape (n, 3)."""
        found = self.solver.solve(load_N)
        if not found.converged:
            raise RuntimeError(f"the organ could not be solved: {found.outcome.value}")
        displacement: NDArray[np.float64] = found.displacement_m
        return displacement


def _body(
    space: "Space", elasticity: NDArray[np.float64], organ: Organ, held: NDArray[np.int64], notes: dict[str, str]
) -> "HeldBody":
    """Stiffness, capsule included, and supports."""
    from scipy.sparse import bsr_array

    from meshes.tets.regions import faces_of
    from tissue.fem.assembly import assemble
    from tissue.fem.capsule import capsule_stiffness
    from tissue.fem.solvers.held_body import HeldBody, held_nodes

    stiffness = assemble(space, elasticity)
    if organ.capsule:
        table = constants("soft", f"{organ.material}_capsule")
        thickness, young = table["thickness_um"], table["modulus_kPa"]
        membrane = capsule_stiffness(
            space,
            thickness_m=1e-6 * thickness.value,
            young_Pa=1e3 * young.value,
            poisson_ratio=table["poisson_ratio"].value,
        )
        stiffness = bsr_array((stiffness + membrane).tobsr((3, 3)))
        notes["capsule"] = (
            f"{thickness.value:g} ({thickness.low:g}-{thickness.high:g}) um of {1e-3 * young.value:g} "
            f"({1e-3 * young.low:g}-{1e-3 * young.high:g}) MPa, confidence {young.confidence}"
        )
    fixed = np.zeros(space.node_count, dtype=bool)
    fixed[held] = True
    fixed[space.with_middles(faces_of(space.mesh, held))] = True
    return HeldBody(stiffness, space.nodes_m, held_nodes(fixed))


def _weight(
    space: "Space", organ: Organ, body: "HeldBody", solver: _Factor, notes: dict[str, str]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Load of the organ's own weight [N] and the displacement by it [m], shape (n, 3) both; zero without gravity."""
    if not organ.gravity:
        return np.zeros((space.node_count, 3)), np.zeros((space.node_count, 3))
    from tissue.fem.loads import gravity

    load = gravity(space, density_kg_m3=constants("soft", organ.material)["density_kg_m3"].value)
    rest = solver.solve(load)
    notes["gravity"] = f"the organ sags by up to {1e3 * np.linalg.norm(rest, axis=1).max():.3g} mm before it is touched"
    return load, rest


def _compliance(
    body: "HeldBody", touchable: NDArray[np.int64], organ: Organ, solver: _Factor, report: Progress
) -> tuple[NDArray[np.float64], "LazyCompliance | None"]:
    """Compliance of the touchable nodes [m/N], shape (3t, 3t), and what fills it while the tool moves."""
    from tissue.fem.solvers.condensed import surface_compliance_m_N
    from tissue.fem.solvers.lazy_compliance import LazyCompliance
    from tissue.fem.solvers.reduced import ReducedSolver

    if organ.path == "condensed":
        doing = "condensing the compliance to the surface that can be touched"
        return surface_compliance_m_N(
            body, touchable, solver=lambda: solver.solver, progress=lambda share: report(doing, share)
        ), None
    if organ.path == "reduced":
        size = min(organ.basis_size, 3 * len(touchable))
        return ReducedSolver(solver.solver, touchable, size=size).compliance_m_N(), None
    count = 3 * len(touchable)
    return np.full((count, count), np.nan), LazyCompliance(solver.solver, touchable)


def _prony(organ: Organ, notes: dict[str, str]) -> "Prony | None":
    """The cited relaxation of the organ's material, where the scene asks for it."""
    if not organ.viscous:
        return None
    if organ.path == "lazy":
        raise InputError("organ.path must not be lazy for a viscous organ, got lazy: use condensed")
    from tissue.materials.prony import Prony

    table = constants("soft", organ.material)
    numbers = [k for k in range(1, 10) if f"prony_g{k}" in table]
    if not numbers:
        raise InputError(f"organ.viscous must be false for {organ.material}, got true: no relaxation is cited for it")
    shares = tuple(table[f"prony_g{k}"].value for k in numbers)
    times = tuple(table[f"prony_tau{k}_s"].value for k in numbers)
    notes["relaxation"] = (
        "; ".join(f"{g:g} in {t:g} s" for g, t in zip(shares, times, strict=True))
        + "; the modulus is that of the first instant; confidence L"
    )
    return Prony(shares, times)
