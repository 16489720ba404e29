"""Cost of a contact tick: `python tests/bench/bench_liver_contact.py [--quick]`.

A slab of 29,106 tetrahedra, 5 kPa, Poisson's ratio 0.45, 484 nodes on its top. A sphere is pressed
in and dragged with friction at 20 mm/s and 1 kHz: sweeps, microseconds a tick, and the error of its
force to a solve that sweeps until rounding, for several tolerances; then the same sweeps in NumPy,
on the same ticks, in the same run.
"""

import argparse
from time import perf_counter

import numpy as np
from harness import Cost, cost_of, machine, table
from scipy.sparse.linalg import splu

from meshes.tets.structured import box
from tissue.fem.assembly import assemble
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.models.organ.contact import ContactOutcome, SurfaceContact, contact_points
from tissue.models.organ.probe import SphereProbe

SIZE_M, CELLS = (0.1, 0.1, 0.04), (21, 21, 11)
FRICTION, FEED_M, PRESS_TICKS = 0.3, 2e-5, 200
SCENES = ((0.005, 0.002), (0.005, 0.004), (0.01, 0.002), (0.01, 0.006), (0.01, 0.010))
"""Radius and depth [m]."""


def slab() -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Touchable nodes, their triangles, their compliance, and the number of tetrahedra."""
    space = Space(box(SIZE_M, CELLS), 1)
    nodes = space.nodes_m - [0.5 * SIZE_M[0], 0.5 * SIZE_M[1], SIZE_M[2]]
    free = np.repeat(nodes[:, 2] > -SIZE_M[2] + 1e-9, 3)
    factor = splu(
        assemble(space, lame(5e3, 0.45)).tocsc()[free][:, free],
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    top = np.flatnonzero(nodes[:, 2] > -1e-9)
    number = np.full(len(nodes), -1)
    number[top] = np.arange(len(top))
    faces = number[space.mesh.surface]
    rows = (np.cumsum(free) - 1)[(3 * top[:, None] + np.arange(3)).ravel()]
    compliance = np.zeros((len(rows), len(rows)))
    for column, row in enumerate(rows):
        load = np.zeros(int(free.sum()))
        load[row] = 1.0
        compliance[column] = factor.solve(load)[rows]
    return (
        nodes[top].copy(),
        faces[(faces >= 0).all(axis=1)],
        0.5 * (compliance + compliance.T),
        space.cell_count,
    )


def tip(depth: float, tick: int) -> np.ndarray:
    """Down to the depth, then along a slanted line."""
    travel = max(0, tick - PRESS_TICKS) * FEED_M
    return np.array([travel, 0.4 * travel, -depth * min(1.0, tick / PRESS_TICKS)])


class NumpyContact:
    """Contact sweeps point by point in NumPy, in the space of the nearby points.

    The sweeps equal the tested contact's sweeps, but without the exact friction cone. The local
    force is projected onto the cone instead. The projection costs no more work, so the comparison
    favours NumPy.
    """

    def __init__(
        self, nodes: np.ndarray, faces: np.ndarray, compliance: np.ndarray, probe: SphereProbe
    ) -> None:
        face, self.weights, _ = contact_points(nodes, faces, probe.spacing_m)
        self.corners = faces[face]
        self.rest = np.einsum("pa,paj->pj", self.weights, nodes[self.corners])
        self.blocks = compliance.reshape(len(nodes), 3, len(nodes), 3)
        self.force = np.zeros_like(self.rest)
        self.radius = probe.radius_m

    def solve(self, at: np.ndarray, last: np.ndarray, sweeps: int) -> np.ndarray:
        """Return the force on the organ after the given number of sweeps."""
        centre = at + self.radius * np.array([0.0, 0.0, 1.0])
        close = np.linalg.norm(self.rest - centre, axis=1) < self.radius + 1e-3
        near = np.flatnonzero(close | self.force.any(axis=1))
        corners, weights = self.corners[near], self.weights[near]
        named, place = np.unique(corners, return_inverse=True)
        spread = np.zeros((len(near), len(named)))
        np.add.at(spread, (np.arange(len(near))[:, None], place.reshape(corners.shape)), weights)
        between = self.blocks[named][:, :, named]
        mutual = np.einsum("pa,aibj,qb->piqj", spread, between, spread, optimize=True)
        inverse = np.linalg.inv(mutual[np.arange(len(near)), :, np.arange(len(near)), :])
        force = self.force[near]
        moved = np.einsum("piqj,qj->pi", mutual, force)
        anchor = self.rest[near] + moved + at - last
        for _ in range(sweeps):
            for i in range(len(near)):
                arm = self.rest[near[i]] + moved[i] - centre
                length = np.sqrt(arm @ arm)
                gap = length - self.radius
                if gap >= 0.0 and not force[i].any():
                    continue
                normal = arm / length
                slip = self.rest[near[i]] + moved[i] - anchor[i]
                new = force[i] - inverse[i] @ (gap * normal + slip - (slip @ normal) * normal)
                press = new @ normal
                side = new - press * normal
                size = np.sqrt(side @ side)
                if press <= 0.0:
                    new = np.zeros(3)
                elif size > FRICTION * press:
                    new = press * normal + FRICTION * press / size * side
                moved += mutual[:, :, i] @ (new - force[i])
                force[i] = new
        self.force[:] = 0.0
        self.force[near] = force
        return force.sum(axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="fewer ticks")
    ticks = 400 if parser.parse_args().quick else 1200
    print(machine())
    start = perf_counter()
    nodes, faces, compliance, cells = slab()
    print(
        f"{cells} tetrahedra, {len(nodes)} touchable nodes, compliance in "
        f"{perf_counter() - start:.1f} s\n"
    )
    rows = []
    for radius, depth in SCENES:
        probe = SphereProbe(radius)
        exact = SurfaceContact(
            nodes, faces, compliance, probe, friction=FRICTION, tolerance=1e-10, sweeps=3000
        )
        exact.place(np.array([0.0, 0.0, 1e-3]), np.eye(3))
        right = np.array(
            [exact.solve(tip(depth, tick), np.eye(3)).force_N.copy() for tick in range(ticks)]
        )
        for tolerance in (1e-2, 1e-3, 1e-4):
            contact = SurfaceContact(
                nodes, faces, compliance, probe, friction=FRICTION, tolerance=tolerance
            )
            contact.place(np.array([0.0, 0.0, 1e-3]), np.eye(3))
            found, sweeps, missed = (
                np.zeros((ticks, 3)),
                np.zeros(ticks),
                np.zeros(ticks, dtype=bool),
            )

            def tick(
                index: int, contact=contact, depth=depth, found=found, sweeps=sweeps, missed=missed
            ) -> None:
                result = contact.solve(tip(depth, index), np.eye(3))
                found[index] = result.force_N
                sweeps[index] = result.iterations
                missed[index] = result.outcome is not ContactOutcome.CONVERGED

            cost = cost_of(tick, count=ticks)
            size = np.linalg.norm(right[PRESS_TICKS:], axis=1)
            error = np.linalg.norm(found - right, axis=1)[PRESS_TICKS:] / size
            rows.append(
                (
                    f"{radius * 1e3:g}",
                    f"{depth * 1e3:g}",
                    f"{tolerance:g}",
                    f"{contact.result.contacts}",
                    f"{np.median(sweeps):.0f}",
                    f"{np.percentile(sweeps, 99):.0f}",
                    f"{missed.sum()}",
                    f"{np.median(error):.1e}",
                    f"{error.max():.1e}",
                    f"{cost.median:.0f}",
                    f"{cost.p99:.0f}",
                    f"{cost.worst:.0f}",
                )
            )
    print(
        table(
            rows,
            (
                "R mm",
                "d mm",
                "tolerance",
                "points",
                "sweeps",
                "99 %",
                "ran out",
                "error",
                "worst",
                "us",
                "99 % us",
                "worst us",
            ),
        )
    )
    against_numpy(nodes, faces, compliance)


def against_numpy(nodes: np.ndarray, faces: np.ndarray, compliance: np.ndarray) -> None:
    """Compare the middle scene, 60 ticks of its drag, with NumPy at the same number of sweeps."""
    radius, depth = SCENES[2]
    probe = SphereProbe(radius)
    contact = SurfaceContact(nodes, faces, compliance, probe, friction=FRICTION)
    contact.place(np.array([0.0, 0.0, 1e-3]), np.eye(3))
    slow = NumpyContact(nodes, faces, compliance, probe)
    ours, theirs, off = [], [], []
    for tick in range(PRESS_TICKS, PRESS_TICKS + 60):
        start = perf_counter()
        result = contact.solve(tip(depth, tick), np.eye(3))
        ours.append(perf_counter() - start)
        start = perf_counter()
        force = slow.solve(tip(depth, tick), tip(depth, tick - 1), max(result.iterations, 1))
        theirs.append(perf_counter() - start)
        off.append(np.linalg.norm(force + result.force_N) / np.linalg.norm(force))
        assert result.outcome in (ContactOutcome.CONVERGED, ContactOutcome.NOT_CONVERGED)
    fast, numpy = Cost(ours[5:]), Cost(theirs[5:])
    print(
        f"\nNumPy, as many sweeps: {numpy.median:.0f} us a tick, "
        f"{numpy.median / fast.median:.0f} times ours "
        f"({fast.median:.0f} us); forces {np.median(off):.1e} apart"
    )


if __name__ == "__main__":
    main()
