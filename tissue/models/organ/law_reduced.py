"""A hyperelastic organ at 1 kHz in a reduced basis: its law's internal forces in every tick, at a few points.

With the modes orthonormal in the stiffness at rest, H them at the touchable nodes, q their amounts, g(q) the internal
forces there and A a tangent of g, the surface moves under nodal forces f by::

    u(f) = W f + offset,  W = W_rest + H (A^-1 - 1) H^T,  offset = H (q - A^-1 g(q))

What the basis misses is thereby answered by the linear law, W_rest - H H^T. Each tick is one step of Newton's method
with a tangent kept for a while: the contact finds f on W, then q goes on by A^-1 (H^T f - g(q)).
"""

import numpy as np

from meshes.base.arrays import Array
from tissue.fem.sampled_body import SampledBody
from tissue.models.organ.contact import SurfaceContact
from tissue.models.organ.law_training import Trained, missed_share

__all__ = ["LawReduced"]

UNSETTLED = 0.02
"""Step that is left to the amounts under the forces of a tick, over their size, from which it did not converge."""
SMALL = 0.05
"""Share of the trained amounts below which amounts count as that much."""
HALVINGS = 6
BEYOND = 1.1
"""Amounts over the greatest trained, from which a press counts as deeper than trained."""
ELSEWHERE = 0.05
"""Share of the linear energy that the basis misses from which a press counts as elsewhere than trained: the linear law
answers it, which is a fifth off where tissue is pressed deep."""


class LawReduced:
    """How far the touchable nodes of an organ are from where a compliance has them.

    Parameters
    ----------
    body
        The law at a few points.
    surface
        Its modes at the touchable nodes, shape (3t, r).
    contact
        The contact at rest.
    training
        What the modes were made from.
    interval_s
        Time between two tangents [s].
    """

    def __init__(
        self, body: SampledBody, surface: Array, contact: SurfaceContact, training: Trained, *, interval_s: float
    ) -> None:
        self._body, self._surface, self._contact, self._training = body, surface, contact, training
        self.interval_s = interval_s
        self._at_rest = contact.result.compliance_m_N.copy()
        self._one = np.eye(body.size)
        self._amounts = np.zeros(body.size)
        self._inner = np.zeros(body.size)
        self._offset = np.zeros((len(surface) // 3, 3))
        self._take(np.asarray(np.linalg.inv(body.tangent(self._amounts)), dtype=np.float64))
        self._next_s = interval_s
        self._stale = self._deeper = self._elsewhere = self._reported = False
        self._ticks = self._unsettled_ticks = self._outside_ticks = 0
        self.notices: list[str] = []
        if training.missed > ELSEWHERE:
            self.notices.append(
                f"the basis of the reduced law misses {training.missed:.0%} of a press that it was trained on, which "
                f"the linear law answers: take more than organ.law_basis_size = {body.size}"
            )

    @property
    def note(self) -> str:
        """How it follows the law."""
        points, error = len(self._body.points), self._training.error
        return f"by {self._body.size} modes at {points} points, whose forces are {error:.1%} off, every tick, trained"

    @property
    def latest_m(self) -> Array:
        """The offset of the last tick [m], shape (t, 3)."""
        return self._offset

    def offset_m(self, _time_s: float, _depth_m: float) -> Array:
        """Go on by the forces of the last tick; the offset of the touchable nodes now [m], the same array each time."""
        force = self._contact.result.nodal_forces_N
        loaded = np.flatnonzero(force.any(axis=1))
        rows = (3 * loaded[:, None] + np.arange(3)).ravel()
        push = force[loaded].ravel() @ self._surface[rows]
        step = self._inverse @ (push - self._inner)
        for _ in range(HALVINGS):
            energy, inner = self._body.energy_and_force(self._amounts + step)
            if np.isfinite(energy):
                self._amounts += step
                self._inner = inner
                break
            step *= 0.5
        touching = len(loaded) > 0
        self._ticks += touching
        left = float(np.linalg.norm(self._inverse @ (push - self._inner)))
        size = max(float(np.linalg.norm(self._amounts)), SMALL * self._training.farthest)
        if left > UNSETTLED * size:
            self._stale = True
            self._unsettled_ticks += touching
        self._lie()
        self._deeper = bool(float(np.linalg.norm(self._amounts)) > BEYOND * self._training.farthest)
        self._outside_ticks += touching and (self._deeper or self._elsewhere)
        return self._offset

    def renew(self, time_s: float, _depth_m: float, contact: SurfaceContact) -> None:
        """Where an interval ends, or a tick did not converge, take the tangent of now."""
        if time_s < self._next_s - 1e-9 and not self._stale:
            return
        self._stale, self._next_s = False, time_s + self.interval_s
        force = contact.result.nodal_forces_N.ravel()
        if not force.any():
            return
        loaded = np.flatnonzero(force)
        linear_J = float(force[loaded] @ self._at_rest[np.ix_(loaded, loaded)] @ force[loaded])
        kept_J = float(np.sum((force[loaded] @ self._surface[loaded]) ** 2))
        missed = missed_share(linear_J, kept_J, self._training.farthest)
        self._elsewhere = missed > max(ELSEWHERE, 1.2 * self._training.missed)
        if (self._elsewhere or self._deeper) and not self._reported:
            self._reported = True
            self.notices.append(
                f"the organ is pressed {'deeper' if self._deeper else 'elsewhere'} than its reduced law was trained: "
                "forces from here may be wrong, lead the path there or set organ.law_method = offset"
            )
        values, vectors = np.linalg.eigh(self._body.tangent(self._amounts))
        if values[0] > 0.0:
            self._take((vectors / values) @ vectors.T)

    def _take(self, inverse: Array) -> None:
        """Go on with another inverse of the tangent; nothing moves by that."""
        self._inverse = inverse
        change = self._surface @ (inverse - self._one) @ self._surface.T
        self._contact.change_compliance(self._at_rest + 0.5 * (change + change.T))
        self._lie()

    def _lie(self) -> None:
        """The offset of the touchable nodes by the amounts and the tangent of now."""
        moved = self._amounts - self._inverse @ self._inner
        np.matmul(self._surface, moved, out=self._offset.reshape(-1))

    def finish(self) -> None:
        """Report how many ticks did not converge, and how many lay outside of what was trained."""
        for count, what in (
            (self._unsettled_ticks, "the reduced law did not converge"),
            (self._outside_ticks, "the organ was pressed otherwise than its reduced law was trained"),
        ):
            if count:
                self.notices.append(f"{what} in {count} of {self._ticks} ticks in contact")
