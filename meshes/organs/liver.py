"""Procedural liver and block of soft tissue, with or without a stiff nodule.

The origin of the liver's site frame is the top of the right lobe's dome. x points to the patient's
left, y to the back, and z to the head. A tool that moves down from +z presses the diaphragmatic
surface. M = from memory of the literature, not looked up.

==================  ================  ===================================================================
width               222 mm            M: adult, 200-225 transverse (anatomy texts, Gray's Anatomy)
depth               127 mm            M: 100-150 antero-posterior at the right lobe (same)
right lobe height   123 mm            M: 105-155 cranio-caudal in the mid-clavicular line (ultrasound)
volume              1.41 l            M: 1.2-1.8 l adult; 1477 ml for the scanned liver the tests use
left lobe           22 %              M: 25-40 % of the volume, thinning to a wedge
==================  ================  ===================================================================

The shape is drawn with signed distances: a dome of two ellipsoids is cut by the inclined visceral
plane. It has hollows for stomach, kidney and gall bladder, a groove for the vena cava and spine,
and a notch for the round ligament. The mesh does not contain vessels or the capsule."""  # noqa: E501 a table

import math
from dataclasses import dataclass

import numpy as np

from meshes.base.errors import InputError, enumerated, require_length
from meshes.shapes.sdf import (
    Shape,
    box,
    capsule,
    difference,
    ellipsoid,
    half_space,
    intersection,
    sphere,
    union,
)
from meshes.tets.regions import Nodes, nodes_behind_plane, nodes_facing
from meshes.tets.structured import graded, grid
from meshes.tets.stuffing import bisected, stuffed, with_part
from meshes.tets.tetrahedra import TetMesh

_TOP_M = (-0.026, 0.0)
"""Position of the right lobe's dome, x and y [m], before the liver is moved to the site frame."""
_SIZE = 0.94
"""Scale factor of the combined basic shapes, chosen to give the sizes in the module docstring."""
_TRIES = 4
"""Number of radii that are tried for a nodule with the required volume."""
_NODULE_EDGES = 3.0
_NODULE_GROWTH = 1.0
"""Number of tetrahedron edges across a nodule (`_NODULE_EDGES`), and growth of the edge length.

The growth is the increase of the edge length per distance from the nodule. With edges as long as
the nodule's radius, a nodule of 18 mm diameter would lose 13 % of its volume. The force on a tool
above the nodule would then have an error of up to 2 %, a fifth of the nodule's contribution to the
force.
"""
_NEAR_M = 1e-5
"""Half the step [m] of the finite differences for the gradient of the signed distance."""
_PROJECTIONS = 4
"""Number of Newton steps that move a point onto the liver's surface.

The signed distance of the liver is nearly exact, so each step squares the relative error.
"""
_VISCERAL = (0.33, 0.10, -0.94)
"""Outward normal of the visceral side. This side is inclined towards the thin left lobe."""
LIVER_REGIONS = {"below": (_VISCERAL, 55.0), "back": ((0.0, 1.0, 0.0), 45.0)}
"""Direction and angle [degrees] of each surface at which a liver may be fixed, by name.

A surface consists of the triangles whose normals deviate from the direction by at most the angle.

The surface ``below`` is the visceral side, on which the liver rests. The surface ``back`` is the
bare area in front of the spine and the vena cava.
"""


@dataclass(frozen=True)
class Nodule:
    """Stiff ball (nodule) in soft tissue.

    Attributes
    ----------
    radius_m
        Radius [m].
    centre_m
        Centre in the site frame [m].
    """

    radius_m: float
    centre_m: tuple[float, float, float]


def liver_shape() -> Shape:
    """Return the liver's shape (signed distance [m]) in the site frame."""
    drawn = _drawn()
    # Height of the dome, by bisection in an interval of 0.2 m. 60 halvings reduce the interval to
    # 2e-19 m.
    low = 0.0
    high = 0.2
    column = np.array([[_TOP_M[0], _TOP_M[1], 0.0]])
    for _ in range(60):
        middle = 0.5 * (low + high)
        if drawn.distance(column + np.array([[0.0, 0.0, middle]]))[0] < 0.0:
            low = middle
        else:
            high = middle
    return drawn.translate((-_TOP_M[0], -_TOP_M[1], -low))


