"""What a reduced model of a hyperelastic organ is made from: presses along the tool's path and beside it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from meshes.base.arrays import Array, Ints
from meshes.base.cache import Arrays, cached_arrays
from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.fem.cubature import few_points
from tissue.fem.press_basis import press_basis
from tissue.fem.quasi_newton import QuasiNewton
from tissue.fem.sampled_body import SampledBody
from tissue.fem.solvers.held_body import HeldBody
from tissue.fem.space import Space
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.models.organ.contact import SurfaceContact
from tissue.models.organ.law_offset import LawOffset

__all__ = ["ReducedSettings", "Trained", "missed_share", "trained"]

STEP_M, MOST_STEPS = 4e-4, 60
"""Step of the tool between two solves [m], and most of them along the path: a long one has longer steps."""
BESIDE = 0.375
"""How far beside the path it presses too, over the tool's radius."""
CORNERS = ((0.0, 0.0), (1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))
APART = 2
"""Steps from one equilibrium that is kept to the next."""
MOST_KEPT, MOST_POINTS, MOST_ROWS = 100, 600, 4000
"""Equilibria, points, and rows of their work: more are summed with random signs, which keeps sizes (Charikar, Chen and
Farach-Colton 2004, Theor. Comput. Sci. 312:3)."""
LIGHT = 0.5
"""Size over the greatest trained below which a press is light: the linear law answers it."""
TOLERANCE, STEPS = 1e-3, 60
"""Of an equilibrium: greatest force that is not balanced, over the greatest; most steps."""


@dataclass(frozen=True, kw_only=True)
class ReducedSettings:
    """Size of a reduced model.

    Attributes
    ----------
    modes
        Vectors of the basis.
    error
        Error of the internal forces of its points, over their size, over all trained equilibria.
    """

    modes: int
    error: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Trained:
    """A reduced model and what it was trained on.

    Attributes
    ----------
    modes
        Of the solved mesh [m/sqrt(J)], orthonormal in its stiffness, shape (3n, r).
    points, volumes_m3
        Gauss points and the volume each stands for [m3], shapes (p,).
    error
        Error of the internal forces that these leave.
    missed
        Greatest share of the linear energy of a trained press that the basis misses.
    farthest
        Greatest size of the trained amounts [sqrt(J)].
    """

    modes: Array
    points: Ints
    volumes_m3: Array
    error: float
    missed: float
    farthest: float


def trained(
    space: Space,
    body: HeldBody,
    law: Hyperelastic,
    cell_factors: Array,
    transfer: csr_array,
    contact: SurfaceContact,
    follower: Callable[[], QuasiNewton],
    tips_m: Array,
    rotations: Array,
    settings: ReducedSettings,
    report: Progress,
) -> Trained:
    """The reduced model of a path, from the cache or made now.

    Parameters
    ----------
    space, body, law, cell_factors
        The solved mesh, its stiffness at rest and supports, and the law.
    transfer
        Shares of its nodes in those of the contact, shape (t, n).
    contact
        The contact at rest; it is left so.
    follower
        Makes what finds equilibria.
    tips_m, rotations
        Corners of the path, shapes (k, 3) and (k, 3, 3).
    settings
        Size of the model.
    report
        Called with what is being done.

    Raises
    ------
    InputError
        If no pose of the path touches the organ.
    """
    probe, at_rest = contact.probe, contact.result.compliance_m_N.copy()

    def press() -> Arrays:
        forces_N, moved_m = _pressed(contact, follower(), body, transfer, tips_m, rotations, report)
        contact.change_compliance(at_rest)
        contact.shift(np.zeros_like(contact.nodes_m))
        contact.forget()
        return {"forces": forces_N, "moved": moved_m}

    tool = [probe.kind, probe.size_m, *(getattr(probe, "points_m", np.zeros(0)).ravel().tolist())]
    key = [body.stiffness.data, body.stiffness.indices, body.fixed, cell_factors, law, at_rest, transfer.data,
           transfer.indices, contact.friction, tool, tips_m, rotations]  # fmt: skip
    presses = cached_arrays("law-presses", key, press)
    forces_N, moved_m = (np.asarray(presses[name], dtype=np.float64) for name in ("forces", "moved"))
    if not len(forces_N):
        raise InputError(
            "organ.law_method must be offset for a tool whose path does not touch the organ, got reduced: "
            "lead the path into it"
        )

    def make() -> Arrays:
        report("reducing the law", 0.7)
        spread, solver = csr_array(transfer.T), follower().at_rest
        loads_N = [spread @ each for each in forces_N]
        linear_m = np.stack([solver.solve(load).displacement_m.ravel() for load in loads_N], axis=1)
        modes = press_basis(body.stiffness, linear_m, moved_m, settings.modes)
        states = (modes.T @ (body.stiffness @ moved_m)).T
        points, volumes, error = _sampled(SampledBody(space, law, cell_factors, modes), states, settings.error)
        farthest, missed = float(np.linalg.norm(states, axis=1).max()), 0.0
        for load, linear in zip(loads_N, linear_m.T, strict=True):
            kept_J = float(np.sum((load.ravel() @ modes) ** 2))
            missed = max(missed, missed_share(float(load.ravel() @ linear), kept_J, farthest))
        return {"modes": modes, "points": points, "volumes": volumes, "limits": np.array([error, missed, farthest])}

    found = cached_arrays("reduced-law", [*key, settings], make)
    error, missed, farthest = np.asarray(found["limits"], dtype=np.float64).tolist()
    return Trained(
        modes=np.asarray(found["modes"], dtype=np.float64), points=np.asarray(found["points"], dtype=np.int64),
        volumes_m3=np.asarray(found["volumes"], dtype=np.float64), error=error, missed=missed, farthest=farthest,
    )  # fmt: skip


