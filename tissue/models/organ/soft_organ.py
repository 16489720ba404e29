"""Soft organ at rest: mesh, materials, supports, weight, and a solver that all tools share."""

from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np
from scipy.sparse import bsr_array
from scipy.spatial import cKDTree

from meshes.base.arrays import Array, Ints
from meshes.base.cache import RecentResults
from meshes.base.errors import InputError, in_brackets
from meshes.base.progress import Progress
from meshes.tets.regions import faces_of
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.assembly import assemble, capsule_stiffness, gravity
from tissue.fem.solvers.compliance import reduced_compliance_m_N, surface_compliance_m_N
from tissue.fem.solvers.held_body import HeldBody, held_nodes
from tissue.fem.space import Space
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.materials.prony import Prony
from tissue.models.organ.compliance import ComplianceMethod, Factor
from tissue.models.organ.probe import ProbeShape

CONDENSING = "condensing the compliance to the surface that can be touched"
MARGIN_EDGES = 0.25
"""Margin around the tool's path within which surface nodes count as touchable [mesh edges].

The margin is needed because the surface moves under the tool. The value is chosen: the force of a
deep straight press is equal for 0, 0.25 and 1.
"""


@dataclass(frozen=True, eq=False)
class ToolPath:
    """Tool and its poses along a path.

    Attributes
    ----------
    probe
        The tool.
    tips_m, rotations
        Positions of the tip [m], shape (p, 3), and rotations from tool to world, shape (p, 3, 3).
    """

    probe: ProbeShape
    tips_m: Array
    rotations: Array


def _touchable_patch(space: Space, tool: ToolPath) -> tuple[Ints, Ints]:
    """Return surface nodes near a tool's path, and the triangles between these nodes.

    The nodes are an array of shape (t,), and the triangles an array of shape (f, 3). The triangles
    are indices into the array of nodes.
    """
    triangles = linear_triangles(space.faces)
    centres = space.nodes_m[triangles].mean(axis=1)
    reach = np.linalg.norm(space.nodes_m[triangles] - centres[:, None], axis=2).max(axis=1)
    nearest = np.full(len(triangles), np.inf)
    for tip, turn in zip(tool.tips_m, tool.rotations, strict=True):
        nearest = np.minimum(nearest, tool.probe.distance((centres - tip) @ turn))
    if not (nearest < reach).any():
        low = in_brackets(1e3 * centres.min(axis=0), ".4g")
        high = in_brackets(1e3 * centres.max(axis=0), ".4g")
        raise InputError(
            "motion",
            "bring the tool to the organ",
            "a tool that never touches it",
            f"move the tool to the organ, which lies between {low} and {high} mm",
        )
    # The reach is about half an edge.
    chosen = triangles[nearest < reach * (1.0 + 2.0 * MARGIN_EDGES)]
    nodes, places = np.unique(chosen, return_inverse=True)
    return nodes.astype(np.int64), places.reshape(-1, 3).astype(np.int64)


def linear_triangles(faces: Ints) -> Ints:
    """Return faces as linear triangles.

    Faces with three nodes are returned unchanged. Every face with six nodes (corners, then middles
    of edges 01, 12, 02) is divided into four triangles.
    """
    if faces.shape[1] == 3:
        return faces
    parts = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    return faces[:, parts].reshape(-1, 3)


_spaces: RecentResults[Space] = RecentResults(2)
_patches: RecentResults[tuple[Ints, Ints]] = RecentResults(2)
"""Cached surface nodes and triangles near a tool's path, keyed by mesh, order, tool and path.

The cache saves time in a study in which every trial presses the same mesh.
"""


@dataclass(frozen=True)
class Membrane:
    """Capsule of an organ: a thin elastic membrane on the whole surface.

    Attributes
    ----------
    thickness_m, young_Pa, poisson_ratio
        Thickness [m], Young's modulus [Pa] and Poisson's ratio.
    """

    thickness_m: float
    young_Pa: float
    poisson_ratio: float

    def stiffness(self, space: Space, faces: Ints) -> bsr_array:
        """Return the stiffness matrix of the membrane on the given faces [N/m]."""
        return capsule_stiffness(
            space,
            thickness_m=self.thickness_m,
            young_Pa=self.young_Pa,
            poisson_ratio=self.poisson_ratio,
            faces=faces,
        )


@dataclass(frozen=True, eq=False)
class OrganLaw:
    """Hyperelastic law of an organ.

    Attributes
    ----------
    law
        Hyperelastic law of a cell whose entry in ``cell_factors`` is 1.
    cell_factors
        Factor by which the law's moduli are multiplied in each cell, shape (m,).
    interval_s
        Time between two solutions of the law [s]; 0 for an organ that is solved only by
        `OrganModel.converge`.
    region_m
        Radius around the contact within which the law applies [m]. Outside this radius the organ is
        linear.
    """

    law: Hyperelastic
    cell_factors: Array
    interval_s: float
    region_m: float = inf