def liver(*, spacing_m: float = 8.4e-3, nodule: Nodule | None = None) -> TetMesh:
    """Build a liver in the site frame from tetrahedra of similar size.

    A nodule becomes the part ``nodule`` of the mesh. The surface of the nodule consists of faces of
    tetrahedra.

    Parameters
    ----------
    spacing_m
        Side [m] of the lattice cubes from which the tetrahedra are built. A side of 8.4 mm gives
        about 30,000 tetrahedra.
    nodule
        Stiff ball. The ball must lie at least `spacing_m` below the liver's surface.

    Raises
    ------
    InputError
        If the spacing is out of range, or the nodule is not inside the liver or is smaller than the
        spacing.
    """
    shape = liver_shape()
    mesh = stuffed(shape, spacing_m)
    return mesh if nodule is None else _with_nodule(mesh, nodule, shape, spacing_m)


def onto_liver(points: np.ndarray) -> np.ndarray:
    """Move points [m], shape (n, 3), onto the surface of the procedural liver."""
    shape = liver_shape()
    found = np.array(points, dtype=np.float64)
    steps = _NEAR_M * np.vstack([np.eye(3), -np.eye(3)])
    for _ in range(_PROJECTIONS):
        around = shape.distance((found[:, None] + steps).reshape(-1, 3)).reshape(-1, 6)
        slope = (around[:, :3] - around[:, 3:]) / (2.0 * _NEAR_M)
        # The slope of a distance is 1, or less where shapes are blended. The limit of 0.1 bounds
        # the step.
        size = np.maximum((slope * slope).sum(axis=1), 0.1)
        found -= (shape.distance(found) / size)[:, None] * slope
    return found


