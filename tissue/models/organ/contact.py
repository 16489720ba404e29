"""Contact of a tool with an elastic organ, computed from the compliance of surface nodes."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from math import isfinite
from typing import Any

import numpy as np
import warp as wp

from kernels.contact_search import find_near
from kernels.contact_state import (
    AREA,
    CONTACTS,
    DEEPEST,
    FORCE,
    LARGEST,
    RESULTS,
    STATE,
    SWEEPS,
    TORQUE,
    Body,
    Lists,
    Points,
)
from kernels.launcher import SplitLaunch, recorded
from kernels.mirror import Mirror, filled
from kernels.near_compliance import gather_all_again, new_patch
from kernels.shell_projection import link_points, project_shell
from kernels.surface_contact import solve_contact
from meshes.base.arrays import Array, Int32s, Ints
from meshes.base.errors import InputError, require_positive, require_range
from tissue.fem.solvers.held_body import components_of
from tissue.models.organ.probe import ProbeShape, ShellProbe
from tissue.models.state import State, require_shapes

MOST_DIVISIONS = 16
"""Largest number of parts of a triangle's edge; the triangle then has 256 inner points."""


def contact_points(nodes_m: Array, faces: Ints, spacing_m: float) -> tuple[Int32s, Array, Array]:
    """Return contact points on triangles: the corners, and inner points of large triangles.

    If the longest edge of a triangle spans n > 1 spacings, the triangle is divided into n^2 equal
    parts. The centres of these parts are added as contact points.

    Parameters
    ----------
    nodes_m
        Node positions [m], shape (s, 3).
    faces
        Triangles, shape (f, 3).
    spacing_m
        Largest allowed distance between neighbouring contact points [m].

    Returns
    -------
    face
        Index of the triangle of each point, shape (p,), in rising order. Every node is a contact
        point once, in one of the triangles around the node.
    weights
        Barycentric weights, shape (p, 3).
    areas_m2
        Area that each point represents [m2], shape (p,). The area is 0 for a node if all triangles
        around it are divided.

    Raises
    ------
    InputError
        If an edge of a triangle spans more than 16 spacings.
    """
    corners = nodes_m[faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    if longest.max() > MOST_DIVISIONS * spacing_m:
        raise InputError(
            "touch_edge_m",
            f"give edges of at most {1e3 * MOST_DIVISIONS * spacing_m:.4g} mm under this tool",
            f"an edge of {1e3 * longest.max():.4g} mm",
            "mesh the touchable surface finer, or take a larger tool",
        )
    # 1e-9: if an edge is a whole number of spacings, rounding adds no division.
    division = np.maximum(np.ceil(longest / spacing_m - 1e-9), 1).astype(int)
    node_area = np.zeros(len(nodes_m))
    np.add.at(node_area, faces[division == 1], area[division == 1, None] / 3.0)
    named, first = np.unique(faces, return_index=True)
    face = [first // 3]
    weights = [np.eye(3)[first % 3]]
    areas = [node_area[named]]
    for n in np.unique(division[division > 1]):
        i, j = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        # The centres of the upright and of the inverted parts, in units of an edge's n-th part.
        up = np.column_stack([i, j])[i + j < n] + 1.0 / 3.0
        down = np.column_stack([i, j])[i + j < n - 1] + 2.0 / 3.0
        inner = np.vstack([up, down]) / n
        inner = np.column_stack([1.0 - inner.sum(axis=1), inner])
        wide = np.flatnonzero(division == n)
        face.append(np.repeat(wide, n * n))
        weights.append(np.tile(inner, (len(wide), 1)))
        areas.append(np.repeat(area[wide] / n**2, n * n))
    order = np.argsort(np.concatenate(face), kind="stable")
    return (
        np.concatenate(face)[order].astype(np.int32),
        np.concatenate(weights)[order],
        np.concatenate(areas)[order],
    )


def body_arrays(nodes_m: Array, faces: Ints, compliance_m_N: Array, device: str) -> Body:
    """Return the device arrays of the touchable surface, at rest and with zero forces.

    On a CPU the compliance is not copied.
    """
    compliance: Any = wp.array(
        compliance_m_N, dtype=wp.float64, device=device, copy=device != "cpu"
    )
    return filled(
        Body,
        device,
        free=nodes_m,
        last_free=nodes_m,
        scale=wp.float64(1.0),
        compliance=compliance,
        corners=faces,
        force=np.zeros_like(nodes_m),
        moved=np.zeros_like(nodes_m),
    )


def point_arrays(
    nodes_m: Array, faces: Ints, probe: ProbeShape, spacing_m: float | None, device: str
) -> Points:
    """Return contact points with zero force, in one linked list for each triangle.

    For a shell, the contact points are the points of the shell. For other tools, the points lie on
    the triangles, at most ``spacing_m`` apart.
    """
    if isinstance(probe, ShellProbe):
        face = np.zeros(0, np.int32)
        weights = np.zeros((len(probe.points_m), 3))
        areas = probe.areas_m2
        following = np.full(len(weights), -1)
    else:
        face, weights, areas = contact_points(nodes_m, faces, spacing_m or probe.spacing_m)
        following = np.append(np.where(np.diff(face) == 0, np.arange(1, len(face)), -1), -1)
    first = np.full(len(faces), -1)
    first[face[::-1]] = np.arange(len(face))[::-1]
    count = len(weights)
    none = dict.fromkeys(("tool_point", "tool_normal", "force", "anchor"), np.zeros((count, 3)))
    return filled(
        Points,
        device,
        first=first,
        following=following,
        weight=weights,
        area=areas,
        response=np.zeros((count, 5, 3, 3)),
        ready=np.zeros(count),
        **none,
    )


class ContactOutcome(Enum):
    """Outcome of a contact solution. The value explains the outcome and how to fix a failure."""

    CONVERGED = "the forces have converged within the tolerance"
    NOT_CONVERGED = (
        "the forces did not converge. Allow more sweeps, raise the tolerance, or move the tool in "
        "smaller steps"
    )
    IMMOVABLE = (
        "the tool enters where the organ's supports do not yield. Hold fewer nodes, or press "
        "elsewhere"
    )


@dataclass
class ContactResult:
    """Forces and penetration of a contact in the world frame; the next solution overwrites them.

    Attributes
    ----------
    force_N
        Force on the tool [N], shape (3,).
    torque_Nm
        Torque on the tool about its tip [N m], shape (3,).
    nodal_forces_N
        Forces on the organ's touchable nodes [N], shape (s, 3).
    outcome
        Convergence, or the reason of a failure.
    iterations
        Number of Gauss-Seidel sweeps.
    contacts
        Number of contact points that carry force.
    area_m2
        Area that contact points with nonzero force represent, on the organ or on a shell [m2].
    penetration_m
        Deepest remaining penetration [m].
    """

    force_N: Array
    torque_Nm: Array
    nodal_forces_N: Array
    compliance_m_N: Array = field(repr=False)
    outcome: ContactOutcome = ContactOutcome.CONVERGED
    iterations: int = 0
    contacts: int = 0
    area_m2: float = 0.0
    penetration_m: float = 0.0
    compliance_scale: float = field(default=1.0, repr=False)

    def displacement_m(self) -> Array:
        """Return the displacement of all s nodes under the contact forces [m], shape (s, 3).

        A displacement set by `SurfaceContact.shift` is not included.
        """
        loaded = np.flatnonzero(self.nodal_forces_N.any(axis=1))
        columns = components_of(loaded)
        moved = self.compliance_m_N[:, columns] @ self.nodal_forces_N[loaded].ravel()
        return (self.compliance_scale * moved).reshape(-1, 3)


STATE_ARRAYS = {
    "body": ("force", "free", "last_free"),
    "points": ("force",),
    "lists": ("count", "working", "working_mark"),
    "patch": ("count", "node", "slot", "near_mark", "loaded_mark", "moved"),
}
"""Names of the device arrays in a copied state, for each group of arrays."""
OUTCOMES = tuple(ContactOutcome)
"""Outcomes in the order of the numbers that the kernel returns."""
START_M = 1e-6
"""Penetration allowed at the first pose of a tool [m], because of rounding errors."""
REACH_M = 1e-4
"""Margin around the tool in the search for near triangles [m].

The largest displacement of the surface is added to the margin. A tool with a speed of 100 mm/s
moves by this margin in a tick.
"""


class SurfaceContact:
    """Contact between a tool and the surface of an organ with a given compliance.

    Each call of `solve` advances the contact by one tick. Slip and stick depend on the tool's
    motion since the last call. The contact is unilateral, with Coulomb friction. An implicit step
    computes the forces at the end of the tick.

    Parameters
    ----------
    nodes_m
        Touchable nodes at rest [m], shape (s, 3).
    faces
        Triangles between these nodes, counter-clockwise seen from outside, shape (f, 3).
    compliance_m_N
        Compliance of the touchable nodes [m/N], symmetric, float64, shape (3s, 3s). On a CPU the
        matrix is not copied. The caller must not change it.
    probe
        The tool.
    friction
        Coefficient of Coulomb friction.
    tolerance
        Allowed change of a point's displacement in the last sweep, relative to the largest
        displacement. For a sphere on a slab, the error of the force is 1 % at a tolerance of 1e-3,
        and 0.2 % at 1e-4.
    sweeps
        Largest number of Gauss-Seidel sweeps in one call of `solve`.
    spacing_m
        Largest distance between contact points on the organ [m]; default: the tool's `spacing_m`.
    device, cores
        Warp device name, and number of processor cores that project the points of a shell onto the
        organ (default: all cores).

    Raises
    ------
    InputError
        If friction is negative.
    """

    def __init__(
        self,
        nodes_m: Array,
        faces: Ints,
        compliance_m_N: Array,
        probe: ProbeShape,
        *,
        friction: float = 0.3,
        tolerance: float = 1e-3,
        sweeps: int = 100,
        spacing_m: float | None = None,
        device: str = "cpu",
        cores: int | None = None,
    ) -> None:
        self.friction = require_range(
            "friction", friction, 0.0, 10.0, "give Coulomb's coefficient, 0 for none"
        )
        self.nodes_m = nodes_m
        self.faces = faces
        self.probe = probe
        self._tolerance = tolerance
        self._sweeps = sweeps
        self._device = device
        self._cores = cores
        corners = nodes_m[faces]
        self._centres = corners.mean(axis=1)
        self._radii = np.linalg.norm(corners - self._centres[:, None], axis=2).max(axis=1)
        self._pose = Mirror(8, wp.vec3d, device)
        self._results = Mirror(RESULTS, wp.float64, device)
        self._placed = self._shifted = False
        self._body = body_arrays(nodes_m, faces, compliance_m_N, device)
        self._points = point_arrays(nodes_m, faces, probe, spacing_m, device)
        none = np.zeros(len(faces))
        self._lists = filled(
            Lists, device, count=np.zeros(3), near=none, working=none, working_mark=none
        )
        self._patch = new_patch(len(nodes_m), device)
        self._stages = self._recorded()
        self._on_host = device == "cpu"
        self.result = ContactResult(
            np.zeros(3), np.zeros(3), self._body.force.numpy(), compliance_m_N
        )
        """Result of the last solve. Every solve returns this object."""

    def _recorded(self) -> list[Callable[[], object]]:
        """Record the kernel launches of a tick, with the factor that `scale_compliance` has set."""
        device = self._device
        probe = self.probe
        size = wp.vec2d(*self.probe.size_m)
        body = self._body
        points = self._points
        lists = self._lists
        patch = self._patch
        pose = self._pose.device
        results = self._results.device

        def record(kernel: wp.Kernel, inputs: list[object]) -> Callable[[], object]:
            return recorded(kernel, dim=1, inputs=inputs, device=device)

        near = [self._centres, self._radii, probe.kind, size, pose, REACH_M]
        stages = [record(find_near, [*near, results, body, lists, patch])]
        if isinstance(probe, ShellProbe):
            count = len(probe.points_m)
            home = wp.zeros(count, wp.int32, device)
            shell = [probe.points_m, probe.normals]
            project = SplitLaunch(
                project_shell,
                count,
                [*shell, pose, float(self._radii.max()), body, lists],
                [points, home],
                device=device,
                cores=self._cores,
            )
            stages += [project, record(link_points, [home, lists, points])]
        law = [self.friction, self._tolerance, self._sweeps]
        stages.append(
            record(
                solve_contact, [probe.kind, size, pose, *law, body, points, lists, patch, results]
            )
        )
        return stages

    def place(self, tip_m: Array, rotation: Array) -> None:
        """Put the tool at its first pose, outside the organ and without contact.

        Raises
        ------
        InputError
            If the pose is not finite, or the tool starts inside the organ.
        """
        self.forget()
        result = self.solve(tip_m, rotation)
        depth = result.penetration_m
        touching = result.contacts
        deepest = float(np.linalg.norm(result.displacement_m(), axis=1).max())
        self.forget()
        if touching and max(deepest, depth) > START_M:
            at = ", ".join(f"{1e3 * each:.4g}" for each in tip_m)
            raise InputError(
                "motion",
                "start outside the organ",
                f"a tool at ({at}) mm that enters it by about {1e3 * deepest:.3g} mm",
                "start farther away",
            )
        self._keep(tip_m, rotation)

    def forget(self) -> None:
        """Reset all forces and the tool's path."""
        self._points.force.zero_()
        self._body.force.zero_()
        self._patch.moved.zero_()
        self._placed = False
        self._read(np.zeros(RESULTS))

    def state(self) -> State:
        """Return a copy of the state on which the next solutions depend.

        The compliance is not part of the state.
        """
        return {
            "arrays": {name: array.numpy().copy() for name, array in self._arrays().items()},
            "pose": self._pose.host.copy(),
            "results": self._results.host.copy(),
            "placed": self._placed,
            "shifted": self._shifted,
        }

    def restore(self, state: State) -> None:
        """Restore a state of this contact, or of a contact with an equal number of nodes."""
        arrays = self._arrays()
        require_shapes({name: each.numpy() for name, each in arrays.items()}, state["arrays"])
        for name, array in arrays.items():
            array.assign(state["arrays"][name])
        gather_all_again(self._patch)
        self._pose.host[:] = state["pose"]
        self._results.host[:] = state["results"]
        self._results.push()
        self._placed = state["placed"]
        self._shifted = state["shifted"]
        self._read(self._results.host)

    def _arrays(self) -> dict[str, Any]:
        """Return the device arrays of the state by name."""
        return {
            f"{part}.{name}": getattr(getattr(self, f"_{part}"), name)
            for part, names in STATE_ARRAYS.items()
            for name in names
        }

    def scale_compliance(self, factor: float) -> None:
        """Set the factor by which the compliance is multiplied.

        For a viscous organ, the factor is slightly above 1, because of the creep within a tick.
        """
        self.result.compliance_scale = require_positive("factor", factor, "use 1 for no change")
        self._body.scale = wp.float64(factor)
        self._points.ready.zero_()
        gather_all_again(self._patch)
        self._stages = self._recorded()

    def change_compliance(self, compliance_m_N: Array) -> None:
        """Replace the values of the compliance [m/N], shape (3s, 3s), for the next solutions.

        With the new compliance, the present forces cause another displacement. The difference (old
        minus new) is added to the stored positions that the nodes have without contact. The
        friction law then registers no motion of the nodes. The caller must also add this difference
        to the offset in the next call of `shift`.
        """
        before = self.result.displacement_m()
        self.use_compliance(compliance_m_N)
        less = before - self.result.displacement_m()
        self._body.last_free.assign(self._body.last_free.numpy() + less)

    def use_compliance(self, compliance_m_N: Array) -> None:
        """Replace the compliance [m/N], shape (3s, 3s), without correcting any stored position."""
        self.result.compliance_m_N[:] = compliance_m_N
        if not self._on_host:
            self._body.compliance.assign(compliance_m_N)
        self._points.ready.zero_()
        gather_all_again(self._patch)

    def shift(self, offset_m: Array) -> None:
        """Set the displacements of the nodes at zero contact force [m], shape (s, 3)."""
        self._body.free.assign(self.nodes_m + offset_m)
        # The search for near triangles must include the largest shift of a node.
        self._results.host[LARGEST] += float(np.linalg.norm(offset_m, axis=1).max())
        self._results.push()
        self._shifted = True

    def solve(self, tip_m: Array, rotation: Array) -> ContactResult:
        """Move the tool to its next pose and solve for the forces.

        Every call returns one and the same object, with new values.

        Parameters
        ----------
        tip_m
            The tool's tip [m], shape (3,), world frame.
        rotation
            Rotation from tool to world, shape (3, 3); z is the tool's axis, from tip to shank.

        Raises
        ------
        InputError
            If the pose is not finite.
        """
        if not isfinite(tip_m.sum() + rotation.sum()):
            raise InputError(
                "tip_m and rotation", "be finite", f"{tip_m}, {rotation.tolist()}", "fix the pose"
            )
        if not self._placed:
            self._keep(tip_m, rotation)
        self._pose.host[0] = tip_m
        self._pose.host[1:4] = rotation
        self._pose.push()
        for stage in self._stages:
            stage()
        if self._shifted:
            # Slip in the next tick is measured from the free positions of this tick.
            wp.copy(self._body.last_free, self._body.free)
        self._keep(tip_m, rotation)
        self._results.pull()
        self._read(self._results.host)
        return self.result

    def _keep(self, tip_m: Array, rotation: Array) -> None:
        """Store the pose at which the motion of the next tick starts."""
        self._placed = True
        self._pose.host[4] = tip_m
        self._pose.host[5:8] = rotation

    def _read(self, values: Array) -> None:
        """Copy the values that the kernel has computed to `result`."""
        result = self.result
        result.force_N[:] = values[FORCE : FORCE + 3]
        result.torque_Nm[:] = values[TORQUE : TORQUE + 3]
        if not self._on_host:
            result.nodal_forces_N[:] = self._body.force.numpy()
        result.outcome = OUTCOMES[int(values[STATE])]
        result.iterations = int(values[SWEEPS])
        result.contacts = int(values[CONTACTS])
        result.area_m2 = float(values[AREA])
        result.penetration_m = float(values[DEEPEST])
