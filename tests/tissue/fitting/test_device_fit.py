"""Mass, damping and friction of a simulated device come back from a log of it, encoder and delays included."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.fitting.device import DeviceLog, device_fit, least_friction_N
from tissue.fitting.posterior import maximum_posterior
from tissue.haptics.device.device import DeviceParameters
from tissue.haptics.device.simulated import SimulatedDevice

PLANTED = (0.05, 0.3, 0.2)


def swung(parameters=PLANTED, *, encoder_m=5.5e-5, seconds=6.0, size_N=1.2, seed=0):
    """A free device that its motors swing along x and y, with sums of sines."""
    mass, damping, friction = parameters
    device = SimulatedDevice(
        DeviceParameters(
            mass_kg=mass,
            damping_N_s_m=damping,
            friction_N=friction,
            encoder_step_m=encoder_m,
            force_limit_N=10.0,
            transport_delay_s=5e-4,
            amplifier_Hz=300.0,
        )
    )
    times = 1e-3 * np.arange(round(1e3 * seconds))
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, (2, 3))
    hertz = np.array([[1.1, 2.3, 4.7], [1.4, 2.9, 5.3]])
    force = np.zeros((len(times), 3))
    force[:, :2] = size_N * np.sin(2.0 * np.pi * hertz * times[:, None, None] + phase).sum(axis=2)
    position = []
    for time, each in zip(times, force, strict=True):
        position.append(device.read(time).position_m)
        device.command(each, np.zeros(3))
    return DeviceLog(times, np.array(position), force)


def test_weak_form_of_a_known_motion():
    """x = A sin(w t) against its own force: averages of sines are exact, so are the constants."""
    times, mass, damping, friction = 1e-3 * np.arange(4000), 0.08, 0.4, 0.1
    w, size = 2.0 * np.pi * 1.5, 0.02
    x = np.zeros((4000, 3))
    x[:, 2] = size * np.sin(w * times)
    speed = size * w * np.cos(w * times)
    force = np.zeros_like(x)
    force[:, 2] = -mass * w**2 * x[:, 2] + damping * speed + friction * np.sign(speed)
    forward, loads = device_fit("touch", (DeviceLog(times, x, force),))
    assert forward.channels == ("force_z_N",)
    there = np.isfinite(loads.values[:, 0])
    found = np.linalg.lstsq(forward.basis[there, 0], loads.values[there, 0], rcond=None)[0]
    np.testing.assert_allclose(found, [mass, damping, friction], rtol=2e-2)


def test_planted_device_comes_back():
    found = maximum_posterior(*device_fit("touch", (swung(),)))
    x = np.array([found.interval(at)[1] for at in range(3)])
    assert found.converged
    np.testing.assert_allclose(x, PLANTED, rtol=0.005)


def test_a_device_at_rest_bounds_its_friction_and_fits_nothing():
    log = swung((0.05, 0.3, 0.9), size_N=0.1, seconds=2.0)
    assert 0.1 < least_friction_N(log, 5.5e-5) < 0.9
    with pytest.raises(InputError, match="in motion"):
        device_fit("touch", (log,))
