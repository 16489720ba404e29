"""Laws of the predictors that know the coupling.

Moved, turned or scaled input gives a moved, turned or scaled prediction.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tissue.prediction.predictor import Contact
from tissue.prediction.trained import Trained, shipped_file
from tissue.simulation.builders.prediction import trained_predictor

KINDS = ("koopman", "koopman-look-ahead", "koopman-online")
SPRING_N_M, TICKS, LEAD = 400.0, 600, 6.11


@pytest.fixture(scope="module")
def trained():
    return Trained.read(shipped_file("wall"))


@pytest.fixture(scope="module", params=["known stiffness", "learnt stiffness"])
def motion(request):
    """Return positions, forces and contacts of a device that swings in and out of a soft face.

    The face drags along.
    """
    time = 1e-3 * np.arange(TICKS)
    device = 1e-3 * np.column_stack(
        [20.0 * time, 2.0 * np.cos(9.0 * time), 3.0 * np.cos(25.0 * time)]
    )
    device = 5.5e-5 * np.round(device / 5.5e-5)
    stiffness = np.diag([0.0, 0.0, 900.0])
    tip, push = device.copy(), np.zeros((TICKS, 3))
    inside = device[:, 2] < 0.0
    tip[inside, 2] *= SPRING_N_M / (SPRING_N_M + 900.0)
    push[inside, 2] = -900.0 * tip[inside, 2]
    force = SPRING_N_M * (tip - device)
    known = request.param == "known stiffness"
    rows = [
        Contact(
            SPRING_N_M,
            tip[i],
            push[i],
            stiffness * float(inside[i]) if known else None,
            max(device[i, 2], 0.0) if known else np.inf,
            np.array([0.0, 0.0, 1.0]),
        )
        for i in range(TICKS)
    ]
    return device, force, rows


def scaled_stiffness(contact, change):
    """Return the changed stiffness of a contact, None if it is unknown."""
    return None if contact.stiffness_N_m is None else change(contact.stiffness_N_m)


def predicted(kind, trained, device, force, contact):
    """Forces that a bare predictor gives, shape (n, 3)."""
    predictor = trained_predictor(kind, trained, force_limit_N=3.3).inner
    found = np.empty((TICKS, 3))
    for tick in range(TICKS):
        predictor.meet(contact[tick])
        predictor.observe(device[tick], np.zeros(3), force[tick])
        found[tick] = predictor.predict(LEAD)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_moved_is_predicted_alike(kind, trained, motion):
    device, force, contact = motion
    shift = np.array([0.08, -0.25, 1.5])
    other = [replace(each, tip_m=each.tip_m + shift) for each in contact]
    moved = predicted(kind, trained, device + shift, force, other)
    np.testing.assert_allclose(moved, predicted(kind, trained, device, force, contact), atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mirrored", [False, True], ids=["turned", "mirrored"])
def test_what_is_turned_is_predicted_turned(kind, mirrored, trained, motion):
    device, force, contact = motion
    turn = Rotation.from_rotvec([0.7, -1.1, 2.0]).as_matrix() @ np.diag(
        [-1.0 if mirrored else 1.0, 1.0, 1.0]
    )
    other = [
        replace(
            each,
            tip_m=turn @ each.tip_m,
            force_N=turn @ each.force_N,
            normal=turn @ each.normal,
            stiffness_N_m=scaled_stiffness(each, lambda matrix: turn @ matrix @ turn.T),
        )
        for each in contact
    ]
    turned = predicted(kind, trained, device @ turn.T, force @ turn.T, other)
    np.testing.assert_allclose(
        turned, predicted(kind, trained, device, force, contact) @ turn.T, atol=1e-8
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("factor", [0.01, 30.0])
def test_scaled_forces_are_predicted_scaled(kind, factor, trained, motion):
    device, force, contact = motion
    other = [
        replace(
            each,
            spring_N_m=factor * each.spring_N_m,
            force_N=factor * each.force_N,
            stiffness_N_m=scaled_stiffness(each, lambda matrix: factor * matrix),
        )
        for each in contact
    ]
    scaled = predicted(kind, trained, device, factor * force, other)
    np.testing.assert_allclose(
        scaled, factor * predicted(kind, trained, device, force, contact), atol=1e-8 * factor
    )
