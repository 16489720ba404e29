"""Contact between bone and the part of a tool's surface that does not cut."""

from math import pi
from typing import Any

import numpy as np

from kernels.cutting import AREA
from kernels.engagement import Coefficients
from kernels.mirror import Mirror, filled
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import Line
from tissue.models.bone.bricks import BrickStore
from tissue.models.bone.elements import CuttingForces, elements_of

SMOOTH_ELEMENTS = 500
"""Number of elements on the surface that does not cut; chosen.

With more elements, each one represents a smaller area, and a tick takes more time.
"""
BLOCKED = 0.25
"""Smooth area in bone that causes a warning, divided by the area of the smallest end; chosen.

An end is a flat end face that does not cut. The value is not zero, because a peg may touch the rim
of its pilot hole.
"""
SINK_M_S = 2e-3
"""Speed at which a smooth surface reaches its full pressure [m/s]; chosen.

A peg with a contact area of 10 mm2 sinks at 4 um/s under 10 N. With 5e-5 m/s, the force balance of
the tool needs up to 21 force evaluations per tick instead of 7. The numbers were measured once, in
the first 3 s of the scene `glenoid` with a simulated expert on a Touch device.
"""
HARDNESS_Pa = 5e8
"""Pressure under which a smooth surface sinks into bone of the reference density [Pa]; assumed.

The value has no source: it is of the order of the hardness of wet bone. The pressure on the smooth
surfaces of tools is far below this value.
"""
FRICTION = 0.3
"""Friction coefficient (Coulomb) of smooth metal on bone; the range is 0.2 to 0.6.

Source: Shirazi-Adl et al., 1993, quoted from memory, so the confidence is L (low).
"""


class SmoothSurface:
    """Part of a tool's surface that does not cut.

    For a tool on a prescribed path, only the part of this surface's area that lies in bone is
    computed. For a tool on a haptic device, the bone under this surface is modelled as rigid and
    perfectly plastic.

    Parameters
    ----------
    cutter, store
        Tool and bone.
    tool
        The tool's distance table on the device.
    pose, recent, motion
        Pose, most recent poses and velocities of the tool, see `CuttingForces`.
    strength
        Strength of each layer as a function of density, see `Coefficients`.

    Attributes
    ----------
    forces
        Forces of the bone on this surface.
    blocked_m2
        Limit of the surface area in bone [m2]. Above this limit, `is_blocked` is True.
    """

    def __init__(
        self,
        cutter: Cutter,
        store: BrickStore,
        tool: Any,
        pose: Mirror,
        recent: Mirror,
        motion: Mirror,
        strength: Any,
    ) -> None:
        pieces = [piece for piece in cutter.profile.pieces if not piece.cutting]
        total_m2 = sum(piece.area_m2 for piece in pieces)
        shell = cutter.shell(spacing_m=(total_m2 / SMOOTH_ELEMENTS) ** 0.5, cutting=False)
        ends = [
            piece for piece in pieces if isinstance(piece, Line) and piece.start[1] == piece.end[1]
        ]
        radii = [max(piece.start[0], piece.end[0]) for piece in ends]
        # The smallest end determines the limit: a peg is narrow compared with the top of its tool.
        self.blocked_m2 = BLOCKED * min([total_m2, *(pi * radius**2 for radius in radii)])
        device = str(pose.device.device)
        layers = len(store.grid.layer_names)
        elements = elements_of(shell, cutter, spacing_m=store.grid.spacing_m, device=device)
        # A pressure takes the place of a force per length of edge.
        elements.edge_length = elements.area
        pressure = [FRICTION * HARDNESS_Pa * (cutter.spin_rad_s != 0.0), HARDNESS_Pa, 0.0]
        rubbing = filled(
            Coefficients,
            device,
            chip=np.zeros((layers, 3)),
            edge=np.tile(pressure, (layers, 1)),
            strength=strength,
            size=np.tile([0.0, SINK_M_S, 1.0], (layers, 1)),
        )
        # The velocity takes the place of the chip thickness.
        self.forces = CuttingForces(
            store, tool, elements, rubbing, pose, recent, motion, chip_per_speed_s=1.0, cores=1
        )

    @property
    def is_blocked(self) -> bool:
        """True if more than `blocked_m2` of the surface lies in bone.

        A model that neglects the force on this surface is then not valid.
        """
        self.forces.find_bone()
        return float(self.forces.sums()[AREA : self.forces.slopes].sum()) > self.blocked_m2
