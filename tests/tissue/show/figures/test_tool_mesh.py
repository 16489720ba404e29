"""Sense of a tool's spin: clockwise seen from the shank, like common burs, drills and reamers."""

import numpy as np
import pytest

from tissue import load_scene
from tissue.show.figures.tool_mesh import spin_arc_mm, tool_surface, turning_tool
from tissue.simulation.builders.cutting import cutter_of


def scene_tool(**changes):
    """The burr of the scene milling."""
    return load_scene("milling").tool.model_copy(update=changes)


@pytest.mark.parametrize("name", ["glenoid", "milling", "molar", "caries"])
def test_built_in_cutters_turn_clockwise_as_seen_from_the_shank(name):
    assert cutter_of(load_scene(name).tool).spin_rad_s < 0.0


@pytest.mark.parametrize("spin_rpm", [500.0, -500.0])
def test_the_arrow_turns_as_the_cutter_does(spin_rpm):
    tool = scene_tool(spin_rpm=spin_rpm)
    arc = spin_arc_mm(tool)
    # about the axis from tip to shank, by the right-hand rule
    turned = np.cross(arc[:-1], arc[1:])[:, 2]
    assert (np.sign(turned) == np.sign(cutter_of(tool).spin_rad_s)).all()


def test_a_tool_that_does_not_turn_has_no_arrow():
    pytest.importorskip("pyvista")
    still, turning = scene_tool(spin_rpm=0.0), scene_tool()
    assert turning_tool(still).n_points == tool_surface(still).n_points
    assert turning_tool(turning).n_points > tool_surface(turning).n_points
    assert turning_tool(None) is None
