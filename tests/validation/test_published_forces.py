"""Cutting law and drill against published measurements.

Bounds are the errors that `docs/validation.md` reports. A smaller error passes; the lists of sets
and rows that disagree must be updated together with that page.
"""

import drilling
import numpy as np
import pytest
from predictions import compared, fitted, ratios
from published import DATA, ORDER, data_sets
from report import controlled, ratio_errors, set_is_inside, variant_errors

from tissue.materials.constants import constants

pytestmark = pytest.mark.skipif(
    not all((DATA / f"{key}.toml").is_file() for key in ORDER),
    reason="the published tables of tests/validation/data are absent",
)
SIMPLE = "simple law, simple drill"
EARLIER = "earlier constants, simple law, simple drill"
OUTSIDE = {
    "macavelia2012_human",
    "orelaja2020_porcine",
    "orelaja2020_artificial",
    "dog_jaw",
    "graft_rake",
    "leucite",
    "yoshida2001",
    "karia2023",
    "marksman",
}
"""Sets with a measured figure outside the band."""


def test_every_file_is_listed_and_complete():
    assert {path.stem for path in DATA.glob("*.toml")} == set(ORDER)
    for key, data in data_sets().items():
        assert data.source and data.read and data.set_up, key
        assert data.role in ("test", "bounds a range", "source"), key
        assert (data.role == "test") == (not data.role_note), key
        assert data.rows or data.figures, key
        assert {row.half for row in data.rows} <= {"fit", "test"}, key
        for each in data.unknown.values():
            assert each.range[0] <= each.value <= each.range[1] and each.source, key
        for row in data.rows:
            assert row.thrust_N is not None and row.thrust_N > 0.0, key


def test_at_least_ten_sets_are_no_source_of_a_constant():
    independent = [key for key, data in data_sets().items() if data.role == "test"]
    assert len(independent) >= 10


def test_axial_coefficients_are_zero():
    """The closed form leaves them out."""
    cited = constants("cutting", "bone")
    for name in ("axial_chip_N_mm2", "axial_edge_N_mm"):
        assert (cited[name].value, cited[name].low, cited[name].high) == (0.0, 0.0, 0.0)


def test_closed_form_of_the_simple_drill():
    """A drill without web has the textbook sums of a straight lip, within 1e-9."""
    radius, feed, half = 1.6, 0.12, np.radians(59.0)
    law = drilling.nominal_law().changed(minimum_chip_um=0.0)
    loads = drilling.drill_loads(
        law,
        drilling.point_of(0.0, 30.0, 118.0),
        diameter_mm=np.array([2.0 * radius]),
        feed_per_turn_mm=np.array([feed]),
        density_kg_m3=law["reference_density_kg_m3"],
    )
    radial = law["radial_chip_N_mm2"]
    tangential = law["tangential_chip_N_mm2"]
    thrust = radial * feed * radius * np.sin(half) + 2.0 * law["radial_edge_N_mm"] * radius
    edge_torque = law["tangential_edge_N_mm"] * radius**2 / np.sin(half)
    assert loads.thrust_N == pytest.approx(thrust, rel=1e-9)
    assert loads.torque_Nmm == pytest.approx(
        tangential * feed * radius**2 / 2.0 + edge_torque, rel=1e-9
    )


def test_rings_are_fine_enough(monkeypatch):
    """Thrust and torque change by less than 0.2 % with four times as many rings."""

    def loads():
        found = drilling.drill_loads(
            drilling.nominal_law(),
            drilling.nominal_point(),
            diameter_mm=np.array([3.2]),
            feed_per_turn_mm=np.array([0.1]),
            density_kg_m3=np.array([1800.0]),
        )
        return [found.thrust_N[0], found.torque_Nmm[0]]

    coarse = loads()
    monkeypatch.setattr(drilling, "RINGS", 4 * drilling.RINGS)
    assert coarse == pytest.approx(loads(), rel=2e-3)


