"""Prediction in the judge of stability.

Eigenvalues with a linearised predictor are compared with runs with the predictor itself.
"""

from copy import deepcopy
from dataclasses import replace
from math import inf

import numpy as np
import pytest

from meshes.base.errors import InputError
from tissue.haptics.device.device import device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m, in_hands
from tissue.haptics.loop.filters import low_pass_gain
from tissue.haptics.loop.forecast import Forecast, forecast_of
from tissue.haptics.loop.sampled_loop import plant_step
from tissue.prediction.predictor import Contact, Hold
from tissue.simulation.builders.prediction import maker_of

TICK = 1e-3


class Control(Hold):
    """Force that loses a tenth of itself every tick and follows a spring of 400 N/m with damping.

    The device keeps its speed over the ticks ahead. Between two ticks the force is interpolated.
    """

    def observe(self, position_m, velocity_m_s, force_N):
        self._device = position_m.copy(), velocity_m_s.copy()
        self._force = force_N.copy()

    def predict(self, ticks):
        place, speed = self._device
        forces = [self._force]
        for later in range(int(ticks) + 1):
            pull = -40.0 * (place + later * TICK * speed) - 0.2 * speed
            forces.append(0.9 * forces[-1] + pull)
        share = ticks - int(ticks)
        return (1.0 - share) * forces[-2] + share * forces[-1]


def bare(kind):
    """A predictor without the guard that may hand over to another."""
    made = maker_of(kind, scene_name="wall", file="", force_limit_N=3.3, encoder_step_m=5.5e-5)
    found = made()
    return getattr(found, "inner", found)


def loop_with(kind="none", *, delay_ticks=3, model_ticks=1, gain=1.0, lead=None, stiffness=400.0):
    """Return a Touch in an expert's hand with latency and low-pass, its forecast and predictor.

    The forecast is made from the predictor.
    """
    device = device_parameters("touch")
    loop = in_hands(
        device.loop(stiffness, filter_s=1e-3, model_ticks=model_ticks),
        [hand_parameters("expert").grip[:3]],
    )[0]
    loop = replace(loop, delay_s=loop.delay_s + delay_ticks * TICK)
    if kind == "none":
        return loop, None, 0
    lead = delay_ticks + 2 if lead is None else lead
    predictor = Control() if kind == "control" else bare(kind)
    forecast = forecast_of(
        predictor, lead_ticks=lead, stiffness_N_m=stiffness, model_ticks=model_ticks, gain=gain
    )
    return replace(loop, forecast=forecast), predictor, lead


def grows(loop, stiffness, predictor, lead, *, ticks=2500):
    """Return True if the contact grows with the predictor in the unchanged loop.

    The loop samples, shows, asks, filters and holds back.
    """
    predictor = deepcopy(predictor)
    whole = int(loop.delay_s / TICK + 1e-9)
    late = loop.delay_s - whole * TICK
    mass, damping = loop.mass_kg + loop.hand_mass_kg, loop.damping_N_s_m + loop.hand_damping_N_s_m
    steps = [
        (
            np.array(plant_step(mass, damping, loop.hand_stiffness_N_m, loop.amplifier_Hz, length))[
                :, :4
            ],
            back,
        )
        for length, back in ((late, whole + 1), (TICK - late, whole))
        if length > 0.0
    ]
    gain, filtered, raw = low_pass_gain(loop.filter_s, TICK), 0.0, 0.0
    plant, queue, before = np.array([0.0, 1e-3, 0.0, 0.0]), [0.0] * (whole + 2), 0.0
    sizes = np.zeros(ticks)
    # About a contact 1 mm deep, whose force is that of the rest: what is shown is the whole of
    # both.
    rest, force, up = -1e-3, 1e-3 * stiffness, np.array([0.0, 0.0, 1.0])
    for tick in range(-300, ticks):
        is_model_tick = tick % loop.model_ticks == 0
        place = plant[0] if tick >= 0 else 0.0
        if is_model_tick:
            raw = -stiffness * place
        speed = (place - before) / TICK
        before = place
        if loop.forecast.stiffness_N_m is not None:
            rigid = 1e6 * stiffness * np.outer(up, up)
            predictor.meet(Contact(stiffness, np.zeros(3), (force + raw) * up, rigid, normal=up))
        predictor.observe(
            (rest + place) * up, speed * up, (force + raw) * up if is_model_tick else None
        )
        predicted = float(predictor.predict(lead) @ up) - force
        if tick < 0:
            continue
        filtered += gain * (raw + loop.forecast.gain * (predicted - raw) - filtered)
        queue = [*queue[1:], filtered]
        for matrix, back in steps:
            plant[3] = queue[-1 - back]
            plant[:3] = matrix @ plant
        sizes[tick] = mass * plant[1] ** 2 + (stiffness + loop.hand_stiffness_N_m) * plant[0] ** 2
        if not sizes[tick] < 1e-2:
            return True
    third = ticks // 3
    return sizes[-third:].sum() > sizes[third : 2 * third].sum()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("hold", {}),
        ("linear", {}),
        ("linear", {"gain": 0.5}),
        ("kalman", {}),
        ("kalman", {"model_ticks": 4, "delay_ticks": 1}),
        ("linear", {"model_ticks": 5, "delay_ticks": 0}),
        ("control", {}),
        ("koopman", {}),
        ("koopman-look-ahead", {}),
        ("koopman-look-ahead", {"delay_ticks": 1, "gain": 0.5}),
        ("koopman-look-ahead", {"model_ticks": 4, "delay_ticks": 1}),
    ],
)
def test_the_judged_stiffness_is_where_the_loop_with_the_predictor_itself_starts_to_grow(
    kind, options
):
    """The eigenvalues' value within 2 % of bisection between 4 % below and above it."""
    loop, predictor, lead = loop_with(kind, **options)
    critical = critical_stiffness_N_m(loop)
    assert 10.0 < critical < 1e5
    assert not grows(loop, 0.98 * critical, predictor, lead)
    assert grows(loop, 1.02 * critical, predictor, lead)