def missed_share(linear_J: float, kept_J: float, farthest: float) -> float:
    """Share of the linear energy of a press that a basis misses; that of a light press counts little.

    Parameters
    ----------
    linear_J, kept_J
        Twice the energy of the linear body under the press, and that in the basis [J].
    farthest
        Greatest size of the trained amounts [sqrt(J)].
    """
    return (linear_J - kept_J) / max(linear_J, (LIGHT * farthest) ** 2)


def _pressed(
    contact: SurfaceContact, follower: QuasiNewton, body: HeldBody, transfer: csr_array, tips_m: Array,
    rotations: Array, report: Progress,
) -> tuple[Array, Array]:  # fmt: skip
    """Forces on the touchable nodes [N], shape (s, t, 3), and displacements [m], shape (3n, s), of presses."""
    spread = csr_array(transfer.T)
    law = LawOffset(follower, body.fixed, transfer, interval_s=1.0)
    forces, moved, time_s = [], [], 0.0
    radius_m = contact.probe.size_m[0]
    poses = list(_steps(tips_m, rotations))
    apart = max(APART, -(-len(poses) * len(CORNERS) // MOST_KEPT))
    for number, corner in enumerate(CORNERS):
        contact.forget()
        for step, (tip, rotation) in enumerate(poses):
            report("pressing the organ to reduce its law", 0.5 * (number + step / len(poses)) / len(CORNERS))
            shift_m = BESIDE * radius_m * (rotation[:, :2] @ np.array(corner)) / max(np.hypot(*corner), 1.0)
            time_s += 1.0
            contact.shift(law.offset_m(time_s, 0.0))
            contact.solve(tip + shift_m, rotation)
            law.renew(time_s, 0.0, contact)
            if contact.result.contacts and (step % apart == 0 or step == len(poses) - 1):
                load = spread @ contact.result.nodal_forces_N
                found = follower.follow(load, tolerance=TOLERANCE, step_limit=STEPS)
                if found.residual <= TOLERANCE:
                    forces.append(contact.result.nodal_forces_N.copy())
                    moved.append(found.displacement_m.ravel().copy())
    if not forces:
        return np.zeros((0, *contact.nodes_m.shape)), np.zeros((body.fixed.size, 0))
    return np.array(forces), np.stack(moved, axis=1)


def _steps(tips_m: Array, rotations: Array) -> list[tuple[Array, Array]]:
    """Poses along a path, no farther apart than a step."""
    step_m = max(STEP_M, float(np.linalg.norm(np.diff(tips_m, axis=0), axis=1).sum()) / MOST_STEPS)
    poses = [(tips_m[0], rotations[0])]
    for tip, rotation in zip(tips_m[1:], rotations[1:], strict=True):
        start = poses[-1][0]
        length = float(np.linalg.norm(tip - start))
        count = int(np.ceil(length / step_m))
        poses += [(start + share * (tip - start), rotation) for share in np.arange(1, count + 1) / max(count, 1)]
    return poses


def _sampled(body: SampledBody, states: Array, error: float) -> tuple[Ints, Array, float]:
    """Few points that do the work of all in states, shape (s, r), and the error that they leave over all of these."""
    count, random = len(body.points), np.random.default_rng(0)
    work = np.zeros((min(states.size, MOST_ROWS), count))
    row, sign = np.arange(states.size), np.ones(states.size)
    if states.size > MOST_ROWS:
        row, sign = random.integers(MOST_ROWS, size=states.size), random.choice([-1.0, 1.0], states.size)
    for place, state in enumerate(states):
        _, stress = body.stress(state)
        each = np.einsum("pix,pi->xp", body.gradients.reshape(count, 9, -1), stress.reshape(count, 9))
        each /= np.linalg.norm(each.sum(axis=1))
        for mode, line in enumerate(each, start=place * body.size):
            work[row[mode]] += sign[mode] * line
    points, weights, _ = few_points(work, error, MOST_POINTS)
    left = 0.0
    for state in states:
        stress = body.stress(state)[1].reshape(count, 9)
        whole = stress.ravel() @ body.gradients
        few = (weights[:, None] * stress[points]).ravel() @ body.gradients.reshape(count, 9, -1)[points].reshape(
            9 * len(points), -1
        )
        left += float(np.sum((few - whole) ** 2) / np.sum(whole**2))
    return points, weights * body.volumes_m3[points], float(np.sqrt(left / len(states)))
