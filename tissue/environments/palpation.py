"""Environment for finding a stiff nodule in a slab of soft tissue by palpation."""

from functools import cached_property
from typing import Any

import numpy as np

from meshes.base.arrays import Array, Singles
from meshes.organs.liver import Nodule, slab, slab_base
from tissue.environments.environment import ContactEnvironment, Entry
from tissue.models.organ.model import ContactSolution, OrganModel
from tissue.models.organ.probe import SphereProbe
from tissue.models.organ.soft_organ import ToolPath
from tissue.models.tissue_model import Response, ToolMotion
from tissue.simulation.builders.organ_given import SoftMaterial

SIZE_M = (0.1, 0.1, 0.028)
"""Size of the slab [m].

The nodule is in the middle of the slab. The fingertip stays within 40 mm of the nodule. The ball of
the fingertip therefore stays at least 2 mm inside the edge of the slab.
"""
EDGE_M = 4e-3
"""Edge length of the tetrahedra [m]: half the radius of the ball and of the nodule."""
NODULE_RADIUS_M = 8e-3
NODULE_DEPTH_M = 13e-3
"""Depth of the nodule's centre [m]. The top of the nodule lies 5 mm below the surface."""
MODULUS_KPA = 5.0
NODULE_TIMES = 20.0
"""Ratio of the nodule's Young's modulus to the modulus of the tissue.

The tissue is solved with the modulus `MODULUS_KPA`. The forces are then scaled to the modulus of
the episode.
"""
POISSON_RATIO = 0.45
"""Poisson's ratio of the simulated tissue.

Soft tissue has a ratio of 0.49, at which linear tetrahedra would lock.
"""
BALL_RADIUS_M = 8e-3
REACH_M = 22e-3
"""Largest lateral distance of the fingertip from its start [m]."""
LOWEST_M = -3e-3
START_M = 1e-3
CEILING_M = 3e-3
"""Height of the tip above the surface at which the tip counts as lifted [m].

`START_M` is the height at the start. `LOWEST_M` is the lowest height, which is below the surface.
At the lowest height, the force of the linear elastic tissue differs by less than 5 % from the force
of a hyperelastic tissue.
"""
NEAR_M = 10e-3
"""Smallest distance between tip and nodule at the start [m].

The potential increases only at smaller distances.
"""
TOP_SPEED_M_S = np.array([60e-3, 60e-3, 30e-3])
"""Largest speed along x, y and z [m/s]: 1.2 mm (x, y) and 0.6 mm (z) in a step of 20 ticks."""


