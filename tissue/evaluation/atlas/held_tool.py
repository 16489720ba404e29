"""Conditioning of a tool held on a device: response of its path to a shift of the device path.

The device path of a closed loop is recorded once. It is then replayed without feedback, unchanged
and with a small change. The functions use the device and the trace, and nothing of the tool except
its mass.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.evaluation.atlas.page import (
    GREEN,
    GREY,
    ORANGE,
    THEORY,
    Answer,
    Conduct,
    Data,
    Page,
    Table,
    Verdict,
    panel,
    shown,
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

__all__ = [
    "OBLIQUE",
    "Course",
    "DevicePath",
    "HeldCutting",
    "amplification",
    "force_error",
    "in_a_hand",
    "recorded_path",
    "replayed",
]

OBLIQUE = np.array([0.48, -0.36, 0.8])
"""Unit direction of a shift, along no axis of a scene."""
LIGHT = 1e-4
"""Share of the tool's mass in the massless quasi-static limit."""
SCENES = ("milling", "glenoid", "pedicle", "molar", "caries")
SHIFTS_M = np.array([1e-9, 1e-6, 1e-5])
SECONDS = 2.3
"""Duration of a run [s]. The reamer, the last tool to touch, cuts for a second of it."""
MOST = 10.0
"""Amplification above which a tool counts as ill-conditioned.

Chosen. A free tool has 1. The massless tool has 70 to 140,000 at a shift of 1 nm.
"""


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
        """Return the path shifted by a constant [m]."""
        return DevicePath(self.positions_m + shift_m, self.quaternions)

    def rounded(self, step_m: float) -> "DevicePath":
        """Return the path rounded to encoder steps [m]."""
        return DevicePath(step_m * np.round(self.positions_m / step_m), self.quaternions)


@dataclass(frozen=True)
class Course:
    """Run of a tool along a given device path.

    Attributes
    ----------
    tips_m
        Positions of the tip in every tick [m], shape (n, 3).
    forces_N
        Forces of the tissue before the scaling for the device [N], shape (n, 3).
    touches
        True in the ticks in contact, shape (n,).
    mass_kg
        Mass of the tool [kg]; None for a tool without inertia.
    """

    tips_m: Array
    forces_N: Array
    touches: NDArray[np.bool_]
    mass_kg: float | None

    @property
    def first(self) -> int:
        """First tick in contact."""
        if not self.touches.any():
            raise InputError("duration_s", "reach the first contact", "no contact", "run longer")
        return int(np.argmax(self.touches))


class _Watch(RunObserver):
    """Observer that records the true poses of a simulated device and scales the tool's mass."""

    def __init__(self, mass_share: float = 1.0) -> None:
        self.positions_m: list[Triple] = []
        self.quaternions: list[Quaternion] = []
        self.mass_kg: float | None = None
        self._mass_share = mass_share
        self._device: SimulatedDevice | None = None

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Find the device, and scale the mass before the first tick."""
        motion = parts.motion
        assert isinstance(motion, HandMotion)
        device = motion.held.device
        self._device = device if isinstance(device, SimulatedDevice) else None
        tool = motion.tool
        self.mass_kg = getattr(tool, "mass_kg", None)
        if self.mass_kg is not None and self._mass_share != 1.0:
            tool.mass_kg = self._mass_share * self.mass_kg  # type: ignore[attr-defined]

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Record the pose."""
        if self._device is not None:
            self.positions_m.append(self._device.true_position_m)
            self.quaternions.append(self._device.orientation)
        return True


def in_a_hand(scene: Scene, *, seed: int, seconds: float) -> Scene:
    """Return the scene on a device in an expert's hand, without fields that only are shown."""
    changes = {"hand": "expert", "seed": seed, "duration_s": seconds, "prediction": "none"}
    return changed(by_hand(scene), changes | dict(force_only(scene)))


def recorded_path(scene: Scene) -> DevicePath:
    """Run the closed loop of a scene and return the true poses of the device."""
    watch = _Watch()
    simulate(scene, allow_unstable=True, observer=watch)
    return DevicePath(np.array(watch.positions_m), np.array(watch.quaternions))


def replayed(scene: Scene, path: DevicePath, *, mass_share: float = 1.0) -> Course:
    """Run a scene with a given device path, on which forces have no effect.

    The velocity of a sample is the difference to the previous one, as on a simulated device.
    """
    times_s = TICK_S * np.arange(len(path.positions_m))
    device = RecordedDevice(times_s, path.positions_m, path.quaternions)
    watch = _Watch(mass_share)
    trace = simulate(scene, allow_unstable=True, device=device, observer=watch).trace
    tips_m = 1e-3 * trace.vectors("tool", "mm")
    return Course(tips_m, trace.vectors("force", "N"), trace["contact_mm2"] > 0.0, watch.mass_kg)


def amplification(course: Course, reference: Course, shift_m: float) -> tuple[float, float]:
    """Return the largest distance between two tool paths over the shift of their device paths.

    The first value covers the time to one second after the first contact, the second the whole run.
    """
    away_m = np.linalg.norm(course.tips_m - reference.tips_m, axis=1)
    early = reference.first + round(1.0 / TICK_S)
    return float(away_m[: early + 1].max() / shift_m), float(away_m.max() / shift_m)


