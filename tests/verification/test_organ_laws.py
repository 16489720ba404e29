"""A ball pressed into an organ of a hyperelastic law at 1 kHz, against Newton's method with a rigid ball of its own.

The reference shares cells and law (which felupe confirms, `test_deep_press`), not the contact, the compliance, nor what
brings law and ticks together.
"""

import pytest
from pressed_deep import by_newton, moving_N, scene_of, surface_error

from tissue.simulation.simulate import simulate


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("ratio", [1.0, 1.4])
@pytest.mark.parametrize(
    "law", [{"law": "neo-hookean", "poisson_ratio": 0.45}, {"law": "ogden", "exponent": 6.0, "poisson_ratio": 0.45}]
)
def test_the_force_of_a_deep_press_is_that_of_newtons_method(law, ratio):
    """While it moves at 20 mm/s, a forty times a second solved law is late; at rest it is not, and shares the mesh or not."""
    scene = scene_of(**law, law_edge_ratio=ratio)
    run, exact = simulate(scene, cores=1), by_newton(scene)
    moving, force_N = moving_N(run), run.trace["force_z_N"]
    print(law, ratio, "moving", moving / exact.force_N - 1.0, "at rest", force_N[-1] / exact.force_N[-1] - 1.0,
          "displacement", surface_error(run, exact))  # fmt: skip
    assert moving == pytest.approx(exact.force_N, rel=0.04)
    assert force_N[-1] == pytest.approx(exact.force_N[-1], rel=0.01)
    assert surface_error(run, exact) < 0.02
    assert not [what for _, what in run.events if "not reached" in what or "did not settle" in what]
    linear = simulate(scene_of(poisson_ratio=0.45), cores=1)
    assert abs(linear.trace["force_z_N"][-1] / exact.force_N[-1] - 1.0) > 0.08, "what the linear law misses"
