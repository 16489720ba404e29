"""Tools that press on an organ: a sphere, a flat cylinder, and any shape as a shell of points.

A tool's tip is the origin of its frame, and its z axis runs from the tip to the shank. `kind`
selects the tool's distance function in the contact kernels, and `size_m` contains its parameters.
If the organ's contact points are at most `spacing_m` apart, the tool cannot slip between them.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kernels.contact_state import CYLINDER, SHELL, SPHERE
from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, require_positive
from meshes.surfaces.triangle_files import read_triangles

SPACINGS = 2.0
"""Number of contact points along a tool's radius, so the tool cannot slip between two points."""
AREA_EDGE = 0.3
"""Largest distance between nodes under a ball for an accurate contact area [ball radii].

A ball of 15 mm was pressed 4 mm into a kidney. The contact area is too small by 28, 18, 14, 15 and
6 % with distances of 0.52, 0.46, 0.39, 0.37 and 0.31 radii (tetrahedra of order 1). With order 2,
which has a node in the middle of each edge, the area is too large by 18 % with 0.33 radii, and by 4
% with 0.26 radii. The baseline is 58.0 mm2, with order 2 and 0.20 radii. In the scene `palpation`,
the largest area is too large by 9 % with 0.35 radii. The command
``pytest -m "" tests/tissue/objects/test_contact_area.py`` measures the areas in the kidney.
"""


class ProbeShape(ABC):
    """Interface of tools that press on an organ."""

    kind: int
    """Index of the tool's distance function, see `kernels.contact_state`."""

    @property
    @abstractmethod
    def size_m(self) -> tuple[float, float]:
        """Two lengths [m]: radius of the tool, and radius of its rounded edge.

        For a shell of points, the lengths are the radius of a ball that holds all points, and the
        height of the ball's centre above the tip.
        """

    @property
    def spacing_m(self) -> float:
        """Largest distance between contact points on the organ [m]: half the tool's radius."""
        return self.size_m[0] / SPACINGS

    @abstractmethod
    def distance(self, points_m: Array) -> Array:
        """Return the signed distance of points from the tool's surface [m], shape (n,).

        The points are given in the tool's frame, shape (n, 3). The distance is negative inside the
        tool.
        """


@dataclass(frozen=True)
class SphereProbe(ProbeShape):
    """A ball whose lowest point is the tip.

    Attributes
    ----------
    radius_m
        Radius of the ball [m].
    """

    radius_m: float
    kind = SPHERE

    def __post_init__(self) -> None:
        require_positive("radius_m", self.radius_m, "give the ball's radius in metres")

    @property
    def size_m(self) -> tuple[float, float]:
        """Radius of the ball [m], and 0 because a ball has no edge."""
        return self.radius_m, 0.0

    def distance(self, points_m: Array) -> Array:
        """Return the signed distance to the ball [m]."""
        return np.linalg.norm(points_m - [0.0, 0.0, self.radius_m], axis=1) - self.radius_m


@dataclass(frozen=True)
class CylinderProbe(ProbeShape):
    """Flat cylindrical punch with a rounded edge; the cylinder extends upwards without an end.

    Attributes
    ----------
    radius_m
        Radius of the cylinder [m].
    edge_m
        Radius of the rounding of the edge [m], smaller than the radius of the cylinder.
    """

    radius_m: float
    edge_m: float
    kind = CYLINDER

    def __post_init__(self) -> None:
        require_positive("radius_m", self.radius_m, "give the cylinder's radius in metres")
        require_positive(
            "edge_m", self.edge_m, "give the edge a small radius, as a turned edge has"
        )
        if self.edge_m >= self.radius_m:
            raise InputError(
                "edge_m",
                f"be below radius_m = {self.radius_m:g}",
                f"{self.edge_m:g}",
                "round the edge less",
            )

    @property
    def size_m(self) -> tuple[float, float]:
        """Radius of the cylinder and radius of the rounded edge [m]."""
        return self.radius_m, self.edge_m

    def distance(self, points_m: Array) -> Array:
        """Return the signed distance to the rounded cylinder [m]."""
        outside = np.hypot(points_m[:, 0], points_m[:, 1]) - self.radius_m + self.edge_m
        below = self.edge_m - points_m[:, 2]
        corner = np.hypot(np.maximum(outside, 0.0), np.maximum(below, 0.0))
        return np.minimum(np.maximum(outside, below), 0.0) + corner - self.edge_m


