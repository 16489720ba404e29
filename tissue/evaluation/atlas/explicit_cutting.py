"""Instability of explicit feed steps of a cutting tool.

Explicit steps diverge because the cutting force acts as a strong damper.
"""

from functools import cache

import numpy as np
from matplotlib.figure import Figure

from meshes.shapes.anatomy import cortical_block
from meshes.voxels.voxelise import voxelise
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr, cylinder
from tissue.evaluation.atlas.page import (
    BLUE,
    GREY,
    RED,
    Answer,
    Data,
    Page,
    Verdict,
    boundary,
    error_of,
    panel,
    refused,
    shown,
    sweep,
)
from tissue.materials.constants import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion
from tissue.motion.thrust import PushAlongAxis, implicit_speed
from tissue.scene.load import load_scene

__all__ = ["PAGE"]

BONE = cutting_coefficients("bone")
THRUST_N = 20.0
"""Thrust above the edge force."""
STEPS = 400
"""Steps after which a mode of 2 % growth is a thousand times as large."""
MASS_KG = 0.05
"""Mass in the sweep of the step."""


@cache
def drag_N_s_m() -> float:
    """Measure the resistance of a blunt burr that plunges 1 mm deep into cortical bone [N s/m].

    The force is computed by the bone model.
    """
    volume = voxelise(cortical_block(size_mm=(7, 7, 2)), spacing_m=1e-4)
    model = BoneModel(volume, Cutter(ball_burr(diameter_m=6e-3), 2, 100.0), (BONE,))
    motion = ToolMotion(speed_m_s=1e-3)
    motion.heading[0] = (0.0, 0.0, -1.0)
    model.place(motion)
    for depth in np.arange(0.0, 1e-3, 1e-5):
        motion.tip_m[2] = -depth
        model.advance(motion)
        response = model.respond(motion)
    return float(response.resistance[2])


def left_over(step_s: float, mass_kg: float, *, implicit: bool) -> float:
    """Compute the distance of the speed to the steady one after 400 steps, relative to it."""
    drag = drag_N_s_m()
    settled = THRUST_N / drag
    speed = 0.0
    for _ in range(STEPS):
        if implicit:
            speed = implicit_speed(speed, thrust=THRUST_N, drag=drag, mass=mass_kg, step_s=step_s)
        else:
            speed += step_s / mass_kg * (THRUST_N - drag * speed)
        if abs(speed) > 1e12 * settled:
            break
    return abs(speed / settled - 1.0)


def measure(quick: bool) -> Data:
    """Find the longest stable step over mass, and sweep the step at one mass."""
    masses = np.geomspace(0.01, 5.0, 3 if quick else 9)
    steps = 2.0 * MASS_KG / drag_N_s_m() * np.geomspace(0.05, 200.0, 8 if quick else 24)

    def limit_s(mass: float) -> dict[str, float]:
        """Return the step above which the explicit feed grows, measured and by theory."""
        runs_away = boundary(
            lambda step: left_over(step, mass, implicit=False) > 1.0, 1e-8, 1.0, steps=30
        )
        return {"explicit_s": runs_away, "theory_s": 2.0 * mass / drag_N_s_m()}

    def left(step: float) -> dict[str, float]:
        """Return the remaining error of both rules."""
        return {
            kind: left_over(step, MASS_KG, implicit=kind == "implicit")
            for kind in ("explicit", "implicit")
        }

    return {"mass": sweep("mass_kg", masses, limit_s), "step": sweep("step_s", steps, left)}


