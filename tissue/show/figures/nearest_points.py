"""Nearest points of a tool and the structures to keep clear of, for pictures of a run."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array, Floats
from meshes.voxels.mesh_sampling import surface_distance
from tissue.cutters.body import medial_axis
from tissue.simulation.run import Run

ALONG, AROUND, FINE = 3, 48, 40
"""Numbers of balls in the search for the ball of a tool that is nearest to a structure.

The first search tests `ALONG` balls along each segment of the tool's medial axis, at `AROUND`
angles about the tool's axis. The second search tests `FINE` positions and `FINE` angles near the
result. `tests/tissue/show/figures/test_layer_pictures.py` checks the length of the drawn line.
"""


@dataclass(frozen=True)
class Closest:
    """Smallest distance between the tool and a protected structure.

    Attributes
    ----------
    name
        Name of the structure.
    row
        Row of the trace with the smallest distance.
    points_mm
        Nearest points of the tool and of the structure [mm], shape (2, 3). If tool and structure
        overlap, the first point is the tool's deepest point in the structure. The second point lies
        on the structure's surface, in the direction in which the depth is measured. The length of
        the line between the points is the magnitude of the distance.
    """

    name: str
    row: int
    points_mm: Array


def closest(run: Run) -> Closest | None:
    """Return the smallest distance in a run between the tool and any protected structure.

    The result is None for a run without structures.
    """
    clear = run.parts.keep_clear
    distances_mm = distances_to_structures(run)
    if clear is None or not distances_mm:
        return None
    name = min(distances_mm, key=lambda each: distances_mm[each])
    # the trace may have smaller distances after the tool left the simulated region
    apart = np.abs(run.trace[f"distance_{name}_mm"] - distances_mm[name])
    row = int(apart.argmin())
    pose = Rotation.from_quat(run.trace.quaternions()[row]), run.trace.vectors("tool", "mm")[row]

    structure = clear.structures[name]
    distance_m = surface_distance(structure.vertices_m, structure.faces)

    def distance_mm(points_mm: Array) -> Floats:
        return 1e3 * distance_m(1e-3 * points_mm)

    # The tool is the union of the balls on its medial axis. The distance from the structure is the
    # smallest distance of these balls, whether tool and structure overlap or not.
    axis = medial_axis(run.cutter.profile)
    shares = np.linspace(0.0, 1.0, ALONG)
    turns = np.linspace(-np.pi, np.pi, AROUND, endpoint=False)
    middles, radii = _balls_mm(axis.starts_m, axis.ends_m, shares, turns, pose)
    best = int((distance_mm(middles) - radii).argmin())
    segment = slice(best // (ALONG * AROUND), best // (ALONG * AROUND) + 1)
    # A second, finer search near the nearest ball of the first search.
    turns = turns[best % AROUND] + np.linspace(-1.0, 1.0, FINE) * (2.0 * np.pi / AROUND)
    shares = np.linspace(0.0, 1.0, FINE)
    middles, radii = _balls_mm(axis.starts_m[segment], axis.ends_m[segment], shares, turns, pose)
    apart_mm = distance_mm(middles)
    best = int((apart_mm - radii).argmin())
    middle = middles[best]
    # 0.01 mm: a step far above the rounding of the distance and far below the size of a structure
    steps = 0.01 * np.eye(3)
    slope = distance_mm(middle + steps) - distance_mm(middle - steps)
    away = slope / max(float(np.linalg.norm(slope)), 1e-12)
    ends = middle - np.array([[radii[best]], [apart_mm[best]]]) * away
    return Closest(name, row, ends)


def _balls_mm(
    starts_m: Array, ends_m: Array, shares: Array, turns: Array, pose: tuple[Rotation, Array]
) -> tuple[Array, Array]:
    """Return centres, shape (n, 3), and radii of balls on segments of a tool's medial axis [mm].

    The balls lie at the given shares of each segment and at the given angles around the axis.
    """
    balls = 1e3 * (starts_m[:, None] + shares[:, None] * (ends_m - starts_m)[:, None])
    radius, height, size = np.repeat(balls.reshape(-1, 3), len(turns), axis=0).T
    angles = np.tile(turns, balls.shape[0] * balls.shape[1])
    centres = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), height])
    rotation, tip_mm = pose
    return rotation.apply(centres) + tip_mm, size


def distances_to_structures(run: Run) -> dict[str, float]:
    """Return the smallest distance [mm] between the tool and each protected structure.

    A distance is negative if the tool was inside the structure. Ticks after the tool left the
    simulated region are ignored.
    """
    clear = run.parts.keep_clear
    found = {} if clear is None else clear.summary()
    distances = {name: each["least_distance_mm"] for name, each in found.items()}
    return {name: each for name, each in distances.items() if each is not None}