@dataclass(frozen=True, eq=False)
class ShellProbe(ProbeShape):
    """Tool of any shape, represented by points on its surface.

    The distance between the points should be at most the length of the mesh edges of the organ.

    Attributes
    ----------
    points_m
        Points [m], shape (n, 3), in the tool's frame.
    normals
        Outward unit normals, shape (n, 3).
    areas_m2
        Area that each point represents [m2], shape (n,).
    """

    points_m: Array
    normals: Array
    areas_m2: Array
    kind = SHELL
    spacing_m = np.inf
    """Infinite spacing [m], because the shell has its own contact points."""

    @classmethod
    def from_mesh(
        cls, mesh: Path | str | object, *, points: int = 300, scale: float = 1.0
    ) -> "ShellProbe":
        """Return points spread over the surface of a mesh.

        The points are centres of the mesh's triangles. To get about the given number of points,
        large triangles are divided, and points that lie too close together are left out.

        Parameters
        ----------
        mesh
            A surface file, see `meshes.surfaces.triangle_files`, or a trimesh mesh. The origin of
            the mesh is the tip, and the z axis of the mesh runs to the shank.
        points
            Approximate number of points. In every tick, each point is projected onto the organ.
        scale
            Length of one unit of the mesh [m]; 1e-3 for millimetres.

        Raises
        ------
        InputError
            If the mesh is not closed, because the outward normals are then not defined.
        """
        import trimesh

        surface: Any = (
            trimesh.Trimesh(*read_triangles(Path(mesh))) if isinstance(mesh, (str, Path)) else mesh
        )
        if not (surface.is_watertight and surface.volume > 0.0):
            raise InputError(
                "mesh",
                "be closed, with triangles that face outwards",
                mesh,
                "repair the tool's surface",
            )
        # Leg of a right triangle with the area of one point. A triangle is divided if it is longer
        # than 1.5 times this leg. Smaller triangles are kept, because the thinning reduces their
        # number.
        longest = (2.0 * surface.area / points) ** 0.5
        vertices, faces = trimesh.remesh.subdivide_to_size(
            surface.vertices, surface.faces, 1.5 * longest
        )
        fine = trimesh.Trimesh(vertices, faces, process=False)
        centres = np.asarray(fine.triangles_center)
        normals = np.array(fine.face_normals)
        chosen, areas = _thinned(
            centres, normals, np.asarray(fine.area_faces), (surface.area / points) ** 0.5
        )
        return cls(scale * centres[chosen], normals[chosen], scale**2 * areas)

    @property
    def size_m(self) -> tuple[float, float]:
        """Radius of a ball that holds all points, and height of its centre above the tip [m]."""
        height = 0.5 * float(self.points_m[:, 2].min() + self.points_m[:, 2].max())
        return float(np.linalg.norm(self.points_m - [0.0, 0.0, height], axis=1).max()), height

    def distance(self, points_m: Array) -> Array:
        """Return the signed distance [m] of points to the tangent plane at their nearest point."""
        from scipy.spatial import cKDTree

        _, nearest = cKDTree(self.points_m).query(points_m)
        return np.einsum("ij,ij->i", points_m - self.points_m[nearest], self.normals[nearest])


def _thinned(centres: Array, normals: Array, areas: Array, side: float) -> tuple[Ints, Array]:
    """Return one point for each cube and each surface direction, and the area of each point.

    Space is divided into cubes with the edge `side`. A surface direction is one of six: along or
    against x, y or z. The points are returned as indices into `centres`, shape (k,).
    """
    normal = np.abs(normals).argmax(axis=1)
    faces = 2 * normal + (np.take_along_axis(normals, normal[:, None], axis=1)[:, 0] > 0.0)
    cells = np.column_stack([np.floor(centres / side).astype(np.int64), faces])
    _, group = np.unique(cells, axis=0, return_inverse=True)
    group = group.reshape(-1)
    total = np.bincount(group, weights=areas)
    middle = (
        np.column_stack([np.bincount(group, weights=areas * centres[:, c]) for c in range(3)])
        / total[:, None]
    )
    order = np.lexsort((np.linalg.norm(centres - middle[group], axis=1), group))
    first = np.unique(group[order], return_index=True)[1]
    return np.asarray(order[first], np.int64), np.asarray(total, np.float64)
