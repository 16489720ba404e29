"""Haptic loops for translation and rotation: settings, and stability check before the run."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, isfinite
from typing import TYPE_CHECKING, Literal

import numpy as np

from meshes.base.errors import InputError, names_of_caller
from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.hand.hand import HandParameters, hand_parameters
from tissue.haptics.loop.critical_stiffness import (
    LinearHand,
    Verdict,
    critical_stiffness_N_m,
    in_hands,
    judge,
    nearest_stable_N_m,
    settling_hands,
)
from tissue.haptics.loop.filters import OBSERVER_MEMORY, VELOCITY_MEMORY
from tissue.haptics.loop.forecast import Forecast, forecast_of
from tissue.haptics.loop.sampled_loop import WallLoop, motor_lag_ticks
from tissue.haptics.loop.vibration import Vibration
from tissue.materials.scene_constants import Materials
from tissue.models.tissue_model import TICK_S
from tissue.prediction.guard import Guarded, Outside
from tissue.prediction.predictor import Predictor
from tissue.scene.coupling import Coupling, Device, WallAnatomy
from tissue.scene.organ import IncisedAnatomy
from tissue.scene.scene import Output, Scene
from tissue.scene.tool import Tool

if TYPE_CHECKING:
    from tissue.perception.perceived import Perception

Contact = Literal["cuts", "touches", "presses", "springs"]
"""Kind of contact between a tool and the tissue.

A tool cuts, touches a rigid object, presses soft tissue, or presses a tissue that reports its
stiffness (`Response.stiffness_N_m`), such as the virtual wall of a scene.
"""
SHARE = 0.5
"""Coupling stiffness divided by the critical stiffness of the loop with the scene's hand.

The ratio sets the coupling stiffness if the scene gives none. Above the critical stiffness, the
loop is unstable. Half of the critical stiffness without a hand would be seven to nine times
smaller. With both stiffnesses, a device that is released on a wall leaves the wall within some
hundredths of a second; see tests/stability/test_wall_laws.py.
"""
REST_SHARE = 0.3
"""Contact force at which a predictor is linearised, divided by the device's largest force.

The value is well below 0.7, the ratio above which forces are compressed to the range of the device.
"""
USUAL_N_M = 1000.0
"""Coupling stiffness at which a predictor is linearised, typical of a desktop device [N/m].

The value is used for a device without a stiffness limit.
"""


@dataclass(frozen=True)
class LoopSettings:
    """Settings of the haptic loop that connects a hand, a device and a tool.

    Attributes
    ----------
    held, output
        Scene tables of the device (with hand, coupling and renderer) and of the output.
    name, limits
        Name of the device in messages, and parameters of the device.
    constants
        Constants of the hand.
    contact
        Kind of contact of the tool.
    teeth_Hz
        Rate at which the cutting edges pass [Hz]; 0 for a tool without edges.
    scene_name
        Name of the scene. A trained predictor must have been trained for this scene.
    own_predictor
        Function that makes a new predictor. With None, the predictor that the device table names is
        used.
    """

    held: Device
    output: Output
    name: str
    limits: DeviceParameters
    constants: Materials
    contact: Contact
    teeth_Hz: float = 0.0
    scene_name: str = ""
    own_predictor: Callable[[], Predictor] | None = None

    @property
    def coupling(self) -> Coupling:
        """Scene table of the coupling: stiffness, scales, latency and rate of the tissue model."""
        return self.held.coupling

    @cached_property
    def person(self) -> HandParameters:
        """Parameters of the hand."""
        return hand_parameters(self.held.hand, self.constants)

    @cached_property
    def _maker(self) -> Callable[[], Predictor]:
        from tissue.simulation.builders.prediction import maker_of

        return maker_of(
            self.held.prediction,
            scene_name=self.scene_name,
            file=self.coupling.predictor_file,
            force_limit_N=self.limits.force_limit_N,
            encoder_step_m=self.limits.encoder_step_m,
        )

    def predictor(self) -> Predictor | None:
        """Return a new predictor of the force; None if forces are not predicted."""
        if self.own_predictor is not None:
            return self.own_predictor()
        return None if self.held.prediction == "none" else self._maker()

    def perception(self, rng: np.random.Generator) -> "Perception | None":
        """Return the perceptual map that scales the force; `rng` generates the sensory noise.

        The result is None if the scene requests no perceptual map.
        """
        if self.held.perception == "none":
            return None
        from tissue.simulation.builders.prediction import perception

        return perception(
            self.held.perception,
            rng=rng,
            force_limit_N=self.limits.force_limit_N,
            tick_s=TICK_S,
            friction_N=self.limits.friction_N,
        )

    @property
    def sample_s(self) -> float:
        """Time between two samples of the device [s]: one tick, or longer for a slow device."""
        return 1.0 / self.limits.rate_Hz

    @property
    def is_slow(self) -> bool:
        """True if the device gives fewer samples than there are ticks."""
        # 1e-6 allows for rounding: a device at 1 kHz is not slow.
        return self.sample_s > TICK_S * (1.0 + 1e-6)

    def vibration(self, step_s: float) -> Vibration | None:
        """Return the vibration of a cutter's teeth, sampled with a time step [s], or None."""
        share = self.output.vibration_share
        if share == 0.0 or self.teeth_Hz == 0.0:
            return None
        return Vibration(self.teeth_Hz, share=share, step_s=step_s)


