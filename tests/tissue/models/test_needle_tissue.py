"""Tissue of a needle: numbers that are refused, and an insertion into a made-up tissue."""

from dataclasses import replace

import numpy as np
import pytest

from tissue import InputError
from tissue.models.needle.model import Insertion, NeedleModel
from tissue.models.needle.parameters import (
    Membrane,
    NeedleTissue,
    ShaftFriction,
    needle_tissue,
    vessel_wall,
)

LIVER = needle_tissue()
FRICTION = LIVER.friction
CAPSULE = LIVER.membranes[0]


@pytest.mark.parametrize(
    ("make", "argument"),
    [
        (lambda: replace(CAPSULE, depth_m=-1e-3), "depth_m of the capsule"),
        (lambda: replace(CAPSULE, puncture_N=0.0), "puncture_N of the capsule must be positive"),
        (lambda: replace(CAPSULE, hold_N=2e4), "hold_N of the capsule"),
        (lambda: replace(FRICTION, sliding_out_N_m=-11.96), "sliding_out_N_m"),
        (lambda: replace(FRICTION, viscous_in_N_s_m2=np.nan), "viscous_in_N_s_m2"),
        (lambda: replace(FRICTION, static_in_N_m=5.0), "static_in_N_m"),
        (lambda: replace(LIVER, linear_N_m=np.nan), "linear_N_m must be positive"),
        (lambda: replace(LIVER, quadratic_N_m2=-1.0), "quadratic_N_m2"),
        (lambda: replace(LIVER, cutting_N=5e4), "cutting_N must be in"),
        (lambda: replace(LIVER, linear_N_m=18.0), "linear_N_m"),
        (lambda: replace(LIVER, membranes=(CAPSULE, CAPSULE)), "membranes"),
        (
            lambda: replace(LIVER, membranes=(CAPSULE, replace(CAPSULE, depth_m=1e-2))),
            "membranes",
        ),
        (lambda: needle_tissue(walls=[vessel_wall(0.0)]), "membranes"),
        (lambda: NeedleModel(LIVER, diameter_m=np.nan), "diameter_m"),
    ],
)
def test_numbers_that_cannot_be_meant_are_refused(make, argument):
    with pytest.raises(InputError, match=argument):
        make()


def test_an_insertion_can_be_built_without_the_cited_numbers():
    """An insertion can be built without the cited numbers.

    A linear organ with only friction has the force C L and the deflection C L / (a1 + C) of the
    travel.
    """
    friction = ShaftFriction(
        sliding_in_N_m=10.0,
        sliding_out_N_m=10.0,
        viscous_in_N_s_m2=0.0,
        viscous_out_N_s_m2=0.0,
        static_in_N_m=10.0,
        static_out_N_m=10.0,
        stick_band_m_s=0.0,
    )
    insertion = Insertion(
        NeedleTissue(linear_N_m=90.0, quadratic_N_m2=0.0, cutting_N=0.0, friction=friction)
    )
    insertion.advance(50e-3, 1e-3)
    assert insertion.deflection_m == pytest.approx(5e-3, rel=1e-12)
    assert insertion.pull_N == pytest.approx(0.45, rel=1e-12)
    wall = Membrane(name="wall", depth_m=45e-3, puncture_N=0.3, hold_N=0.0)
    insertion = Insertion(replace(insertion.tissue, membranes=(wall,)))
    insertion.advance(53e-3, 1e-3)
    assert (insertion.inserted_m, insertion.pull_N) == (45e-3, pytest.approx(0.72, rel=1e-12))
    insertion.advance(54e-3, 1e-3)
    assert insertion.punctures == [
        (pytest.approx(45e-3 + 0.75 / 90.0, rel=1e-12), pytest.approx(0.75, rel=1e-12))
    ]
