"""Devices of other rates than the loop: filters, velocity, slew and hold are right in seconds."""

import numpy as np
import pytest
from hand_steps import STEP_S, held, meet

from tissue import InputError, Sample
from tissue.models.tissue_model import FreeSpace, WallModel

RATES_HZ = [500, 1000, 2000]
SLEW_N_MS = 0.2


class Sampled:
    """Device on a given path z(t) [m].

    It is `dated` by its own clock, or repeated with the time of the tick.
    """

    in_process = True

    def __init__(self, path, rate_Hz, *, dated):
        self.path, self.rate_Hz, self.dated = path, rate_Hz, dated
        self.forces = []

    def read(self, time_s):
        taken_s = int(time_s * self.rate_Hz + 1e-6) / self.rate_Hz
        return Sample(taken_s if self.dated else time_s, (0.0, 0.0, self.path(taken_s)))

    def command(self, force_N, torque_Nm):
        self.forces.append(force_N.copy())


@pytest.fixture
def at_rate(tmp_path):
    """Makes the changes of a scene in which the Touch has another rate, and a slew of 0.2 N/ms."""

    def changes(rate_Hz, **more):
        path = tmp_path / f"{rate_Hz}.toml"
        entry = (
            f'value = {rate_Hz}\nrange = [{rate_Hz}, {rate_Hz}]\nsource = "test"\nconfidence = '
            '"M"\n'
        )
        slew = entry.replace(str(rate_Hz), str(SLEW_N_MS))
        path.write_text(
            f"[devices.touch.rate_Hz]\n{entry}[devices.touch.force_slew_N_ms]\n{slew}", "utf-8"
        )
        return {"device": "touch", "materials": str(path), "coupling__stiffness_N_m": 100.0} | more

    return changes


class Watched:
    """A law that notes the device's velocity along z [m/s] and plays nothing."""

    def __init__(self):
        self.speeds = []

    def render(self, device, device_velocity, proxy, proxy_velocity, dt):
        self.speeds.append((device_velocity[2], proxy_velocity[2]))
        return np.zeros(3)

    def pause(self):
        self.speeds.clear()


@pytest.mark.parametrize("dated", [True, False])
@pytest.mark.parametrize("rate_Hz", [*RATES_HZ, 700])
def test_the_velocity_of_a_ramp_is_its_slope(at_rate, rate_Hz, dated):
    """The velocity of a ramp is its slope.

    The law gets the velocities of device and tool in every tick, and the tool moves at that speed
    on average.
    """
    slope = -0.08
    motion = held(**at_rate(rate_Hz))
    motion.device = Sampled(lambda time_s: 0.1 + slope * time_s, rate_Hz, dated=dated)
    law = motion._contact = Watched()
    tool_speeds = []

    class Free(FreeSpace):
        def respond(self, tool):
            tool_speeds.append(tool.speed_m_s * tool.heading[0, 2])
            return super().respond(tool)

    meet(motion, Free(), 0.4)
    np.testing.assert_allclose(law.speeds[-20:], slope, rtol=1e-6)
    assert np.mean(tool_speeds[-140:]) == pytest.approx(slope, rel=1e-3)


@pytest.mark.parametrize("rate_Hz", RATES_HZ)
def test_the_force_rises_by_no_more_than_the_stated_newtons_a_second(at_rate, rate_Hz):
    """The force rises by no more than the stated newtons a second.

    A device that stands 20 mm in the wall from the first contact asks for its whole force at once.
    """
    motion = held(**at_rate(rate_Hz, output__low_pass_ms=0.0))
    device = Sampled(
        lambda time_s: 5e-3 if time_s < 0.05 else -20e-3 * min((time_s - 0.05) / 0.005, 1.0),
        rate_Hz,
        dated=True,
    )
    motion.device = device
    meet(motion, WallModel(1e4, radius_m=5e-3), 0.1)
    force = np.array(device.forces)[:, 2]
    rising = np.flatnonzero((force > 0.1) & (force < 0.9 * force.max()))
    slope_N_s = np.polyfit(STEP_S * rising, force[rising], 1)[0]
    assert len(rising) > 4
    assert slope_N_s == pytest.approx(200.0, rel=1e-6)


def test_what_needs_a_sample_in_every_tick_is_refused_for_a_slow_device(at_rate):
    for changes, words in (
        ({"renderer": "passivity"}, "renderer = passivity needs 1000"),
        ({"prediction": "kalman"}, "a prediction needs 1000"),
    ):
        assert held(**at_rate(1000), **changes) is not None
        with pytest.raises(InputError, match=f"touch gives 500 samples a second, but {words}"):
            held(**at_rate(500), **changes)