def sampled(limits: DeviceParameters) -> DeviceParameters:
    """Return the parameters of a device, with its sample rate limited to one sample per tick."""
    return replace(limits, rate_Hz=min(limits.rate_Hz, 1.0 / TICK_S))


def loop_settings(scene: Scene) -> LoopSettings:
    """Return the settings of a scene for device, hand and coupling."""
    held = scene.held
    tool = scene.tool
    limits = sampled(device_parameters(held.kind, scene.constants))
    springs = isinstance(scene.anatomy, WallAnatomy | IncisedAnatomy)
    contact: Contact = "springs" if springs else "presses"
    teeth_Hz = 0.0
    if isinstance(tool, Tool):
        contact = "touches" if tool.spin_rpm == 0.0 else "cuts"
        teeth_Hz = tool.flutes * abs(tool.spin_rpm) / 60.0
    return LoopSettings(
        held, scene.output, held.kind, limits, scene.constants, contact, teeth_Hz, scene.name
    )


@dataclass(frozen=True)
class JudgedLoop:
    """Haptic loop, including its total delay, and the result of its stability check.

    Attributes
    ----------
    loop
        Loop with the given or chosen stiffness. For the loop of rotation, the units are those of
        rotation, such as N m/rad.
    verdict
        Result of the stability check for the loop with the hand.
    unit
        Unit of the stiffness.
    alone
        Critical stiffness of the loop without a hand.
    """

    loop: WallLoop
    verdict: Verdict
    unit: str
    alone: float

    def sentence(self) -> str:
        """Return a sentence on the stiffness of the loop and on its stability with a hand."""
        return self.verdict.sentence(self.loop.stiffness_N_m).replace("N/m", self.unit)


def release_note(settings: LoopSettings, loops: Sequence[JudgedLoop]) -> str:
    """Return a text about the loops that are stable only with a hand, or an empty text.

    The text names the mechanisms, other than a hand, that can stop an oscillation of the device.
    """
    limits = " and ".join(
        f"{each.alone:.3g} {each.unit}"
        for each in loops
        if each.verdict.stable and each.loop.stiffness_N_m >= each.alone
    )
    if not limits:
        return ""
    saves = "friction (or renderer = passivity)"
    if settings.held.renderer == "passivity":
        saves = "friction and the passivity controller"
    return (
        "If the hand lets go while the tissue holds the tool from two sides, the device can "
        f"oscillate. Without a hand, the coupling is stable only below {limits}. "
        f"Only {saves} can stop the oscillation"
    )


def judged_loops(
    settings: LoopSettings, *, allow_unstable: bool
) -> tuple[JudgedLoop, JudgedLoop | None]:
    """Check and return the loop of translation and, if the device has torque, the loop of rotation.

    The check of the rotational loop takes into account that a contact at a lever arm couples both
    loops.

    Raises
    ------
    InputError
        If a loop is unstable and `allow_unstable` is not set.
    """

    def judged(
        loop: WallLoop, hands: tuple[LinearHand, ...], steepest: float, key: str, unit: str
    ) -> JudgedLoop:
        """Return the stability of a loop after multiplying its force slope by `steepest`."""
        verdict = judge(loop.with_stiffness(steepest * loop.stiffness_N_m), hands)
        critical = verdict.critical_N_m / steepest
        nearest = loop.stiffness_N_m if verdict.stable else nearest_stable_N_m(critical)
        verdict = replace(verdict, critical_N_m=critical, nearest_N_m=nearest)
        if not verdict.stable and not allow_unstable:
            raise _refusal(settings, verdict, loop.stiffness_N_m, key)
        return JudgedLoop(loop, verdict, unit, critical_stiffness_N_m(loop) / steepest)

    person = settings.person
    loop = judged_loop(settings)
    hands = settling_hands(loop, person.linear_hands)
    position = judged(loop, hands, _steepest(settings), "stiffness_N_m", "N/m")
    if settings.limits.torque_limit_Nm <= 0.0:
        return position, None
    hands = (LinearHand(*person.grip[3:]),)
    steepest = 1.0 / _usable_share(position.verdict)
    turning = _turning_loop(settings)
    return position, judged(turning, hands, steepest, "stiffness_Nm_rad", "N m/rad")


