"""Atlas page on a held tool: effect of a small shift of the device path on the tool path.

The path of a haptic device is recorded once in a closed loop. The recorded path is then replayed
without feedback, once unchanged and once shifted.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array, Flags
from meshes.base.errors import InputError
from tissue.evaluation.atlas.page import (
    GREEN,
    GREY,
    ORANGE,
    THEORY,
    Conduct,
    Data,
    Page,
    Table,
    Verdict,
    panel,
)
from tissue.evaluation.charts.settings import by_hand, force_only
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand_motion import HandMotion
from tissue.models.tissue_model import TICK_S
from tissue.motion.quaternion import Quaternion, Triple
from tissue.scene.load import changed, load_scene
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import Parts
from tissue.simulation.simulate import RunObserver, simulate

OBLIQUE = np.array([0.48, -0.36, 0.8])
"""Unit vector along which the device path is shifted. It is not parallel to a coordinate axis."""
LIGHT = 1e-4
"""Factor on the mass of the tool in runs that approximate a massless, quasi-static tool.

The value is a choice. The factor also reduces the damping between tool and device to a hundredth,
because the damping is proportional to the square root of the mass.
"""
SECONDS = {"milling": 1.4, "glenoid": 2.4, "pedicle": 1.1, "molar": 1.7, "caries": 1.6}
"""Duration of the run of each cutting scene [s]. The run includes one second of contact."""
SHIFTS_M = np.array([1e-9, 1e-6, 1e-5])
MOST = 10.0
"""Amplification (tool-path shift over device-path shift) above which a tool is ill-conditioned.

The value is a choice. At commit c4a1af96, the amplification is at most 2.6 with the tool mass of
the engine. With an almost massless tool and a shift of 1 nm, it is 23 in the scene ``molar`` and at
most 3.7 in the other scenes.
"""
STYLES = (("o-", "#0072B2"), ("s-", ORANGE), ("^-", GREEN), ("D-", "#56B4E9"), ("v-", "#CC79A7"))
RULES = {"engine": "tool of the engine", "massless": "massless quasi-static limit"}


@dataclass(frozen=True)
class DevicePath:
    """Poses of a haptic device in every tick, not rounded to encoder steps.

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
        Forces of the tissue on the tool [N], shape (n, 3), before they are scaled for the device.
    touches
        True for ticks in contact, shape (n,).
    mass_kg
        Mass of the tool in this run [kg]; None for a tool without inertia.
    """

    tips_m: Array
    forces_N: Array
    touches: Flags
    mass_kg: float | None = None

    @property
    def first(self) -> int:
        """First tick in contact. Raises InputError if no tick is in contact."""
        if not self.touches.any():
            raise InputError(
                "duration_s",
                "be long enough for the tool to touch the tissue",
                "a run without contact",
                "use a longer duration_s",
            )
        return int(np.argmax(self.touches))


class _PoseObserver(RunObserver):
    """Run observer that records true poses of a simulated device, and scales the tool's mass."""

    def __init__(self, mass_share: float = 1.0) -> None:
        self.positions_m: list[Triple] = []
        self.quaternions: list[Quaternion] = []
        self.mass_kg: float | None = None
        self._mass_share = mass_share
        self._device: object = None

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Find the device, and scale the mass of the tool before the first tick."""
        assert isinstance(parts.motion, HandMotion)
        self._device = parts.motion.held.device
        # only a tool with inertia has a mass
        tool: Any = parts.motion.tool
        if hasattr(tool, "mass_kg"):
            tool.mass_kg *= self._mass_share
            self.mass_kg = tool.mass_kg

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Record the true pose of the device."""
        if isinstance(self._device, SimulatedDevice):
            self.positions_m.append(self._device.true_position_m)
            self.quaternions.append(self._device.orientation)
        return True


def in_a_hand(scene: Scene, *, seed: int, seconds: float) -> Scene:
    """Return a copy of the scene in which an expert's hand moves the tool through a haptic device.

    Settings that do not influence the force, such as computed fields, are switched off.
    """
    # The path is replayed without feedback, so that a prediction would only cost time.
    run: dict[str, object] = {"seed": seed, "duration_s": seconds, "prediction": "none"}
    return changed(by_hand(scene), run | {"hand": "expert"} | force_only(scene))


def recorded_path(scene: Scene) -> DevicePath:
    """Run a scene in which a hand moves the device; return the poses of the device."""
    observer = _PoseObserver()
    simulate(scene, allow_unstable=True, observers=[observer])
    return DevicePath(np.array(observer.positions_m), np.array(observer.quaternions))


