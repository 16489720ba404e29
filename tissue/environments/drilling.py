"""Environment for drilling through the enamel of a molar and stopping in the dentin."""

from functools import cached_property
from typing import Any

import numpy as np

from meshes.base.arrays import Array, Singles
from meshes.tooth.molar import molar
from meshes.voxels.volume import VoxelVolume
from meshes.voxels.voxelise import voxelise
from tissue.cutters import ball_burr
from tissue.environments.environment import BoneEnvironment, Entry
from tissue.models.tissue_model import TICK_S, Response, ToolMotion
from tissue.motion.thrust import SpeedSearch, implicit_speed

REGION_M = np.array([[-2.0e-3, -2.0e-3, -4.0e-3], [2.0e-3, 2.0e-3, 1.2e-3]])
"""Corners of the part of the crown that can be cut [m].

The whole bur lies in this part at every start position (up to 1 mm to each side) and at every
depth.
"""
SPACING_M = 5e-5
"""Edge of a voxel [m]: a twentieth of the diameter of the bur."""
BUR_MM = 1.0
FLUTES = 6
SPIN_RPM = 400_000.0
HAND_KG = 0.1
"""Mass that moves with the bur [kg]: handpiece and part of the hand.

A handpiece has 0.06 to 0.1 kg (manufacturers' data, quoted from memory).
"""
TOP_SPEED_M_S = 1e-2
"""Largest speed of the bur [m/s]: 0.01 mm per tick, a fifth of a voxel."""
START_M = 5e-4
CEILING_M = 8e-4
"""Distance between tip and tooth at the start [m].

The bur counts as withdrawn at the same distance.
"""
INTO_DENTIN_M = 5e-4
"""Target depth below the junction of enamel and dentin [m].

The base of a cavity lies 0.2 to 0.5 mm below the junction (quoted from memory).
"""
TOO_DEEP_M = 1e-3
"""Distance below the target depth at which an episode ends without success [m].

The pulp lies 3 mm below the junction of enamel and dentin.
"""


