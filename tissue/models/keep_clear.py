"""Distance of the tool from structures that the tool must not touch, at every tick.

A breach, an overlap of tool and structure, is reported as an event.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
import warp as wp

from kernels.launcher import SplitLaunch
from kernels.mirror import Mirror, filled, put
from kernels.structure_depth import CELLS, AxisCell, MedialAxis
from kernels.structure_distance import NODES, TRIANGLES, Tree, distance_to_structure
from kernels.tool_distance import TOLERANCE_M, Outline
from meshes.base.arrays import Array, Floats, Ints
from meshes.surfaces.box_tree import box_tree, cut_long
from tissue.cutters.body import MEDIAL_TOLERANCE_M, medial_axis, outline_table
from tissue.cutters.profile import Profile
from tissue.models.state import State, copied, put_back
from tissue.models.tissue_model import TICK_S, ToolMotion

Distance = Callable[[Array], Floats]
"""Function from points [m], shape (n, 3), to signed distances [m], shape (n,), negative inside."""
DEVICE = "cpu"
"""Device of the distance search: one thread of the CPU, also if the tissue is on a GPU."""

DISTANCE_ERROR_M = float(TOLERANCE_M)
"""Largest error of the distance between a tool and triangles that do not overlap it [m]."""
OVERLAP_ERROR_M = 1e-5
"""Largest error of the distance between a tool and triangles that overlap it [m].

The tolerances of the kernel and of the tool's medial axis add up to less than this value.
`tests/tissue/models/test_clearance.py` checks this limit.
"""
MANY_TRIANGLES = 10000
"""Number of triangles of a structure above which the search in a deep overlap is coarse.

In a deep overlap with more triangles, a fine search would take tens of milliseconds per tick. The
value was chosen by judgement.
"""
DEEP_OVERLAP_ERROR_M = 1e-4
"""Largest error of the distance between tool and triangles in a coarse search [m].

The search is coarse if the structure has more than `MANY_TRIANGLES`, and a point of the structure's
surface lies more than 1 mm (`DEEP_M`) inside the tool.
"""
FINE_M = MEDIAL_TOLERANCE_M, 3e-6
"""Errors of the tool's medial axis and of the search [m].

Their sum is less than `OVERLAP_ERROR_M`.
"""
COARSE_M = 5e-5, 4.5e-5
"""Errors of the tool's medial axis and of the coarse search [m]; chosen.

