"""Mass, damping and friction of a haptic device from logs of it free and held.

The tip obeys ``m a + b v + c v / |v| = gain motors + hand``. Both sides are averaged with a window, see
`tissue.fitting.device_windows`; the equation is linear in the constants. What delays the motors is the offset of clocks
that every fit estimates. An amplifier of time constant tau delays by tau, and weakens a tone w by (w tau)^2 / 2: the
command is what is needed of the motors less tau^2 / 2 times its second derivative, over the gain. The force sensor of
the held log has a clock of its own, and channels of its own, whose bias and noise are its own.

While the tip is at rest, friction is anything up to c: such windows are left out. They bound c from below, see
`least_friction_N`. The motors give a gain times what is commanded, which is estimated with the constants: a log of
motor forces alone determines these in units of the gain; the force sensor of the held log is what makes them newtons.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.sparse import csr_array

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.fitting.device_windows import APART_S, GRID_S, DeviceAverages, DeviceLog, device_averages, rests
from tissue.fitting.measured import FEWEST, MeasuredLoads
from tissue.fitting.parameter import Parameter
from tissue.fitting.shift import shift_operators
from tissue.materials.constants import Constant, constants
from tissue.materials.prior import Prior

__all__ = ["DeviceForward", "device_fit", "least_friction_N"]

AXES = ("x", "y", "z")
CONSTANTS = ("mass_kg", "damping_N_s_m", "friction_N")
GAIN = Parameter("motors.gain", Prior(1.0, 0.85, 1.18))
"""What motors give over what is commanded: 10 % between copies of a device (from memory of the literature)."""
HAND_CLOCK = Parameter("motors.hand_later_s", Prior(0.0, -0.033, 0.033))
"""Offset of the hand's force sensor against the motors' commands: two instruments, as the offset of every fit."""


@dataclass(frozen=True, eq=False)
class DeviceForward:
    """The averaged equation of a device; a `Forward`.

    Attributes
    ----------
    parameters, channels, times_s
        See `tissue.fitting.forward.Forward`; mass, damping, friction, gain and lag of the motors, and the clock of the
        hand's sensor where there is one. The held log follows the free one in time, in channels of its own.
    free, held
        Averages of the logs; None without a held one.
    """

    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    times_s: Array
    free: DeviceAverages
    held: DeviceAverages | None

    def loads(self, x: Array) -> Array:
        """See `Forward`."""
        free = self.free
        found = np.zeros((len(self.times_s), len(self.channels)))
        first, second = self._blocks(found)
        first[:] = ((free.basis - 0.5 * x[4] ** 2 * free.bends) @ x[:3]) / x[3]
        if self.held is not None:
            second[:] = self._later(x, self.held)[0] @ (self.held.basis @ x[:3] - x[3] * self.held.motors_N)
        return found

    def jacobian(self, x: Array) -> Array:
        """See `Forward`."""
        found = np.zeros((len(self.times_s), len(self.channels), len(self.parameters)))
        first, second = self._blocks(found)
        mixed = self.free.basis - 0.5 * x[4] ** 2 * self.free.bends
        first[..., :3] = mixed / x[3]
        first[..., 4] = -x[4] * (self.free.bends @ x[:3]) / x[3]
        first[..., 3] = -(mixed @ x[:3]) / x[3] ** 2
        if self.held is not None:
            values, moved = self._later(x, self.held)
            basis = self.held.basis
            second[..., :3] = (values @ basis.reshape(len(basis), -1)).reshape(basis.shape)
            second[..., 3] = -(values @ self.held.motors_N)
            second[..., 5] = moved @ (basis @ x[:3] - x[3] * self.held.motors_N)
        return found

    def _blocks(self, values: Array) -> tuple[Array, Array]:
        """The parts of the free and the held log, of what has shape (n, channels) or (n, channels, any)."""
        rows, axes, _ = self.free.basis.shape
        return values[:rows, :axes], values[rows:, axes:]

    def _later(self, x: Array, held: DeviceAverages) -> tuple[csr_array, csr_array]:
        """Values of the held log on the clock of the hand's sensor, and derivatives by its offset, as matrices."""
        times_s = self.times_s[: len(held.basis)]
        return shift_operators(times_s, times_s, float(x[5]))


