"""Soft organ at rest, ready to be pressed: its mesh, materials, supports and weight."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from math import inf

import numpy as np
from scipy.sparse import bsr_array

from kernels.cores import core_count
from meshes.base.arrays import Array, Ints
from meshes.base.cache import Kept
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.tets.regions import faces_of
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.assembly import assemble
from tissue.fem.capsule import capsule_stiffness
from tissue.fem.loads import gravity
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody, held_nodes
from tissue.fem.space import Space
from tissue.materials.prony import Prony
from tissue.models.organ.compliance import CompliancePath, Factor, compliance_of
from tissue.models.organ.contact import SurfaceContact
from tissue.models.organ.fields import OrganFields
from tissue.models.organ.law import OrganLaw, large_fields_of, law_offset_of
from tissue.models.organ.model import LiverModel
from tissue.models.organ.probe import ProbeShape, SphereProbe
from tissue.models.tissue_model import TICK_S

__all__ = ["KeptColumns", "Membrane", "SoftOrgan", "linear_triangles", "touchable_patch"]

MARGIN_EDGES = 0.25
"""Distance from the tool's path, in mesh edges, within which the surface may be touched."""


def touchable_patch(
    space: Space, probe: ProbeShape, tips_m: Array, rotations: Array
) -> tuple[Ints, Ints]:
    """Return surface nodes near a tool's path, and the triangles between them.

    The nodes have shape (t,), the triangles (f, 3). The triangles hold the positions of their nodes
    in the first array.

    Parameters
    ----------
    space
        The organ's nodes and cells.
    probe
        The tool.
    tips_m, rotations
        Poses along the path: tips [m], shape (p, 3), and tool to world, shape (p, 3, 3).

    Raises
    ------
    InputError
        If the tool touches nothing along the path.
    """
    triangles = linear_triangles(space.faces)
    centres = space.nodes_m[triangles].mean(axis=1)
    reach = np.linalg.norm(space.nodes_m[triangles] - centres[:, None], axis=2).max(axis=1)
    nearest = np.full(len(triangles), np.inf)
    for tip, turn in zip(tips_m, rotations, strict=True):
        nearest = np.minimum(nearest, probe.distance((centres - tip) @ turn)[0])
    if not (nearest < reach).any():
        low, high = (
            ", ".join(f"{1e3 * v:.4g}" for v in corner)
            for corner in (centres.min(axis=0), centres.max(axis=0))
        )
        raise InputError(
            "motion",
            "bring the tool to the organ",
            "a tool that never touches it",
            f"move it to the organ between ({low}) and ({high}) mm",
        )
    chosen = triangles[nearest < reach * (1.0 + 2.0 * MARGIN_EDGES)]
    nodes, places = np.unique(chosen, return_inverse=True)
    return nodes.astype(np.int64), places.reshape(-1, 3).astype(np.int64)


def linear_triangles(faces: Ints) -> Ints:
    """Return faces as linear triangles.

    Faces of three nodes stay as they are. Faces of six nodes (corners, then middles of edges 01,
    12, 02) become four triangles each.
    """
    if faces.shape[1] == 3:
        return faces
    parts = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    return faces[:, parts].reshape(-1, 3)


TOGETHER = 16
"""Columns in one back-substitution, on one thread of BLAS.

More columns are not faster, and threads on small blocks are slower.
"""
LIMIT_BYTES = 1_000_000_000
"""Memory above which the columns of earlier places are dropped [bytes]."""


