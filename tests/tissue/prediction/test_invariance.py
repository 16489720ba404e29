"""Laws of the predictors that know the coupling.

Moved, turned or scaled input gives a moved, turned or scaled prediction.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tissue.prediction.predictor import Contact
from tissue.prediction.trained import Trained, shipped_file
from tissue.simulation.builders.prediction import trained_predictor

KINDS = ("koopman", "koopman-look-ahead", "koopman-online")
SPRING_N_M, TICKS, LEAD = 400.0, 600, 6.11
PLACES, FORCES, NORMAL, STIFFNESS = slice(1, 4), slice(4, 7), slice(17, 20), slice(7, 16)


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
        ).row()
        for i in range(TICKS)
    ]
    return device, force, np.array(rows)


def predicted(kind, trained, device, force, contact):
    """Forces that a bare predictor gives, shape (n, 3)."""
    predictor = trained_predictor(kind, trained, force_limit_N=3.3).inner
    found = np.empty((TICKS, 3))
    for tick in range(TICKS):
        predictor.meet(Contact.of_row(contact[tick]))
        predictor.observe(device[tick], np.zeros(3), force[tick])
        found[tick] = predictor.predict(LEAD)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_moved_is_predicted_alike(kind, trained, motion):
    device, force, contact = motion
    shift, other = np.array([0.08, -0.25, 1.5]), contact.copy()
    other[:, PLACES] += shift
    moved = predicted(kind, trained, device + shift, force, other)
    np.testing.assert_allclose(moved, predicted(kind, trained, device, force, contact), atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mirrored", [False, True], ids=["turned", "mirrored"])
def test_what_is_turned_is_predicted_turned(kind, mirrored, trained, motion):
    device, force, contact = motion
    turn = Rotation.from_rotvec([0.7, -1.1, 2.0]).as_matrix() @ np.diag(
        [-1.0 if mirrored else 1.0, 1.0, 1.0]
    )
    other = contact.copy()
    for part in (PLACES, FORCES, NORMAL):
        other[:, part] = contact[:, part] @ turn.T
    other[:, STIFFNESS] = (turn @ contact[:, STIFFNESS].reshape(-1, 3, 3) @ turn.T).reshape(-1, 9)
    turned = predicted(kind, trained, device @ turn.T, force @ turn.T, other)
    np.testing.assert_allclose(
        turned, predicted(kind, trained, device, force, contact) @ turn.T, atol=1e-8
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("factor", [0.01, 30.0])
def test_scaled_forces_are_predicted_scaled(kind, factor, trained, motion):
    device, force, contact = motion
    other = contact.copy()
    for part in (0, FORCES, STIFFNESS):
        other[:, part] *= factor
    scaled = predicted(kind, trained, device, factor * force, other)
    np.testing.assert_allclose(
        scaled, factor * predicted(kind, trained, device, force, contact), atol=1e-8 * factor
    )
