"""Scripted policies for the environments, as baselines for learned policies.

The policies use only observations. `expert_of(env)` returns the expert of an environment.
"""

from typing import Any

import numpy as np

from meshes.base.arrays import Array
from tissue.environments.drilling import Drilling
from tissue.environments.milling import Milling
from tissue.environments.palpation import Palpation

__all__ = ["DrillingExpert", "MillingExpert", "PalpationExpert", "expert_of"]

TRACK_MM = 0.7
"""Distance of two tracks [mm]. The scallops between tracks are 0.03 mm high, within the margin."""
LAYER_MM = 0.27
"""Depth of a layer [mm]. The pocket of 0.8 mm has three layers."""
ABOVE_MM = 0.3
"""Height of the first corner above the bone [mm]: the lowest start of the tip."""
REACHED_MM = 0.03
"""Distance at which a corner counts as reached [mm]: the height of the scallops."""
SOFTER = 0.5
"""Share of the enamel's resistance below which the bur counts as beyond the enamel.

The force in sound dentin is an eighth of the force in enamel
(`examples/03_drill_through_the_layers.py`).
"""


class MillingExpert:
    """Policy that mills the pocket in tracks, layer by layer, slower near the force limit."""

    def __init__(self, env: Milling) -> None:
        self._env = env
        length, width, depth = env.pocket_mm
        rows = np.linspace(-0.5 * width, 0.5 * width, int(np.ceil(width / TRACK_MM)) + 1)
        self._corners = [np.array([-0.5 * length, rows[0], ABOVE_MM])]
        side = -0.5 * length
        for z in np.linspace(0.0, -depth, int(np.ceil(depth / LAYER_MM)) + 1)[1:]:
            # back and forth; each layer starts at the end of the previous layer
            for y in rows:
                self._corners += [np.array([side, y, z]), np.array([-side, y, z])]
                side = -side
            rows = rows[::-1]
        self._speed = env.top_speed_mm_s

    def __call__(self, observation: Any) -> Array:
        """Return the next action."""
        env = self._env
        seen = self._env.named(observation)
        share = float(np.linalg.norm(seen["force"])) / env.force_limit_N
        # The force increases with the speed. Aim at 0.9 of the force limit. The speed changes by a
        # limited factor in a step, and is at least a fifth of the top speed.
        self._speed = float(
            np.clip(self._speed * np.clip(0.9 / max(share, 0.1), 0.6, 1.5), 2.0, env.top_speed_mm_s)
        )
        while (
            len(self._corners) > 1 and np.linalg.norm(self._corners[0] - seen["tip"]) < REACHED_MM
        ):
            self._corners.pop(0)
        away = self._corners[0] - seen["tip"]
        step_mm = 1e-3 * env.ticks * self._speed
        return away / max(float(np.linalg.norm(away)), step_mm) * (self._speed / env.top_speed_mm_s)


class DrillingExpert:
    """Policy that drills through enamel at the force limit, then 0.5 mm further, and withdraws.

    The policy reduces the thrust after the resistance has fallen to one half.
    """

    def __init__(self, env: Drilling) -> None:
        self._env = env
        self._hardest = 0.0
        self._stop_mm = np.inf
        self._out = False

    def __call__(self, observation: Any) -> Array:
        """Return the next action."""
        env = self._env
        seen = self._env.named(observation)
        depth = float(seen["depth"][0])
        velocity = float(seen["velocity"][0])
        force = float(seen["force"][2])
        # force above the limit reduces the reward
        limit = 0.95 * env.force_limit_N / env.thrust_N
        # within 0.01 mm the depth counts as reached
        if self._out or depth >= self._stop_mm - 0.01:
            self._out = True
            return np.array([-1.0])
        # Dentin resists less, so the thrust is reduced, and reduced again in the last 0.15 mm.
        # Scores change by less than 0.01 if the first factor is 0.2 to 0.5, and the second 0.06 to
        # 0.25.
        if self._stop_mm < np.inf:
            return np.array([0.35 * limit if depth < self._stop_mm - 0.15 else 0.12 * limit])
        # at first the bur's tip is not yet covered; below 0.05 mm/s the ratio is mostly noise
        if depth > 0.3 and velocity > 0.05:
            self._hardest = max(self._hardest, force / velocity)
            if force / velocity < SOFTER * self._hardest:
                # the resistance halves about 0.08 mm below the junction; the goal is 0.5 mm below
                self._stop_mm = depth + 0.42
        # a small thrust in air, so that the bur does not hit the tooth at full speed
        return np.array([limit if depth > 0.0 else 0.3 * limit])


