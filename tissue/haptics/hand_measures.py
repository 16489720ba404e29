"""Trace columns of a haptic device, of force prediction, and of a perception model."""

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
"""Trace columns of a device.

The columns are, in this order:

- Pose of the device [mm, quaternion].
- Force [N] and torque [N m] sent to the device.
- Force before it is compressed into the range of the device [N].
- Flag: 1 if the range compressed the force or the torque, otherwise 0.
- Energy taken from the device [J].
- Stability margin: 1 minus the stiffness divided by the critical stiffness.
- Force of the renderer before prediction, filter and delay [N].
"""
PREDICTED = (*(f"predicted_force_{c}_N" for c in "xyz"), "prediction_residual_N", "predicted_by")
"""Trace columns of a force prediction.

The columns are the predicted force, the magnitude of the last prediction error for one tick ahead,
and the source of the prediction: 1 for the predictor, 0 for the fallback predictor.
"""
PERCEIVED = ("estimated_force_N", "perceived", "perceived_spread", "above_threshold")
"""Trace columns of a perception model; see `tissue.perception.Perception`."""
VIBRATION = tuple(f"vibration_{c}_N" for c in "xyz")
"""Trace columns of the vibration of a spinning cutter.

The vibration is part of the device force. No other force column contains the vibration.
"""
CUE = tuple(f"cue_{c}_N" for c in "xyz")
"""Trace columns of cues: short force transients at contacts and punctures.

The device force includes the cues.
"""
TRUE = tuple(f"device_true_{c}_mm" for c in "xyz")
"""Trace columns of the true device position, before it is quantised by the encoders.

The columns exist only for devices that provide their true position, such as simulated devices.
"""
HAND_FORCE = tuple(f"hand_force_{c}_N" for c in "xyz")
"""Trace columns of the mean force of the device on the hand in the previous tick.

These columns exist only for devices that know their true position. The force is the motor force
minus the friction of the device and minus the force that accelerates the device's own mass. The
motor force is the force after latency, limits and amplifier.
"""

POSITION = slice(0, 3)
QUATERNION = slice(3, 7)
PLAYED_FORCE = slice(7, 10)
PLAYED_TORQUE = slice(10, 13)
FILTERED_FORCE = slice(13, 16)
SATURATED = 16
ENERGY = 17
MARGIN = 18
RAW_FORCE = slice(19, 22)
PREDICTED_FORCE = slice(22, 25)
RESIDUAL = 25
PREDICTED_BY = 26
