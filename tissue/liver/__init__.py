"""Linear-elastic tetrahedra: the liver and other soft organs."""

from tissue.liver.assembly import assemble
from tissue.liver.capsule import capsule_stiffness
from tissue.liver.condensed import surface_compliance
from tissue.liver.contact import SurfaceContact
from tissue.liver.fields import OrganFields
from tissue.liver.lazy_compliance import LazyCompliance
from tissue.liver.model import LiverModel
from tissue.liver.reduced import ReducedSolver
from tissue.liver.solver import HeldBody, Supports
from tissue.liver.space import Space

__all__ = [
    "HeldBody",
    "LazyCompliance",
    "LiverModel",
    "OrganFields",
    "ReducedSolver",
    "Space",
    "Supports",
    "SurfaceContact",
    "assemble",
    "capsule_stiffness",
    "surface_compliance",
]
