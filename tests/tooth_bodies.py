"""Bodies of particles for tests: blocks with particles at Gauss points, on a lattice, or at random."""

import numpy as np

from tissue.models.tooth.grid import CORNERS, HexGrid
from tissue.models.tooth.particles import ParticleSet
from tissue.models.tooth.supports import Supports

GAUSS = 0.5 + (CORNERS - 0.5) / np.sqrt(3.0)
"""The 2 x 2 x 2 Gauss points of a unit cell, shape (8, 3)."""


def lattice(per_edge):
    """Centres of per_edge^3 equal parts of a unit cell."""
    at = (np.arange(per_edge) + 0.5) / per_edge
    return np.stack(np.meshgrid(at, at, at, indexing="ij"), axis=-1).reshape(-1, 3)


def block(shape, edge_m, *, modulus_pa=1e9, poisson_ratio=0.3, places=GAUSS):
    """A block of full cells and its grid; ``modulus_pa`` may be a function of the particles' positions, and ``places``
    one set for all cells, shape (p, 3), or a set a cell, shape (c, p, 3)."""
    cells = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1).reshape(-1, 1, 3)
    position = ((cells + places) * edge_m).reshape(-1, 3)
    volume = edge_m**3 / np.shape(places)[-2]
    particles = ParticleSet.uniform(position, volume_m3=volume, modulus_pa=1.0, poisson_ratio=poisson_ratio)
    particles.modulus_pa[:] = modulus_pa(position) if callable(modulus_pa) else modulus_pa
    return particles, HexGrid.around(position, edge_m=edge_m, origin_m=np.zeros(3))


def at_bottom(grid):
    """Supports that hold the lowest layer of nodes."""
    return Supports.of(grid.node_count, held=grid.node_place[:, 2] == 0)


def on_boundary(grid):
    """Nodes on the outside of a block, shape (n,)."""
    return ((grid.node_place == 0) | (grid.node_place == grid.node_place.max(axis=0))).any(axis=1)


def slope(sizes, errors):
    """Order of convergence: the fitted slope of log error over log size."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])