def _usable_share(position: Verdict) -> float:
    """Return the share of the critical rotational stiffness that a loop of rotation may use.

    A contact at a lever arm couples both loops. If each loop has its critical stiffness, the
    coupled loops may be unstable. If one loop has at most `SHARE` of its critical stiffness, the
    other loop may use its full critical stiffness. Otherwise, the sum of both shares is limited to
    1 + `SHARE`. In tests, the smallest sum of shares at which an oscillation grew is 1.76. In this
    test, bone blocks a cutter 55 mm from its tip on a sigma-7; see
    tests/stability/test_judged_loops.py.
    """
    return min(max(SHARE + position.margin, SHARE), 1.0)


def _steepest(settings: LoopSettings) -> float:
    """Return the largest slope of the commanded force as a function of the contact force."""
    perception = settings.perception(np.random.default_rng(0))
    return 1.0 if perception is None else perception.steepest


def judged_loop(settings: LoopSettings) -> WallLoop:
    """Return the loop, including its total delay, with which a coupling is checked for stability.

    The force responds to a device sample in the same tick if the tool cuts, touches bone, or
    presses a tissue that reports its stiffness. For any other tissue, the force balance is found
    one tick later, and the model of the tool estimates the stiffness of the tissue from the last
    motion. For a tool that slides along the surface, the estimate is the stiffness along the
    surface. If the predictor has a fallback, the loop contains whichever of the two has the lower
    critical stiffness. The loop also includes the vibration of a cutter's teeth, because the
    amplitude of the vibration is proportional to the force.

    A slow device holds each force until its next sample, so its loop is checked at the sample rate
    of the device.

    Raises
    ------
    InputError
        If the device is slow and the renderer or the prediction needs a sample in every tick.
    """
    limits = settings.limits
    chosen = settings.coupling
    if settings.is_slow and settings.held.renderer == "passivity":
        raise _too_slow(settings, "renderer = passivity", "renderer = proxy or penalty")
    loop = limits.loop(
        1.0,
        wall_damping_N_s_m=chosen.damping_N_s_m,
        filter_s=1e-3 * settings.output.low_pass_ms,
        model_ticks=_model_samples(settings),
    )
    cuts = settings.contact == "cuts"
    loop = replace(
        loop,
        velocity_memory=OBSERVER_MEMORY if cuts else VELOCITY_MEMORY,
        observes=cuts,
        vibration=settings.vibration(loop.tick_s),
    )
    hand = settings.person.grip[:3]
    loops = [
        replace(_delayed(settings, loop, TICK_S * (settings.contact == "presses")), forecast=each)
        for each in _forecasts(settings)
    ]
    loop = (
        min(loops, key=lambda each: critical_stiffness_N_m(in_hands(each, [hand])[0]))
        if loops[1:]
        else loops[0]
    )
    return _chosen(
        loop, hand, chosen.stiffness_N_m, limits.stiffness_limit_N_m, _steepest(settings)
    )


def lead_ticks(settings: LoopSettings) -> float:
    """Return the prediction horizon: the delay of a force on its path to the motor [ticks]."""
    return motor_lag_ticks(motor_path(settings))


def horizon_text(horizon_ms: float, delay_ms: float) -> str:
    """Return a text with a prediction horizon and its parts: coupling latency and remainder."""
    rest_ms = horizon_ms - delay_ms
    return (
        f"{horizon_ms:.3g} ms (coupling.delay_ms = {delay_ms:g}, and {rest_ms:.3g} ms for device, "
        "low-pass and zero-order hold)"
    )


def motor_path(settings: LoopSettings) -> WallLoop:
    """Return a loop with only the stages that a force passes on its path to the motor.

    The stages are low-pass, latency, transport, zero-order hold and amplifier.
    """
    path = replace(device_path(settings.limits), filter_s=1e-3 * settings.output.low_pass_ms)
    return _delayed(settings, path, 0.0)


def device_path(limits: DeviceParameters) -> WallLoop:
    """Return a loop, in ticks of 1 ms, with only the stages that the force passes in the device.

    The stages are transport, zero-order hold and amplifier. A slow device holds each force longer
    than a tick. Half of the additional hold time is therefore added as delay.
    """
    loop = sampled(limits).loop(1.0)
    return replace(loop, tick_s=TICK_S, delay_s=loop.delay_s + 0.5 * (loop.tick_s - TICK_S))


