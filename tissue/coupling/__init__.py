"""Between a hand and a tissue: devices, hands, what keeps their loop stable, and how a contact becomes a force."""

from tissue.coupling.signal import DelayLine, ForceRange, LowPass, cutoff_hz, low_pass_gain, relaxation_bound

__all__ = ["DelayLine", "ForceRange", "LowPass", "cutoff_hz", "low_pass_gain", "relaxation_bound"]