Their sum must be less than `DEEP_OVERLAP_ERROR_M`.
"""


@dataclass(frozen=True, eq=False)
class Structure:
    """Closed surface of a structure.

    Attributes
    ----------
    vertices_m
        Vertices [m], shape (n, 3).
    faces
        Triangles wound outward, shape (m, 3).
    slack_m
        Largest distance between the triangles and the surface that they approximate [m]. This value
        is subtracted from every computed distance.
    """

    vertices_m: Array
    faces: Ints
    slack_m: float = 0.0


@dataclass
class _Breach:
    """Record of the smallest distance and the breaches (overlaps with the tool) of a structure."""

    name: str
    least_m: float = inf
    least_at_s: float = 0.0
    least_tip_m: tuple[float, ...] = ()
    deepest_m: float = 0.0
    began_s: float | None = None
    deepest_now_m: float = 0.0
    lasted_s: float = 0.0
    first_s: float | None = None
    first_below_s: float | None = None
    below_since_s: float | None = None
    below_s: float = 0.0


class KeepClear:
    """Distance of a tool's whole body from each of several structures.

    The body is the simulated cutter, including peg, flank and back; the shaft behind the cutter is
    not included. At each point of space the signed distances from the tool and from the structure
    are added. The distance of the tool from the structure is the smallest of these sums. If tool
    and structure are apart, the distance is the clearance. If tool and structure overlap, the
    distance is negative, and its magnitude is the depth of the overlap.

    Parameters
    ----------
    profile
        The tool's half section.
    structures
        Dictionary that maps the name of each structure to its surface.
    distances
        Dictionary that maps the name of a structure to a function. The function returns the signed
        distance of points from the structure, and is used only for pictures.
    box_m
        Lowest and highest corner of the box that the tool can reach [m], shape (2, 3); None if the
        box is not known.
    times_s
        Times at which distances are measured [s]; None to measure in every tick.
    margin_m
        Distance below which an event is reported [m]; 0 to report only breaches.

    Attributes
    ----------
    structures, distances
        Values of the parameters.
    names
        Names of the trace columns: ``distance_NAME_mm`` for the structure with the name NAME.
    measures
        Distances in the last tick [mm], shape (structures,), negative in an overlap. A value is
        never larger than the true distance. The error is at most the slack of the structure plus
        0.001 mm if tool and structure are apart, and at most the slack plus 0.01 mm if they
        overlap (0.1 mm in a coarse search, see `DEEP_OVERLAP_ERROR_M`). The error is larger if tens
        of thousands of triangles have the same distance.
    notices
        Events, one sentence each. The simulation loop logs an event and then removes it.
    """

    def __init__(
        self,
        profile: Profile,
        structures: Mapping[str, Structure],
        distances: Mapping[str, Distance] | None = None,
        *,
        box_m: Array | None = None,
        times_s: Array | None = None,
        margin_m: float = 0.0,
    ) -> None:
        self._times_s = times_s
        self._margin_m = margin_m
        self.structures = dict(structures)
        self.distances = dict(distances or {})
        self.names = tuple(f"distance_{name}_mm" for name in structures)
        self.measures = np.zeros(len(structures))
        self.notices = list[str]()
        self._breaches = [_Breach(name) for name in structures]
        self._tick = 0
        self._follows = True
        outline = filled(Outline, DEVICE, **outline_table(profile))
        fine = _medial(profile, *FINE_M)
        coarse = fine
        if any(len(each.faces) > MANY_TRIANGLES for each in structures.values()):
            coarse = _medial(profile, *COARSE_M)
        self._searches = list[_Search]()
        for each in structures.values():
            deep = coarse if len(each.faces) > MANY_TRIANGLES else fine
            self._searches.append(_Search(outline, [fine, deep], each, box_m))

    def measure(self, tool: ToolMotion, *, placed: bool = False) -> None:
        """Measure the distances from all structures at a pose of the tool.

        Set `placed` to True for the pose before the first tick. This pose counts neither as a tick
        nor as a breach.
        """
        for number, search in enumerate(self._searches):
            distance_m = search(tool)
            self.measures[number] = 1e3 * distance_m
            if self._follows and not placed:
                self._follow(self._breaches[number], distance_m, tool)
        self._tick += 0 if placed else 1

    def overlaps(self) -> list[str]:
        """Return one text for each structure that the tool overlapped in the last tick.

        The text contains the depth of the overlap.
        """
        return [
            f"{-distance_mm:.2f} mm inside {breach.name}"
            for breach, distance_mm in zip(self._breaches, self.measures, strict=True)
            if distance_mm < 0.0
        ]

    def state(self) -> State:
        """Return a copy of the state on which later ticks depend."""
        return copied(self, ("measures", "_breaches", "_tick"))

    def restore(self, state: State) -> None:
        """Restore a state that `state` has returned."""
        put_back(self, state)

    @property
    def _now_s(self) -> float:
        """Time of the present tick, or of the last tick at which the tool was measured [s]."""
        if self._times_s is None:
            return self._tick * TICK_S
        return float(self._times_s[min(self._tick, len(self._times_s) - 1)])

    def _follow(self, breach: _Breach, distance_m: float, tool: ToolMotion) -> None:
        """Update the record of a structure, and report the start and the end of an overlap."""
        if distance_m < breach.least_m:
            breach.least_m = distance_m
            breach.least_at_s = self._now_s
            breach.least_tip_m = tuple(tool.tip_m.tolist())
        is_too_close = self._margin_m > 0.0 and distance_m < self._margin_m
        if is_too_close and breach.first_below_s is None:
            breach.first_below_s = self._now_s
            self.notices.append(f"came closer than {1e3 * self._margin_m:g} mm to {breach.name}")
        if not is_too_close:
            self._end_below(breach)
        elif breach.below_since_s is None:
            breach.below_since_s = self._now_s
        if distance_m < 0.0:
            if breach.began_s is None:
                breach.began_s = self._now_s
                breach.deepest_now_m = 0.0
                breach.first_s = self._now_s if breach.first_s is None else breach.first_s
                self.notices.append(f"breached {breach.name}, which is to be kept clear of")
            breach.deepest_now_m = max(breach.deepest_now_m, -distance_m)
            breach.deepest_m = max(breach.deepest_m, -distance_m)
        elif breach.began_s is not None:
            self._leave(breach, "left")

    def _end_below(self, breach: _Breach) -> None:
        """Add a time span below the margin that ends now to the record of a structure."""
        if breach.below_since_s is not None:
            breach.below_s += self._now_s - breach.below_since_s
            breach.below_since_s = None

    def _leave(self, breach: _Breach, how: str) -> None:
        """Record the end of a breach."""
        assert breach.began_s is not None
        lasted_s = self._now_s - breach.began_s
        breach.lasted_s += lasted_s
        self.notices.append(
            f"{how} {breach.name}: {1e3 * breach.deepest_now_m:.3f} mm deep, {lasted_s:.3g} s long"
        )
        breach.began_s = None

    def stop_reporting(self) -> None:
        """End all breaches, and stop recording breaches and smallest distances."""
        self.finish()
        self._follows = False

    def finish(self) -> None:
        """Record the end of breaches and of times below the margin at the end of the run."""
        for breach in self._breaches:
            self._end_below(breach)
            if breach.began_s is not None:
                self._leave(breach, "still in")

    def summary(self) -> dict[str, dict[str, Any]]:
        """Return a dictionary with the smallest distance and the breaches of each structure.

        The keys are the names of the structures. The values of a structure are the smallest
        distance [mm], the first time of this distance [s], the position of the tool's tip at this
        time [mm], the largest depth [mm] and total duration [s] of the breaches, and the time of
        the first breach [s]. If a margin is set, the values include the margin [mm], the first time
        at which the distance was below the margin [s], and the total time below the margin [s].
        """
        found = dict[str, dict[str, Any]]()
        for breach in self._breaches:
            if breach.least_m == inf:
                continue
            found[breach.name] = {
                "least_distance_mm": 1e3 * breach.least_m,
                "least_distance_at_s": breach.least_at_s,
                "least_distance_tip_mm": [1e3 * each for each in breach.least_tip_m],
                "breach_depth_mm": 1e3 * breach.deepest_m,
                "breach_s": breach.lasted_s,
                "first_breach_s": breach.first_s,
            }
            if self._margin_m > 0.0:
                found[breach.name] |= {
                    "margin_mm": 1e3 * self._margin_m,
                    "first_below_margin_s": breach.first_below_s,
                    "below_margin_s": breach.below_s,
                }
        return found


class _Search:
    """Search for the distance between a tool and one structure, with its device arrays."""

    def __init__(
        self, outline: Any, axes: list[Any], structure: Structure, box_m: Array | None
    ) -> None:
        # Coordinates are taken along the structure's principal axes, because boxes around its
        # triangles are small there. Their origin is in the middle of the structure, because the
        # sign is computed in single precision.
        vertices = structure.vertices_m
        self._origin = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        self._turn = np.linalg.eigh(np.cov((vertices - self._origin).T))[1]
        # Eigenvectors may form a reflection, which would turn the triangles inside out.
        self._turn[:, 0] *= np.sign(np.linalg.det(self._turn))
        corners = cut_long(vertices[structure.faces], box_m)
        boxes = box_tree((corners - self._origin) @ self._turn)
        tree = filled(
            Tree,
            DEVICE,
            centre=boxes.centres_m,
            half=boxes.halves_m,
            corners=boxes.corners_m,
            first_leaf=boxes.first_leaf,
        )
        vertices = (vertices - self._origin) @ self._turn
        self._slack_m = structure.slack_m
        self._motion = Mirror(4, wp.vec3d, DEVICE)
        self._distance = Mirror(1, wp.float64, DEVICE)
        self._mesh = wp.Mesh(
            points=put(vertices, wp.vec3, DEVICE),
            indices=put(structure.faces.ravel(), wp.int32, DEVICE),
            support_winding_number=True,
        )
        self._launch = SplitLaunch(
            distance_to_structure,
            1,
            [
                outline,
                tree,
                self._mesh.id,
                self._motion.device,
                *axes,
                np.array([boxes.first_leaf]),
                wp.zeros(NODES, wp.int32, DEVICE),
                wp.zeros(NODES, wp.float64, DEVICE),
                wp.zeros((TRIANGLES, 3), wp.vec3d, DEVICE),
                wp.zeros(TRIANGLES, wp.float64, DEVICE),
                wp.zeros(1, wp.int32, DEVICE),
                wp.zeros(CELLS, AxisCell, DEVICE),
            ],
            [self._distance.device],
            device=DEVICE,
            # The search runs in one thread, so dim is 1.
            cores=1,
        )

    def __call__(self, tool: ToolMotion) -> float:
        """Compute the distance [m] at a tool's pose."""
        motion = self._motion.host
        np.dot(tool.tip_m - self._origin, self._turn, out=motion[0])
        np.dot(tool.rotation.T, self._turn, out=motion[1:4])
        self._launch()
        return float(self._distance.host[0]) - self._slack_m


def _medial(profile: Profile, slack_m: float, tolerance_m: float) -> Any:
    """Return the tool's medial axis and the accuracy of the search in the format of the kernel."""
    # See `STRAIGHT_M` for the ratio of the two errors.
    axis = medial_axis(profile, straight_m=0.25 * slack_m)
    return filled(
        MedialAxis,
        DEVICE,
        starts=axis.starts_m,
        ends=axis.ends_m,
        across=axis.across,
        slack=slack_m,
        tolerance=tolerance_m,
    )
