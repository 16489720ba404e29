"""Devices of other rates than the loop: the velocity is right in seconds."""

import numpy as np
import pytest
from hand_steps import held, meet

from tissue import InputError, Sample
from tissue.models.tissue_model import FreeSpace

RATES_HZ = [500, 1000, 2000]


class Sampled:
    """Device on a given path z(t) [m].

    It is `dated` by its own clock, or repeated with the time of the tick.
    """

    in_process = True

    def __init__(self, path, rate_Hz, *, dated):
        self.path, self.rate_Hz, self.dated = path, rate_Hz, dated

    def read(self, time_s):
        taken_s = int(time_s * self.rate_Hz + 1e-6) / self.rate_Hz
        return Sample(taken_s if self.dated else time_s, (0.0, 0.0, self.path(taken_s)))

    def command(self, force_N, torque_Nm):
        pass


@pytest.fixture
def at_rate(tmp_path):
    """Function that returns the changes of a scene in which the Touch has another rate."""

    def changes(rate_Hz):
        path = tmp_path / f"{rate_Hz}.toml"
        entry = (
            f'value = {rate_Hz}\nrange = [{rate_Hz}, {rate_Hz}]\nsource = "test"\nconfidence = '
            '"M"\n'
        )
        path.write_text(f"[devices.touch.rate_Hz]\n{entry}", "utf-8")
        return {"device": "touch", "materials": str(path), "coupling__stiffness_N_m": 100.0}

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


@pytest.mark.parametrize("name", ["wall", "milling"])
@pytest.mark.parametrize("dated", [True, False])
@pytest.mark.parametrize("rate_Hz", [*RATES_HZ, 700])
def test_the_velocity_of_a_ramp_is_its_slope(at_rate, rate_Hz, dated, name):
    """The velocity of a ramp is its slope.

    The law gets the velocities of device and tool in every tick, and the tool moves at that speed
    on average. A slow device repeats its samples, which must not count as rest, also in front of
    the position observer of a tool that cuts.
    """
    slope = -0.08
    motion = held(name, **at_rate(rate_Hz))
    assert motion.observes == (name == "milling")
    motion.device = Sampled(lambda time_s: 0.1 + slope * time_s, rate_Hz, dated=dated)
    law = motion._contact = Watched()
    tool_speeds = []

    class Free(FreeSpace):
        def respond(self, tool):
            tool_speeds.append(tool.speed_m_s * tool.heading[0, 2])
            return super().respond(tool)

    meet(motion, Free(), 0.6)
    device_speeds, law_speeds = np.array(law.speeds[-100:]).T
    # The observed position is held between the samples of a slow device. A tool with inertia
    # follows these steps with a ripple of 2.5 % of its speed.
    steps = name == "milling" and rate_Hz < 1000
    # Measured: 4e-6 at 500 Hz, which is left of the start of the observer after 0.5 s.
    np.testing.assert_allclose(device_speeds, slope, rtol=5e-6 if steps else 1e-10)
    np.testing.assert_allclose(law_speeds, slope, rtol=0.03 if steps else 1e-10)
    assert np.mean(tool_speeds[-140:]) == pytest.approx(slope, rel=5e-6)


@pytest.mark.parametrize("name", ["wall", "milling"])
def test_a_slow_device_that_repeats_a_sample_after_a_fault_starts_its_filter_again(at_rate, name):
    """A slow device that repeats a sample after a fault starts its filter again.

    The fault is in tick 101. In tick 102, the device repeats its sample of tick 100.
    """
    slope = -0.02

    class Faulty(Sampled):
        def read(self, time_s):
            sample = super().read(time_s)
            is_faulty = round(time_s / 1e-3) == 101
            return sample._replace(position_m=(np.nan,) * 3) if is_faulty else sample

    motion = held(name, **at_rate(250))
    motion.device = Faulty(lambda time_s: 0.1 + slope * time_s, 250, dated=True)
    law = motion._contact = Watched()
    meet(motion, FreeSpace(), 1.2)
    assert motion.guard.bad_ticks == 1
    # Ticks 102 and 103 repeat a sample, from which no velocity is known.
    assert not np.array(law.speeds[:2])[:, 0].any()
    np.testing.assert_allclose(np.array(law.speeds[-100:])[:, 0], slope, rtol=1e-5)


def test_what_needs_a_sample_in_every_tick_is_refused_for_a_slow_device(at_rate):
    for changes, words in (
        ({"renderer": "passivity"}, "renderer = passivity needs 1000"),
        ({"prediction": "kalman"}, "a prediction needs 1000"),
    ):
        assert held(**at_rate(1000), **changes) is not None
        with pytest.raises(InputError, match=f"touch gives 500 samples a second, but {words}"):
            held(**at_rate(500), **changes)
