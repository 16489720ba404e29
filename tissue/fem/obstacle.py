"""A rigid sphere that a body may not enter, without friction, for static solves.

Augmented Lagrangian on the surface nodes (Simo and Laursen 1992, Comput. Struct. 42:97): with g how deep a node lies in
the sphere, k a penalty and p a multiplier [N], the energy is ``sum (max(0, p + k g)^2 - p^2) / 2 k``, and after each
equilibrium ``p <- max(0, p + k g)``. At the end g <= 0 where p = 0 and g = 0 where p > 0, whatever the penalty.
"""

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import require_positive

__all__ = ["RigidSphere"]


class RigidSphere:
    """Sphere against the nodes of a surface.

    Parameters
    ----------
    nodes
        Nodes that may touch it, shape (s,).
    penalty_N_m
        Penalty of each of them [N/m], shape (s,); ten times their own stiffness is a good one.
    radius_m
        Radius [m].
    centre_m
        Centre [m], shape (3,).
    tolerance
        Depth of a node, or gap of a pressed one, that is allowed at the end, over the radius.

    Raises
    ------
    InputError
        If the radius or the tolerance is not positive.
    """

    def __init__(
        self, nodes: Ints, penalty_N_m: Array, *, radius_m: float, centre_m: Array,
        tolerance: float = 1e-6,
    ) -> None:  # fmt: skip
        self.nodes = nodes
        self.radius_m = require_positive("radius_m", radius_m, "use 0.01")
        self._penalty = penalty_N_m
        self._tolerance_m = self.radius_m * require_positive("tolerance", tolerance, "use 1e-6")
        self._multiplier = np.zeros(len(nodes))
        self.move_to(centre_m)

    def move_to(self, centre_m: Array) -> None:
        """Put the centre here [m], shape (3,); multipliers stay, as a first guess."""
        self.centre_m = centre_m

    def energy_and_force(self, positions_m: Array) -> tuple[float, Array]:
        """Energy [J], and its derivative by the positions of ``nodes`` [N], shape (s, 3)."""
        pressed, outward, _ = self._pressed(positions_m)
        energy = 0.5 * np.sum((pressed**2 - self._multiplier**2) / self._penalty)
        return float(energy), -pressed[:, None] * outward

    def blocks(self, positions_m: Array) -> Array:
        """Second derivative of the energy for each of ``nodes`` [N/m], shape (s, 3, 3)."""
        pressed, outward, distance = self._pressed(positions_m)
        along = outward[:, :, None] * outward[:, None]
        stiff = np.where(pressed > 0.0, self._penalty, 0.0)
        return stiff[:, None, None] * along - (pressed / distance)[:, None, None] * (np.eye(3) - along)

    def force_N(self, positions_m: Array) -> Array:
        """Force of the body on the sphere [N], shape (3,)."""
        return self.energy_and_force(positions_m)[1].sum(axis=0)

    def settled(self, positions_m: Array) -> bool:
        """Whether the nodes lie as they must to the tolerance; if not, correct the multipliers."""
        pressed, _, distance = self._pressed(positions_m)
        violation = np.maximum(self.radius_m - distance, -self._multiplier / self._penalty)
        if np.abs(violation).max() <= self._tolerance_m:
            return True
        self._multiplier = pressed
        return False

    def _pressed(self, positions_m: Array) -> tuple[Array, Array, Array]:
        """Force on each node [N], direction away from the centre, distance from it [m]."""
        from_centre = positions_m[self.nodes] - self.centre_m
        distance = np.maximum(np.linalg.norm(from_centre, axis=1), 1e-3 * self.radius_m)
        pressed = np.maximum(0.0, self._multiplier + self._penalty * (self.radius_m - distance))
        return pressed, from_centre / distance[:, None], distance
