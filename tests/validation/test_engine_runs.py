"""Runs of the engine in published set-ups against the closed form behind the tables."""

from dataclasses import replace

import numpy as np
import pytest
from engine_runs import drill_bands, drill_run, reamed_error_mm
from predictions import nominal, row_loads
from published import DATA, ORDER, data_sets

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not all((DATA / f"{key}.toml").is_file() for key in ORDER),
        reason="the published tables of tests/validation/data are absent",
    ),
]


@pytest.mark.parametrize(
    ("key", "place"),
    [
        ("macavelia2012_human", 2),
        ("macavelia2012_artificial", 0),
        ("pourgiv2024", 5),
        ("porcine2014", 1),
        ("jbsmse2020", 0),
    ],
)
def test_a_simulated_hole_has_the_loads_of_the_closed_form(key, place):
    """Thrust and torque of a hole in a block agree within 1 % and are flat over the depth.

    Measured forces are flat in depth as well until chips clog the flutes (Lee and Chu 2020, doi
    10.1115/1.4047463).
    """
    data = data_sets()[key]
    row = data.rows[place]
    found = drill_run(data, row)
    loads = row_loads(data, row, nominal(data))
    print(
        f"\n{data.name}: engine {found.thrust_N:.3f} N, {found.torque_Nmm:.3f} N mm; closed form "
        f"{loads.thrust_N[0]:.3f} N, {loads.torque_Nmm[0]:.3f} N mm; spread {found.spread:.1e}"
    )
    assert found.thrust_N == pytest.approx(loads.thrust_N[0], rel=0.01)
    assert found.torque_Nmm == pytest.approx(loads.torque_Nmm[0], rel=0.01)
    assert found.spread < 0.01


def test_only_the_feed_per_turn_counts():
    """Twice the speed at twice the feed gives the same loads, within 0.2 %.

    Measured forces depend on the feed alone, not on the speed (Med Eng Phys 2018, PubMed 29089237,
    animal bone and composite).
    """
    data = data_sets()["macavelia2012_human"]
    row = data.rows[0]
    slow = drill_run(data, row)
    fast = drill_run(data, replace(row, rpm=2.0 * row.rpm, feed_mm_min=2.0 * row.feed_mm_min))
    assert fast.thrust_N == pytest.approx(slow.thrust_N, rel=2e-3)
    assert fast.torque_Nmm == pytest.approx(slow.torque_Nmm, rel=2e-3)


def test_bands_of_the_engine_are_those_of_the_closed_form():
    """Each sample of a band has the loads of the closed form, within 1 % of the median load."""
    data = data_sets()["pourgiv2024"]
    engine, closed = drill_bands(data, data.rows[5])
    assert len(engine) == 256
    difference = np.abs(engine - closed) / np.median(closed, axis=0)
    print(f"\nlargest differences of thrust and torque: {difference.max(axis=0)}")
    assert difference.max() < 0.01


def test_reamed_cavities_deviate_less_than_measured_ones():
    """The reamer's path is exact, and so is the cavity: 0.003 mm of diameter, 0.03 mm of depth.

    Measured cavities are off by 0.08 to 1.2 mm, through play, bending and the motion of the hand.
    """
    assert abs(reamed_error_mm("reamed diameter")) < 0.003
    assert reamed_error_mm("reamed sphere") < 0.03
