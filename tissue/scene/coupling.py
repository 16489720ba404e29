"""Haptic device of a scene: hand, coupling to the tool, and settings for a real device."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from meshes.base.errors import InputError
from tissue.scene.anatomy import WallAnatomy
from tissue.scene.names import DEVICES, HANDS, PERCEPTIONS, PREDICTORS, RENDERERS
from tissue.scene.part import FileName, OneOf, Part, Rule, Vector

__all__ = [
    "SMALLEST_MOTION_SCALE",
    "Coupling",
    "Device",
    "Fidelity",
    "Hardware",
    "WallAnatomy",
]

Button = Annotated[int, Field(ge=0, le=31)]
SMALLEST_MOTION_SCALE = 0.01
"""Lower limit of `Coupling.motion_scale`."""


class Hardware(Part):
    """Settings for a real device: connection, orientation of its axes, and limits of its force.

    The key ``coupling.motion_scale`` scales the motion of the device.
    """

    address: str = Field("", max_length=1000, examples=["ws://localhost:10001"])
    """Address or serial number of the device. If the text is empty, the usual address of the device
    is used.
    """
    turn_deg: Vector = (0.0, 0.0, 0.0)
    """Rotation from the axes of the device to the axes of the scene: angles about the scene's x, y
    and z axes, applied in this order.
    """
    clutch_button: Button | None = Field(None, examples=[1])
    """Number of the clutch button of the device; the first button is 0. While the user holds this
    button, the device moves without the tool. Default: no clutch button.
    """
    force_button: Button | None = Field(None, examples=[0])
    """Number of the button that the user must hold to feel any force (dead man's switch); the first
    button is 0. Default: no button has to be held.
    """
    force_cap_N: float | None = Field(None, gt=0, le=100, examples=[3.0])
    """Largest force that a real device exerts on the hand. Default: the force limit of the device.
    The key has no effect on a simulated device.
    """
    ramp_ms: float = Field(500.0, ge=0, le=10_000)
    """Time in which the force increases from zero to its full value. The force increases
    like this after the start, after the release of the clutch button, after the press of the force
    button, and after an interruption of the connection.
    """
    watchdog_ms: float = Field(20.0, ge=2, le=1000)
    """Time without a new sample from the device after which the force is set to zero."""

    def require_valid(self) -> None:
        """Check that `clutch_button` and `force_button` differ."""
        if self.clutch_button is not None and self.clutch_button == self.force_button:
            raise InputError(
                "hardware.clutch_button",
                "differ from hardware.force_button",
                f"{self.clutch_button} for both",
                "use another button for one of the two",
            )


class Coupling(Part):
    """Coupling of a haptic device to the tool."""

    stiffness_N_m: float | None = Field(None, ge=1, le=1e5, examples=[400.0])
    """Stiffness of the spring between device and tool, as felt at the device. Default: half of the
    largest stiffness that is stable with the chosen hand, but at most the published limit of the
    device.
    """
    stiffness_Nm_rad: float | None = Field(None, ge=0.06, le=1000, examples=[0.3])
    """Rotational stiffness of the spring between device and tool, as felt at a device with torque
    output. Default: half of the largest stiffness that is stable with the chosen hand, but at most
    the published limit of the device.
    """
    damping_N_s_m: float = Field(0.0, ge=0, le=1000)
    """Damping coefficient of the connection between device and tool, as felt at the device."""
    force_scale: Annotated[float, Field(ge=1e-4, le=100)] | Literal["auto"] = Field(
        "auto", examples=[0.1]
    )
    """Force at the device [N] for each newton at the tool. With `auto`, the scale is chosen so that
    users can best distinguish stiffnesses, with forces between the friction and the force limit of
    the device.
    """
    motion_scale: float = Field(1.0, ge=SMALLEST_MOTION_SCALE, le=100)
    """Tool displacement [m] for each metre of device displacement, measured from the start of the
    motion. Angles are not scaled.
    """
    delay_ms: int = Field(0, ge=0, le=200)
    """Latency that is added to the force before it is sent to the device, in ticks of 1 ms."""
    model_ms: int = Field(1, ge=1, le=100)
    """Time between two evaluations of the tissue model, in ticks of 1 ms. For a model that runs at
    100 Hz, it is 10.
    """
    prediction_gain: float = Field(1.0, ge=0, le=2)
    """Gain C of the force prediction. The device plays the force F + C (F_ahead - F), where F is
    the present force and F_ahead is the predicted force.
    """
    predictor_file: FileName = ""
    """File of a trained predictor, written by `tissue train`. If the text is empty, the predictor
    that is shipped for the built-in scene is used.
    """
    roam_mm: float | None = Field(None, ge=0, le=100, examples=[8.0])
    """Distance from the motion of the scene within which the tissue is prepared for contact with
    the tool. Default: 2 mm on an organ, and 0 on bone.
    """


class Device(Part):
    """A haptic device through which a hand moves the tool.

    Without this table, the tool moves as the table `motion` defines.
    """

    kind: Annotated[str, OneOf(DEVICES)] = Field(examples=["touch"])
    """Name of the device."""
    hand: Annotated[str, OneOf(HANDS)] = "expert"
    """User group of the hand that holds the device."""
    renderer: Annotated[str, OneOf(RENDERERS)] = "proxy"
    """Rendering law that converts contact of the tool into a force at the device."""
    prediction: Annotated[str, OneOf(PREDICTORS, ("none",))] = "none"
    """Force predictor, which compensates the latency of the force and of slow tissue models."""
    perception: Annotated[str, OneOf(PERCEPTIONS, ("none",))] = "none"
    """Model of force perception that scales the force at the device for a person. `population` is a
    model of an unknown person. `observer:FILE` is a model of one person, from a file that `tissue
    calibrate` wrote.
    """
    coupling: Coupling = Coupling()
    """Coupling of the device to the tool."""
    hardware: Hardware = Hardware()
    """Address and axes of a real device, and safety limits of its force."""

    def rules(self) -> Iterator[Rule]:
        """Yield the conditions under which the device or the predictor makes keys ineffective."""
        entry = DEVICES[self.kind]
        has_torque = entry.numbers.get("torque_limit_Nm", 0.0) > 0.0
        # koopman-online starts from a file where there is one.
        is_trained = self.prediction == "koopman-online" or (
            self.prediction != "none" and PREDICTORS[self.prediction].trained
        )
        simulated = f"with device = {self.kind}, for which there is no adapter"
        koopman = "set prediction = koopman"
        yield "hardware", not entry.has_adapter, simulated, "set device = haply"
        yield (
            "coupling.stiffness_Nm_rad",
            not has_torque,
            "with a device that plays no torque",
            "set device = six-dof",
        )
        yield "coupling.prediction_gain", self.prediction == "none", "without a prediction", koopman
        hold = "with prediction = hold, which uses the present force"
        yield "coupling.prediction_gain", self.prediction == "hold", hold, koopman
        yield (
            "coupling.predictor_file",
            not is_trained,
            "unless prediction is a trained predictor",
            koopman,
        )


class Fidelity(Part):
    """Requirements on the accuracy and the speed of a run.

    Accuracy and speed are measured on this machine for several settings, such as voxel sizes. With
    `force_error`, the run uses the fastest settings that meet the requirements. With `tick_ms`
    alone, the run uses the most accurate settings that are fast enough.
    """

    force_error: float | None = Field(None, gt=0, le=1, examples=[0.03])
    """Largest relative error of the force, against a fine reference solution without latency."""
    tick_ms: float | None = Field(None, gt=0, le=100, examples=[0.7])
    """Computing time within which at least 99 % of the ticks must end."""

    def require_valid(self) -> None:
        """Check that at least one of `force_error` and `tick_ms` is given."""
        if self.force_error is None and self.tick_ms is None:
            raise InputError(
                "fidelity",
                "have force_error or tick_ms",
                "neither",
                "add for example force_error = 0.03 or tick_ms = 0.7",
            )
