"""Large rotation: the linear law finds stress in a bar that is only turned; corotational and neo-Hookean find none."""

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array
from meshes.tets.structured import box
from tissue.evaluation.atlas.drawing import BLUE, GREEN, GREY, RED, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, error_of, refused, shown
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.fem.hyperelastic import Law, NonlinearBody
from tissue.fem.newton import NewtonSolver
from tissue.fem.space import Space
from tissue.materials.elasticity import lame
from tissue.scene.load import load_scene
from tissue.simulation.run import Run
from tissue.simulation.simulate import simulate

__all__ = ["PAGE"]

YOUNG_PA, WIDTH_M, LENGTH_M = 5e3, 0.015, 0.06


def bar() -> tuple[Space, NDArray[np.bool_]]:
    """A bar and which of its components are held: both ends."""
    space = Space(box((LENGTH_M, WIDTH_M, WIDTH_M), (6, 2, 2)))
    ends = (space.nodes_m[:, 0] < 1e-9) | (space.nodes_m[:, 0] > LENGTH_M - 1e-9)
    return space, np.repeat(ends[:, None], 3, axis=1)


def false_stress_Pa(law: Law, angles: Array) -> Array:
    """Pull on an end over its area [Pa], with both ends turned together; NaN where a solve does not converge."""
    space, held = bar()
    solver, moved, found = NewtonSolver(NonlinearBody(space, lame(YOUNG_PA, 0.0), law=law), held), None, []
    reached = 0.0
    for angle in angles.tolist():
        # A law that turns is led there in steps of ten degrees at most.
        for part in np.linspace(reached, angle, 2 + int((angle - reached) / 10.0))[1:]:
            turn = Rotation.from_rotvec([0.0, 0.0, np.deg2rad(part)])
            solution = solver.solve(turn.apply(space.nodes_m) - space.nodes_m, start_m=moved)
            moved = solution.displacement_m
        reached = angle
        pull = np.linalg.norm(solution.force_N[space.nodes_m[:, 0] < 1e-9].sum(axis=0))
        found.append(float(pull) / WIDTH_M**2 if solution.converged else np.nan)
    return np.array(found)


def measure(quick: bool) -> Data:
    """False stress over the angle for three laws."""
    angles = np.array([10.0, 45.0]) if quick else np.array([1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0])
    return {
        "turn": {
            "angle_deg": angles,
            **{f"{law.name.lower()}_pa": false_stress_Pa(law, angles) for law in Law},
            "theory_pa": YOUNG_PA * (1.0 - np.cos(np.deg2rad(angles))),
        }
    }


def judge(data: Data) -> Verdict:
    """The linear law against E (1 - cos), the others against nothing."""
    turn = data["turn"]
    off, last = error_of(turn["linear_pa"], turn["theory_pa"]), turn["linear_pa"][-1]
    ours = np.concatenate([turn["corotational_pa"], turn["neo_hookean_pa"]])
    worst = float(ours.max()) if np.isfinite(ours).all() else np.inf
    return Verdict(
        off < 1e-3,  # exact for ν = 0 by Betti's theorem, but for the solve
        worst < 1e-4 * YOUNG_PA,
        f"Turned by {turn['angle_deg'][-1]:.0f}° without any strain, the bar is assigned a stress of "
        f"{100 * last / YOUNG_PA:.0f} % of E by the linear law: E(1 − cos θ) to {off:.0e}. The "
        f"corotational and the neo-Hookean law find {worst / YOUNG_PA:.0e} of E at most.",
    )


def pressed_slab() -> Run:
    """A small slab of linear tissue that a ball is pressed into."""
    changed = {
        "anatomy.size_mm": [60, 60, 30], "anatomy.edge_mm": 15, "anatomy.touch_edge_mm": 6,
        "anatomy.nodule_diameter_mm": 0, "organ.interval_ms": 10_000,
        "motion.points_mm": [[0, 0, 1], [0, 0, -4]], "motion.feed_mm_s": 50,
    }  # fmt: skip
    return simulate(load_scene("palpation", changed))


def ask() -> list[Answer]:
    """What is reported of the linear law in a scene, and a turn that is too large for a step."""
    space, held = bar()
    solver = NewtonSolver(NonlinearBody(space, lame(YOUNG_PA, 0.45), law=Law.NEO_HOOKEAN), held)
    turn = Rotation.from_rotvec([0.0, 0.0, np.pi])
    goal = np.where(space.nodes_m[:, :1] > LENGTH_M - 1e-9, turn.apply(space.nodes_m) - space.nodes_m, 0.0)
    outcome = solver.solve(goal).outcome
    notes = "; ".join(what for _, what in pressed_slab().events)
    return [
        refused("displacements that are no numbers", lambda: solver.solve(np.full(space.nodes_m.shape, np.nan))),
        shown("one end turned by half a circle in one step", outcome is not SolverOutcome.CONVERGED,
              f"{outcome.name}: {outcome.value}", conduct=Conduct.REFUSES),
        shown("a ball pressed 4 mm into a linear organ", "linear elasticity" in notes, f"runs and reports: {notes}",
              conduct=Conduct.FALLS_BACK),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """False stress over the angle."""
    axes, turn, least = chart.subplots(), data["turn"], 1e-13
    angle = turn["angle_deg"]
    fine = np.geomspace(angle[0], angle[-1], 100)
    axes.plot(fine, 1.0 - np.cos(np.deg2rad(fine)), color=GREY, label="theory of the linear law: 1 − cos θ")
    panel(axes, angle, "both ends turned by θ / degrees", "stress where there is none / E", [
        ("linear", np.maximum(turn["linear_pa"] / YOUNG_PA, least), "s", RED),
        ("corotational", np.maximum(turn["corotational_pa"] / YOUNG_PA, least), "^", GREEN),
        ("neo-Hookean", np.maximum(turn["neo_hookean_pa"] / YOUNG_PA, least), "o", BLUE),
    ], ylim=(least, 10.0))  # fmt: skip


PAGE = Page(
    "large_rotation",
    "Large rotation: linear against corotational",
    "A bar is turned as a whole, which strains nothing. What stress do the elastic laws find?",
    "Small strain of a turn is cos θ − 1 along both axes of its plane; bar 60 × 15 × 15 mm, ν = 0",
    measure,
    judge,
    ask,
    draw,
)
