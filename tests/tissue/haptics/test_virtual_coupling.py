"""The virtual coupling: what it does to energy, in shift and turn, and what it refuses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.base.errors import InputError
from tissue.haptics.proxy.virtual_coupling import VirtualCoupling
from tissue.motion.motion import matrix_of, quaternion_of
from tissue.motion.quaternion import turn_between

STILL = np.zeros(3)


def test_coupling_only_loses_energy_where_the_printed_damper_feeds_it():
    """E9: k (p - x) + b v_device pushes along a moving device; ours brakes it, and rests with a proxy that goes along."""
    coupling = VirtualCoupling(
        stiffness_N_m=500.0, damping_N_s_m=3.0, rotational_stiffness_Nm_rad=0.3, rotational_damping_Nms_rad=0.01
    )
    velocity = np.array([0.1, -0.2, 0.05])
    ours = coupling.force_N(STILL, STILL, STILL, velocity)
    printed = 500.0 * (STILL - STILL) + 3.0 * velocity
    assert printed @ velocity > 0.0
    assert ours == pytest.approx(-3.0 * velocity)
    assert (coupling.force_N(STILL, STILL, velocity, velocity) == 0.0).all()
    turned = Rotation.from_rotvec([0.0, 0.0, 0.2]).as_quat()
    same = np.array([0.0, 0.0, 0.0, 1.0])
    assert coupling.torque_Nm(turned, same, STILL, STILL) == pytest.approx([0.0, 0.0, 0.06])
    assert coupling.torque_Nm(same, same, STILL, velocity) == pytest.approx(-0.01 * velocity)
    assert coupling.torque_Nm(turned, -turned, STILL, STILL) == pytest.approx(STILL, abs=1e-15)


def test_force_and_torque_are_the_slope_of_the_energy():
    """Central differences over random poses; turns are made on the group."""
    random = np.random.default_rng(2)
    coupling = VirtualCoupling(stiffness_N_m=700.0, rotational_stiffness_Nm_rad=0.4)
    for _ in range(20):
        here, there = random.normal(size=3) * 1e-2, random.normal(size=3) * 1e-2
        q, p = (Rotation.from_rotvec(random.normal(size=3) * 0.7) for _ in range(2))
        step = 1e-6
        for axis in np.eye(3) * step:
            moved = [coupling.energy_J(there, here + s * axis, p.as_quat(), q.as_quat()) for s in (1, -1)]
            assert -(moved[0] - moved[1]) / (2 * step) == pytest.approx(
                coupling.force_N(there, here, STILL, STILL) @ axis / step, abs=1e-6
            )
            turned = [
                coupling.energy_J(there, here, p.as_quat(), (Rotation.from_rotvec(s * axis) * q).as_quat())
                for s in (1, -1)
            ]
            assert -(turned[0] - turned[1]) / (2 * step) == pytest.approx(
                coupling.torque_Nm(p.as_quat(), q.as_quat(), STILL, STILL) @ axis / step, abs=1e-6
            )


def test_coupling_numbers_are_checked():
    assert VirtualCoupling(stiffness_N_m=1e3).lever_m is None
    assert VirtualCoupling(stiffness_N_m=1e3, rotational_stiffness_Nm_rad=0.4).lever_m == pytest.approx(0.02)
    with pytest.raises(InputError, match="stiffness_N_m"):
        VirtualCoupling(stiffness_N_m=np.nan)
    with pytest.raises(InputError, match="damping_N_s_m"):
        VirtualCoupling(stiffness_N_m=1.0, damping_N_s_m=-1.0)
    with pytest.raises(InputError, match="rotational_stiffness_Nm_rad"):
        VirtualCoupling(stiffness_N_m=1.0, rotational_damping_Nms_rad=1.0)


def test_matrices_and_quaternions_agree_with_scipy():
    for rotation in [*Rotation.random(50, random_state=1), *(Rotation.from_rotvec(v) for v in np.pi * np.eye(3))]:
        quaternion = quaternion_of(rotation.as_matrix())
        assert matrix_of(quaternion) == pytest.approx(rotation.as_matrix(), abs=1e-14)
        assert quaternion[3] >= 0.0
        other = Rotation.random(random_state=2)
        expected = (other * rotation.inv()).as_rotvec()
        assert turn_between(quaternion, other.as_quat()) == pytest.approx(expected, abs=1e-12)