def _forecasts(settings: LoopSettings) -> list[Forecast | None]:
    """Return the linearised model of the predictor and, for a guarded predictor, of its fallback.

    If forces are not predicted, the only element of the list is None.

    The models are linearised for a tool at rest in contact. The contact force is the share
    `REST_SHARE` of the device's largest force.
    """
    predictor = settings.predictor()
    chosen = settings.coupling
    limits = settings.limits
    if predictor is None:
        return [None]
    if settings.is_slow:
        raise _too_slow(settings, "a prediction", "prediction = none")
    limit = limits.stiffness_limit_N_m
    # The responses of the forecast are proportional to its stiffness (`Forecast.stiffness_N_m`).
    # This stiffness does not depend on the scene, so all couplings share one forecast and one
    # critical stiffness.
    stiffness = limit if isfinite(limit) else USUAL_N_M
    judged: list[Predictor] = [predictor]
    if isinstance(predictor, Guarded):
        judged = [predictor.inner, predictor.instead]
    name = judged[0].name if isinstance(judged[0], Outside) else settings.held.prediction
    with names_of_caller({"predictor": f"predictor {name}"}):
        return [
            forecast_of(
                each,
                lead_ticks=lead_ticks(settings),
                stiffness_N_m=stiffness,
                depth_m=REST_SHARE * limits.force_limit_N / stiffness,
                model_ticks=chosen.model_ms,
                gain=chosen.prediction_gain,
            )
            for each in judged
        ]


def _turning_loop(settings: LoopSettings) -> WallLoop:
    """Return the loop for the stability check of the rotational coupling.

    For a pressing tool, the rotational stiffness of the tissue is estimated, so the balance of
    torques may be found one tick later.
    """
    limits = settings.limits
    chosen = settings.coupling
    loop = limits.turning_loop(
        1.0, filter_s=1e-3 * settings.output.low_pass_ms, model_ticks=_model_samples(settings)
    )
    hand = settings.person.grip[3:]
    late = 0.0 if settings.contact in ("cuts", "touches") else TICK_S
    return _chosen(
        _delayed(settings, loop, late), hand, chosen.stiffness_Nm_rad, limits.stiffness_limit_Nm_rad
    )


def _chosen(
    loop: WallLoop,
    hand: tuple[float, float, float],
    given: float | None,
    limit: float,
    steepest: float = 1.0,
) -> WallLoop:
    """Return the loop with the given stiffness or, if none is given, with a chosen stiffness.

    The chosen stiffness is half of the critical stiffness in a hand without reflex, divided by
    `steepest`, but at most `limit`.
    """
    if given is None:
        critical = critical_stiffness_N_m(in_hands(loop, [hand])[0])
        # If the critical stiffness is 0, the limit is used. The check then refuses it and reports
        # the reason.
        given = min(SHARE * critical / steepest, limit) or limit
    return loop.with_stiffness(given)


def _delayed(settings: LoopSettings, loop: WallLoop, extra_s: float) -> WallLoop:
    """Return the loop with the latency of the coupling and an additional delay [s]."""
    return replace(loop, delay_s=loop.delay_s + 1e-3 * settings.coupling.delay_ms + extra_s)


def _model_samples(settings: LoopSettings) -> int:
    """Return the number of device samples for which one response of the tissue model is used."""
    return max(ceil(settings.coupling.model_ms * TICK_S / settings.sample_s - 1e-9), 1)


def _too_slow(settings: LoopSettings, what: str, remedy: str) -> InputError:
    """Return the error for a device whose sample rate is too low for a stage of the loop."""
    return InputError(
        f"{settings.name} gives {settings.limits.rate_Hz:.4g} samples a second, but {what} "
        f"needs {1.0 / TICK_S:g}. "
        f"Use {remedy}, or a faster device"
    )


def _refusal(settings: LoopSettings, verdict: Verdict, stiffness: float, key: str) -> InputError:
    """Return the error for an unstable coupling."""
    allow = "set allow_unstable (--allow-unstable)"
    if verdict.critical_N_m == 0.0 and not settings.scene_name:  # a loop that a caller made
        return InputError(
            "delay_ms",
            "be small enough for a stable coupling",
            f"{settings.coupling.delay_ms:g}",
            f"reduce delay_ms or low_pass_ms, use another predictor, or {allow}",
        )
    if verdict.critical_N_m == 0.0:
        return InputError(
            "coupling.damping_N_s_m",
            "be small enough for a stable coupling",
            f"{settings.coupling.damping_N_s_m:g}",
            "reduce it, coupling.delay_ms, output.low_pass_ms or coupling.prediction_gain, or "
            f"{allow}",
        )
    return InputError(
        f"coupling.{key}",
        f"be below {verdict.critical_N_m:.4g} to be stable with device = {settings.name} in the "
        f"hand of {person_of(settings.held.hand)}",
        f"{stiffness:g} (stability margin {100.0 * verdict.margin:.1f} %)",
        f"use {verdict.nearest_N_m:g}, or {allow}",
    )


def person_of(hand: str) -> str:
    """Return the name of an expertise group with its article, such as "an expert"."""
    return f"a{'n' * (hand[0] in 'aeiou')} {hand}"