class Palpation(ContactEnvironment):
    """Find a stiff nodule in soft tissue: press, slide, and lift the finger above the nodule.

    A fingertip, modelled as a ball of 16 mm diameter, moves over a slab of linear elastic tissue
    with a friction coefficient of 0.1. A nodule of 16 mm diameter, 20 times as stiff as the tissue,
    lies 5 mm below the surface. Its lateral distance from the start position of the tip is 10 to 18
    mm. Each episode draws the modulus of the tissue, the distance and direction of the nodule, and
    the rotation of the slab. All forces are proportional to the modulus. The origin of the
    coordinate frame is on the surface, at the lateral start position of the tip.

    **Action**, 3 numbers in [-1, 1]: velocity of the tip, in units of 60 mm/s along x and y, and 30
    mm/s along z. The tip stays within a lateral distance of 22 mm from the start, and between 3 mm
    above and 3 mm below the surface.

    **Observation**, see `entries`: position and velocity of the tip, force and torque on the
    tip, and remaining time.

    **Reward**, see `ContactEnvironment`, with the potential::

        P = max(0, 1 - d / 10 mm)

    Here d is the lateral distance between tip and nodule. The potential is 0 at the start. It is
    the value ``progress`` in ``reward_terms``. The score is the sum of rewards in an episode. It is
    at most 1; without any action it is -0.1. An episode ends when the tip, after touching the
    tissue, is back at 3 mm above the surface. An episode is truncated after 6 s. The position of
    the tip at the end is the estimate of the nodule's position. Force above 0.4 N reduces the
    reward.

    Parameters
    ----------
    options
        As for `ContactEnvironment`.
    """

    entries = (
        # The scales are the reach, the largest speed, and 1 N with 8 N mm. The force at the lowest
        # point above the nodule is 0.5 N at 8 kPa. The torque of 1 N at the ball's radius of 8 mm
        # is 8 N mm.
        Entry("tip", 22.0, "mm", 3),
        Entry("velocity", 60.0, "mm/s", 3),
        Entry("force", 1.0, "N", 3),
        Entry("torque", 8.0, "N mm", 3),
        Entry("time_left", 1.0, "1"),
    )
    action_count = 3
    ranges = {  # noqa: RUF012
        # The slab is also rotated with its nodule, because the mesh is not symmetric.
        "modulus_kPa": (3.0, 8.0),
        "distance_mm": (10.0, 18.0),
        "bearing_deg": (0.0, 360.0),
        "turn_deg": (0.0, 360.0),
    }
    # The scripted expert takes 2.9 s. The force at the lowest point above the nodule is 0.2 N at 3
    # kPa and 0.53 N at 8 kPa. A policy must therefore press stiff tissue less deep than soft
    # tissue.
    usual_duration_s = 6.0
    usual_force_limit_N = 0.4
    # Of its past, the linear organ keeps only friction, so a path of 5 ms is solved in one step.
    # The error of the mean force of a step is then 0.2 % for the expert and 0.4 % for random
    # actions. It is the RMS over four episodes, against a solution in every tick
    # (tests/bench/bench_session.py --part solves).
    solve_ticks = 5
    episode = ("tip_m", "nodule_m", "_turn", "_velocity_m_s", "_touched")

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.tip_m = np.zeros(3)
        self.nodule_m = np.zeros(2)
        self._turn = np.eye(3)
        self._velocity_m_s = np.zeros(3)
        self._touched = False

    @cached_property
    def model(self) -> OrganModel:
        """Model of the slab under the fingertip; made at the first reset.

        The compliance of the slab is kept in a cache on disk.
        """
        mesh = slab(
            size_m=SIZE_M,
            spacing_m=EDGE_M,
            nodule=Nodule(NODULE_RADIUS_M, (0.0, 0.0, -NODULE_DEPTH_M)),
        )
        moduli: dict[str | int, float] = {"nodule": NODULE_TIMES * MODULUS_KPA}
        material = SoftMaterial(
            modulus_kPa=MODULUS_KPA,
            poisson_ratio=POISSON_RATIO,
            parts=moduli,
            friction=0.1,
            order=1,
        )
        farthest = 1e-3 * self.ranges["distance_mm"][1] + REACH_M
        side = np.arange(-farthest, farthest + EDGE_M, EDGE_M)
        tips = np.stack([each.ravel() for each in np.meshgrid(side, side, [LOWEST_M])], axis=1)
        tips = tips[np.linalg.norm(tips[:, :2], axis=1) < farthest + EDGE_M]
        turns = np.broadcast_to(np.eye(3), (len(tips), 3, 3))
        organ = material.organ(mesh, slab_base(mesh))
        path = ToolPath(SphereProbe(BALL_RADIUS_M), tips, turns)
        # One core is used, because environments run in parallel.
        return OrganModel(organ, path, ContactSolution("condensed", cores=1))

    def _prepare(self) -> None:
        bearing, turn = (np.deg2rad(self.drawn[name]) for name in ("bearing_deg", "turn_deg"))
        self.nodule_m[:] = (
            1e-3 * self.drawn["distance_mm"] * np.array([np.cos(bearing), np.sin(bearing)])
        )
        cosine = np.cos(turn)
        sine = np.sin(turn)
        self._turn[:2, :2] = [[cosine, -sine], [sine, cosine]]
        self.tip_m[:] = (0.0, 0.0, START_M)
        self._velocity_m_s[:] = 0.0
        self._touched = False

    def begin(self, motion: ToolMotion) -> None:
        """Place the tool at the tip position, converted to the frame of the slab.

        The nodule lies below the origin of this frame.
        """
        away = np.array([*(self.tip_m[:2] - self.nodule_m), self.tip_m[2]])
        np.dot(self._turn, away, out=motion.tip_m)

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Move the tip with the commanded velocity, but keep its position within the limits."""
        wanted = self.tip_m + TOP_SPEED_M_S * step_s * self._command
        aside = float(np.hypot(wanted[0], wanted[1]))
        if aside > REACH_M:
            wanted[:2] *= REACH_M / aside
        wanted[2] = min(max(wanted[2], LOWEST_M), CEILING_M)
        self._velocity_m_s = (wanted - self.tip_m) / step_s
        self.tip_m[:] = wanted
        self.begin(motion)

    def _felt(self, response: Response) -> Array:
        wrench = response.wrench.reshape(2, 3)
        wrench = (self.drawn["modulus_kPa"] / MODULUS_KPA) * (wrench @ self._turn).reshape(6)
        self._touched |= bool(wrench[2] > 0.0)
        return wrench

    @property
    def error_mm(self) -> float:
        """Lateral distance between the tip and the nodule [mm]."""
        return 1e3 * float(np.hypot(*(self.tip_m[:2] - self.nodule_m)))

    def _potential(self) -> dict[str, float]:
        return {"progress": max(0.0, 1.0 - 1e-3 * self.error_mm / NEAR_M)}

    def _is_over(self) -> bool:
        return self._touched and self.tip_m[2] >= CEILING_M

    def _observe(self) -> Singles:
        velocity = 1e3 * self._velocity_m_s
        return self._scaled(1e3 * self.tip_m, velocity, *self._loads_shown, self.time_left)

    def _facts(self) -> dict[str, Any]:
        return {
            "tip_mm": 1e3 * self.tip_m,
            "nodule_mm": 1e3 * self.nodule_m,
            "error_mm": self.error_mm,
        }