class KeptColumns:
    """Displacements of an organ's surface under unit forces on its nodes, kept from press to press.

    Parameters
    ----------
    factor
        The organ's factor, which is made when the first compliance is needed.
    surface
        Nodes of the surface in rising order, shape (s,).
    """

    def __init__(self, factor: Factor, surface: Ints) -> None:
        self._factor = factor
        self._surface = surface
        self._rows = (3 * surface[:, None] + np.arange(3)).ravel()
        self._columns: dict[int, Array] = {}

    def between(self, nodes: Ints) -> Array:
        """Return the compliance between some surface nodes [m/N], symmetric, shape (3t, 3t)."""
        solver = self._factor.solver
        if isinstance(solver, DirectSolver) and np.isin(nodes, solver.last).all():
            return solver.compliance_between(nodes)
        missing = [int(node) for node in nodes if int(node) not in self._columns]
        if 8 * 3 * len(self._rows) * (len(self._columns) + len(missing)) > LIMIT_BYTES:
            self._columns.clear()
            missing = [int(node) for node in nodes]
        self._find(missing)
        rows = (3 * np.searchsorted(self._surface, nodes)[:, None] + np.arange(3)).ravel()
        matrix: Array = np.concatenate([self._columns[int(node)][rows] for node in nodes], axis=1)
        return 0.5 * (matrix + matrix.T)

    def _find(self, nodes: list[int]) -> None:
        from threadpoolctl import threadpool_limits

        solver = self._factor.solver
        each = TOGETHER // 3
        solve = (
            partial(solver.columns, together=TOGETHER)
            if isinstance(solver, DirectSolver)
            else solver.columns
        )
        parts = [nodes[start : start + each] for start in range(0, len(nodes), each)]

        def find(part: list[int]) -> Array:
            found: Array = solve((3 * np.array(part)[:, None] + np.arange(3)).ravel())[self._rows]
            return found

        # A back-substitution releases the interpreter lock.
        with (
            threadpool_limits(1, "blas"),
            ThreadPoolExecutor(core_count(), thread_name_prefix="columns") as threads,
        ):
            for part, columns in zip(parts, threads.map(find, parts), strict=True):
                for place, node in enumerate(part):
                    self._columns[node] = columns[:, 3 * place : 3 * place + 3].copy()


_spaces: Kept[Space] = Kept(2)
_patches: Kept[tuple[Ints, Ints]] = Kept(2)
"""Patches by mesh and order, and by tool and path: a study presses one mesh in every trial."""


@dataclass(frozen=True)
class Membrane:
    """A capsule: a thin elastic membrane on the whole surface.

    Attributes
    ----------
    thickness_m, young_Pa, poisson_ratio
        Thickness [m], Young's modulus [Pa] and Poisson's ratio.
    """

    thickness_m: float
    young_Pa: float
    poisson_ratio: float


