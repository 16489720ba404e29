"""Haptic device of a scene: its hand, its coupling to the tool, and the processing of its force."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

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
    """Address or serial number of the device, in the form that its adapter requires. If the text is
    empty, the default address is used.
    """
    turn_deg: Vector = (0.0, 0.0, 0.0)
    """Rotation of the device's axes into the world's axes, about the world's x, then y, then z."""
    clutch_button: Button | None = Field(None, examples=[1])
    """Number of the clutch button. While the user holds this button, the device moves without the
    tool. The first button is 0. Default: no clutch button.
    """
    force_button: Button | None = Field(None, examples=[0])
    """Number of the button that the user must hold to get any force (dead man's switch). The first
    button is 0. Default: no button has to be held.
    """
    force_cap_N: float | None = Field(None, gt=0, le=100, examples=[3.0])
    """Largest force that a real device exerts on the hand. Default: the force limit of the device.
    A simulated device has only its own force limit.
    """
    ramp_ms: float = Field(500.0, ge=0, le=10_000)
    """Time in which the force increases from zero to its full value. This happens after the start,
    after the release of the clutch button, after the force button is pressed, and after a lost
    device responds again.
    """
    watchdog_ms: float = Field(20.0, ge=2, le=1000)
    """Time without a new sample after which the force is zero."""

    def require_valid(self) -> None:
        """Check that the clutch and the force have different buttons."""
        if self.clutch_button is not None and self.clutch_button == self.force_button:
            raise InputError(
                "hardware.clutch_button",
                "not be hardware.force_button",
                f"{self.clutch_button} for both",
                "use another button for one of them",
            )


class Coupling(Part):
    """Coupling of a device to the tool."""

    stiffness_N_m: float | None = Field(None, ge=1, le=1e5, examples=[400.0])
    """Stiffness of the coupling spring, as felt at the device. Default: half of the critical
    stiffness for the chosen hand, but at most the published limit of the device.
    """
    stiffness_Nm_rad: float | None = Field(None, ge=0.06, le=1000, examples=[0.3])
    """Rotational stiffness of the coupling, as felt at a device with torque output. Default: half
    of the critical stiffness for the chosen hand, but at most the published limit of the device.
    """
    damping_N_s_m: float = Field(0.0, ge=0, le=1000)
    """Damping coefficient of the coupling, as felt at the device."""
    force_scale: Annotated[float, Field(ge=1e-4, le=100)] | Literal["auto"] = Field(
        "auto", examples=[0.1]
    )
    """Force at the device [N] for each newton at the tool. `auto` chooses the scale at which people
    feel differences of stiffness best. With this scale, the forces lie between the friction and the
    force limit of the device.
    """
    motion_scale: float = Field(1.0, ge=0.01, le=100)
    """Tool displacement [m] for each metre of device displacement, measured from the start of the
    motion. Angles are not scaled.
    """
    delay_ms: int = Field(0, ge=0, le=200)
    """Latency that is added to the force before the device receives the force, in whole ticks."""
    model_ms: int = Field(1, ge=1, le=100)
    """Time between two evaluations of the tissue model, in whole ticks. A model at 100 Hz has 10.
    """
    prediction_gain: float = Field(1.0, ge=0, le=2)
    """Gain C in F + C (F_ahead - F), where F is the present force and F_ahead is the predicted
    force. With 0 the device plays the present force, and with 1 it plays the predicted force.
    """
    predictor_file: FileName = ""
    """File of a trained predictor that `tissue train` wrote. If the text is empty, the built-in
    predictor of the scene is used.
    """
    roam_mm: float | None = Field(None, ge=0, le=100, examples=[8.0])
    """Distance around the scripted motion within which the tissue is prepared for contact with the
    tool. Default: 2 mm on an organ, and 0 on bone.
    """


class Device(Part):
    """A haptic device. A hand moves the tool through the device.

    Without this table, the scripted motion moves the tool.
    """

    kind: Annotated[str, OneOf(DEVICES)] = Field(examples=["touch"])
    """Name of the device."""
    hand: Annotated[str, OneOf(HANDS)] = "expert"
    """Skill group of the hand that holds the device."""
    renderer: Annotated[str, OneOf(RENDERERS)] = "proxy"
    """Rendering law that converts contact of the tool into a force at the device."""
    prediction: Annotated[str, OneOf(PREDICTORS, ("none",))] = "none"
    """Predictor that compensates the latency of the force and of slow tissue models."""
    perception: Annotated[str, OneOf(PERCEPTIONS, ("none",))] = "none"
    """Perception model that scales the force at the device. `population` uses the constants of the
    population. `observer:FILE` uses the constants of one person, from a file that
    `tissue calibrate` wrote.
    """
    coupling: Coupling = Coupling()
    """Coupling of the device to the tool."""
    hardware: Hardware = Hardware()
    """Address and axes of a real device, and limits of the force that protect the user."""

    def rules(self) -> Iterator[Rule]:
        """Yield the rules for keys that have no effect with the chosen device or prediction."""
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

    With `force_error`, the program uses the fastest setting on this machine that satisfies the
    requirements. With `tick_ms` alone, it uses the most accurate setting that is fast enough.
    """

    force_error: float | None = Field(None, gt=0, le=1, examples=[0.03])
    """Largest error of the force, as a fraction of the reference force without latency."""
    tick_ms: float | None = Field(None, gt=0, le=100, examples=[0.7])
    """Longest time of a tick. At least 99 % of the ticks must end within this time."""

    def require_valid(self) -> None:
        """Check that an error or a time is required."""
        if self.force_error is None and self.tick_ms is None:
            raise InputError(
                "fidelity",
                "state an error or a time",
                "nothing",
                "use for example force_error = 0.03 or tick_ms = 0.7",
            )
