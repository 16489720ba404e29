"""Contact on the compliance: its laws over random scenes, its frame, its history, its bad input."""

import numpy as np
import pytest
import trimesh
from contact_slab import TIGHT, along, away
from scipy.spatial.transform import Rotation

from tissue.models.organ.contact import ContactOutcome, SurfaceContact, contact_points
from tissue.models.organ.probe import CylinderProbe, ShellProbe, SphereProbe

CLOSE = 1e-7
"""Steps of 1e-11 add up to at most this where sweeps converge by no less than 1e-4 each."""


@pytest.mark.parametrize("seed", range(6))
def test_friction_cone_and_complementarity_hold_on_random_scenes(slab, seed):
    rng = np.random.default_rng(seed)
    # A loaded point on a sharp edge slides off it unless friction holds it: cylinders get friction
    # and round edges.
    friction = rng.uniform([0.05, 0.4][seed % 2], 0.8)
    radius = rng.uniform(0.004, 0.012)
    rotation = Rotation.from_euler("xy", rng.uniform(-0.4, 0.4, 2)).as_matrix()
    probe = [SphereProbe(radius), CylinderProbe(radius, 0.5 * radius)][seed % 2]
    contact = slab.contact(probe, friction=friction, **TIGHT)
    face, weights, _ = contact_points(slab.rest, slab.faces, probe.spacing_m)
    tip = np.array([*rng.uniform(-0.008, 0.008, 2), 0.006])
    contact.place(tip, rotation)
    place = np.einsum("pa,paj->pj", weights, slab.rest[slab.faces[face]])
    seen = np.zeros(2, dtype=int)
    for tick in range(24):
        step = np.array([0.0, 0.0, -7e-4]) if tick < 12 else rng.normal(size=3) * [4e-4, 4e-4, 2e-4]
        turn = Rotation.from_rotvec(rng.normal(size=3) * 0.01).as_matrix()
        new_tip = tip + step
        new_rotation = turn @ rotation
        anchor = new_tip + (place - tip) @ rotation @ new_rotation.T
        result = contact.solve(new_tip, new_rotation)
        assert result.outcome is ContactOutcome.CONVERGED
        tip = new_tip
        rotation = new_rotation
        moved = slab.rest + result.displacement_m()
        place = np.einsum("pa,paj->pj", weights, moved[slab.faces[face]])
        local = (place - tip) @ rotation
        gap = probe.distance(local)
        steps = 1e-7 * np.eye(3)
        slopes = [probe.distance(local + e) - probe.distance(local - e) for e in steps]
        normal = np.column_stack(slopes) / 2e-7 @ rotation.T
        force = contact._points.force.numpy()
        press = np.einsum("pj,pj->p", force, normal)
        side = force - press[:, None] * normal
        slip = place - anchor
        slip -= np.einsum("pj,pj->p", slip, normal)[:, None] * normal
        size = np.linalg.norm(side, axis=1)
        direction = np.linalg.norm(slip, axis=1)
        largest = np.linalg.norm(result.force_N)
        deepest = np.abs(result.displacement_m()).max()
        assert press.min() >= -CLOSE * largest
        assert gap.min() >= -CLOSE * deepest
        assert np.abs(press * gap).max() <= CLOSE * largest * deepest
        assert (size - friction * press).max() <= CLOSE * largest
        sticking = (press > CLOSE * largest) & (size < friction * press * (1.0 - 1e-6))
        assert (direction[sticking] <= CLOSE * deepest).all()
        loaded = press > 1e-3 * largest
        opposed = np.einsum("pj,pj->p", side, slip)[loaded & ~sticking]
        assert (
            opposed <= CLOSE * largest * deepest - 0.999 * (size * direction)[loaded & ~sticking]
        ).all()
        seen += [sticking.sum(), (loaded & ~sticking).sum()]
        about = -np.cross(moved - tip, result.nodal_forces_N).sum(axis=0)
        np.testing.assert_allclose(result.torque_Nm, about, atol=1e-12 + 1e-9 * largest * radius)
        np.testing.assert_allclose(
            result.force_N, -result.nodal_forces_N.sum(axis=0), atol=1e-12 * largest
        )
    assert (seen > 0).all()


def test_turning_everything_turns_the_answer(slab):
    turn = Rotation.random(random_state=4).as_matrix()
    path = away([0.003, 0.001, -0.004])
    probe = SphereProbe(0.01)
    options = {**TIGHT, "spacing_m": 1.0}
    here = along(slab.contact(probe, **options), path)
    force = here.force_N.copy()
    torque = here.torque_Nm.copy()
    nodal = here.nodal_forces_N.copy()
    count = len(slab.rest)
    turned = np.einsum("ij,ajbk,lk->aibl", turn, slab.compliance.reshape(count, 3, count, 3), turn)
    contact = SurfaceContact(
        slab.rest @ turn.T, slab.faces, turned.reshape(3 * count, -1), probe, **options
    )
    there = along(contact, [turn @ tip for tip in path], turn)
    close = 1e-6 * np.linalg.norm(force)
    np.testing.assert_allclose(there.force_N, turn @ force, atol=close)
    np.testing.assert_allclose(there.torque_Nm, turn @ torque, atol=close * 0.006)
    np.testing.assert_allclose(there.nodal_forces_N, nodal @ turn.T, atol=close)


