"""Forces of a run by a hand at the motor, with ideal forces: `tissue.motor_forces`."""

from tissue.objects.run import Run
from tissue.simulation.reference_force import MotorForces, ideal_force_N
from tissue.simulation.reference_force import motor_forces as forces_of

__all__ = ["MotorForces", "motor_forces"]


def motor_forces(run: Run) -> MotorForces:
    """Compute the force that a device played, and the ideal force [N].

    The ideal force has no latency, encoder steps and filters, on the motion of the run. For it the
    scene is simulated again.

    Parameters
    ----------
    run
        Run by a hand that was simulated in this process.

    Returns
    -------
    Mean forces over every tick but the last, each of shape (n - 1, 3): ``played``,
    ``ideal``, ``nearest`` (the ideal force from the encoder positions) and ``sent`` (within the
    device's range).

    Raises
    ------
    InputError
        If the run had no device, or was read from a folder.
    """
    return forces_of(run, ideal_force_N(run))