def liver_region(mesh: TetMesh, name: str) -> Nodes:
    """Return the surface nodes on one side (``below`` or ``back``) of the liver.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    if name not in LIVER_REGIONS:
        raise InputError(
            "region", f"be one of {enumerated(LIVER_REGIONS, 'or')}", name, "use one of them"
        )
    direction, within_deg = LIVER_REGIONS[name]
    return nodes_facing(mesh, direction=direction, within_deg=within_deg)


def slab(
    *,
    size_m: tuple[float, float, float] = (0.1, 0.1, 0.04),
    spacing_m: float = 4.2e-3,
    nodule: Nodule | None = None,
) -> TetMesh:
    """Build a block of tissue with the origin at the centre of its top face and +z upward.

    The layers of cells become thicker from the top down.

    Parameters
    ----------
    size_m
        Sides [m].
    spacing_m
        Sides of the cells along the top face [m]. The thickness of the first layer is 0.6 times
        this spacing, and each further layer is 1.2 times as thick as the layer above.
    nodule
        Stiff ball, which becomes the part ``nodule`` of the mesh. The nodule's surface consists of
        faces of tetrahedra.

    Raises
    ------
    InputError
        If a size is not positive, or the nodule is not inside the block or is smaller than the
        spacing.
    """
    x, y, z = (require_length("size_m", side, 0.0, math.inf, 0.1) for side in size_m)
    spacing = require_length("spacing_m", spacing_m, 0.0, min(x, y, z), max(x, y, z) / 20.0)
    along_x, along_y = (
        np.linspace(-0.5 * side, 0.5 * side, max(round(side / spacing), 1) + 1) for side in (x, y)
    )
    # Thin layers at the top resolve the contact; each is 1.2 times as thick as the one above it.
    mesh = grid(along_x, along_y, graded(0.0, -z, 0.6 * spacing, 1.2)[::-1])
    if nodule is None:
        return mesh
    return _with_nodule(mesh, nodule, box((x, y, z), (0.0, 0.0, -0.5 * z)), spacing)


def slab_base(mesh: TetMesh) -> Nodes:
    """Return the nodes on the lower face of a slab."""
    lowest = float(mesh.nodes_m[:, 2].min())
    return nodes_behind_plane(mesh, point_m=(0.0, 0.0, lowest), normal=(0.0, 0.0, 1.0))


def _drawn() -> Shape:
    """Build the liver, with its origin in the middle of the visceral side.

    The basic shapes give a liver that is slightly too large, so the result is scaled down.
    """
    # Half axes, radii, positions and blends [m] are chosen by eye. The table above lists the
    # resulting sizes.
    right = ellipsoid((0.082, 0.066, 0.084), (-0.030, 0.0, -0.009))
    left = ellipsoid((0.080, 0.045, 0.039), (0.046, -0.016, 0.024))
    visceral = half_space(_VISCERAL, (-0.030, 0.0, -0.034))
    body = intersection(union(right, left, blend_m=0.042), visceral, blend_m=0.015)
    for hollow, blend in (
        (ellipsoid((0.052, 0.052, 0.044), (0.074, 0.009, -0.038)), 0.018),  # stomach
        (ellipsoid((0.035, 0.032, 0.044), (-0.048, 0.050, -0.078)), 0.018),  # kidney
        (capsule(0.013, (-0.006, -0.066, -0.040), (0.003, 0.0, -0.028)), 0.012),  # gall bladder
        (capsule(0.026, (0.016, 0.076, -0.09), (0.016, 0.071, 0.11)), 0.018),  # vena cava and spine
        (capsule(0.008, (0.028, -0.075, -0.027), (0.028, -0.030, -0.014)), 0.010),  # round ligament
    ):
        body = difference(body, hollow, blend_m=blend)
    lower, upper = (tuple(_SIZE * x for x in corner) for corner in (body.lower_m, body.upper_m))
    return Shape(lambda p: _SIZE * body.distance(p / _SIZE), lower, upper)


def _with_nodule(mesh: TetMesh, nodule: Nodule, shape: Shape, spacing: float) -> TetMesh:
    """Add the nodule to the mesh as a part that has the volume of the nodule's ball.

    An error is raised if the mesh is too coarse for the nodule or the nodule is not deep enough.
    """
    radius = require_length("nodule.radius_m", nodule.radius_m, 0.0, math.inf, 0.01)
    if radius < spacing:
        raise InputError(
            "nodule.radius_m",
            # 2000 converts a radius in m to a diameter in mm
            f"give a diameter of at least {2000.0 * spacing:.4g} mm, two edges of the mesh",
            f"{2000.0 * radius:.4g} mm",
            "use a finer mesh",
        )
    deep = -float(shape.distance(np.array([nodule.centre_m], dtype=np.float64))[0])
    if not deep >= radius + spacing:
        raise InputError(
            "nodule.centre_m",
            (
                f"be at least {1e3 * (radius + spacing):.3g} mm below the surface (its radius "
                "plus the mesh spacing)"
            ),
            f"{1e3 * deep:.3g} mm",
            "move the centre deeper",
        )
    centre = np.array(nodule.centre_m)
    edge = 2.0 * radius / _NODULE_EDGES

    def size_m(points: np.ndarray) -> np.ndarray:
        outside = np.maximum(np.linalg.norm(points - centre, axis=1) - radius, 0.0)
        return np.asarray(edge + _NODULE_GROWTH * outside)

    mesh = bisected(mesh, size_m)
    # A polyhedron with corners on a ball has a smaller volume than the ball, so the surface is
    # placed slightly outside to match the volume. The volume as a function of the radius has jumps
    # where nodes are snapped differently, so the best of a few radii is used.
    volume = 4.0 / 3.0 * math.pi * radius**3
    laid = radius
    best = mesh
    least = math.inf
    for _ in range(_TRIES):
        made = with_part(mesh, sphere(laid, nodule.centre_m), "nodule")
        share = float(made.volumes_m3[made.part == len(mesh.part_names)].sum()) / volume
        if abs(share - 1.0) < least:
            best = made
            least = abs(share - 1.0)
        laid *= share ** (-1.0 / 3.0)
    return best
