"""Conditioning of a tool on a device: change of the tool path after a small change of the device
path.

The device path of a closed loop is recorded once. The recorded path is then replayed without
feedback, once unchanged and once shifted. The functions of this module read the trace and the true
poses of the device. The mass is the only property of the tool that these functions use.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.evaluation.charts.settings import by_hand, force_only
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand_motion import HandMotion
from tissue.models.tissue_model import TICK_S
from tissue.motion.quaternion import Quaternion, Triple
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import Parts
from tissue.simulation.simulate import RunObserver, simulate

__all__ = [
    "OBLIQUE",
    "Course",
    "DevicePath",
    "amplification",
    "force_error",
    "in_a_hand",
    "recorded_path",
    "replayed",
]

OBLIQUE = np.array([0.48, -0.36, 0.8])
"""Unit direction of a shift. It is not parallel to any axis of a scene."""


@runtime_checkable
class HasMass(Protocol):
    """Tool with inertia.

    Attributes
    ----------
    mass_kg
        Mass [kg], read in every tick.
    """

    mass_kg: float


@dataclass(frozen=True)
class DevicePath:
    """True poses of a device in every tick.

    Attributes
    ----------
    positions_m
        Positions [m], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4).
    """

    positions_m: Array
    quaternions: Array

    def shifted(self, shift_m: Array) -> "DevicePath":
        """Return the path shifted by a constant vector [m], shape (3,)."""
        return DevicePath(self.positions_m + shift_m, self.quaternions)


@dataclass(frozen=True)
class Course:
    """Path and forces of a tool whose device follows a given path.

    Attributes
    ----------
    tips_m
        Positions of the tip in every tick [m], shape (n, 3).
    forces_N
        Forces of the tissue before they are scaled for the device [N], shape (n, 3).
    touches
        True for ticks in contact, shape (n,).
    mass_kg
        Mass of the tool in this run [kg]; None for a tool without inertia.
    """

    tips_m: Array
    forces_N: Array
    touches: NDArray[np.bool_]
    mass_kg: float | None = None

    @property
    def first(self) -> int:
        """First tick in contact.

        Raises
        ------
        InputError
            If no tick is in contact.
        """
        if not self.touches.any():
            raise InputError(
                "duration_s", "reach the first contact", "no contact", "use a longer duration_s"
            )
        return int(np.argmax(self.touches))


class _PoseObserver(RunObserver):
    """Run observer that records true poses of a simulated device, and scales the tool's mass."""

    def __init__(self, mass_share: float = 1.0) -> None:
        self.positions_m: list[Triple] = []
        self.quaternions: list[Quaternion] = []
        self.mass_kg: float | None = None
        self._mass_share = mass_share
        self._device: SimulatedDevice | None = None

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Find the device, and scale the mass of the tool before the first tick."""
        motion = parts.motion
        assert isinstance(motion, HandMotion)
        device = motion.held.device
        self._device = device if isinstance(device, SimulatedDevice) else None
        tool = motion.tool
        if isinstance(tool, HasMass):
            # With a share of 1, the mass is unchanged to the last bit.
            tool.mass_kg *= self._mass_share
            self.mass_kg = tool.mass_kg

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Record the true pose of the device."""
        if self._device is not None:
            self.positions_m.append(self._device.true_position_m)
            self.quaternions.append(self._device.orientation)
        return True


def in_a_hand(scene: Scene, *, seed: int, seconds: float) -> Scene:
    """Return the scene with its tool on a device that an expert's hand holds.

    Parts of the scene without influence on the force are left out.
    """
    changes: dict[str, object] = {
        "hand": "expert",
        "seed": seed,
        "duration_s": seconds,
        # The path is replayed without feedback, so that the prediction would only cost time.
        "prediction": "none",
    }
    return changed(by_hand(scene), changes | dict(force_only(scene)))


def recorded_path(scene: Scene) -> DevicePath:
    """Run the closed loop of a scene, and return the true poses of the device."""
    observer = _PoseObserver()
    simulate(scene, allow_unstable=True, observers=[observer])
    return DevicePath(np.array(observer.positions_m), np.array(observer.quaternions))


def replayed(scene: Scene, path: DevicePath, *, mass_share: float = 1.0) -> Course:
    """Run a scene along a given device path; forces do not change this path.

    As on a simulated device, the velocity is the difference of two successive positions divided by
    the duration of a tick. The mass of a tool with inertia is multiplied by ``mass_share``.
    """
    times_s = TICK_S * np.arange(len(path.positions_m), dtype=np.float64)
    device = RecordedDevice(times_s, path.positions_m, path.quaternions)
    observer = _PoseObserver(mass_share)
    trace = simulate(scene, allow_unstable=True, device=device, observers=[observer]).trace
    tips_m = 1e-3 * trace.vectors("tool", "mm")
    return Course(tips_m, trace.vectors("force", "N"), trace["contact_mm2"] > 0.0, observer.mass_kg)


def amplification(course: Course, reference: Course, shift_m: float) -> tuple[float, float]:
    """Return the distance between two tool paths divided by the shift between their device paths.

    Two values are returned: the ratio one second after the first contact (or at the end of a
    shorter run), and the largest ratio of the run. ``shift_m`` is the shift between the device
    paths [m]. For a tool without contact, the ratio is 1.
    """
    away_m = np.linalg.norm(course.tips_m - reference.tips_m, axis=1)
    later = min(reference.first + round(1.0 / TICK_S), len(away_m) - 1)
    return away_m[later] / shift_m, away_m.max() / shift_m


def force_error(course: Course, reference: Course) -> float:
    """Return the RMS difference of the forces divided by the RMS force of the reference.

    Only ticks with contact in at least one of the two runs are used.
    """
    touching = course.touches | reference.touches
    difference = (course.forces_N - reference.forces_N)[touching]
    return float(np.linalg.norm(difference) / np.linalg.norm(reference.forces_N[touching]))
