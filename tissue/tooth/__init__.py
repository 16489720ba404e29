"""Tooth: particle finite elements on a grid that a drill cuts."""

from tissue.tooth.body import Change, ParticleBody
from tissue.tooth.compliance import SupportCompliance, support_compliance
from tissue.tooth.grid import HexGrid
from tissue.tooth.particles import ParticleSet
from tissue.tooth.solver import Outcome, Solution
from tissue.tooth.stress import Stress, cell_stress, node_average, particle_stress
from tissue.tooth.supports import Supports

__all__ = [
    "Change", "HexGrid", "Outcome", "ParticleBody", "ParticleSet", "Solution", "Stress", "SupportCompliance",
    "Supports", "cell_stress", "node_average", "particle_stress", "support_compliance",
]  # fmt: skip