class PalpationExpert:
    """Policy that slides in a circle, then along two lines through the stiffest point, and lifts.

    The first line is radial, and the second line crosses it. The policy lifts the tip where the
    tissue is stiffest.
    """

    def __init__(self, env: Palpation) -> None:
        self._env = env
        self._felt: list[Array] = []
        self._plan: list[Array] = [np.array([0.0, 0.0])]
        self._stage = 0
        # wanted height of the tip: 2 mm deep, unless the force becomes too large
        self._height_mm = -2.0

    def __call__(self, observation: Any) -> Array:
        """Return the next action."""
        seen = self._env.named(observation)
        tip = seen["tip"]
        force = float(np.linalg.norm(seen["force"]))
        if self._stage > 0:
            # resistance of Hertz contact; at depths below 0.3 mm, force and depth are too small
            self._felt.append(np.array([tip[0], tip[1], force / max(-tip[2], 0.3) ** 1.5]))
        # force above the limit reduces the reward: reduce the depth, but keep contact
        if force > 0.9 * self._env.force_limit_N:
            # reduce the depth by 0.15 mm in each step, to not less than 0.5 mm [mm]
            self._height_mm = min(self._height_mm + 0.15, -0.5)
        # within 0.4 mm a place counts as reached, if the tip is also deep enough at the first place
        while (
            self._plan
            and np.linalg.norm(self._plan[0] - tip[:2]) < 0.4
            and (self._stage > 0 or tip[2] < -1.5)
        ):
            self._plan.pop(0)
            if not self._plan:
                self._next_stage()
        if not self._plan:
            return np.array([0.0, 0.0, 1.0])
        away = self._plan[0] - tip[:2]
        step_s = 1e-3 * self._env.ticks
        # top speeds of the environment: 60 mm/s along the surface, 30 mm/s along z
        aside = away / max(float(np.linalg.norm(away)), 60.0 * step_s)
        rise = np.clip((self._height_mm - tip[2]) / (30.0 * step_s), -1.0, 1.0)
        return np.array([*aside, rise])

    def _next_stage(self) -> None:
        """Plan the next stage from the forces felt since the last stage."""
        self._stage += 1
        hardest = self._hardest_place() if self._stage > 1 else np.zeros(2)
        # The nodule lies 10 to 18 mm from the start: a circle of 14 mm, a line from 8 to 20 mm
        # through its hardest place, and 5 mm to both sides of the hardest place of the line.
        if self._stage == 1:
            angles = np.linspace(0.0, 2.0 * np.pi, 25)
            self._plan = [14.0 * np.array([np.cos(angle), np.sin(angle)]) for angle in angles]
        elif self._stage == 2:
            out = hardest / np.linalg.norm(hardest)
            self._plan = [14.0 * out, 8.0 * out, 20.0 * out]
        elif self._stage == 3:
            aside = 5.0 * np.array([-hardest[1], hardest[0]]) / np.linalg.norm(hardest)
            self._plan = [hardest, hardest - aside, hardest + aside]
        elif self._stage == 4:
            self._plan = [hardest]
        # not emptied at the end, because `_hardest_place` needs at least one place
        self._felt = [] if self._stage < 4 else self._felt

    def _hardest_place(self) -> Array:
        """Return the mean of the touched points, weighted by their excess stiffness.

        The excess is relative to the third quartile of the stiffness.
        """
        felt = np.array(self._felt)
        # 1e-12 avoids a division by zero if all places are equal
        weight = np.clip(felt[:, 2] - np.quantile(felt[:, 2], 0.75), 0.0, None) ** 2 + 1e-12
        return np.asarray((weight[:, None] * felt[:, :2]).sum(axis=0) / weight.sum())


def expert_of(env: Any) -> MillingExpert | DrillingExpert | PalpationExpert:
    """Return a new expert for an episode of an environment, wrapped or not.

    Call the expert with each observation.
    """
    bare = env.unwrapped
    if isinstance(bare, Milling):
        return MillingExpert(bare)
    return DrillingExpert(bare) if isinstance(bare, Drilling) else PalpationExpert(bare)