def test_hold_and_no_gain_change_nothing():
    plain, _, _ = loop_with()
    held, _, _ = loop_with("hold")
    none, _, _ = loop_with("linear", gain=0.0)
    for loop in (held, none):
        assert critical_stiffness_N_m(loop) == pytest.approx(
            critical_stiffness_N_m(plain), rel=1e-9
        )


@pytest.mark.parametrize("force_N", [0.0, 1.0])
def test_a_constant_force_is_stable_on_every_wall(force_N):
    class Constant(Hold):
        def predict(self, ticks):
            return np.array([0.0, 0.0, force_N])

    constant = forecast_of(Constant(), lead_ticks=4, stiffness_N_m=400.0)
    assert not constant.taps.any()
    plain, _, _ = loop_with()
    loops = [replace(plain, forecast=replace(constant, gain=gain)) for gain in (0.5, 1.0)]
    half, whole = (critical_stiffness_N_m(loop) for loop in loops)
    # a gain of 0.5 shows half of the present force
    assert half == pytest.approx(2.0 * critical_stiffness_N_m(plain), rel=1e-9)
    assert whole == inf


def test_a_probed_predictor_has_the_taps_of_its_closed_form():
    """A recursive average a + 0.3 (F - a): the force seen k ticks ago has the share 0.3 0.7^k."""

    class Average(Hold):
        def observe(self, position_m, velocity_m_s, force_N):
            self._force = self._force + 0.3 * (force_N - self._force)

    probed = forecast_of(Average(), lead_ticks=0, stiffness_N_m=400.0)
    stated = Forecast(taps=np.multiply.outer(0.3 * 0.7 ** np.arange(80.0), [0.0, 0.0, 1.0])[None])
    count = min(probed.taps.shape[1], stated.taps.shape[1])
    np.testing.assert_allclose(probed.taps[:, :count], stated.taps[:, :count], atol=1e-6)
    plain, _, _ = loop_with()
    # A one-pole average is a low-pass of its own: the same loop with both poles in its filter is
    # the closed form here.
    found = [critical_stiffness_N_m(replace(plain, forecast=each)) for each in (probed, stated)]
    assert found[0] == pytest.approx(found[1], rel=1e-3) and found[0] < critical_stiffness_N_m(
        plain
    )


def test_what_cannot_be_judged_is_refused():
    class Sum(Hold):
        def observe(self, position_m, velocity_m_s, force_N):
            self._force = self._force + force_N

    with pytest.raises(
        InputError, match="predictor must have a response that decays within 512 ticks"
    ):
        forecast_of(Sum(), lead_ticks=0, stiffness_N_m=400.0)
