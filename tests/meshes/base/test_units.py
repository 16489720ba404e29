"""Headers with units, and columns found by name and unit."""

import pytest

from meshes.base.units import UNITS, column_of, name_of, plain_unit, unit_of


@pytest.mark.parametrize(
    ("header", "quantity", "name", "unit"),
    [
        ("tool_x_mm", "length", "tool_x", "mm"),
        ("Tool X [µm]", "length", "tool_x", "um"),
        ("Load (N)", "force", "load", "N"),
        ("Fz / mN", "force", "fz", "mN"),
        ("t, s", "time", "t", "s"),
        ("Time in msec", "time", "time", "ms"),
        ("feed_mm_min", "speed", "feed", "mm/min"),
        ("Feed [mm/min]", "speed", "feed", "mm/min"),
        ("Torque (N-m)", "torque", "torque", "Nm"),
        ("torque_x_N*mm", "torque", "torque_x_n_mm", ""),
        ("tool_x", "length", "tool_x", ""),
        ("__time", "time", "time", ""),
        ("Fz_kN", "length", "fz_kn", ""),
    ],
)
def test_name_and_unit_of_a_header(header, quantity, name, unit):
    assert name_of(header, quantity) == name
    assert unit_of(header, quantity) == unit
    assert unit == "" or unit in UNITS[quantity]


def test_a_column_is_found_in_any_unit_but_not_by_guess():
    assert column_of("tool_x_mm", "length", ["tool_x_um", "tool_x_mm"]) == "tool_x_mm"
    assert column_of("tool_x_mm", "length", ["Tool X [m]", "tool_y_mm"]) == "Tool X [m]"
    assert column_of("tool_x_mm", "length", ["tool_x_um", "tool_x_m"]) is None
    assert column_of("tool_x_mm", "length", ["tool_x"]) is None
    assert column_of("tool_qx", "number", ["Tool qx"]) == "Tool qx"


def test_spellings_of_units():
    spelt = ["N m", "N·m", "N*m", "μm", "inch", "sec", "°"]
    assert [plain_unit(each) for each in spelt] == ["Nm", "Nm", "Nm", "um", "in", "s", "deg"]
