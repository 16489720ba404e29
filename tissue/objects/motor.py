"""Forces of a run by a hand where the motor acts, beside the ideal ones: `tissue.motor_forces`."""

from tissue.objects.run import Run
from tissue.simulation.reference_force import MotorForces, ideal_force_N
from tissue.simulation.reference_force import motor_forces as forces_of

__all__ = ["MotorForces", "motor_forces"]


def motor_forces(run: Run) -> MotorForces:
    """Compute the force that a device played, and that without latency, encoder steps and filters
    [N].

    The ideal force is that of a prompt loop on the very motion of the run: the scene is simulated
    once more.

    Parameters
    ----------
    run
        A run by a hand, simulated here.

    Returns
    -------
    Mean forces over every tick but the last, each of shape (n - 1, 3): ``played``,
    ``ideal``, ``nearest`` (the ideal one by what the encoders read) and ``sent`` (within the
    device's range).

    Raises
    ------
    InputError
        If the run had no device, or was read back from a folder.
    """
    return forces_of(run, ideal_force_N(run))
