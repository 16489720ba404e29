"""Every hyperelastic law in every built-in scene of an organ.

The scenes are shortened; the organ is pressed deep, and the tool slides and lifts off.
"""

import numpy as np
import pytest

from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate

LAWS = {
    "neo-hookean": {},
    "mooney-rivlin": {"second_share": 0.3},
    "yeoh": {"square_ratio": 0.2},
    "ogden": {"exponent": 8.0},
}
SCENES = {
    "liver-press": {
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


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", SCENES)
def test_a_law_runs_in_a_scene(name, law):
    """A law runs in a scene.

    Every solve is balanced, and an elastic organ pushes back as hard when the ball leaves it as
    when it comes.
    """
    changes = {"organ.law": law, "organ.interval_ms": 200.0, "organ.friction": 0.05}
    changes |= {f"organ.{key}": value for key, value in LAWS[law].items()}
    run = simulate(load_scene(name, SCENES[name] | changes), cores=1)
    assert run.summary["law"]["not_reached"] == 0
    assert run.summary["law"]["solves"] > 5
    assert not [what for _, what in run.events if "not reached" in what or "did not settle" in what]
    force_N, depth_mm = run.trace["force_z_N"], run.trace["indentation_mm"]
    assert np.isfinite(force_N).all()
    deepest = int(np.argmax(depth_mm))
    down = np.interp(DEPTHS_MM, depth_mm[: deepest + 1], force_N[: deepest + 1])
    leaving = np.flatnonzero(depth_mm > DEPTHS_MM[0] - 0.5)[::-1]
    up = np.interp(DEPTHS_MM, depth_mm[leaving[:60]], force_N[leaving[:60]])
    print(
        name, law, run.summary["law"], "up over down", (up / down).round(3), "peak", force_N.max()
    )
    # The ball leaves at another place than it came, up to 8 mm away, with a solve 25 ms old: 1.5 mm
    # of its path.
    np.testing.assert_allclose(up, down, rtol=0.35)
    frame = run.parts.tissue.fields.frames[-1]
    assert np.abs(frame.points["displacement_mm"]).max() < 1.2 * depth_mm.max() + 1.0
