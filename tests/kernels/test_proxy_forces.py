"""Active set and its friction, against SciPy's non-negative least squares and Coulomb's laws."""

import numpy as np
import pytest
import warp as wp
from scipy.optimize import brentq, nnls

from kernels.proxy_contacts import Contacts
from kernels.proxy_forces import MEMBERS, holding_force, resolve, slipping_force

NOTHING = np.zeros((2, 3))
EXACT = 1e-9
"""Of lengths of a few mm: the set's matrix is stiffened by 1e-13 and its condition reaches 1e4."""


@wp.kernel
def solve_once(
    contacts: Contacts,
    count: int,
    compliance: wp.float64,
    friction: wp.float64,
    free: wp.array(dtype=wp.vec3d),
    last: wp.array(dtype=wp.vec3d),  # rubbing force and its arm of the tick before
    wrench_out: wp.array(dtype=wp.vec3d),  # rubbing force and its arm
    members_out: wp.array(dtype=wp.int32),  # size of the active set, and solves of it
):
    members, solves, tangential_force, arm = resolve(
        contacts,
        count,
        compliance,
        friction,
        wp.float64(1.0e-13),
        free[0],
        free[1],
        last[0],
        last[1],
        wp.float64(1.0e-13),
    )
    wrench_out[0] = tangential_force
    wrench_out[1] = arm
    members_out[0] = members
    members_out[1] = solves


def solved(
    arms,
    normals,
    gaps,
    free,
    *,
    compliance,
    friction=0.0,
    normal_force=None,
    last=NOTHING,
    solves=None,
):
    """Normal forces, friction force and its arm; the number of solves is added to `solves`."""
    count = len(gaps)
    clearance = Contacts()
    clearance.slots = 1
    clearance.normal_force = wp.array(
        np.zeros(count) if normal_force is None else normal_force, dtype=wp.float64, device="cpu"
    )
    clearance.slot = wp.array(np.arange(count), dtype=wp.int32, device="cpu")
    clearance.arm = wp.array(arms, dtype=wp.vec3d, device="cpu")
    clearance.normal = wp.array(normals, dtype=wp.vec3d, device="cpu")
    clearance.moment = wp.array(np.cross(arms, normals), dtype=wp.vec3d, device="cpu")
    clearance.gap = wp.array(gaps, dtype=wp.float64, device="cpu")
    clearance.chosen = wp.zeros(count, dtype=wp.int32, device="cpu")
    clearance.member = wp.zeros(MEMBERS, dtype=wp.int32, device="cpu")
    clearance.lower = wp.zeros((MEMBERS, MEMBERS), dtype=wp.float64, device="cpu")
    clearance.side = wp.zeros((MEMBERS, 3), dtype=wp.float64, device="cpu")
    out, members = (
        wp.zeros(2, dtype=wp.vec3d, device="cpu"),
        wp.zeros(2, dtype=wp.int32, device="cpu"),
    )
    start, before = (wp.array(each, dtype=wp.vec3d, device="cpu") for each in (free, last))
    inputs = [clearance, count, compliance, friction, start, before]
    wp.launch(solve_once, dim=1, inputs=inputs, outputs=[out, members], device="cpu")
    if solves is not None:
        solves.append(int(members.numpy()[1]))
    return clearance.normal_force.numpy(), *out.numpy()


def least_distance(arms, normals, gaps, free, *, compliance):
    """Return the motion nearest to the free one that keeps all planes.

    The method is distance programming by Lawson and Hanson (1974).
    """
    scale = np.sqrt(compliance)
    rows = np.hstack([normals, scale * np.cross(arms, normals)])
    start = np.concatenate([free[0], free[1] / scale if scale else np.zeros(3)])
    wanted = -gaps - rows @ start
    size = max(np.abs(wanted).max(), 1e-30)
    u, _ = nnls(
        np.vstack([rows.T, wanted / size]), np.concatenate([np.zeros(6), [1.0]]), maxiter=10_000
    )
    rest = np.vstack([rows.T, wanted / size]) @ u - np.concatenate([np.zeros(6), [1.0]])
    step = start - size * rest[:6] / rest[6]
    return step[:3], scale * step[3:]


def moved(
    arms, normals, normal_force, free, *, compliance, tangential_force=(0, 0, 0), arm=(0, 0, 0)
):
    force = normal_force @ normals + tangential_force
    moment = normal_force @ np.cross(arms, normals) + np.cross(arm, tangential_force)
    return free[0] + force, free[1] + compliance * moment


