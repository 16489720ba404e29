"""Settings used to judge and build a loop with a device, from a scene or a caller."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.hand.hand import HandParameters, hand_parameters
from tissue.haptics.loop.vibration import Vibration
from tissue.models.tissue_model import TICK_S
from tissue.prediction.predictor import Predictor
from tissue.scene.coupling import Coupling, WallAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool

if TYPE_CHECKING:
    from tissue.perception.perceived import Perception

__all__ = ["Contact", "LoopSettings", "loop_settings", "no_predictor", "sampled"]

Contact = Literal["cuts", "touches", "presses", "wall"]
"""Kind of contact of a tool.

A tool cuts, touches a rigid object, presses soft tissue, or presses the test wall.
"""


def no_predictor() -> None:
    """Return no predictor: the present force is played."""


def no_perception(rng: np.random.Generator) -> None:
    """Return no perception: the force is not scaled for a person."""


@dataclass(frozen=True)
class LoopSettings:
    """Settings of the loop of a device, a hand and a tool.

    Attributes
    ----------
    device, limits
        Name of the device in messages, and its parameters.
    hand, person
        Name of the hand in messages, and its parameters.
    coupling
        Stiffness, scales, latency, rate of the model.
    renderer
        Name of the law by which the device plays the contact force.
    low_pass_ms
        Time constant of the low-pass before the device.
    contact
        Kind of contact of the tool.
    teeth_Hz, vibration_share
        Rate at which a cutter's edges pass, 0 for none, and the amplitude of their vibration over
        the force.
    predictor
        Makes a new predictor of the force; None where the present force is played.
    perception
        Makes the person for whom the force is scaled, with a generator of its noise; None where the
        force is not scaled.
    cue_N
        Amplitude of the event cues [N]; 0 for none.
    """

    device: str
    limits: DeviceParameters
    hand: str
    person: HandParameters
    coupling: Coupling
    renderer: str
    low_pass_ms: float
    contact: Contact
    teeth_Hz: float = 0.0
    vibration_share: float = 0.0
    predictor: Callable[[], Predictor | None] = no_predictor
    perception: "Callable[[np.random.Generator], Perception | None]" = no_perception
    cue_N: float = 0.0

    @property
    def late(self) -> bool:
        """True if the tissue's balance is found a tick after the sample; only for soft organs."""
        return self.contact == "presses"

    @property
    def sample_s(self) -> float:
        """Time between two samples of the device [s]: a tick, or longer for a slow device."""
        return 1.0 / self.limits.rate_Hz

    @property
    def is_slow(self) -> bool:
        """True if the device gives fewer samples than there are ticks."""
        return self.sample_s > TICK_S * (1.0 + 1e-6)

    def vibration(self, step_s: float) -> Vibration | None:
        """Return the vibration of a cutter's teeth for a step [s]; None for no vibration."""
        if self.vibration_share == 0.0 or self.teeth_Hz == 0.0:
            return None
        return Vibration(self.teeth_Hz, share=self.vibration_share, step_s=step_s)


def sampled(limits: DeviceParameters) -> DeviceParameters:
    """Return a device as the loop samples it: a faster one is read once a tick."""
    return replace(limits, rate_Hz=min(limits.rate_Hz, 1.0 / TICK_S))


def loop_settings(scene: Scene) -> LoopSettings:
    """Return the settings that a scene states for its device, its hand and their coupling."""
    held = scene.held
    tool = scene.tool
    limits = sampled(device_parameters(held.kind, scene.constants))
    contact: Contact = "wall" if isinstance(scene.anatomy, WallAnatomy) else "presses"
    teeth_Hz = 0.0
    if isinstance(tool, Tool):
        contact = "touches" if tool.spin_rpm == 0.0 else "cuts"
        teeth_Hz = tool.flutes * abs(tool.spin_rpm) / 60.0

    predictor: Callable[[], Predictor | None] = no_predictor
    if held.prediction != "none":
        from tissue.simulation.builders.prediction import maker_of

        predictor = maker_of(
            held.prediction,
            scene_name=scene.name,
            file=scene.predictor_file,
            force_limit_N=limits.force_limit_N,
        )

    def perception(rng: np.random.Generator) -> "Perception | None":
        """Return the model of the person whom the scene names."""
        if held.perception == "none":
            return None
        from tissue.simulation.builders.perception import perception

        return perception(
            held.perception,
            rng=rng,
            force_limit_N=limits.force_limit_N,
            tick_s=TICK_S,
            friction_N=limits.friction_N,
        )

    return LoopSettings(
        held.kind,
        limits,
        held.hand,
        hand_parameters(held.hand, scene.constants),
        held.coupling,
        held.renderer,
        scene.output.low_pass_ms,
        contact,
        teeth_Hz,
        scene.output.vibration_share,
        predictor,
        perception,
        scene.output.cue_N,
    )