def device_fit(name: str, free: DeviceLog, held: DeviceLog | None = None) -> tuple[DeviceForward, MeasuredLoads]:
    """What a fit of a device of `tissue/materials/devices.toml` takes: the averaged equation, and what was measured.

    Raises
    ------
    InputError
        If the device is not listed, hardly moves, or the logs differ in their rates.
    """
    cited, step = constants("devices", name), free.step_s
    lag_s, most_s = (0.5 / np.pi / each for each in (cited["amplifier_Hz"].value, cited["amplifier_Hz"].low))
    parameters = [Parameter(f"devices.{name}.{each}", Prior.of(cited[each], each)) for each in CONSTANTS]
    parameters += [GAIN, Parameter("motors.lag_s", Prior(lag_s, 0.0, most_s))]
    logs = [free]
    if held is not None:
        if abs(held.step_s / step - 1.0) > 0.01:
            raise InputError("logs must have one rate, got several: resample them to the first one's")
        logs.append(DeviceLog(held.times_s, held.position_m, _delayed(held, cited), held.hand_N))
        parameters.append(HAND_CLOCK)
    grid = max(round(GRID_S / step), 1)
    apart = max(round(APART_S / (grid * step)), 1)
    axes = np.flatnonzero(np.any([np.ptp(log.position_m, axis=0) > 0.0 for log in logs], axis=0))
    found = [device_averages(log, axes, cited["encoder_step_m"].value, grid) for log in logs]
    channels = tuple(f"{kind}_{AXES[at]}_N" for kind in ("force", "hand")[: len(logs)] for at in axes)
    values = np.full((sum(len(each.force_N) for each in found), len(channels)), np.nan)
    values[: len(found[0].force_N), : len(axes)] = found[0].force_N
    if held is not None:
        values[len(found[0].force_N) :, len(axes) :] = found[1].force_N
    times = np.asarray(step * grid * np.arange(len(values)), dtype=np.float64)
    forward = DeviceForward(tuple(parameters), channels, times, found[0], found[1] if held is not None else None)
    return forward, _in_motion(times[::apart], values[::apart], channels)


def least_friction_N(log: DeviceLog, encoder_step_m: float) -> float:
    """Greatest force that was on the tip while it rested [N]: friction is no less; 0 for a tip that never rests."""
    still = rests(log, encoder_step_m)
    return float(np.linalg.norm(log.force_N[still], axis=1).max()) if still.any() else 0.0


def _in_motion(times_s: Array, values: Array, channels: tuple[str, ...]) -> MeasuredLoads:
    """The channels along which the tip was moved.

    Raises
    ------
    InputError
        If it hardly was.
    """
    known = np.isfinite(values)
    kept = [at for at in range(len(channels)) if np.any(values[known[:, at], at])]
    if not kept or known[:, kept].sum(axis=0).min() < FEWEST:
        seconds = known.any(axis=1).sum() * APART_S
        raise InputError(
            f"each log must show the device in motion for {FEWEST * APART_S:g} s, got {seconds:.2g} s in all: let it "
            "move by centimetres for several seconds"
        )
    return MeasuredLoads(times_s, values[:, kept], tuple(channels[at] for at in kept))


def _delayed(log: DeviceLog, cited: dict[str, Constant]) -> Array:
    """What motors make of their commands, by the cited delay and amplifier, shape (n, 3)."""
    keeps = float(np.exp(-2.0 * np.pi * cited["amplifier_Hz"].value * log.step_s))
    driven = np.concatenate([log.applied_N[:1], log.applied_N[:-1]])
    smooth = lfilter([1.0 - keeps], [1.0, -keeps], driven, axis=0)
    late_s = log.times_s - cited["transport_delay_s"].value
    return np.column_stack([np.interp(late_s, log.times_s, each) for each in smooth.T])
