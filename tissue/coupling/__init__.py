"""Between a hand and a tissue: devices, hands, what keeps their loop stable, and how a contact becomes a force."""

from tissue.coupling.device import DEVICES, Device, DeviceError, DeviceParameters, Sample, device_parameters
from tissue.coupling.faulty import Fault, FaultyDevice
from tissue.coupling.guard import GuardLimits, SampleGuard
from tissue.coupling.hand import GROUPS, Hand, HandParameters, hand_parameters
from tissue.coupling.loop import WallLoop
from tissue.coupling.other_devices import MouseDevice, RecordedDevice
from tissue.coupling.renderer import RENDERERS, Renderer, TurningRenderer, renderer
from tissue.coupling.safe_device import SafeDevice
from tissue.coupling.signal import DelayLine, ForceRange, LowPass
from tissue.coupling.simulated_device import SimulatedDevice
from tissue.coupling.stability import Verdict, judge, require_stable

__all__ = [
    "DEVICES", "GROUPS", "RENDERERS", "DelayLine", "Device", "DeviceError", "DeviceParameters", "Fault",
    "FaultyDevice", "ForceRange", "GuardLimits", "Hand", "HandParameters", "LowPass", "MouseDevice", "RecordedDevice",
    "Renderer", "SafeDevice", "Sample", "SampleGuard", "SimulatedDevice", "TurningRenderer", "Verdict", "WallLoop",
    "device_parameters", "hand_parameters", "judge", "renderer", "require_stable",
]  # fmt: skip
