"""Material and supports of a soft organ, for scenes and for `tissue.Organ`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError, names_of_caller, require_positive, require_range
from meshes.base.hints import nearest
from meshes.tets.regions import Nodes, faces_of, nodes_behind_plane, nodes_facing, nodes_of_part
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import nearest_on_triangles
from tissue.materials.elasticity import (
    fibre_ratio_range,
    lame,
    rotated,
    transversely_isotropic,
    volume_preserving_ratio,
)

if TYPE_CHECKING:
    from tissue.models.organ.soft_organ import OrganLaw, SoftOrgan

COINCIDE = 1e-6
"""Largest relative distance at which a node is treated as equal to a given point.

The distance is divided by the size of the mesh.
"""
CAPSULE = "give its thickness in um and its modulus in kPa, such as (50, 8200)"
SIDES = {
    "bottom": (0.0, 0.0, -1.0),
    "top": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "+x": (1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
    "+z": (0.0, 0.0, 1.0),
}
"""Outward directions of the sides of an organ's surface that may be held, keyed by name."""
Hold = Callable[[TetMesh], Nodes]
"""Function that returns the held nodes of a mesh."""


@dataclass(frozen=True)
class SoftMaterial:
    """Material of an organ, and options for the solution of its equations.

    Attributes
    ----------
    modulus_kPa
        Young's modulus of each part that is not in `parts` [kPa].
    poisson_ratio
        Poisson's ratio.
    parts
        Young's moduli of parts [kPa], keyed by name or number.
    order
        Order of the tetrahedra.
    friction
        Coulomb friction coefficient between tool and organ.
    capsule, capsule_poisson_ratio
        `capsule` contains the thickness [um] and Young's modulus [kPa] of a membrane on the
        surface; None for no membrane. `capsule_poisson_ratio` is Poisson's ratio of this membrane;
        if it is None, the ratio of the organ is used.
    density_kg_m3
        Density [kg/m3]. If it is given, gravity acts on the organ.
    relaxation
        Pairs of two numbers: the share of the modulus that relaxes, and the time in which this
        share relaxes [s].
    graded_kPa, grading_exponent
        Young's modulus changes from `modulus_kPa` at the smallest x to `graded_kPa` [kPa] at the
        largest x. In between, the change is proportional to a power of the distance from the
        smallest x, with the exponent `grading_exponent`. There is no grading if `graded_kPa` is
        None.
    fibre_direction, fibre_modulus_ratio
        Direction of the fibres; None if the organ has no fibres. The ratio is Young's modulus along
        the fibres divided by Young's modulus across the fibres.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    modulus_kPa: float
    poisson_ratio: float
    parts: Mapping[Any, float] = field(default_factory=dict)
    order: int = 2
    friction: float = 0.3
    capsule: tuple[float, float] | None = None
    capsule_poisson_ratio: float | None = None
    density_kg_m3: float | None = None
    relaxation: Sequence[tuple[float, float]] = ()
    graded_kPa: float | None = None
    grading_exponent: float = 1.0
    fibre_direction: tuple[float, float, float] | None = None
    fibre_modulus_ratio: float = 1.0

    def __post_init__(self) -> None:
        require_positive("modulus_kPa", self.modulus_kPa, "liver has about 5, kidney 10")
        require_range(
            "poisson_ratio", self.poisson_ratio, -0.999, 0.4999, "soft tissue has 0.45 to 0.499"
        )
        require_range(
            "friction", self.friction, 0.0, 10.0, "give Coulomb's coefficient, 0 for none"
        )
        for name, modulus in self.parts.items():
            require_positive(f"parts[{name!r}]", modulus, "give its Young's modulus in kPa")
        if self.capsule is not None and np.shape(self.capsule) != (2,):
            raise InputError("capsule", "be two numbers", self.capsule, CAPSULE)
        for value in self.capsule or ():
            require_positive("capsule", value, CAPSULE)
        if any(np.shape(each) != (2,) for each in self.relaxation):
            raise InputError(
                "relaxation",
                "be a list of pairs: a share and a time [s]",
                list(self.relaxation),
                "use for example [(0.3, 1.0)]",
            )
        if self.density_kg_m3 is not None:
            require_positive("density_kg_m3", self.density_kg_m3, "soft tissue has about 1060")

    def moduli_kPa(self, part_names: Sequence[str]) -> dict[str, float]:
        """Return Young's modulus of each part of a mesh [kPa], keyed by name.

        Raises
        ------
        InputError
            If the mesh does not have a named part, or a part is named twice.
        """
        return dict.fromkeys(part_names, self.modulus_kPa) | self._stated_kPa(part_names)

    def _stated_kPa(self, part_names: Sequence[str]) -> dict[str, float]:
        """Return the moduli in `parts` [kPa], keyed by the names of the parts in a mesh."""
        found: dict[str, float] = {}
        for name, modulus in self.parts.items():
            known = next((each for each in (str(name), f"part {name}") if each in part_names), None)
            if known is None:
                has = ", ".join(part_names)
                got = f"{name!r}{nearest(str(name), part_names)}"
                raise InputError(
                    "parts",
                    "name parts of the mesh",
                    got,
                    f"use names of its parts: {has}",
                )
            if known in found:
                raise InputError(
                    "parts", "name each part once", f"{known} twice", "remove one of the two"
                )
            found[known] = float(modulus)
        return found

    def elasticity(self, mesh: TetMesh) -> Array:
        """Return the elastic constants of the cells of a mesh [Pa].

        The result contains Lame constants, shape (m, 2). With fibres, it contains stiffness
        matrices, shape (m, 6, 6).

        Raises
        ------
        InputError
            If the constants of the fibres make the material unstable.
        """
        young = np.full(len(mesh.cells), self.modulus_kPa)
        if self.graded_kPa is not None:
            x = mesh.nodes_m[mesh.cells].mean(axis=1)[:, 0]
            share = (x - x.min()) / np.ptp(x)
            young += (self.graded_kPa - self.modulus_kPa) * share**self.grading_exponent
        for name, modulus in self._stated_kPa(mesh.part_names).items():
            young[mesh.part == mesh.part_names.index(name)] = modulus
        if self.fibre_direction is None:
            return lame(1e3 * young, self.poisson_ratio)
        turned = rotated(self._fibrous_Pa(), np.array([self.fibre_direction]))
        return young[:, None, None] * turned

    def _fibrous_Pa(self) -> Array:
        """Return the stiffness matrix of tissue with fibres along axis 3 [Pa], shape (6, 6).

        Young's modulus across the fibres is 1 kPa.
        """
        ratio = self.poisson_ratio
        along = self.fibre_modulus_ratio
        low, high = fibre_ratio_range(ratio)
        if not low < along < high:
            bound = f"more than {low:.3g}" if along <= low else f"less than {high:.3g}"
            raise InputError(
                "organ.fibre_modulus_ratio",
                f"be {bound} for stable tissue of Poisson's ratio {ratio:g}",
                f"{along:g}",
                "change this ratio or organ.poisson_ratio",
            )
        return transversely_isotropic(
            young_fibre_Pa=1e3 * along,
            young_across_Pa=1e3,
            # No shear modulus is given. It is computed from the mean of the moduli along and
            # across, as for isotropic tissue.
            shear_fibre_Pa=1e3 * (0.5 + 0.5 * along) / (2.0 * (1.0 + ratio)),
            poisson_fibre=ratio,
            poisson_across=volume_preserving_ratio(poisson_ratio=ratio, modulus_ratio=along),
        )

    def organ(
        self, mesh: TetMesh, held: Nodes, *, law: "OrganLaw | None" = None, compute: str = "cpu"
    ) -> "SoftOrgan":
        """Return the undeformed organ on a mesh; the nodes in `held` do not move."""
        from tissue.materials.prony import Prony
        from tissue.models.organ.soft_organ import Membrane, SoftOrgan

        capsule = None
        if self.capsule is not None:
            ratio = self.capsule_poisson_ratio
            capsule = Membrane(
                1e-6 * self.capsule[0],
                1e3 * self.capsule[1],
                self.poisson_ratio if ratio is None else ratio,
            )
        prony = None
        if len(self.relaxation):
            with names_of_caller(dict.fromkeys(("g", "tau_s"), "relaxation")):
                prony = Prony(
                    *(tuple(map(float, each)) for each in zip(*self.relaxation, strict=True))
                )
        return SoftOrgan(
            mesh,
            self.elasticity(mesh),
            held,
            order=self.order,
            capsule=capsule,
            density_kg_m3=self.density_kg_m3,
            prony=prony,
            friction=self.friction,
            device=compute,
            law=law,
        )


def hold_of(
    held: str | ArrayLike,
    held_below_mm: float | None,
    mesh: TetMesh,
    points_mm: Array | None = None,
) -> tuple[Hold, str]:
    """Return a function that finds the held nodes of a mesh, and a note on the support.

    Parameters
    ----------
    held
        A side of the surface (``bottom``, ``top``, ``-x`` to ``+z``), the name of a part, or
        points. A side contains faces whose normals are within 60 degrees of its direction. Points
        are given as a mask, shape (n,), or as indices.
    held_below_mm
        Height below which the surface is held [mm]; used instead of `held`.
    mesh, points_mm
        Mesh of the organ, and the points [mm], shape (n, 3), to which a mask or indices refer. If
        `points_mm` is None, they refer to the nodes of the mesh.

    Raises
    ------
    InputError
        If the mesh does not have the given side, part or point.
    """
    if held_below_mm is not None:
        point = (0.0, 0.0, 1e-3 * float(held_below_mm))
        return (
            lambda mesh: nodes_behind_plane(mesh, point_m=point, normal=(0.0, 0.0, 1.0)),
            f"the surface below z = {held_below_mm:g} mm",
        )
    if isinstance(held, str):
        if held in SIDES:
            side = SIDES[held]
            return lambda mesh: nodes_facing(mesh, direction=side), f"the surface that faces {held}"
        if held in mesh.part_names:
            return lambda mesh: nodes_of_part(mesh, held), f"the part {held}"
        raise InputError(
            "held",
            f"be one of {', '.join((*SIDES, *mesh.part_names))}, or an array of points",
            f"{held!r}",
            "use for example 'bottom'",
        )
    nodes = _named(np.asarray(held), mesh, 1e3 * mesh.nodes_m if points_mm is None else points_mm)
    points_m = mesh.nodes_m
    triangles = faces_of(mesh, nodes)

    def hold(other: TetMesh) -> Nodes:
        """Return the nodes of a finer mesh that lie on the given points or between them."""
        # In the caller's own mesh, the nodes are known without a search.
        if other is mesh:
            return nodes
        from scipy.spatial import cKDTree

        away: Array = cKDTree(points_m[nodes]).query(other.nodes_m)[0]
        if len(triangles):
            surface = other.nodes_m[other.surface_nodes]
            on = nearest_on_triangles(points_m, triangles, surface)
            away[other.surface_nodes] = np.minimum(
                away[other.surface_nodes], np.linalg.norm(on - surface, axis=1)
            )
        return np.flatnonzero(away <= COINCIDE * float(np.ptp(points_m, axis=0).max()))

    return hold, f"{len(nodes)} points that were named"


def _named(held: NDArray[Any], mesh: TetMesh, points_mm: Array) -> Nodes:
    """Return the mesh nodes selected by a mask or by indices of the caller's points."""
    from scipy.spatial import cKDTree

    count = len(points_mm)
    if held.dtype == np.bool_ and held.shape == (count,):
        held = np.flatnonzero(held)
    is_numbers = held.dtype.kind in "iu" and held.ndim == 1 and len(held) > 0
    if not is_numbers or held.min() < 0 or held.max() >= count:
        raise InputError(
            "held",
            f"be a side, a part, a mask of the {count} points or indices of points",
            f"an array of type {held.dtype} and shape {held.shape}",
            f"give True or False for each point, or indices from 0 to {count - 1}",
        )
    near = COINCIDE * 1e3 * float(np.ptp(mesh.nodes_m, axis=0).max())
    away, nodes = cKDTree(1e3 * mesh.nodes_m).query(points_mm[held])
    return np.unique(nodes[away <= near])
