"""A ball pressed into an organ of a hyperelastic law at 1 kHz, against Newton's method with a rigid ball of its own.

The reference shares cells and law (which felupe confirms, `test_deep_press`), not the contact, the compliance, nor what
brings law and ticks together. Its nodes lie on the ball, ours are held off by points on triangles.
"""

import numpy as np
import pytest

from tissue.builders.organ import elasticity_of, held_mesh
from tissue.builders.organ_law import law_of
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.linear_limits import resting_sphere
from tissue.fem.newton import NewtonSolver
from tissue.models.organ.soft_organ import SoftOrgan
from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate

RADIUS_M, DEPTHS_M = 8e-3, np.array([1.6e-3, 3.2e-3, 4.8e-3, 6.4e-3])
PRESS = {
    "anatomy.size_mm": [80, 80, 40], "anatomy.edge_mm": 10.0, "anatomy.touch_edge_mm": 4.5,
    "anatomy.nodule_diameter_mm": 0.0, "organ.parts": None, "organ.young_kPa": 5.0, "organ.young_end_kPa": None,
    "organ.friction": 0.0, "organ.interval_ms": 0.0, "tool.diameter_mm": 16.0, "motion.feed_mm_s": 20.0,
    "motion.points_mm": [[0, 0, 0.5], [0, 0, -6.4], [0, 0, -6.41]], "duration_s": 0.9,
}  # fmt: skip


def newton_forces_N(scene) -> np.ndarray:
    """Force on the ball at each depth [N]."""
    path = 1e-3 * np.array(scene.motion.points_mm)
    found = held_mesh(
        scene.anatomy, path_m=path, touch_edge_m=1e-3 * scene.anatomy.touch_edge_mm, report=lambda *_: None
    )
    elasticity, _ = elasticity_of(found.mesh, scene.anatomy, scene.organ)
    law, factors = law_of(scene.organ, elasticity)
    organ = SoftOrgan(found.mesh, elasticity, found.held)
    solver = NewtonSolver(
        NonlinearBody(organ.space, None, law=law, cell_factors=factors), organ.body.fixed, tolerance=1e-4
    )
    ball, _ = resting_sphere(solver, np.zeros(3), np.array([0.0, 0.0, -1.0]), RADIUS_M, 3e-4)
    forces, now = [], None
    for depth_m in DEPTHS_M:
        ball.move_to(np.array([0.0, 0.0, RADIUS_M - depth_m]))
        solution = solver.solve(sphere=ball, start_m=now)
        assert solution.converged
        now = solution.displacement_m
        forces.append(float(solution.tool_force_N[2]))
    return np.array(forces)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "law", [{"law": "neo-hookean", "poisson_ratio": 0.45}, {"law": "ogden", "exponent": 6.0, "poisson_ratio": 0.45}]
)
def test_the_force_of_a_deep_press_is_that_of_newtons_method(law):
    """While it moves at 20 mm/s, a forty times a second solved law is late; at rest it is not."""
    scene = load_scene("palpation", PRESS | {f"organ.{name}": value for name, value in law.items()})
    run = simulate(scene, cores=1)
    exact_N, depth_m, force_N = newton_forces_N(scene), -1e-3 * run.trace["tool_z_mm"], run.trace["force_z_N"]
    moving_N = np.interp(DEPTHS_M, depth_m[:340], force_N[:340])
    print(law, "moving", moving_N / exact_N - 1.0, "at rest", force_N[-1] / exact_N[-1] - 1.0)
    assert moving_N == pytest.approx(exact_N, rel=0.04)
    assert force_N[-1] == pytest.approx(exact_N[-1], rel=0.01)
    assert not [what for _, what in run.events if "not reached" in what or "did not settle" in what]
    linear = simulate(load_scene("palpation", PRESS | {"organ.poisson_ratio": 0.45}), cores=1)
    assert abs(linear.trace["force_z_N"][-1] / exact_N[-1] - 1.0) > 0.08, "what the linear law misses"
