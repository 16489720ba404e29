"""Presses of an organ under a law of large strains, and the laws that it refuses."""

from types import SimpleNamespace

import numpy as np
import pytest
from device_doubles import Recording

import tissue
from meshes.base.errors import InputError
from tissue.models.organ.law import LawOffset

INDEPENDENT_N = 0.4009
"""Force on a ball of 16 mm pressed 6.4 mm into the slab below, neo-Hookean [N].

An analyst who had not read the code found it (`tests/verification/test_deep_press.py`).
"""


def block(**options: object) -> tissue.Organ:
    """A coarse block of linear cells."""
    stated = {"modulus_kPa": 5.0, "poisson_ratio": 0.45, "order": 1, "friction": 0.0} | options
    return tissue.Organ.block((50, 50, 30), edge_mm=10.0, **stated)


def test_small_presses_are_linear_and_deep_ones_stiffer():
    linear, curved = (
        organ.refined(edge_mm=6.0, near_mm=(0, 0, 0))
        for organ in (block(), block(law="neo-hookean"))
    )
    ball = tissue.ball(diameter_mm=16)
    ratios = []
    for depth_mm in (0.1, 6.4):
        presses = [
            each.press(ball, depth_mm=depth_mm, at_mm=(0, 0, 0)) for each in (linear, curved)
        ]
        ratios.append(presses[1].force_N[2] / presses[0].force_N[2])
    assert ratios[0] == pytest.approx(1.0, abs=0.01)
    assert ratios[1] > 1.1
    assert presses[1].notes.get("linear") is None


@pytest.mark.slow
def test_a_deep_press_has_the_independent_force():
    """The force agrees with an independent solution within 1.5 %."""
    organ = tissue.Organ.block(
        (80, 80, 40), modulus_kPa=5, poisson_ratio=0.45, edge_mm=10, law="neo-hookean", friction=0.0
    ).refined(edge_mm=4.5, near_mm=(0, 0, 0))
    found = organ.press(tissue.ball(diameter_mm=16), depth_mm=6.4, at_mm=(0, 0, 0))
    assert float(found.force_N[2]) == pytest.approx(INDEPENDENT_N, rel=0.015)


def test_a_press_next_to_held_tissue_needs_no_springs_there():
    """A ball that pushes faces with held corners, which have no compliance, finds its force."""
    organ = block(law={"name": "yeoh", "square_ratio": 1.0}, held="-x")
    found = organ.press(tissue.ball(diameter_mm=16), depth_mm=3.0, at_mm=(-22.0, 0, 0))
    assert np.isfinite(found.force_N).all()
    assert found.force_N[2] > 0.0
    assert "contact" not in found.notes


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"law": "yeoh"}, "law yeoh must have the key square_ratio. Use for"),
        ({"law": {"name": "yeoh", "square": 1.0}}, "law must have only known keys, got 'square'"),
        ({"law": {"name": "ogden", "law": "yeoh"}}, "law must have only known keys, got 'law'"),
        ({"law": {"square_ratio": 1.0}}, "law must have a name, got"),
        ({"law": {"name": "ogden", "exponent": 0.0}}, "organ.exponent must not be 0"),
        ({"law": "foo"}, "law must be one of linear, neo-hookean"),
        (
            {"law": "neo-hookean", "density_kg_m3": 1060.0},
            "law and density_kg_m3 must not be combined",
        ),
    ],
)
def test_what_a_law_cannot_have_is_refused(options, sentence):
    with pytest.raises(InputError, match=sentence):
        block(**options)


class Pressing(Recording):
    """Device that moves 6 mm down within 0.25 s, and rests there."""

    def read(self, time_s):
        self.time_s = time_s
        return tissue.Sample(time_s, (0.0, 0.0, -6e-3 * min(time_s / 0.25, 1.0)))


@pytest.fixture(scope="module")
def in_capsule():
    """A finer block with a capsule."""
    organ = block(law="neo-hookean", capsule=(50, 100))
    return organ.refined(edge_mm=6.0, near_mm=(0, 0, 0))


@pytest.mark.parametrize("real_time", [False, True])
def test_a_loop_presses_a_law(in_capsule, real_time):
    """The balance of spring and organ lies on the curve of a press.

    In real time a second thread solves the law.
    """
    organ = in_capsule
    ball = tissue.ball(diameter_mm=16)
    with tissue.Loop(
        organ, ball, device=Pressing(), start_mm=(0, 0, 0.5), reach_mm=6.0, stiffness_N_m=500.0
    ) as loop:
        loop.run(0.4, real_time=real_time)
    depth_mm = -loop.trace["tool_z_mm"][-1]
    force_N = loop.trace["model_force_z_N"][-1]
    pressed = organ.press(ball, depth_mm=depth_mm, at_mm=(0, 0, 0))
    assert depth_mm > 4.0
    # Beyond two radii the organ of a loop is linear.
    assert force_N == pytest.approx(float(pressed.force_N[2]), rel=0.02)


def test_the_first_slow_solve_is_an_event_and_later_ones_are_not():
    law = object.__new__(LawOffset)
    law.solves = law.unsettled = 0
    law.took_s, law.notices = [], []
    law.interval_s, law._late, law._thread = 0.025, False, None
    law.windows = SimpleNamespace(indefinite=0)
    for took_s in (0.01, 0.282, 0.9):
        law._report(SimpleNamespace(residual=0.0, reached=1.0), took_s, first=False)
    assert law.notices == [
        "first slow solve of the law: it took 0.282 s, longer than its interval of 0.025 s. "
        "In this run the tick waits for the solution, so the force is unchanged"
    ]


def test_the_linear_law_may_be_named():
    assert repr(block(law="linear", capsule=(50, 8200))) == repr(block(capsule=(50, 8200)))