@pytest.mark.parametrize("lever", [None, 5e-3, 5e-2])
def test_frictionless_motion_is_the_nearest_one_allowed(lever):
    """Random planes with a common free region; three or six degrees of freedom."""
    random = np.random.default_rng(1)
    compliance = 0.0 if lever is None else lever**-2
    active = 0
    for _ in range(60):
        count = int(random.integers(1, 60))
        arms = random.normal(size=(count, 3)) * 3e-3
        normals = random.normal(loc=(0.0, 0.0, 2.5), size=(count, 3))
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        normals[normals[:, 2] < 0.1] = [0.0, 0.0, 1.0]
        gaps = random.uniform(0.0, 1e-3, count)
        free = np.array(
            [random.normal(size=3) * 3e-3, random.normal(size=3) * (0.1 if lever else 0.0)]
        )
        normal_force, _, _ = solved(arms, normals, gaps, free, compliance=compliance)
        shift, turn = moved(arms, normals, normal_force, free, compliance=compliance)
        expected = least_distance(arms, normals, gaps, free, compliance=compliance)
        assert shift == pytest.approx(expected[0], abs=EXACT)
        assert turn == pytest.approx(expected[1], abs=EXACT * (1.0 + np.sqrt(compliance)))
        assert (normal_force >= 0.0).all()
        active = max(active, int((normal_force > 0.0).sum()))
    assert active >= 3


@pytest.mark.parametrize("friction", [0.05, 0.3, 1.0])
def test_friction_holds_or_works_against_the_slip(friction):
    """Friction holds or works against the slip.

    It obeys Coulomb at the centre of pressure: inside the cone nothing slips, on it the force
    opposes the slip.
    """
    random = np.random.default_rng(3)
    stuck = slipped = 0
    for _ in range(60):
        count = int(random.integers(1, 12))
        arms = random.normal(size=(count, 3)) * 3e-3
        normals = np.tile([0.0, 0.0, 1.0], (count, 1))
        free = np.array(
            [random.normal(size=3) * [1e-3, 1e-3, 0.0] - [0, 0, 2e-3], random.normal(size=3) * 0.01]
        )
        normal_force, tangential_force, arm = solved(
            arms,
            normals,
            0.2e-3 + arms[:, 2] - arms[:, 2].min(),
            free,
            compliance=2500.0,
            friction=friction,
        )
        total = normal_force.sum()
        shift, turn = moved(
            arms,
            normals,
            normal_force,
            free,
            compliance=2500.0,
            tangential_force=tangential_force,
            arm=arm,
        )
        slip = (shift + np.cross(turn, arm))[:2]
        size = np.linalg.norm(tangential_force)
        assert tangential_force[2] == pytest.approx(0.0, abs=1e-15)
        assert size <= friction * total * (1.0 + 1e-6)
        if size < friction * total * (1.0 - 1e-6):
            assert slip == pytest.approx(np.zeros(2), abs=1e-9)
            stuck += 1
        elif total > 0.0:
            against = -tangential_force[:2] @ slip / (size * np.linalg.norm(slip))
            assert against == pytest.approx(1.0, abs=1e-4)
            slipped += 1
    assert slipped > 5 or stuck > 5