def replayed(scene: Scene, path: DevicePath, *, mass_share: float = 1.0) -> Course:
    """Run a scene along a given device path, without force feedback to the device.

    As for a simulated device, the velocity is the difference of two successive positions divided by
    the duration of a tick. If the tool model includes inertia, its mass is multiplied by
    ``mass_share``.
    """
    times_s = TICK_S * np.arange(len(path.positions_m), dtype=np.float64)
    device = RecordedDevice(times_s, path.positions_m, path.quaternions)
    observer = _PoseObserver(mass_share)
    trace = simulate(scene, allow_unstable=True, device=device, observers=[observer]).trace
    tips_m = 1e-3 * trace.vectors("tool", "mm")
    return Course(tips_m, trace.vectors("force", "N"), trace["contact_mm2"] > 0.0, observer.mass_kg)


def amplification(course: Course, reference: Course, shift_m: float) -> tuple[float, float]:
    """Return the amplification: distance of the tool paths divided by the device-path shift.

    Two values are returned: the ratio one second after first contact (or at the end, if the run
    ends earlier), and the largest ratio. ``shift_m`` is the shift between the device paths [m]. In
    free motion, the ratio is 1.
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


class HeldTool(Page):
    """Sensitivity of the tool path to the device path, for the normal and for a tiny tool mass."""

    name = "held_tool"
    title = "Cutting tool in a hand: amplification of a small shift"
    question = (
        "The path of a device is replayed with a shift of 1 nm, 1 µm and 10 µm. How far is the "
        "cutting tool from its path without the shift one second after the first contact, relative "
        "to the shift?"
    )
    source = (
        "Touch in the hand of an expert, one second of contact, replayed without feedback; "
        "massless limit: a ten-thousandth of the tool's mass"
    )

    def measure(self) -> Data:
        """Replay a shifted device path in each scene, with normal and with tiny tool mass."""
        data: Data = {}
        for name, seconds in SECONDS.items():
            scene = in_a_hand(load_scene(name), seed=1, seconds=seconds)
            path = recorded_path(scene)
            table: Table = {"shift_m": SHIFTS_M}
            for rule, share in zip(RULES, (1.0, LIGHT), strict=True):
                reference = replayed(scene, path, mass_share=share)
                rows = []
                for shift_m in SHIFTS_M.tolist():
                    course = replayed(scene, path.shifted(shift_m * OBLIQUE), mass_share=share)
                    grown, _ = amplification(course, reference, shift_m)
                    rows.append((grown, force_error(course, reference)))
                table[rule], table[f"{rule}_force"] = np.array(rows).T
            data[name] = table
        return data

    def judge(self, data: Data) -> Verdict:
        """Compare the largest amplification with the limit `MOST` for normal and tiny tool mass."""
        worst = {rule: max(data, key=lambda name: data[name][rule].max()) for rule in RULES}
        grown = {rule: data[name][rule].max() for rule, name in worst.items()}
        error = {
            rule: 100.0 * max(table[f"{rule}_force"].max() for table in data.values())
            for rule in RULES
        }
        return Verdict(
            grown["massless"] > MOST,
            grown["engine"] <= MOST,
            "In the massless quasi-static limit the tool path changes by up to "
            f"{grown['massless']:.3g} times the shift ({worst['massless']}), and the force by up "
            f"to {error['massless']:.2g} %. With the tool of the engine the path changes by at "
            f"most {grown['engine']:.3g} times the shift ({worst['engine']}), and the force by at "
            f"most {error['engine']:.2g} %. The bound is {MOST:g} times.",
        )

    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the amplification against the device-path shift, for normal and tiny tool mass."""
        holds = self.judge(data).holds
        panels = chart.subplots(1, 2, sharey=True)
        for axes, (rule, title) in zip(panels, RULES.items(), strict=True):
            engine = rule == "engine"
            curves = [
                (name, table[rule], style)
                for (name, table), style in zip(data.items(), STYLES, strict=True)
            ]
            panel(
                axes,
                SHIFTS_M,
                ("shift of the device / m", "change of the tool path / shift" if engine else ""),
                [("free tool", 1.0, THEORY), ("bound", MOST, (":", GREY)), *curves],
                conduct=[(Conduct.HOLDS, SHIFTS_M[0], SHIFTS_M[-1])] if engine and holds else (),
                legend="best" if engine else "",
                title=title,
            )
