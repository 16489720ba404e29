"""Columns that a device, a prediction and a perception add to the trace, and where each lies
among them.
"""

__all__ = [
    "CUE",
    "ENERGY",
    "FILTERED_FORCE",
    "HAND_FORCE",
    "MARGIN",
    "MEASURES",
    "PERCEIVED",
    "PLAYED_FORCE",
    "PLAYED_TORQUE",
    "POSITION",
    "PREDICTED",
    "PREDICTED_BY",
    "PREDICTED_FORCE",
    "QUATERNION",
    "RAW_FORCE",
    "RESIDUAL",
    "SATURATED",
    "TRUE",
    "VIBRATION",
]

MEASURES = (
    *(f"device_{c}_mm" for c in "xyz"),
    *(f"device_q{c}" for c in "xyzw"),
    *(f"device_force_{c}_N" for c in "xyz"),
    *(f"device_torque_{c}_Nm" for c in "xyz"),
    *(f"filtered_force_{c}_N" for c in "xyz"),
    "saturated",
    "passivity_J",
    "margin",
    *(f"raw_force_{c}_N" for c in "xyz"),
)
"""Columns of a device: its pose, what it played, the filtered force before it was brought into the
device's range [N at the device], whether that compressed it or the torque, the energy taken from
the device, the share of the critical stiffness that is left, and the force of the renderer, before
prediction, filter and delay.
"""
PREDICTED = (*(f"predicted_force_{c}_N" for c in "xyz"), "prediction_residual_N", "predicted_by")
"""Columns of a prediction: force, size of the last one-tick error, and whose it is: 1 the
predictor's, 0 what it falls back on."""
PERCEIVED = ("estimated_force_N", "perceived", "perceived_spread", "above_threshold")
"""Columns of a perception: see `tissue.perception.Perception`."""
VIBRATION = tuple(f"vibration_{c}_N" for c in "xyz")
"""Columns of a spinning cutter's vibration: what the device's force holds of it; no other column
of a force does.
"""
CUE = tuple(f"cue_{c}_N" for c in "xyz")
"""Columns of the event cues, which are part of the device force."""
TRUE = tuple(f"device_true_{c}_mm" for c in "xyz")
"""Columns of a device that knows where it is, which its encoders only step through."""
HAND_FORCE = tuple(f"hand_force_{c}_N" for c in "xyz")
"""Columns of the same devices: the force with which the device pushes the hand, mean over the tick
before: that of the motors after latency, range and amplifier, less the device's friction and what
moves its own mass.
"""

POSITION, QUATERNION = slice(0, 3), slice(3, 7)
PLAYED_FORCE, PLAYED_TORQUE, FILTERED_FORCE = slice(7, 10), slice(10, 13), slice(13, 16)
SATURATED, ENERGY, MARGIN = 16, 17, 18
RAW_FORCE = slice(19, 22)
PREDICTED_FORCE, RESIDUAL, PREDICTED_BY = slice(22, 25), 25, 26