class SoftOrgan:
    """Elastic organ that any number of tools may press; all tools share one factorisation.

    Parameters
    ----------
    mesh
        Mesh of tetrahedra.
    elasticity
        Elastic constants of each cell [Pa], in the format of `tissue.fem.assembly.assemble`.
    held
        Nodes of the mesh that do not move.
    order
        Order of the tetrahedra, 1 or 2.
    capsule
        Elastic membrane on the surface; None for an organ without a capsule.
    density_kg_m3
        Density [kg/m3]. If it is given, the organ is loaded by its own weight, along -z, before a
        tool touches it.
    prony
        Prony series with which every modulus relaxes; None for an elastic organ.
    friction
        Coefficient of Coulomb friction between a tool and the organ.
    law
        Hyperelastic law whose small-strain limit is `elasticity`; None for the linear law. With a
        hyperelastic law, the capsule is linear, relaxation is quasi-linear, and the weight must be
        zero.
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
        self.law = law
        self.capsule = capsule
        self._density = density_kg_m3
        if law is not None and density_kg_m3 is not None:
            raise InputError(
                "law",
                "be None for an organ with weight",
                "a law",
                "leave the law or the weight out",
            )

    @property
    def mesh(self) -> TetMesh:
        """Mesh of tetrahedra."""
        return self.space.mesh

    @cached_property
    def membrane(self) -> bsr_array | None:
        """Stiffness of the capsule [N/m]; None if the organ has no capsule."""
        if self.capsule is None:
            return None
        return self.capsule.stiffness(self.space, self.space.faces)

    @cached_property
    def body(self) -> HeldBody:
        """Body with supports; its stiffness [N/m] includes the organ and the capsule.

        Raises
        ------
        InputError
            If the held nodes do not prevent every rigid motion of the organ, or of an unconnected
            part of the organ.
        """
        # The cells of a hyperelastic law are not softened, and its region must match the cells
        # around it.
        stiffness = assemble(self.space, self.elasticity, softened=self.law is None)
        if self.membrane is not None:
            stiffness = bsr_array((stiffness + self.membrane).tobsr((3, 3)))
        fixed = np.zeros(self.space.node_count, bool)
        fixed[self.held] = True
        fixed[self.space.with_middles(faces_of(self.mesh, self.held))] = True
        return HeldBody(stiffness, self.space.nodes_m, held_nodes(fixed))

    @cached_property
    def factor(self) -> Factor:
        """Solver for the whole organ, made when it is first used."""
        return Factor(self.body, np.unique(self.space.faces))

    def expect(self, near_m: Array, within_m: float) -> None:
        """Request a stiffness factorisation that contains the surface compliance near some points.

        `near_m` are the points [m], shape (k, 3), and `within_m` is the largest distance of a node
        from a point. The request has no effect if the factor was computed before. If a tool presses
        at another place, additional back-substitutions are needed before its first step.
        """
        surface = np.unique(self.space.faces)
        near = cKDTree(near_m).query(self.space.nodes_m[surface])[0] <= within_m
        self.factor.expect(surface[near])

    @cached_property
    def rest(self) -> tuple[Array, Array]:
        """Nodal forces of gravity [N] and the resulting displacement [m], each of shape (n, 3).

        If no density was given, load and displacement are zero.
        """
        load = np.zeros((self.space.node_count, 3))
        if self._density is None:
            return load, np.zeros_like(load)
        load = gravity(self.space, density_kg_m3=self._density)
        return load, self.factor.solve(load)

    def touchable(self, tool: ToolPath) -> tuple[Ints, Ints]:
        """Return surface nodes near a tool's path, and the triangles between these nodes.

        The nodes are an array of shape (t,), and the triangles an array of shape (f, 3). The
        triangles are indices into the array of nodes.

        Raises
        ------
        InputError
            If the tool touches nothing, or only nodes on supports.
        """
        key = self.space, tool.probe, tool.tips_m.tobytes(), tool.rotations.tobytes()
        touchable, faces = _patches.of(key, lambda: _touchable_patch(self.space, tool))
        if self.body.fixed[touchable].all():
            raise InputError(
                "motion",
                "bring the tool to tissue that can move",
                "a tool that touches only held tissue",
                "move the tool, or hold another part of the organ",
            )
        return touchable, faces

    def compliance_between(self, nodes: Ints) -> Array:
        """Return the compliance matrix of n surface nodes [m/N], shape (3n, 3n)."""
        self.factor.expect(nodes)
        return self.factor.compliance_between(nodes)

    def compliance(
        self, touchable: Ints, method: ComplianceMethod | None, *, basis_size: int, report: Progress
    ) -> Array:
        """Return the compliance of t touchable nodes [m/N], shape (3t, 3t).

        If `method` is None, columns of the compliance are computed from the factorised stiffness
        and stored for the next tool. `basis_size` is the number of basis vectors if `method` is
        ``reduced``.

        Raises
        ------
        InputError
            If the compliance would not fit into memory.
        """
        report(CONDENSING, 0.0)
        if method is None:
            return self.compliance_between(touchable)
        if method == "reduced":
            return reduced_compliance_m_N(self.factor.solver, touchable, basis_size)
        self.factor.expect(touchable)
        return surface_compliance_m_N(
            self.body,
            touchable,
            solver=lambda: self.factor.solver,
            progress=lambda share: report(CONDENSING, share),
        )