def force_error(course: Course, reference: Course) -> float:
    """Return the RMS difference of the forces over the RMS force of the reference, in contact."""
    touching = course.touches | reference.touches
    difference = (course.forces_N - reference.forces_N)[touching]
    return float(np.linalg.norm(difference) / np.linalg.norm(reference.forces_N[touching]))


def _columns(scene: Scene, path: DevicePath, rule: str, mass_share: float) -> tuple[Table, Course]:
    """Measure one rule: amplification and force error for each shift, and the run without shift."""
    reference = replayed(scene, path, mass_share=mass_share)
    rows = []
    for shift_m in SHIFTS_M.tolist():
        course = replayed(scene, path.shifted(shift_m * OBLIQUE), mass_share=mass_share)
        rows.append((*amplification(course, reference, shift_m), force_error(course, reference)))
    after, end, error = np.array(rows).T
    return {f"{rule}_1s": after, rule: end, f"{rule}_force": error}, reference


@cache
def _measured() -> Data:
    """Replay the path of one hand in every scene, by the engine and in the massless limit."""
    data: Data = {}
    for name in SCENES:
        scene = in_a_hand(load_scene(name), seed=1, seconds=SECONDS)
        path = recorded_path(scene)
        engine, reference = _columns(scene, path, "engine", 1.0)
        if reference.mass_kg is None:
            # A tool without inertia is its own massless limit.
            light = {key.replace("engine", "massless"): each for key, each in engine.items()}
        else:
            light, _ = _columns(scene, path, "massless", LIGHT)
        data[name] = {"shift_m": SHIFTS_M} | engine | light
    return data


class HeldCutting(Page):
    """Shift of a device path: the path of the cutting tool and its quasi-static limit."""

    name = "held_tool"
    title = "Cutting tool in a hand: how far does a small shift of the device move it?"
    question = (
        "The path of a device is replayed after a shift of 1 nm, 1 µm and 10 µm. How far does the "
        "path of the cutting tool change, relative to the shift?"
    )
    source = (
        "Sensitivity to initial conditions; Touch, path of an expert replayed without feedback; "
        "massless limit: a ten-thousandth of the tool's mass"
    )

    def measure(self) -> Data:
        """Replay the shifted paths; a second call returns the same tables."""
        return dict(_measured())

    def judge(self, data: Data) -> Verdict:
        """Compare the largest amplification of both rules with the bound."""
        engine, massless, error, light_error = (
            {scene: float(table[column].max()) for scene, table in data.items()}
            for column in ("engine", "massless", "engine_force", "massless_force")
        )
        worst = max(massless, key=massless.__getitem__)
        own = max(engine, key=engine.__getitem__)
        return Verdict(
            massless[worst] > MOST,
            engine[own] <= MOST,
            f"In the massless quasi-static limit a shift grows up to {massless[worst]:.3g} times "
            f"({worst}), and the force changes by up to {100 * max(light_error.values()):.2g} %. "
            f"The tool of the engine amplifies by at most {engine[own]:.3g} ({own}), and its force "
            f"changes by at most {100 * max(error.values()):.2g} %. The bound is {MOST:g}.",
        )

    def ask(self) -> list[Answer]:
        """List the amplification of each scene, and replay paths without a change and on a wall."""
        return [*self._scenes(_measured()), *_replays()]

    def _scenes(self, data: Data) -> Iterator[Answer]:
        for scene, table in data.items():
            own, light = (
                ", ".join(f"{each:.3g}" for each in table[rule]) for rule in ("engine", "massless")
            )
            yield shown(
                f"{scene}, shifted by 1 nm, 1 µm and 10 µm",
                bool((table["engine"] <= MOST).all()),
                f"{own} times the shift; massless limit {light}",
            )

    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the amplification over the shift, one panel for each rule."""
        styles = (("o-", "#0072B2"), ("s-", ORANGE), ("^-", GREEN), ("D-", GREY), ("v-", "#CC79A7"))
        rules = {"engine": "tool of the engine", "massless": "massless quasi-static limit"}
        holds = self.judge(data).holds
        for axes, (rule, title) in zip(chart.subplots(1, 2, sharey=True), rules.items(), strict=True):
            curves = [
                (scene, table[rule], style)
                for (scene, table), style in zip(data.items(), styles, strict=True)
            ]
            panel(
                axes,
                SHIFTS_M,
                ("shift of the device / m", "change of the tool path / shift" * (rule == "engine")),
                [("free tool", 1.0, THEORY), *curves],
                conduct=[(Conduct.HOLDS, 1e-9, 1e-5)] if holds and rule == "engine" else (),
                title=title,
            )


def _replays() -> Iterator[Answer]:
    """Yield the answers for a path replayed twice, and for a shift on a wall."""
    scene = in_a_hand(load_scene("milling"), seed=1, seconds=0.6)
    path = recorded_path(scene)
    first, second = replayed(scene, path), replayed(scene, path)
    same = bool((first.tips_m == second.tips_m).all() and (first.forces_N == second.forces_N).all())
    yield shown("the same path twice, milling", same, "the same tool path and forces to the bit")
    wall = in_a_hand(load_scene("wall"), seed=1, seconds=1.5)
    path = recorded_path(wall)
    shift_m = 1e-6
    end = amplification(replayed(wall, path.shifted(shift_m * OBLIQUE)), replayed(wall, path), shift_m)
    # measured: 1.000; a wall only holds back the part of a shift that is normal to it
    yield shown("a ball on a wall, shifted by 1 µm", end[1] < 1.1, f"{end[1]:.4g} times the shift")
