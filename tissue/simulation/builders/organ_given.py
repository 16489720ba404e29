"""Organ that a caller describes: its materials, surface and mesh refinement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, names_of_caller, require_positive, require_range
from meshes.surfaces.surface import Surface, surface_from_triangles
from meshes.surfaces.triangle_files import read_triangles
from meshes.tets.files import require_millimetres
from meshes.tets.stuffing import EDGE_GROWTH, bisected
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import nearest_on_triangles, triangle_distance
from tissue.materials.elasticity import lame

if TYPE_CHECKING:
    from tissue.models.organ.soft_organ import SoftOrgan

__all__ = ["SoftMaterial", "refined", "surface_of"]

FINE_EDGES = 1.0
"""Distance from a point, in edges, within which edges do not grow.

It is the radius of a tool of four edges.
"""


@dataclass(frozen=True)
class SoftMaterial:
    """Material of an organ, and options of its solution.

    Attributes
    ----------
    modulus_kPa
        Young's modulus of every part that `parts` does not name [kPa].
    poisson_ratio
        Poisson's ratio.
    parts
        Young's moduli of parts by their names or numbers [kPa].
    order
        Order of the tetrahedra.
    friction
        Coulomb's coefficient between tool and organ.
    capsule
        Thickness [um] and Young's modulus [kPa] of a membrane on the surface; None for no membrane.
    density_kg_m3
        Density [kg/m3]; where it is given, gravity acts on the organ.
    relaxation
        Pairs of a share of the modulus that relaxes and its relaxation time [s].

    Raises
    ------
    InputError
        If a value is out of its range.
    """

    modulus_kPa: float
    poisson_ratio: float
    parts: Mapping[str | int, float] = field(default_factory=dict)
    order: int = 2
    friction: float = 0.3
    capsule: tuple[float, float] | None = None
    density_kg_m3: float | None = None
    relaxation: Sequence[tuple[float, float]] = ()

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
            raise InputError(
                "capsule",
                "be two numbers",
                self.capsule,
                "give its thickness in um and its modulus in kPa, such as (50, 8200)",
            )
        if any(np.shape(each) != (2,) for each in self.relaxation):
            raise InputError(
                "relaxation",
                "be pairs of a share and a time [s]",
                list(self.relaxation),
                "use for example [(0.3, 1.0)]",
            )
        for value in self.capsule or ():
            require_positive(
                "capsule",
                value,
                "give its thickness in um and its modulus in kPa, such as (50, 8200)",
            )
        if self.density_kg_m3 is not None:
            require_positive("density_kg_m3", self.density_kg_m3, "soft tissue has about 1060")

    def moduli_kPa(self, part_names: Sequence[str]) -> dict[str, float]:
        """Return Young's modulus of each part of a mesh by its name [kPa].

        Raises
        ------
        InputError
            If the mesh has no part of that name.
        """
        found = dict.fromkeys(part_names, self.modulus_kPa)
        given = set[str]()
        for name, modulus in self.parts.items():
            known = next((each for each in (str(name), f"part {name}") if each in found), None)
            if known is None:
                raise InputError(
                    "parts", "name parts of the mesh", f"{name!r}", f"it has {', '.join(found)}"
                )
            if known in given:
                raise InputError("parts", "name each part once", f"{known} twice", "remove one")
            given.add(known)
            found[known] = float(modulus)
        return found

    def elasticity(self, mesh: TetMesh) -> NDArray[np.float64]:
        """Return Lame constants of the cells [Pa], shape (m, 2)."""
        moduli = np.array(list(self.moduli_kPa(mesh.part_names).values()))
        return lame(1e3 * moduli[mesh.part], self.poisson_ratio)

    def organ(self, mesh: TetMesh, held: NDArray[np.int64]) -> "SoftOrgan":
        """Return the organ at rest on a mesh whose nodes `held` do not move."""
        from tissue.materials.prony import Prony
        from tissue.models.organ.soft_organ import Membrane, SoftOrgan

        capsule = None
        if self.capsule is not None:
            capsule = Membrane(1e-6 * self.capsule[0], 1e3 * self.capsule[1], self.poisson_ratio)
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
        )


def surface_of(name: str, given: object, scale_mm: float | None) -> Surface:
    """Return a closed surface from a file, a pyvista or trimesh surface, or vertices and triangles.

    Raises
    ------
    InputError
        If it is no surface, its size points to another unit, or it encloses no solid.
    """
    source = name
    if isinstance(given, str | Path):
        source = Path(given).name
        with names_of_caller({"file": name}):
            vertices, faces = read_triangles(Path(given))
    else:
        vertices, faces = _triangles(name, given)
    scale = require_millimetres(name, vertices, scale_mm)
    with names_of_caller(dict.fromkeys(("surface", "vertices", "faces", "triangles"), name)):
        return surface_from_triangles(vertices, faces, source=source, scale_mm=scale)


def _triangles(name: str, given: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices and triangles of a surface in memory."""
    if hasattr(given, "is_all_triangles"):  # pyvista
        whole = given.triangulate()
        return np.asarray(whole.points, dtype=np.float64), np.asarray(
            whole.regular_faces, dtype=np.int64
        )
    if hasattr(given, "vertices") and hasattr(given, "faces"):  # trimesh
        given = given.vertices, given.faces
    if isinstance(given, Sequence) and len(given) == 2:
        vertices, faces = (np.asarray(each) for each in given)
        if vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3:
            return vertices.astype(np.float64), faces.astype(np.int64)
    raise InputError(
        name,
        "be a closed surface of pyvista or trimesh, vertices and triangles, or a file",
        type(given).__name__,
        "export it as STL",
    )


def refined(
    mesh: TetMesh, surface: Surface | None, *, edge_m: float, near_m: NDArray[np.float64] | None
) -> TetMesh:
    """Refine a mesh to edges of at most a length [m] near points, or on the whole surface.

    The points have shape (k, 3).
    """
    from scipy.spatial import cKDTree

    vertices, faces = (
        (mesh.nodes_m, mesh.surface) if surface is None else (surface.vertices_m, surface.faces)
    )

    def wanted(points: NDArray[np.float64]) -> NDArray[np.float64]:
        if near_m is None:
            away = np.abs(triangle_distance(mesh.nodes_m, mesh.surface, points))
        else:
            away = np.asarray(cKDTree(near_m).query(points)[0], dtype=np.float64)
        return edge_m + EDGE_GROWTH * np.maximum(
            away - (0.0 if near_m is None else FINE_EDGES * edge_m), 0.0
        )

    onto = (
        None if surface is None else (lambda points: nearest_on_triangles(vertices, faces, points))
    )
    with names_of_caller({"size_m": "edge_mm"}):
        return bisected(mesh, wanted, onto=onto)
