"""Haptic device of a scene: its hand, its coupling to the tool, and the processing of its force."""

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
    """Connection of a real device, and placement of its workspace in the scene.

    The scale of the workspace is ``coupling.motion_scale``.
    """

    address: str = Field("", max_length=1000, examples=["ws://localhost:10001"])
    """Device address or serial number, as the adapter takes it; empty for the default location."""
    turn_deg: Vector = (0.0, 0.0, 0.0)
    """Rotation of the device's axes into the world's axes, about the world's x, then y, then z."""
    clutch_button: Button | None = Field(None, examples=[1])
    """Number of the button that lets the device move without the tool while it is held. The first
    button is 0. Default: no such button.
    """
    force_button: Button | None = Field(None, examples=[0])
    """Number of the button that must be held for any force (dead man's switch). The first button is
    0. Default: no button has to be held.
    """
    force_cap_N: float | None = Field(None, gt=0, le=100, examples=[3.0])
    """Largest force on the hand. Default: the device's limit."""
    ramp_ms: float = Field(500.0, ge=0, le=10_000)
    """Time in which the force ramps up from zero. The ramp follows the start, the clutch, the force
    button and a lost device.
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
    """Coupling of a device to the tool."""

    stiffness_N_m: float | None = Field(None, ge=1, le=1e5, examples=[400.0])
    """Stiffness at the device. Default: half the critical stiffness in that hand, at most the
    device's published limit.
    """
    stiffness_Nm_rad: float | None = Field(None, ge=0.06, le=1000, examples=[0.3])
    """Rotational stiffness at the device, for a device that plays torque. Default: half the
    critical stiffness in that hand, at most the device's published limit.
    """
    damping_N_s_m: float = Field(0.0, ge=0, le=1000)
    """Damping at the device."""
    force_scale: Annotated[float, Field(ge=1e-4, le=100)] | Literal["auto"] = Field(
        "auto", examples=[0.1]
    )
    """Newtons at the device for each newton at the tool. `auto` chooses the scale at which people
    best feel differences of stiffness, between the device's friction and its limit.
    """
    motion_scale: float = Field(1.0, ge=0.01, le=100)
    """Metres at the tool for each metre at the device, from the start of the motion. Angles are not
    scaled.
    """
    delay_ms: int = Field(0, ge=0, le=200)
    """Latency added before the device, in whole ticks."""
    model_ms: int = Field(1, ge=1, le=100)
    """Time for which one tissue response is held, in whole ticks; 10 is a model at 100 Hz."""
    prediction_gain: float = Field(1.0, ge=0, le=2)
    """Gain C in F + C (F_ahead - F): 0 plays the present force, 1 the predicted force."""
    predictor_file: FileName = ""
    """Trained predictor, as `tissue train` writes it; empty for the scene's own predictor."""
    roam_mm: float | None = Field(None, ge=0, le=100, examples=[8.0])
    """Distance around the scripted motion within which tissue is prepared for the tool. Default: 2
    mm on an organ, otherwise none.
    """


class Device(Part):
    """A haptic device with which a hand moves the tool.

    Without this table, the motion moves the tool.
    """

    kind: Annotated[str, OneOf(DEVICES)] = Field(examples=["touch"])
    """Name of the device."""
    hand: Annotated[str, OneOf(HANDS)] = "expert"
    """Hand that holds the device."""
    renderer: Annotated[str, OneOf(RENDERERS)] = "proxy"
    """Law that renders the tool's contact force at the device."""
    prediction: Annotated[str, OneOf(PREDICTORS, ("none",))] = "none"
    """Predictor of the device's force ahead of latency and slow models."""
    perception: Annotated[str, OneOf(PERCEPTIONS, ("none",))] = "none"
    """Perception model that scales the device's force: none, population, or observer:FILE. `tissue
    calibrate` writes the file.
    """
    coupling: Coupling = Coupling()
    """Coupling of the device to the tool."""
    hardware: Hardware = Hardware()
    """Address and axes of a real device, and limits that protect the hand."""

    def rules(self) -> Iterator[Rule]:
        """Yield the rules for keys that the device and the prediction do not use."""
        entry = DEVICES[self.kind]
        has_torque = entry.numbers.get("torque_limit_Nm", 0.0) > 0.0
        # koopman-online starts from a file where there is one.
        is_trained = self.prediction == "koopman-online" or (
            self.prediction != "none" and PREDICTORS[self.prediction].trained
        )
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
    """Required fidelity of a run.

    With `force_error`, the fastest setting on this machine that satisfies the requirements is used.
    With `tick_ms` alone, the most accurate one is used.
    """

    force_error: float | None = Field(None, gt=0, le=1, examples=[0.03])
    """Largest error of the force, as a fraction of the reference force without latency."""
    tick_ms: float | None = Field(None, gt=0, le=100, examples=[0.7])
    """Time within which 99 % of the ticks must end."""

    @model_validator(mode="after")
    def _asks_for_something(self) -> "Fidelity":
        if self.force_error is None and self.tick_ms is None:
            raise InputError(
                "fidelity",
                "state an error or a time",
                "nothing",
                "use for example force_error = 0.03 or tick_ms = 0.7",
            )
        return self