class SoftOrgan:
    """Elastic organ that any number of tools may press, one factor for all of them.

    Parameters
    ----------
    mesh
        Tetrahedra.
    elasticity
        Elasticity of each cell, as for `tissue.fem.assembly.assemble` [Pa].
    held
        Nodes of the mesh that do not move.
    order
        Order of the tetrahedra, 1 or 2.
    capsule
        Membrane on the surface; None for no membrane.
    density_kg_m3
        Density [kg/m3]. With a density the organ is loaded by its own weight, along -z, before a
        tool touches it.
    prony
        Relaxation of every modulus; None for an elastic organ.
    friction
        Coulomb's coefficient between a tool and the organ.
    law
        Hyperelastic law whose small-strain limit is `elasticity`; None for the linear law. It
        cannot be combined with capsule, weight and relaxation.
    device
        Warp device name.
    """

    def __init__(
        self,
        mesh: TetMesh,
        elasticity: Array,
        held: Ints,
        *,
        order: int = 2,
        capsule: Membrane | None = None,
        density_kg_m3: float | None = None,
        prony: Prony | None = None,
        friction: float = 0.3,
        law: OrganLaw | None = None,
        device: str = "cpu",
    ) -> None:
        self.space = _spaces.of((mesh, order, device), lambda: Space(mesh, order, device=device))
        self.elasticity = elasticity
        self.held = held
        self.prony = prony
        self.friction = friction
        self._capsule = capsule
        self._density = density_kg_m3
        self._law = law
        if law is not None and not (capsule is None and density_kg_m3 is None and prony is None):
            raise InputError(
                "law", "be None with a capsule, a weight or a relaxation", "one", "leave them out"
            )

    @property
    def mesh(self) -> TetMesh:
        """The tetrahedra."""
        return self.space.mesh

    @cached_property
    def body(self) -> HeldBody:
        """Stiffness [N/m], capsule included, and supports.

        Raises
        ------
        InputError
            If the held nodes leave the organ, or a loose part of it, free to move.
        """
        stiffness = assemble(self.space, self.elasticity)
        if self._capsule is not None:
            membrane = capsule_stiffness(
                self.space,
                thickness_m=self._capsule.thickness_m,
                young_Pa=self._capsule.young_Pa,
                poisson_ratio=self._capsule.poisson_ratio,
            )
            stiffness = bsr_array((stiffness + membrane).tobsr((3, 3)))
        fixed = np.zeros(self.space.node_count, dtype=bool)
        fixed[self.held] = True
        fixed[self.space.with_middles(faces_of(self.mesh, self.held))] = True
        return HeldBody(stiffness, self.space.nodes_m, held_nodes(fixed))

    @cached_property
    def factor(self) -> Factor:
        """Solver for the whole organ, made at the first use."""
        return Factor(self.body)

    @cached_property
    def _columns(self) -> KeptColumns:
        return KeptColumns(self.factor, np.unique(self.space.faces))

    def expect(self, near_m: Array, within_m: float) -> None:
        """Request the compliance of the surface near some points [m], shape (k, 3), at once.

        "Near" is within a distance [m]. The compliance is read off the factor, if the factor is not
        made yet. A press elsewhere needs back-substitutions first.
        """
        from scipy.spatial import cKDTree

        surface = np.unique(self.space.faces)
        near = cKDTree(near_m).query(self.space.nodes_m[surface])[0] <= within_m
        self.factor.expect(surface[near])

    @cached_property
    def rest(self) -> tuple[Array, Array]:
        """Load of the organ's weight [N] and its displacement [m], shape (n, 3) both.

        Both are zero without a density.
        """
        if self._density is None:
            return np.zeros((self.space.node_count, 3)), np.zeros((self.space.node_count, 3))
        load = gravity(self.space, density_kg_m3=self._density)
        return load, self.factor.solve(load)

    def touchable(self, probe: ProbeShape, tips_m: Array, rotations: Array) -> tuple[Ints, Ints]:
        """Return surface nodes and triangles near a tool's path, as `touchable_patch` does.

        Raises
        ------
        InputError
            If the tool touches nothing, or only held nodes.
        """
        key = self.space, probe, tips_m.tobytes(), rotations.tobytes()
        touchable, faces = _patches.of(
            key, lambda: touchable_patch(self.space, probe, tips_m, rotations)
        )
        if self.body.fixed[touchable].all():
            raise InputError(
                "motion",
                "bring the tool to tissue that can move",
                "a tool that touches only what is held",
                "move it, or change what holds the organ",
            )
        return touchable, faces

    def under(
        self,
        probe: ProbeShape,
        tips_m: Array,
        rotations: Array,
        *,
        path: CompliancePath | None = None,
        basis_size: int = 300,
        interval_s: float = inf,
        step_s: float = TICK_S,
        tolerance: float = 1e-3,
        sweeps: int = 100,
        cores: int | None = None,
        report: Progress = silent,
    ) -> tuple[LiverModel, int]:
        """Return the organ under a tool on a given path, and the number of nodes that it can touch.

        Parameters
        ----------
        probe, tips_m, rotations
            The tool and its poses along the path, as for `touchable_patch`.
        path, basis_size
            Method used to compute the compliance of the touchable nodes, and the number of vectors
            of a reduced basis; None: from columns of the one factor, each kept for the next tool.
        interval_s
            Time between two frames of displacement and stress [s]; infinite for no frames.
        step_s
            Length of a tick [s].
        tolerance, sweeps
            Tolerance and sweeps of the contact, as for `SurfaceContact`; the defaults are for a
            tick of 1 ms.
        cores
            Processor cores to spread a shell's projection over; default all.
        report
            Called with the current task.

        Raises
        ------
        InputError
            As for `touchable`, or if the touchable nodes would not fit into memory.
        """
        touchable, faces = self.touchable(probe, tips_m, rotations)
        if path is None or path == "condensed":
            self.factor.expect(touchable)
        load, rest = self.rest
        report("condensing the compliance to the surface that can be touched", 0.0)
        if path is None:
            compliance = self._columns.between(touchable)
            lazy = None
        else:
            compliance, lazy = compliance_of(
                self.body, touchable, self.factor, path=path, basis_size=basis_size, report=report
            )
        contact = SurfaceContact(
            self.space.nodes_m[touchable] + rest[touchable],
            faces,
            compliance,
            probe,
            friction=self.friction,
            tolerance=tolerance,
            sweeps=sweeps,
            device=self.space.device,
            cores=cores,
        )
        law = self._law
        fields = OrganFields(
            self.space,
            self.elasticity,
            large=None if law is None else large_fields_of(self, law, touchable),
            solve=self.factor.solve_all,
            product=lambda moved: (self.body.stiffness @ moved.ravel()).reshape(-1, 3),
            touchable=touchable,
            rest_m=rest,
            rest_load_N=load,
            held=self.held,
            interval_s=interval_s,
        )
        surface_law = None
        if law is not None:
            surface_law = law_offset_of(self, law, touchable)
        radius = probe.radius_m if isinstance(probe, SphereProbe) else None
        model = LiverModel(
            contact,
            space=self.space,
            touchable=touchable,
            fields=fields,
            prony=self.prony,
            lazy=lazy,
            law=surface_law,
            ball_radius_m=radius,
            step_s=step_s,
        )
        return model, len(touchable)