def test_ratios_over_speed_and_feed_of_controlled_sets():
    """Ratios at cited constants: 11 of 12 over speed and 2 of 3 over feed are within 15 %."""
    keys = controlled(data_sets())
    speed = np.abs(ratio_errors(keys, "speed"))
    feed = np.abs(ratio_errors(keys, "feed"))
    assert (len(speed), len(feed)) == (12, 3)
    assert (speed <= 0.15).sum() >= 11
    assert speed.max() < 0.19
    assert (feed <= 0.15).sum() >= 2
    assert feed.max() < 0.20


def test_the_flat_porcine_thrust_is_not_reproduced():
    """Measured thrust grows by 1.32 over 5.6 times the feed per turn; the law gives 2.45."""
    (found,) = ratios("porcine2014")
    assert found.kind == "both"
    assert 0.80 < found.error < 0.90


def test_earlier_constants_fail_the_ratios():
    """The check of ratios rejects the constants of before."""
    keys = controlled(data_sets())
    assert (np.abs(ratio_errors(keys, "speed", EARLIER)) <= 0.15).sum() < 9


def test_fits_of_half_of_the_rows():
    """Errors on the held-out rows, two factors fitted."""
    bounds = {"macavelia2012_human": 0.06, "macavelia2012_artificial": 0.13, "pourgiv2024": 0.09}
    for key, bound in bounds.items():
        found = fitted(key, 2)
        assert found.test_error < bound
        assert found.test_error > 0.0
    assert fitted("porcine2014", 2) is None
    assert fitted("porcine2014", 1).test_error > 0.8
    assert fitted("jbsmse2020", 1) is None


def test_a_fit_recovers_planted_factors(monkeypatch):
    """Rows made with chip and edge coefficients times 2 and 3 give these factors."""
    import predictions

    data = data_sets()["pourgiv2024"]
    drawn = predictions.nominal(data)
    planted = []
    for row in data.rows:
        loads = predictions.row_loads(data, row, drawn).scaled(2.0, 3.0)
        planted.append(
            type(row)(row.half, row.rpm, row.feed_mm_min, thrust_N=float(loads.thrust_N[0]))
        )
    changed = {"pourgiv2024": type(data)(**(vars(data) | {"rows": tuple(planted)}))}
    monkeypatch.setattr(predictions, "data_sets", lambda: changed)
    found = fitted("pourgiv2024", 2)
    assert (found.chip, found.edge) == pytest.approx((2.0, 3.0), rel=1e-6)
    assert found.test_error < 1e-6


def test_what_chisel_edge_and_rake_buy():
    """Chisel edge and rake halve the error of torque over thrust and of two-factor fits."""
    keys = controlled(data_sets())
    simple = variant_errors(keys, SIMPLE)
    refined = variant_errors(keys, drilling.DEFAULT)
    assert refined.arm < 0.31
    assert refined.arm < 0.5 * simple.arm
    assert refined.held_two < 0.6 * simple.held_two
    assert refined.factor < 2.9


def test_the_minimum_chip_does_not_matter_in_drilling():
    """Chips of these drills are at least 2 um thick, 20 times the minimum chip thickness."""
    keys = controlled(data_sets())
    simple = variant_errors(keys, SIMPLE)
    assert variant_errors(keys, "minimum chip, simple drill") == simple


@pytest.mark.slow
def test_bands_contain_the_measured_figures_of_nine_sets():
    """Of 18 sets that are no source, nine lie inside their bands: 50 %, short of the goal of 80 %.

    Without the two sets that bound ranges it is eight of 16.
    """
    tests = [key for key, data in data_sets().items() if data.role != "source"]
    assert len(tests) == 18
    assert {key for key in tests if not set_is_inside(key)} == OUTSIDE
    free = [key for key in tests if data_sets()[key].role == "test"]
    assert (len(free), sum(map(set_is_inside, free))) == (16, 8)
    figures = [each.inside for key in tests for each in compared(key)]
    assert sum(figures) >= 37


@pytest.mark.slow
def test_sources_of_constants_agree_but_for_two_figures():
    """Sets behind the constants are reproduced, which is no validation.

    The cutting force of a saw tooth is constant over the depth. The cited coefficients let it grow
    by 36 %.
    """
    sources = [key for key, data in data_sets().items() if data.role == "source"]
    outside = [each.label for key in sources for each in compared(key) if not each.inside]
    assert outside == ["cutting force at 10 over 2 um"]