def slanted_planes(random):
    """A few planes of a groove, and a free motion into it."""
    count = int(random.integers(2, 5))
    arms = random.normal(size=(count, 3)) * 1e-3
    normals = random.normal(loc=(0.0, 0.0, 2.5), scale=(0.7, 0.7, 0.3), size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    free = np.array([random.normal(size=3) * 1e-3 - [0.0, 0.0, 3e-3], random.normal(size=3) * 0.05])
    return arms, normals, np.zeros(count), free


def after_ticks(given, *, friction, normal_force=None, last=NOTHING, ticks=20):
    """Normal forces, friction force and its arm after some ticks at one place."""
    for _ in range(ticks):
        normal_force, *last = solved(
            *given,
            compliance=GROOVE,
            friction=friction,
            normal_force=normal_force,
            last=np.array(last),
        )
    return normal_force, *last


GROOVE = 5e-3**-2


def slip_of(given, normal_force, tangential_force, arm):
    """Motion of the point where friction acts, across the planes' resultant, and that resultant."""
    arms, normals, _, free = given
    shift, turn = moved(
        arms,
        normals,
        normal_force,
        free,
        compliance=GROOVE,
        tangential_force=tangential_force,
        arm=arm,
    )
    along, slip = normal_force @ normals, shift + np.cross(turn, arm)
    return slip - (slip @ along) * along / (along @ along), along


@pytest.mark.parametrize("friction", [0.1, 0.4])
def test_friction_on_slanted_planes_answers_to_what_they_press_then(friction):
    """Friction on slanted planes is bounded by the normal forces that act with it.

    On a groove of random planes friction changes the force on each plane. All laws hold at once: no
    plane is entered, none pulls, and either its gap or its force is zero. Friction acts at the
    centre of pressure across the resultant, at most the coefficient times the sum of the normal
    forces, and holds that point or opposes its slip.
    """
    random = np.random.default_rng(7)
    stuck = slipped = 0
    for _ in range(16):
        given = arms, normals, _, free = slanted_planes(random)
        normal_force, tangential_force, arm = after_ticks(given, friction=friction)
        shift, turn = moved(
            arms,
            normals,
            normal_force,
            free,
            compliance=GROOVE,
            tangential_force=tangential_force,
            arm=arm,
        )
        gaps = normals @ shift + np.cross(arms, normals) @ turn
        slip, along = slip_of(given, normal_force, tangential_force, arm)
        total, size, slid = (
            normal_force.sum(),
            np.linalg.norm(tangential_force),
            np.linalg.norm(slip),
        )
        assert normal_force.min() >= 0.0 and total > 0.0
        assert gaps.min() >= -1e-12 and np.abs(gaps[normal_force > 0.0]).max() < 1e-12
        assert arm == pytest.approx(normal_force @ arms / total, abs=2e-6)
        assert abs(tangential_force @ along) <= 1e-4 * size * np.linalg.norm(along)
        assert size <= friction * total * (1.0 + 1e-6)
        if size < friction * total * (1.0 - 1e-6):
            assert slid < 1e-9
            stuck += 1
        else:
            assert -tangential_force @ slip == pytest.approx(size * slid, rel=1e-4)
            slipped += 1
    assert slipped > 5 and (stuck > 3 or friction < 0.2)


def test_solves_of_the_active_set_are_counted_over_all_rounds():
    """Solves of the active set are counted over all rounds.

    From wrong forces each plane that joins or leaves is a solve; friction solves again in every
    round.
    """
    given = slanted_planes(np.random.default_rng(7))
    counts = []
    for friction in (0.0, 0.4):
        solved(*given, compliance=GROOVE, friction=friction, solves=counts)
    assert 1 <= counts[0] < counts[1]


COUNT = 200


@wp.kernel
def evaluate(
    compliance: wp.array(dtype=wp.vec3d),  # w00, w01, w11
    slip: wp.array(dtype=wp.vec2d),
    bound: wp.array(dtype=wp.float64),
    force_out: wp.array2d(dtype=wp.vec2d),
):
    i = wp.tid()
    w = compliance[i]
    v = slip[i]
    f0, f1 = holding_force(w[0], w[1], w[2], v[0], v[1], wp.float64(0.0))
    force_out[i, 0] = wp.vec2d(f0, f1)
    f0, f1 = slipping_force(w[0], w[1], w[2], v[0], v[1], bound[i])
    force_out[i, 1] = wp.vec2d(f0, f1)


def test_holding_and_slipping_forces():
    """Holding and slipping forces solve their equations.

    W f = -v where the bound allows it; else (W + s I) f = -v with the s >= 0 for which |f| is the
    bound.
    """
    random = np.random.default_rng(0)
    half = random.normal(size=(COUNT, 2, 2))
    compliance = half @ half.transpose(0, 2, 1) + 0.1 * np.eye(2)
    slip = random.normal(size=(COUNT, 2))
    hold = -np.linalg.solve(compliance, slip[..., None])[..., 0]
    bound = np.linalg.norm(hold, axis=1) * random.uniform(0.05, 1.5, COUNT)
    bound[0] = 0.0
    out = wp.zeros((COUNT, 2), dtype=wp.vec2d, device="cpu")
    inputs = [
        wp.array(compliance.reshape(COUNT, 4)[:, [0, 1, 3]], dtype=wp.vec3d, device="cpu"),
        wp.array(slip, dtype=wp.vec2d, device="cpu"),
        wp.array(bound, dtype=wp.float64, device="cpu"),
    ]
    wp.launch(evaluate, dim=COUNT, inputs=inputs, outputs=[out], device="cpu")
    found = out.numpy()
    assert found[:, 0] == pytest.approx(hold, rel=EXACT, abs=EXACT)
    assert not found[0, 1].any()
    for i in range(1, COUNT):

        def force(softer, i=i):
            return -np.linalg.solve(compliance[i] + softer * np.eye(2), slip[i])

        right = hold[i]
        if np.linalg.norm(right) > bound[i]:
            most = np.linalg.norm(slip[i]) / bound[i]
            right = force(
                brentq(
                    lambda s, i=i: np.linalg.norm(force(s)) - bound[i],
                    0.0,
                    most,
                    xtol=1e-14,
                    rtol=1e-14,
                )
            )
        assert found[i, 1] == pytest.approx(right, abs=EXACT * np.linalg.norm(hold[i]))
    assert 50 < (np.linalg.norm(hold, axis=1) > bound).sum() < COUNT - 20