def test_a_tool_smaller_than_a_triangle_is_felt_between_nodes(slab):
    probe = SphereProbe(0.0015)
    middle = slab.rest[slab.faces[100]].mean(axis=0)
    contact = slab.contact(probe)
    contact.place(middle + np.array([0.0, 0.0, 1e-4]), np.eye(3))
    result = contact.solve(middle - [0.0, 0.0, 1e-3], np.eye(3))
    assert result.contacts > 0 and result.force_N[2] > 1e-3
    nodes_only = slab.contact(probe, spacing_m=1.0)
    assert nodes_only.solve(middle - [0.0, 0.0, 1e-3], np.eye(3)).contacts == 0


def test_a_shell_of_points_feels_what_its_shape_feels(slab):
    """A shell of points has the force of its shape.

    A ball by its closed form and by 5,000 points touch equal nodes up to the shell's spacing.
    """

    ball = trimesh.creation.icosphere(4, 0.012)
    ball.apply_translation([0.0, 0.0, 0.012])
    path = away([0.002, 0.001, -0.004])
    shell = along(slab.contact(ShellProbe.from_mesh(ball, points=5000), friction=0.2), path)
    assert shell.outcome in (ContactOutcome.CONVERGED, ContactOutcome.NOT_CONVERGED)
    force = shell.force_N.copy()
    torque = shell.torque_Nm.copy()
    exact = along(slab.contact(SphereProbe(0.012), friction=0.2), path)
    # Points 1 mm apart on triangles of 5 mm: the flat triangles of either side count differently.
    np.testing.assert_allclose(force, exact.force_N, atol=0.06 * np.linalg.norm(exact.force_N))
    np.testing.assert_allclose(
        torque, exact.torque_Nm, atol=0.06 * np.linalg.norm(exact.force_N) * 0.012
    )


def test_a_drag_sticks_first_and_then_slips_at_the_coefficient(slab):
    contact = slab.contact(SphereProbe(0.011), friction=0.3, spacing_m=1.0, **TIGHT)
    path = [np.array([0.0, 0.0, z]) for z in np.linspace(0.0005, -0.002, 26)]
    along(contact, path)
    shares = []
    for x in np.linspace(0.0, 0.003, 31)[1:]:
        force = contact.solve(np.array([x, 0.0, -0.002]), np.eye(3)).force_N
        shares.append(-force[0] / force[2])
    assert shares[0] < 0.2 and (np.diff(shares[:5]) > 0.0).all()
    # Normals of the sphere lean by up to a/R = 0.4: the ratio of sums is the coefficient only
    # nearly.
    assert abs(shares[-1] - 0.3) < 0.06
    back = contact.solve(np.array([0.003 - 1e-4, 0.0, -0.002]), np.eye(3)).force_N
    assert -back[0] / back[2] < shares[-1]


def test_outcomes_of_a_solve_are_reported(slab):
    tip = np.array([0.0005, 0.0, -0.003])
    assert (
        slab.contact(SphereProbe(0.01), sweeps=1).solve(tip, np.eye(3)).outcome
        is ContactOutcome.NOT_CONVERGED
    )
    held = SurfaceContact(slab.rest, slab.faces, np.zeros_like(slab.compliance), SphereProbe(0.01))
    result = held.solve(tip, np.eye(3))
    assert result.outcome is ContactOutcome.IMMOVABLE
    assert result.penetration_m > 0.001
    apart = held.solve(np.array([0.0, 0.0, 0.01]), np.eye(3))
    assert (
        apart.outcome is ContactOutcome.CONVERGED
        and apart.contacts == 0
        and not apart.force_N.any()
    )


def test_a_scaled_compliance_and_shifted_nodes_are_those_of_another_organ(slab):
    path = away([0.002, 0.0, -0.003])
    offset = np.array([3e-4, -2e-4, -5e-4])
    options = {"spacing_m": 1.0, **TIGHT}
    other = SurfaceContact(
        slab.rest + offset, slab.faces, 2.5 * slab.compliance, SphereProbe(0.01), **options
    )
    expected = along(other, path).force_N.copy()
    contact = slab.contact(SphereProbe(0.01), **options)
    contact.scale_compliance(2.5)
    contact.shift(np.broadcast_to(offset, slab.rest.shape))
    result = along(contact, path)
    np.testing.assert_allclose(result.force_N, expected, atol=1e-7 * np.linalg.norm(expected))
    np.testing.assert_allclose(result.displacement_m(), other.result.displacement_m(), atol=1e-9)


def test_another_compliance_with_the_surface_where_it_was_leaves_the_force(slab):
    """Another compliance with an unmoved surface leaves the force.

    It is half as stiff, and shifted by its displacement: nothing changes until the tool moves on.
    """
    options = {"spacing_m": 1.0, "friction": 0.4} | TIGHT
    path = away([0.002, 0.0, -0.003])
    contact = SurfaceContact(
        slab.rest, slab.faces, slab.compliance.copy(), SphereProbe(0.01), **options
    )
    before = along(contact, path)
    force = before.force_N.copy()
    moved = before.displacement_m().copy()
    contact.change_compliance(2.0 * slab.compliance)
    contact.shift(moved - before.displacement_m())
    tip = np.array(path[-1])
    result = contact.solve(tip, np.eye(3))
    np.testing.assert_allclose(result.force_N, force, atol=1e-6 * np.linalg.norm(force))
    deeper = contact.solve(tip - [0.0, 0.0, 1e-5], np.eye(3)).force_N[2] - force[2]
    plain = SurfaceContact(slab.rest, slab.faces, slab.compliance, SphereProbe(0.01), **options)
    stiffer = along(plain, [*path, tip - [0.0, 0.0, 1e-5]]).force_N[2] - force[2]
    assert 0.3 * stiffer < deeper < 0.8 * stiffer
