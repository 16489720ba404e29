"""A scene's haptic device: whose hand holds it, how it is coupled to the tool, and what is done
to its force.
"""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, model_validator

from meshes.base.errors import InputError
from tissue.scene.anatomy import WallAnatomy
from tissue.scene.names import DEVICES, HANDS, PERCEPTIONS, PREDICTORS, RENDERERS
from tissue.scene.part import FileName, OneOf, Part, Rule, Vector

__all__ = ["Coupling", "Device", "Fidelity", "Hardware", "WallAnatomy"]

Button = Annotated[int, Field(ge=0, le=31)]


class Hardware(Part):
    """How a real device is opened, and how its workspace lies in the scene;
    ``coupling.motion_scale`` is its scale.
    """

    address: str = Field("", max_length=1000, examples=["ws://localhost:10001"])
    """Where the device is, as its adapter takes it: an address, a serial number; empty for the
    usual place.
    """
    turn_deg: Vector = (0.0, 0.0, 0.0)
    """Turn of the device's axes into the world's: about the world's x, then y, then z."""
    clutch_button: Button | None = Field(None, examples=[1])
    """Button, 0 the first, that lets the device move without the tool while it is held; without
    it there is none.
    """
    force_button: Button | None = Field(None, examples=[0])
    """Button, 0 the first, that must be held for any force (dead man's switch); without it none
    has to be held.
    """
    force_cap_N: float | None = Field(None, gt=0, le=100, examples=[3.0])
    """Greatest force on the hand; without it the device's own limit."""
    ramp_ms: float = Field(500.0, ge=0, le=10_000)
    """Time in which the force comes on from zero: after the start, the clutch, the force button
    and a lost device.
    """
    watchdog_ms: float = Field(20.0, ge=2, le=1000)
    """Time without a new sample after which the force is zero."""

    @model_validator(mode="after")
    def _buttons_differ(self) -> "Hardware":
        if self.clutch_button is not None and self.clutch_button == self.force_button:
            raise InputError(
                "hardware.clutch_button",
                "not be hardware.force_button",
                f"{self.clutch_button} for both",
                "use another button for one of them",
            )
        return self


class Coupling(Part):
    """How a device is coupled to the tool."""

    stiffness_N_m: float | None = Field(None, ge=1, le=1e5, examples=[400.0])
    """Stiffness at the device; without it half the critical one in that hand, at most the
    device's published limit.
    """
    stiffness_Nm_rad: float | None = Field(None, ge=0.06, le=1000, examples=[0.3])
    """The same for rotation, with a device that plays torque."""
    damping_N_s_m: float = Field(0.0, ge=0, le=1000)
    """Damping at the device."""
    force_scale: Annotated[float, Field(ge=1e-4, le=100)] | Literal["auto"] = Field(
        "auto", examples=[0.1]
    )
    """Newtons at the device for each newton at the tool; auto fits the script's largest force to
    the device.
    """
    motion_scale: float = Field(1.0, ge=0.01, le=100)
    """Metres at the tool for each metre at the device, both from where the motion starts; angles
    stay.
    """
    delay_ms: int = Field(0, ge=0, le=200)
    """Latency added before the device, in whole ticks."""
    model_ms: int = Field(1, ge=1, le=100)
    """Time for which one answer of the tissue holds, in whole ticks; 10 is a model at 100 Hz."""
    prediction_gain: float = Field(1.0, ge=0, le=2)
    """C of F + C (F_ahead - F): 0 plays the present force, 1 the one that is predicted."""
    predictor_file: FileName = ""
    """Trained predictor, as `tissue train` writes it; empty for the scene's own."""
    roam_mm: float | None = Field(None, ge=0, le=100, examples=[8.0])
    """How far around the scripted motion tissue is made ready for the tool; without it 2 mm on
    an organ, else none.
    """


class Device(Part):
    """A haptic device by which a hand moves the tool. Without this table the motion moves the
    tool.
    """

    kind: Annotated[str, OneOf(DEVICES)] = Field(examples=["touch"])
    """Name of the device."""
    hand: Annotated[str, OneOf(HANDS)] = "expert"
    """Whose hand holds the device."""
    renderer: Annotated[str, OneOf(RENDERERS)] = "proxy"
    """Law by which the device plays what the tool meets."""
    prediction: Annotated[str, OneOf(PREDICTORS, ("none",))] = "none"
    """What predicts the device's force ahead of latency and slow models."""
    perception: Annotated[str, OneOf(PERCEPTIONS, ("none",))] = "none"
    """For whom the device's force is scaled: none, population, or observer:FILE, as `tissue
    calibrate` writes it.
    """
    coupling: Coupling = Coupling()
    """How the device is coupled to the tool."""
    hardware: Hardware = Hardware()
    """Where a real device is, how its axes lie in the scene, and what protects the hand that
    holds it.
    """

    def rules(self) -> Iterator[Rule]:
        """Yield the rules of what the device and the prediction do not use."""
        entry = DEVICES[self.kind]
        has_torque = entry.numbers.get("torque_limit_Nm", 0.0) > 0.0
        is_trained = self.prediction != "none" and PREDICTORS[self.prediction].trained
        simulated = f"with device = {self.kind}, which no adapter opens"
        koopman = "set prediction = koopman"
        yield "hardware", not entry.has_adapter, simulated, "set device = haply"
        yield (
            "coupling.stiffness_Nm_rad",
            not has_torque,
            "with a device that plays no torque",
            "set device = six-dof",
        )
        yield "coupling.prediction_gain", self.prediction == "none", "without a prediction", koopman
        hold = "with prediction = hold, the present force"
        yield "coupling.prediction_gain", self.prediction == "hold", hold, koopman
        yield (
            "coupling.predictor_file",
            not is_trained,
            "unless a trained prediction is used",
            koopman,
        )


class Fidelity(Part):
    """The least fidelity of a run; the fastest setting of this machine that meets it is taken."""

    force_error: float | None = Field(None, gt=0, le=1, examples=[0.03])
    """Greatest error of the force, as a share of the reference force without latency."""
    tick_ms: float | None = Field(None, gt=0, le=100, examples=[0.7])
    """Time within which 99 % of the ticks shall end."""

    @model_validator(mode="after")
    def _asks_for_something(self) -> "Fidelity":
        if self.force_error is None and self.tick_ms is None:
            raise InputError(
                "fidelity",
                "ask for something",
                "nothing",
                "use force_error = 0.03 or tick_ms = 0.7",
            )
        return self