def judge(data: Data) -> Verdict:
    """Compare the longest explicit step with 2 m / c, and the implicit rule with the steady feed.

    The implicit rule is used with steps beyond the limit of the explicit one.
    """
    mass = data["mass"]
    step = data["step"]
    off = error_of(mass["explicit_s"], mass["theory_s"])
    beyond = step["step_s"] > 2.1 * MASS_KG / drag_N_s_m()
    worst = float(step["implicit"][beyond].max())
    return Verdict(
        bool(off < 0.01 and (step["explicit"][beyond] > 1e3).all()),
        worst < 1e-6,
        f"The burr resists with {drag_N_s_m():.0f} N s/m, so an explicit step must be "
        "shorter than 2m/c (measured to "
        f"{100 * off:.2f} %). At 1 ms a tool below {0.5e-3 * drag_N_s_m():.1f} kg runs away. "
        "The implicit step is "
        f"within {worst:.0e} of the steady feed up to {1e3 * step['step_s'].max():.0f} ms.",
    )


def plunge(mass_kg: float, thrust_N: float) -> tuple[float, float]:
    """Push a drill into bone for 0.5 s; return the late mean axial force and the largest speed.

    The force is in N and the speed in m/s.
    """
    volume = voxelise(cortical_block(size_mm=(6, 6, 5)), spacing_m=1e-4)
    model = BoneModel(volume, Cutter(cylinder(diameter_m=4e-3, length_m=8e-3), 4, 300.0), (BONE,))
    push = PushAlongAxis(
        np.array([0.0, 0.0, 1e-4]),
        axis=(0, 0, 1),
        thrust_N=thrust_N,
        mass_kg=mass_kg,
        max_feed_m_s=5e-3,
        depth_m=4e-3,
    )
    motion = ToolMotion()
    push.begin(motion)
    model.place(motion)
    response = model.respond(motion)
    axial = []
    speed = []
    for tick in range(500):
        push.advance(1e-3 * tick, 1e-3, response, motion)
        model.advance(motion)
        response = model.respond(motion)
        axial.append(float(response.wrench[2]))
        speed.append(motion.speed_m_s)
    return float(np.mean(axial[-200:])), max(speed)


def ask() -> list[Answer]:
    """Push a tool too light for an explicit step, and give a scene a thrust that is NaN."""
    force, speed = plunge(0.01, 40.0)
    scene = {"motion.kind": "thrust", "motion.thrust_N": float("nan")}
    return [
        shown(
            "a drill of 10 g pushed with 40 N at the tick of 1 ms",
            abs(force / 40.0 - 1.0) < 0.01 and speed <= 5e-3,
            f"cuts with {force:.2f} N, at no time faster than its limit of {1e3 * speed:.1f} mm/s",
        ),
        refused("a scene with a thrust that is NaN", lambda: load_scene("glenoid", scene)),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Draw the longest step over mass, and the remaining error over the step."""
    left, right = chart.subplots(1, 2)
    mass = data["mass"]
    panel(
        left,
        mass["mass_kg"],
        ("moving mass / kg", "longest step / ms"),
        [
            ("theory: 2m/c", 1e3 * mass["theory_s"], "-", GREY),
            ("explicit step runs away above", 1e3 * mass["explicit_s"], "s", RED),
            ("tick of the engine (implicit)", 1.0, "--", BLUE),
        ],
    )
    step = data["step"]
    right.axvline(2e3 * MASS_KG / drag_N_s_m(), color=GREY, label="theory: 2m/c")
    panel(
        right,
        1e3 * step["step_s"],
        ("step / ms", "error of the feed after 400 steps / steady feed"),
        [
            ("explicit", np.clip(step["explicit"], 1e-16, 1e12), "s", RED),
            ("implicit (engine)", np.clip(step["implicit"], 1e-16, 1e12), "o", BLUE),
        ],
        title="50 g",
    )


PAGE = Page(
    "explicit_cutting",
    "Explicit step of a cutting tool",
    "The cutting force increases with the feed so fast that it acts as a damper c. How long "
    "may a step of a tool be "
    "that is pushed into bone?",
    (
        "Euler's explicit rule on m dv/dt = F − cv needs Δt < 2m/c; c of a burr of 6 mm, 1 mm "
        "deep at 100 rad/s"
    ),
    measure,
    judge,
    ask,
    draw,
)