class Drilling(BoneEnvironment):
    """Drill through the enamel of a molar, stop 0.5 mm into the dentin, and withdraw.

    A round bur of 1 mm diameter at 400,000 revolutions per minute moves straight down. The
    resistance decreases where the enamel ends. The observation does not contain the depth of the
    enamel-dentin junction. In each episode, a position on the occlusal surface and the densities of
    enamel and dentin are random. The densities change the cutting forces.

    **Action**, 1 number in [-1, 1]: the hand's thrust along the bur, in units of 3 N, positive
    downwards. The motion of the bur follows from thrust, cutting force, damping and a mass of 0.1
    kg. In air, the damping limits the speed of the bur to 10 mm/s at 3 N.

    **Observation**, see `entries`: depth of the tip below the surface at the drawn position,
    largest depth so far, downward velocity, force and torque on the bur, removed volume, and
    remaining time.

    **Reward**, see `ContactEnvironment`, with the potential::

        P = min(deepest, d) / d - max(0, deepest - d) / 1 mm

    Here ``deepest`` is the largest depth so far. The target depth d is measured on the axis of the
    bur, from the surface to 0.5 mm below the junction. ``reward_terms`` contains the two parts of
    the potential as ``progress`` and ``overdepth``. The score is the sum of rewards in an episode.
    It is at most 1; without any action it is -0.1. An episode ends when the bur is back at 0.8 mm
    above the surface after cutting, or when it is 1 mm below the target depth. An episode is
    truncated after 5 s. Force above 2 N reduces the reward. Heat is not modelled.

    Parameters
    ----------
    options
        As for `BoneEnvironment`.
    """

    entries = (
        # The scales are the depth of `REGION_M`, the largest speed, and twice the force limit. In
        # an episode with full thrust, force, torque and volume reach 2.0 N, 1.2 N mm and 2.2 mm3.
        Entry("depth", 4.0, "mm"),
        Entry("deepest", 4.0, "mm"),
        Entry("velocity", 10.0, "mm/s"),
        Entry("force", 4.0, "N", 3),
        Entry("torque", 4.0, "N mm", 3),
        Entry("removed", 4.0, "mm3"),
        Entry("time_left", 1.0, "1"),
    )
    action_count = 1
    ranges = {  # noqa: RUF012
        # Positions around the middle of the fossa, and densities around those of cutting.toml.
        "x_mm": (-1.0, 1.0),
        "y_mm": (-1.0, 1.0),
        "enamel_density_kg_m3": (2700.0, 3000.0),
        "dentin_density_kg_m3": (2000.0, 2200.0),
    }
    # The scripted expert takes 1.8 s, with forces up to 1.4 N. With full thrust the force reaches
    # the limit. Dentists prepare teeth with 0.1 to 5 N (perception.toml).
    usual_duration_s = 5.0
    usual_force_limit_N = 2.0
    thrust_N = 3.0
    balances = True
    episode = ("_speed", "_deepest_m", "_before", "_thrust", "_top_m", "_searches", "_search")

    cutter = ball_burr(diameter_mm=BUR_MM, flutes=FLUTES, spin_rpm=SPIN_RPM)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.surface_m = self.wanted_m = self._speed = self._deepest_m = 0.0
        self._before = self._thrust = self._top_m = 0.0
        self._searches = False
        self._search = SpeedSearch()

    @cached_property
    def volume(self) -> VoxelVolume:
        """Voxels of the crown around its fossa."""
        return voxelise(molar(), spacing_m=SPACING_M, region_m=(REGION_M[0], REGION_M[1]))

    def _prepare(self) -> None:
        self.restore_bone(
            {name: self.drawn[f"{name}_density_kg_m3"] for name in ("enamel", "dentin")}
        )
        self._place_m = np.array([1e-3 * self.drawn["x_mm"], 1e-3 * self.drawn["y_mm"]])
        self.surface_m, junction_m = self._heights(self._place_m)
        self.wanted_m = self.surface_m - junction_m + INTO_DENTIN_M
        self._speed = self._deepest_m = 0.0

    def begin(self, motion: ToolMotion) -> None:
        """Place the tip above the position that was drawn at random."""
        motion.tip_m[:2] = self._place_m
        motion.tip_m[2] = self.surface_m + START_M
        motion.heading[0] = (0.0, 0.0, -1.0)
        motion.speed_m_s = 0.0
        motion.pressed = 0.0

    def _heights(self, place_m: Array) -> tuple[float, float]:
        """Return the heights of the surface and of the end of the enamel at a position [m].

        The heights are multiples of the voxel spacing.
        """
        volume = self.volume
        i, j = np.floor((place_m - volume.origin_m[:2]) / volume.spacing_m).astype(int)
        # at least half full (255 = full)
        held = volume.fraction[i, j] > 127
        enamel = held & (volume.layer[i, j] == volume.layer_names.index("enamel"))
        heights = volume.origin_m[2] + volume.spacing_m * np.array(
            [np.flatnonzero(held)[-1] + 1, enamel.argmax()]
        )
        return float(heights[0]), float(heights[1])

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Move the bur to a first estimate of its next pose.

        The estimate is computed with the force at the end of the last tick.
        """
        self._thrust = self.thrust_N * float(self._command[0])
        self._before = self._speed
        self._top_m = float(motion.tip_m[2])
        # The tooth resists only a bur that moves or is pushed down, because the cut is open above
        # the bur.
        down = self._before > 0.0 or self._thrust > 0.0
        self._speed = self._balanced(response, motion, down=down)
        self._searches = down and self._speed > 0.0
        if self._searches:
            self._search.begin(self._speed, highest=TOP_SPEED_M_S)
            motion.heading[0, 2] = -1.0
            motion.tip_m[2] = self._top_m - self._search.tried * step_s
            motion.tangent_m_s = self._search.tangent
            return
        motion.tip_m[2] = self._top_m - self._speed * step_s
        self._set_speed(response, motion)

    def correct(self, response: Response, motion: ToolMotion) -> bool:
        """Search downwards for the pose at which the tooth balances the thrust.

        The function returns True if it moved the bur and the force must be computed again.
        """
        if not self._searches:
            return False
        balanced = max(self._balanced(response, motion, down=True), 0.0)
        if not self._search.accepts(balanced):
            motion.tip_m[2] = self._top_m - self._search.tried * TICK_S
            motion.tangent_m_s = self._search.tangent
            return True
        self._speed = balanced
        self._set_speed(response, motion)
        return False

    def _set_speed(self, response: Response, motion: ToolMotion) -> None:
        """Set the cutting speed, and the share of the thrust that the tooth bears at rest."""
        edge = max(float(response.edge[2]), 0.0)
        motion.speed_m_s = abs(self._speed)
        rests = self._speed == 0.0 and self._thrust > 0.0 and edge > 0.0
        motion.pressed = min(self._thrust / edge, 1.0) if rests else 0.0
        motion.heading[0, 2] = 1.0 if self._speed < 0.0 else -1.0

    def _felt(self, response: Response) -> Array:
        """Return the loads of the cut tooth on a bur that moves down.

        The next tick starts with these loads.
        """
        motion = self.tool
        motion.heading[0, 2] = -1.0
        motion.speed_m_s = max(self._speed, 0.0)
        motion.tangent_m_s = None
        self.stepper.response = self.model.respond(motion)
        self._deepest_m = max(self._deepest_m, self.depth_m)
        return self.stepper.response.wrench

    def _balanced(self, response: Response, motion: ToolMotion, *, down: bool) -> float:
        """Return the speed that balances thrust, inertia, damping and force of the tooth [m/s]."""
        edge = max(float(response.edge[2]), 0.0)
        drag = max(float(response.resistance[2]), 0.0)
        before = self._before
        thrust = self._thrust
        speed = implicit_speed(
            before,
            thrust=thrust - (edge if down else 0.0),
            drag=self.thrust_N / TOP_SPEED_M_S + (drag if down else 0.0),
            mass=HAND_KG,
            step_s=TICK_S,
        )
        # The edge force resists motion and does not push the bur back.
        if down and before >= 0.0 and thrust >= 0.0:
            speed = max(speed, 0.0)
        # Withdrawal stops at the ceiling.
        highest = (self.surface_m + CEILING_M - float(motion.tip_m[2])) / TICK_S
        return min(max(speed, -TOP_SPEED_M_S, -highest), TOP_SPEED_M_S)

    @property
    def depth_m(self) -> float:
        """Depth of the tip below the surface [m]."""
        return self.surface_m - float(self.tool.tip_m[2])

    def _potential(self) -> dict[str, float]:
        too_deep = max(self._deepest_m - self.wanted_m, 0.0)
        return {
            "progress": min(self._deepest_m, self.wanted_m) / self.wanted_m,
            "overdepth": -too_deep / TOO_DEEP_M,
        }

    def _is_over(self) -> bool:
        # 1e-9 m allows for rounding of the height at which the ceiling stops the bur.
        withdrawn = self._deepest_m > 0.0 and self.depth_m <= -CEILING_M + 1e-9
        return withdrawn or self._deepest_m - self.wanted_m >= TOO_DEEP_M

    def _observe(self) -> Singles:
        removed = 1e9 * float(self.model.removed_m3.sum())
        depths = 1e3 * self.depth_m, 1e3 * self._deepest_m
        return self._scaled(*depths, 1e3 * self._speed, *self._loads_shown, removed, self.time_left)

    def _facts(self) -> dict[str, Any]:
        volumes_mm3 = (1e9 * self.model.removed_m3).tolist()
        removed = dict(zip(self.model.layer_names, volumes_mm3, strict=True))
        return {
            "depth_mm": 1e3 * self.depth_m,
            "deepest_mm": 1e3 * self._deepest_m,
            "wanted_mm": 1e3 * self.wanted_m,
            "removed_mm3": {name: removed[name] for name in ("enamel", "dentin")},
        }
