"""The cutting force damps so hard that an explicit step of the feed runs away; the implicit one does not."""

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from meshes.shapes.anatomy import cortical_block
from meshes.voxels.voxelise import voxelise
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr, cylinder
from tissue.evaluation.atlas.drawing import BLUE, GREY, RED, finish, region
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.materials.cutting import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion
from tissue.motion.motion import PushAlongAxis, implicit_speed
from tissue.scene.load import load_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["EXPLICIT_CUTTING"]

BONE = cutting_coefficients("bone")
THRUST_N, STEPS = 20.0, 400
"""Thrust above the edge force, and steps after which a mode of 2 % growth has gone a thousandfold."""


@cache
def drag_N_s_m() -> float:
    """Resistance of a blunt burr that plunges 1 mm deep into cortical bone [N s/m], from the bone model itself."""
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
    """How far the speed is from the settled one after 400 steps, over it."""
    drag, speed = drag_N_s_m(), 0.0
    settled = THRUST_N / drag
    for _ in range(STEPS):
        if implicit:
            speed = implicit_speed(speed, thrust=THRUST_N, drag=drag, mass=mass_kg, step_s=step_s)
        else:
            speed += step_s / mass_kg * (THRUST_N - drag * speed)
        if abs(speed) > 1e12 * settled:
            break
    return abs(speed / settled - 1.0)


def boundary_s(mass_kg: float) -> float:
    """Step above which the explicit feed grows, by bisection over runs [s]."""
    low, high = 1e-8, 1.0
    for _ in range(30):
        middle = np.sqrt(low * high)
        low, high = (low, middle) if left_over(middle, mass_kg, implicit=False) > 1.0 else (middle, high)
    return float(np.sqrt(low * high))


def measure(quick: bool) -> Data:
    """The boundary over mass; what is left over the step for one mass."""
    masses = np.geomspace(0.01, 5.0, 3 if quick else 9)
    limit = 2.0 * 0.05 / drag_N_s_m()
    steps = limit * np.geomspace(0.05, 200.0, 8 if quick else 24)
    return {
        "mass": {
            "mass_kg": masses,
            "explicit_s": np.array([boundary_s(mass) for mass in masses.tolist()]),
            "theory_s": 2.0 * masses / drag_N_s_m(),
        },
        "step": {
            "step_s": steps,
            "explicit": np.array([left_over(step, 0.05, implicit=False) for step in steps.tolist()]),
            "implicit": np.array([left_over(step, 0.05, implicit=True) for step in steps.tolist()]),
        },
    }


def judge(data: Data) -> Verdict:
    """The measured limit against 2 m / c, and the implicit step beyond it."""
    mass, step = data["mass"], data["step"]
    off = float(np.abs(mass["explicit_s"] / mass["theory_s"] - 1.0).max())
    beyond = step["step_s"] > 2.1 * 0.05 / drag_N_s_m()
    worst = float(step["implicit"][beyond].max())
    needed = 0.5e-3 * drag_N_s_m()
    return Verdict(
        bool(off < 0.01 and (step["explicit"][beyond] > 1e3).all()),
        worst < 1e-6,
        f"The burr resists with {drag_N_s_m():.0f} N s/m, so that an explicit step must stay below 2m/c (met to "
        f"{100 * off:.2f} %): at 1 ms a tool under {needed:.1f} kg runs away. The implicit step is within {worst:.0e} "
        f"of the settled feed up to {1e3 * step['step_s'].max():.0f} ms.",
    )


def plunge(mass_kg: float, thrust_N: float) -> tuple[float, float]:
    """A drill pushed into bone for 0.5 s at the engine's tick: late mean axial force [N] and greatest speed [m/s]."""
    volume = voxelise(cortical_block(size_mm=(6, 6, 5)), spacing_m=1e-4)
    model = BoneModel(volume, Cutter(cylinder(diameter_m=4e-3, length_m=8e-3), 4, 300.0), (BONE,))
    push = PushAlongAxis(
        np.array([0.0, 0.0, 1e-4]), axis=(0, 0, 1), thrust_N=thrust_N, mass_kg=mass_kg, max_feed_m_s=5e-3, depth_m=4e-3
    )
    motion, axial, speed = ToolMotion(), [], []
    push.begin(motion)
    model.place(motion)
    response = model.respond(motion)
    for tick in range(500):
        push.advance(1e-3 * tick, 1e-3, response, motion)
        model.advance(motion)
        response = model.respond(motion)
        axial.append(float(response.wrench[2]))
        speed.append(motion.speed_m_s)
    return float(np.mean(axial[-200:])), max(speed)


def ask() -> list[Answer]:
    """A light tool at the engine's tick, far beyond the explicit limit, and a thrust that is none."""
    force, speed = plunge(0.01, 40.0)
    return [
        shown(
            "a drill of 10 g pushed with 40 N at the tick of 1 ms",
            abs(force / 40.0 - 1.0) < 0.01 and speed <= 5e-3,
            f"cuts with {force:.2f} N, never faster than its {1e3 * speed:.1f} mm/s limit",
        ),
        refused(
            "a scene with a thrust that is not a number",
            lambda: load_scene("glenoid", {"motion.kind": "thrust", "motion.thrust_N": float("nan")}),
        ),
    ]


def draw(data: Data, chart: "Figure") -> None:
    """Longest step over mass; what is left over the step."""
    left, right = chart.subplots(1, 2)
    mass, step = data["mass"], data["step"]
    region(left, Conduct.HOLDS, mass["mass_kg"][0], mass["mass_kg"][-1])
    left.loglog(mass["mass_kg"], 1e3 * mass["theory_s"], color=GREY, label="theory: 2m/c")
    left.loglog(mass["mass_kg"], 1e3 * mass["explicit_s"], "s", color=RED, label="explicit step runs away above")
    left.axhline(1.0, color=BLUE, linestyle="--", label="the engine's tick (implicit)")
    finish(left, "moving mass / kg", "longest step / ms", xlim=mass["mass_kg"][[0, -1]])
    across = 1e3 * step["step_s"]
    region(right, Conduct.HOLDS, across[0], across[-1])
    right.loglog(across, np.clip(step["explicit"], 1e-16, 1e12), "s", color=RED, label="explicit")
    right.loglog(across, np.clip(step["implicit"], 1e-16, 1e12), "o", color=BLUE, label="implicit (ours)")
    right.axvline(2e3 * 0.05 / drag_N_s_m(), color=GREY, label="theory: 2m/c")
    finish(right, "step / ms", "feed off after 400 steps / settled feed", title="50 g", xlim=across[[0, -1]])


EXPLICIT_CUTTING = Page(
    "explicit_cutting",
    "Explicit step of a cutting tool",
    "The cutting force grows with the feed so fast that it acts as a damper c. How long may a step of a tool be that "
    "is pushed into bone?",
    "Euler's explicit rule on m dv/dt = F − cv needs Δt < 2m/c; c of a burr of 6 mm, 1 mm deep at 100 rad/s",
    measure,
    judge,
    ask,
    draw,
)
