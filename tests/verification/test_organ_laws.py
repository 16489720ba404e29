"""Ball pressed into an organ of a hyperelastic law at 1 kHz, against Newton's method.

The reference has a rigid ball of its own. It shares cells and law (which felupe confirms,
`test_deep_press`), but not the contact, the compliance, or the coupling of law and ticks.
"""

from functools import cache

import numpy as np
import pytest
from pressed_deep import by_newton, moving_N, scene_of, surface_error

from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m, in_hands
from tissue.scene.load import changed, load_scene
from tissue.simulation.builders.loop import judged_loop, loop_settings
from tissue.simulation.simulate import simulate

STIFFENING = {"law": "yeoh", "square_ratio": 2.0, "cube_ratio": 2.0}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_force_of_a_deep_press_is_that_of_newtons_method():
    """The force of a deep press under a stiffening law agrees with Newton's method.

    `test_deep_press.py` compares the neo-hookean law with an independent force.

    At 20 mm/s a law that is solved forty times a second is late; at rest it is not. The stiffening
    organ carries twice the linear force. On the compliance at rest it oscillated and lost a third
    of its force.
    """
    scene = scene_of(**STIFFENING, poisson_ratio=0.45)
    run, exact = simulate(scene, cores=1), by_newton(scene)
    moving, force_N = moving_N(run), run.trace["force_z_N"]
    print(
        "moving",
        moving / exact.force_N - 1.0,
        "at rest",
        force_N[-1] / exact.force_N[-1] - 1.0,
        "displacement",
        surface_error(run, exact),
    )
    assert moving == pytest.approx(exact.force_N, rel=0.07)
    # Beyond two radii from the contact the tissue is linear, which a stiffening law feels.
    assert force_N[-1] == pytest.approx(exact.force_N[-1], rel=0.025)
    assert surface_error(run, exact) < 0.03
    assert not [what for _, what in run.events if "not reached" in what or "did not settle" in what]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_hand_presses_a_stiffening_organ_without_swinging():
    """A hand presses a stiffening organ without oscillation.

    The coupling has 95 % of its critical stiffness, which is judged on a wall: nothing is
    stiffer. Over the last 0.4 s, with a cubic removed, the force at the device moves by less than 2
    %.
    """
    scene = changed(
        scene_of(**STIFFENING, poisson_ratio=0.45), {"device": "touch", "duration_s": 1.4}
    )
    settings = loop_settings(scene)
    hands = in_hands(judged_loop(settings), [settings.person.grip[:3]])
    run = simulate(
        changed(scene, {"coupling.stiffness_N_m": 0.95 * critical_stiffness_N_m(hands[0])}),
        cores=1,
    )
    force_N = run.trace["device_force_z_N"][-400:]
    ticks = np.arange(len(force_N))
    swing = np.std(force_N - np.polyval(np.polyfit(ticks, force_N, 3), ticks))
    print(f"{force_N[-1]:.3f} N, swings by {swing / force_N[-1]:.2%}")
    assert force_N[-1] > 0.8
    assert swing < 0.02 * force_N[-1]
    assert not [what for _, what in run.events if "not reached" in what or "did not settle" in what]


SCENE_LAWS = {
    "neo-hookean": {},
    "exponential": {"exponential_rate": 1.0},
}


SCENES = {
    "liver-press": {
        "organ.material": "liver",
        "anatomy.edge_mm": 22.0,
        "anatomy.touch_edge_mm": 7.0,
        "motion.feed_mm_s": 60.0,
        "motion.points_mm": [[0, 0, 0.5], [0, 0, -8], [8, 0, -8], [8, 0, 0.5]],
    },
    "palpation": {
        "anatomy.size_mm": [80, 50, 40],
        "anatomy.touch_edge_mm": 7.0,
        "motion.feed_mm_s": 60.0,
        "motion.points_mm": [[-24, 0, 0.5], [-24, 0, -4], [-20, 0, -4], [-20, 0, 0.5]],
    },
}
"""Of the liver 0.8 of the ball's radius deep. There the tangent under forces alone is indefinite:
version 0.2 left 18 % of the force unbalanced in this slide, and ended in a traceback at other
places."""


DEPTHS_MM = np.linspace(1.0, 3.5, 6)


def in_scene(name, **changes):
    """Run a scene, and return the run and its force while the ball leaves over that while it comes."""
    given = {"organ.interval_ms": 200.0, "organ.friction": 0.05}
    run = simulate(load_scene(name, SCENES[name] | given | changes), cores=1)
    force_N, depth_mm = run.trace["force_z_N"], run.trace["indentation_mm"]
    assert np.isfinite(force_N).all()
    deepest = int(np.argmax(depth_mm))
    down = np.interp(DEPTHS_MM, depth_mm[: deepest + 1], force_N[: deepest + 1])
    leaving = np.flatnonzero(depth_mm > DEPTHS_MM[0] - 0.5)[::-1]
    up = np.interp(DEPTHS_MM, depth_mm[leaving[:60]], force_N[leaving[:60]])
    return run, up / down


@cache
def linear_ratio(name):
    """Return the force while the ball leaves over that while it comes, with the linear law."""
    return in_scene(name, **{"organ.law": "linear"})[1]


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    ("name", "law"),
    [*(("liver-press", law) for law in SCENE_LAWS), ("palpation", "exponential")],
)
def test_a_law_runs_in_a_scene(name, law):
    """A law runs in a scene.

    Every solve is balanced. An elastic organ pushes back as hard when the ball leaves it as when it
    comes. The ball leaves at another place, up to 8 mm away, so that the ratio of the forces is
    that of the linear law, up to 1.32.
    """
    changes = {"organ.law": law, "organ.law_interval_ms": 10.0}
    changes |= {f"organ.{key}": value for key, value in SCENE_LAWS[law].items()}
    run, ratio = in_scene(name, **changes)
    assert run.summary["law"]["not_reached"] == 0
    assert run.summary["law"]["solves"] > 5
    assert not [what for _, what in run.events if "not reached" in what or "did not settle" in what]
    off = ratio / linear_ratio(name)
    print(name, law, run.summary["law"], "up over down, over the linear law", off.round(3))
    # A solve is 10 ms old when it acts: 0.6 mm of the ball's path. Measured: 2.5 % in `liver-press`,
    # and 17 % in `palpation`, where the ball turns after 67 ms (exponential).
    np.testing.assert_allclose(off, 1.0, atol={"liver-press": 0.03, "palpation": 0.2}[name])
    depth_mm = run.trace["indentation_mm"]
    frame = run.parts.tissue.fields.frames[-1]
    assert np.abs(frame.points["displacement_mm"]).max() < 1.2 * depth_mm.max() + 1.0
