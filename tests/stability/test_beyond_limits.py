"""Requests beyond the limits that the atlas measures: each is refused, or has a stated fallback."""

import numpy as np
import pytest

from tissue import InputError
from tissue.evaluation.atlas.bone_tooth import CELLS, cut_block, pushed, soft_middle
from tissue.evaluation.atlas.walls import point_proxy
from tissue.fem.conjugate_gradients import SolverOutcome
from tissue.haptics.device.device import device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.haptics.rigid_wall import knock
from tissue.materials.scene_constants import Materials
from tissue.models.tooth.body import INNER_STRENGTH, LEAST_FILL, ParticleBody
from tissue.models.tooth.grid import NodeSupports
from tissue.scene.load import load_scene
from tissue.scene.organ import Organ, SlabAnatomy
from tissue.simulation.builders.organ import material_of
from tissue.simulation.simulate import simulate


def friction_limit_N_m(name):
    """Stiffness 2 f / step that friction and encoder step of a device allow."""
    device = device_parameters(name)
    return 2.0 * device.friction_N / device.encoder_step_m


@pytest.mark.parametrize(
    "changes",
    [
        {"device": "six-dof", "hand": "expert", "coupling.stiffness_N_m": 6000.0},
        {"device": "touch", "coupling.stiffness_N_m": friction_limit_N_m("touch")},
    ],
    ids=["above the critical stiffness", "at the limit of friction over encoder step"],
)
def test_a_wall_that_is_too_stiff_is_refused(changes):
    with pytest.raises(InputError, match="stiffness"):
        simulate(load_scene("wall", changes | {"duration_s": 0.3}))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["touch", "omni", "six-dof"])
def test_a_device_is_quiet_at_the_stiffness_of_its_vendor(name):
    device = device_parameters(name)
    assert device.stiffness_limit_N_m < friction_limit_N_m(name)
    run, _ = knock(device, hand_parameters("expert"), "proxy", device.stiffness_limit_N_m)
    # in the last 0.2 s, when the knock has died away; measured: 0.016 N
    assert run.ripple_N(0.2) < 0.05


def test_no_speed_takes_a_point_through_a_wall_and_no_point_starts_in_one():
    # 51 mm within a tick, across a wall of 20 um
    rest = point_proxy(2e-5, start_m=1e-3).advance(np.array([0.0, 0.0, -5e-2])).position_m[2]
    assert rest == pytest.approx(1e-5, abs=1e-9)
    with pytest.raises(InputError):
        point_proxy(1e-3, start_m=0.0)


def test_a_nearly_incompressible_organ_of_linear_tetrahedra_is_noted():
    slab = SlabAnatomy(kind="slab", nodule_diameter_mm=0.0)
    _, notes = material_of(slab, Organ(order=1, poisson_ratio=0.49), Materials.cited)
    assert "lock" in notes["modulus"]


@pytest.mark.slow
def test_a_ball_deep_in_a_linear_organ_is_an_event():
    # a coarse slab that builds in seconds; 4 mm is beyond 0.33 of the ball's radius
    changes = {
        "anatomy.size_mm": [60, 60, 30],
        "anatomy.edge_mm": 15,
        "anatomy.touch_edge_mm": 6,
        "anatomy.nodule_diameter_mm": 0,
        "organ.interval_ms": 10_000,
        "motion.points_mm": [[0, 0, 1], [0, 0, -4]],
        "motion.feed_mm_s": 50,
    }
    events = simulate(load_scene("palpation", changes)).events
    assert any("force of the linear law" in event for _, event in events)


def test_cells_of_a_tooth_that_are_too_empty_are_left_out():
    dropped = cut_block(0.5 * LEAST_FILL, INNER_STRENGTH).cells.live == 0
    assert dropped.sum() == CELLS**2


def test_a_tooth_with_a_singular_matrix_does_not_converge():
    body = cut_block(0.1, 0.0)
    load = np.random.default_rng(0).normal(size=(body.grid.node_count, 3))
    solution = body.solve(load * body.carrying[:, None])
    assert solution.outcome is not SolverOutcome.CONVERGED


@pytest.mark.slow
def test_a_tooth_without_supports_or_with_too_few_iterations_is_reported():
    body = soft_middle(8, 42e3)
    # two of the 6 to 8 iterations that a cold solve takes
    short = body.solve(pushed(body), limit=2, cold=True)
    assert short.outcome is SolverOutcome.NOT_CONVERGED
    loose = ParticleBody(body.particles, body.grid, NodeSupports.of(body.grid.node_count))
    assert loose.solve(pushed(loose)).outcome is SolverOutcome.UNSUPPORTED
