"""Large rotation: the linear law finds stress in a bar that is only rotated."""

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array
from meshes.tets.structured import box
from tissue.evaluation.atlas.page import (
    BLUE,
    GREEN,
    GREY,
    RED,
    Answer,
    Conduct,
    Data,
    Page,
    Verdict,
    error_of,
    panel,
    refused,
    shown,
)
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.fem.hyperelastic import Law, NonlinearBody
from tissue.fem.newton import NewtonSolver
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate

__all__ = ["PAGE"]

YOUNG_PA = 5e3
WIDTH_M = 0.015
LENGTH_M = 0.06


def bar() -> tuple[Space, NDArray[np.bool_]]:
    """Return a bar and its held components, which are all components at both ends."""
    space = Space(box((LENGTH_M, WIDTH_M, WIDTH_M), (6, 2, 2)))
    ends = (space.nodes_m[:, 0] < 1e-9) | (space.nodes_m[:, 0] > LENGTH_M - 1e-9)
    return space, np.repeat(ends[:, None], 3, axis=1)


def false_stress_Pa(law: Law, angles: Array) -> Array:
    """Compute the pull on an end over its area with both ends rotated [Pa].

    The result is NaN where a solve does not converge.
    """
    space, held = bar()
    solver = NewtonSolver(NonlinearBody(space, lame(YOUNG_PA, 0.0), law=law), held)
    reached = 0.0
    moved = None
    stresses = []
    for angle in angles.tolist():
        # Newton's method follows a rotation in steps of at most ten degrees.
        for part in np.linspace(reached, angle, 2 + int((angle - reached) / 10.0))[1:]:
            turn = Rotation.from_rotvec([0.0, 0.0, np.deg2rad(part)])
            solution = solver.solve(turn.apply(space.nodes_m) - space.nodes_m, start_m=moved)
            moved = solution.displacement_m
        reached = angle
        pull_N = np.linalg.norm(solution.force_N[space.nodes_m[:, 0] < 1e-9].sum(axis=0))
        stresses.append(float(pull_N) / WIDTH_M**2 if solution.converged else np.nan)
    return np.array(stresses)


def measure(quick: bool) -> Data:
    """Sweep the angle for all laws."""
    angles = (
        np.array([10.0, 45.0])
        if quick
        else np.array([1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0])
    )
    stresses = {f"{law.name.lower()}_pa": false_stress_Pa(law, angles) for law in Law}
    theory = YOUNG_PA * (1.0 - np.cos(np.deg2rad(angles)))
    return {"turn": {"angle_deg": angles, **stresses, "theory_pa": theory}}


def judge(data: Data) -> Verdict:
    """Compare the linear law with E (1 - cos θ) and the other laws with zero."""
    turn = data["turn"]
    off = error_of(turn["linear_pa"], turn["theory_pa"])
    others = np.concatenate([turn["corotational_pa"], turn["neo_hookean_pa"]])
    worst = float(others.max()) if np.isfinite(others).all() else np.inf
    return Verdict(
        off < 1e-3,  # exact for ν = 0 by Betti's theorem, up to the tolerance of the solve
        worst < 1e-4 * YOUNG_PA,
        f"Rotated by {turn['angle_deg'][-1]:.0f}° without strain, the bar has a stress of "
        f"{100 * turn['linear_pa'][-1] / YOUNG_PA:.0f} % of E by the linear law. It is E(1 − "
        f"cos θ) to {off:.0e}. By "
        f"the corotational and the neo-Hookean law it is at most {worst / YOUNG_PA:.0e} of E.",
    )


def events_of_a_press() -> str:
    """Press a ball into a small slab of linear tissue and return the events of the run."""
    changes = {
        "anatomy.size_mm": [60, 60, 30],
        "anatomy.edge_mm": 15,
        "anatomy.touch_edge_mm": 6,
        "anatomy.nodule_diameter_mm": 0,
        "organ.interval_ms": 10_000,
        "motion.points_mm": [[0, 0, 1], [0, 0, -4]],
        "motion.feed_mm_s": 50,
    }
    return "; ".join(event for _, event in simulate(load_scene("palpation", changes)).events)


def ask() -> list[Answer]:
    """Rotate too far in one step, and press a linear organ deep in a scene."""
    space, held = bar()
    solver = NewtonSolver(NonlinearBody(space, lame(YOUNG_PA, 0.45), law=Law.NEO_HOOKEAN), held)
    turn = Rotation.from_rotvec([0.0, 0.0, np.pi])
    goal = np.where(
        space.nodes_m[:, :1] > LENGTH_M - 1e-9, turn.apply(space.nodes_m) - space.nodes_m, 0.0
    )
    outcome = solver.solve(goal).outcome
    events = events_of_a_press()
    return [
        refused(
            "displacements that are NaN", lambda: solver.solve(np.full(space.nodes_m.shape, np.nan))
        ),
        shown(
            "one end rotated by 180° in one step",
            outcome is not SolverOutcome.CONVERGED,
            f"{outcome.name}: {outcome.value}",
            conduct=Conduct.REFUSES,
        ),
        shown(
            "a ball pressed 4 mm into a linear organ",
            "linear elasticity" in events,
            f"runs and reports: {events}",
            conduct=Conduct.FALLS_BACK,
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Draw the false stress over the angle."""
    axes = chart.subplots()
    turn = data["turn"]
    angle = turn["angle_deg"]
    least = 1e-13
    fine = np.geomspace(angle[0], angle[-1], 100)
    axes.plot(
        fine,
        1.0 - np.cos(np.deg2rad(fine)),
        color=GREY,
        label="theory of the linear law: 1 − cos θ",
    )
    panel(
        axes,
        angle,
        ("rotation θ of both ends / degrees", "false stress / E"),
        [
            ("linear", np.maximum(turn["linear_pa"] / YOUNG_PA, least), "s", RED),
            ("corotational", np.maximum(turn["corotational_pa"] / YOUNG_PA, least), "^", GREEN),
            ("neo-Hookean", np.maximum(turn["neo_hookean_pa"] / YOUNG_PA, least), "o", BLUE),
        ],
        ylim=(least, 10.0),
    )


PAGE = Page(
    "large_rotation",
    "Large rotation: linear against corotational",
    "A bar is rotated as a whole, without strain. Which stress do the elastic laws find?",
    (
        "The small strain of a rotation is cos θ − 1 along both axes of its plane; bar 60 × 15 × "
        "15 mm, ν = 0"
    ),
    measure,
    judge,
    ask,
    draw,
)
