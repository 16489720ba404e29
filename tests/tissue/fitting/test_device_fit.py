"""Mass, damping and friction of a simulated device come back from a log of it, encoder and delays included."""

import numpy as np
import pytest

import tissue
from meshes.base.errors import InputError
from tissue.fitting.device import device_fit, least_friction_N
from tissue.fitting.device_windows import DeviceLog
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
    forward, loads = device_fit("touch", DeviceLog(times, x, force))
    assert forward.channels == ("force_z_N",)
    there = np.isfinite(loads.values[:, 0])
    basis = forward.free.basis[np.isin(forward.times_s, loads.times_s), 0]
    found = np.linalg.lstsq(basis[there], loads.values[there, 0], rcond=None)[0]
    np.testing.assert_allclose(found, [mass, damping, friction], rtol=2e-2)


def test_a_free_log_knows_the_constants_over_the_gain_of_the_motors():
    found = maximum_posterior(*device_fit("touch", swung()))
    x = np.array([found.interval(at)[1] for at in range(4)])
    assert found.converged
    np.testing.assert_allclose(x[:3] / x[3], PLANTED, rtol=0.005)
    low, _, high = found.interval(0)
    assert high / low > 1.15  # the gain alone is known to 10 %


def test_a_hand_sensor_has_a_clock_and_a_bias_of_its_own():
    """One that is 7 ms late and reads 0.1 N too much."""
    held = swung(seed=1)
    late = np.concatenate([np.zeros((7, 3)), held.applied_N[:-7]]) + 0.1
    found = maximum_posterior(*device_fit("touch", swung(), hold(held, late)))
    x = np.array([found.interval(at)[1] for at in range(6)])
    np.testing.assert_allclose(x[:4], [*PLANTED, 1.0], rtol=0.005)
    assert x[5] == pytest.approx(0.007, abs=1e-4)
    np.testing.assert_allclose(found.nuisances.bias, [0.0, 0.0, 0.1, 0.1], atol=2e-3)


def test_derivatives_of_the_loads_are_those_of_differences():
    held = swung(seed=1, seconds=2.5)
    held = DeviceLog(held.times_s, held.position_m, held.applied_N[::-1], held.applied_N)
    forward, _ = device_fit("touch", swung(seconds=2.5), held)
    x = np.array([0.05, 0.3, 0.2, 0.9, 6e-4, 3e-3])
    for at, step in enumerate(1e-3 * x):
        above, below = (forward.loads(x + sign * step * np.eye(6)[at]) for sign in (1.0, -1.0))
        slope = (above - below) / (2.0 * step)
        np.testing.assert_allclose(forward.jacobian(x)[:, :, at], slope, atol=1e-4 * np.abs(slope).max())


def test_a_device_at_rest_bounds_its_friction_and_fits_nothing():
    log = swung((0.05, 0.3, 0.9), size_N=0.1, seconds=2.0)
    assert 0.1 < least_friction_N(log, 5.5e-5) < 0.9
    with pytest.raises(InputError, match="in motion"):
        device_fit("touch", log)


def hold(log, hand_N):
    """The same motion, swung by a hand while the motors are off."""
    return DeviceLog(log.times_s, log.position_m, np.zeros_like(hand_N), hand_N)


def written(path, log, hand=None, *, motors=True):
    columns = {"time_s": log.times_s}
    for at, c in enumerate("xyz"):
        columns[f"device_{c}_mm"] = 1e3 * log.position_m[:, at]
        if motors:
            columns[f"device_force_{c}_N"] = log.applied_N[:, at]
        if hand is not None:
            columns[f"hand_force_{c}_N"] = hand[:, at]
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Free, and held by a hand that swings it while the motors are off."""
    folder, log = tmp_path_factory.mktemp("device"), swung()
    held = swung(seed=1)
    return (
        written(folder / "free.csv", log),
        written(folder / "held.csv", held, held.applied_N, motors=False),
        written(folder / "weak.csv", type(log)(log.times_s, log.position_m, 1.25 * log.applied_N)),
    )


@pytest.mark.slow
def test_planted_device_comes_back_by_the_command(logs, tmp_path, command):
    code, text, problem = command(
        "fit", "device:touch", "--measured", logs[0], "--held", logs[1], "--out", tmp_path / "d"
    )
    assert code == 0, problem
    assert "devices touch mass" in text and "tissue run wall --set device=touch" in text
    scene = tissue.load_scene("wall", {"device": "touch", "materials": str(tmp_path / "d" / "fitted.toml")})
    found = scene.constants.constants("devices", "touch")
    for name, planted in zip(("mass_kg", "damping_N_s_m", "friction_N"), PLANTED, strict=True):
        assert found[name].value == pytest.approx(planted, rel=0.005)


def test_motors_that_are_weaker_than_stated_are_found_by_the_held_log(logs):
    """They give 0.8 of what the log has."""
    found = tissue.fit("device:touch", logs[2], held=logs[1]).to_pandas()["p50"].to_numpy()
    np.testing.assert_allclose(found[:4], [*PLANTED, 0.8], rtol=0.005)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("device:tuch",), "device must be one of"),
        (("device:touch", "--free", "devices"), "free must be left out"),
        (("device:touch", "--set", "seed=1"), "--set must be left out"),
        (("glenoid", "--held", "free.csv"), "held must be left out"),
    ],
)
def test_what_has_no_effect_is_refused(logs, tmp_path, refused, arguments, message):
    assert message in refused("fit", *arguments, "--measured", logs[0], "--out", tmp_path / "d")


def test_a_held_log_without_the_hands_force_is_refused(logs, tmp_path, refused):
    message = refused("fit", "device:touch", "--measured", logs[0], "--held", logs[0], "--out", tmp_path / "d")
    assert message.startswith("measured must hold hand_force_x_N")
