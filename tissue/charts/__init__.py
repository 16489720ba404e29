"""What every setting of a scene costs and what it is worth, measured on this machine."""

from tissue.charts.fidelity import with_fidelity
from tissue.charts.frontier import Frontier, frontier_of, undominated
from tissue.charts.measure import Measured

__all__ = ["Frontier", "Measured", "frontier_of", "undominated", "with_fidelity"]
