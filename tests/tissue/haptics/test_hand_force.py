"""Force that a hand feels of a device.

It follows the device's own balance.
"""

import numpy as np

from tissue.haptics.device.device import DeviceParameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Grip, HandAction

TICK = 1e-3
GRIP = Grip(stiffness_N_m=300.0, damping_N_s_m=4.0, mass_kg=0.1)


class Moving:
    """A hand whose aim goes at a constant speed."""

    def __init__(self, speed=(0.0, 0.0, 0.0), push=(0.0, 0.0, 0.0)):
        self.speed, self.push = speed, push

    def act(self, time_s, position_m):
        aim = tuple(time_s * each for each in self.speed)
        return HandAction(aim_m=aim, aim_velocity_m_s=self.speed, push_N=self.push, grip=GRIP)


def test_in_motion_it_is_the_motors_less_what_the_device_takes():
    """Momentum of the device alone, which the force is not formed from."""
    mass, damping, motor = 0.045, 0.35, np.array([0.8, -0.3, 0.1])
    hand = Moving(speed=(0.02, 0.0, -0.05), push=(0.0, 0.4, 0.0))
    device = SimulatedDevice(DeviceParameters(mass_kg=mass, damping_N_s_m=damping), hand)
    places = [device.translation.position]
    forces, velocities = [], [device.translation.velocity]
    device.command(motor, np.zeros(3))
    for tick in range(1, 60):
        device.read(tick * TICK)
        places.append(device.translation.position)
        velocities.append(device.translation.velocity)
        forces.append(device.hand_force_N)
    went, change = np.diff(places, axis=0) / TICK, np.diff(velocities, axis=0) / TICK
    # a command is played from the next tick on
    played = np.vstack([np.zeros(3), np.tile(motor, (58, 1))])
    balance = played - damping * went - mass * change
    lag = np.abs(np.array(forces) - balance).max(axis=1)
    assert lag[2:].max() < 2e-4 and min(lag[0], lag[1]) < 2e-4
