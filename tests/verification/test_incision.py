"""Blade in soft tissue, against closed forms.

No measured force of a blade in skin or liver was found as numbers that can be compared. Tested are
the consequences of the model: force against width, depth and angle, work against toughness and
friction, and an open cut.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tissue.models.incision.model import IncisionModel
from tissue.models.incision.parameters import Blade, IncisedTissue, incised_tissue
from tissue.models.tissue_model import ToolMotion

STEP_M = 2e-5
"""Travel in a tick at 20 mm/s [m]."""

WITHIN = 0.01
"""Tolerance of the closed forms: 1 %. Measured are 0.3 % at most."""

TISSUE = IncisedTissue(
    name="skin",
    toughness_J_m2=1700.0,
    friction_Pa=2e4,
    stiffness_N_m=2e4,
    young_Pa=1.5e6,
    poisson_ratio=0.45,
    prestrain=0.1,
)
J = TISSUE.toughness_J_m2
TAU = TISSUE.friction_Pa


def blade(width_mm=6.0, edge_deg=90.0):
    """A blade."""
    return Blade(width_m=1e-3 * width_mm, thickness_m=4e-4, edge_rad=np.radians(edge_deg))


class Driven:
    """A blade that is moved along straight lines, with the work of the tool."""

    def __init__(self, tool, *, tissue=TISSUE, lean_deg=0.0):
        """Put a blade above the surface, leaning towards +x by an angle."""
        self.model = IncisionModel(tissue, tool)
        self.motion = ToolMotion()
        self.motion.rotation[:] = Rotation.from_euler("y", lean_deg, degrees=True).as_matrix()
        self.motion.tip_m[:] = 0.02 * self.motion.rotation[:, 2]
        self.model.place(self.motion)
        self.force_N = np.zeros(3)
        self.work_J = 0.0
        self.places = []

    def go(self, *points_mm, step_m=STEP_M):
        """Visit points and return the last force [N]."""
        for point in points_mm:
            start = self.motion.tip_m.copy()
            stroke = 1e-3 * np.array(point, float) - start
            count = max(round(np.linalg.norm(stroke) / step_m), 1)
            self.motion.heading[0] = stroke / max(np.linalg.norm(stroke), 1e-300)
            for share in np.arange(1, count + 1) / count:
                before = self.motion.tip_m.copy()
                self.motion.tip_m[:] = start + share * stroke
                self.model.advance(self.motion)
                force = self.model.respond(self.motion).wrench[:3].copy()
                self.work_J -= 0.5 * (force + self.force_N) @ (self.motion.tip_m - before)
                self.force_N = force
                if self.model.cuts:
                    self.places.append(self.model.cuts[0].place_m)
        return self.force_N

    @property
    def cut(self):
        """The first cut."""
        return self.model.cuts[0]


@pytest.mark.parametrize("width_mm", [2.0, 6.0, 15.0])
def test_a_chisel_pushed_in_resists_with_its_width_and_its_walls(width_mm):
    """F = J w + 2 tau w l."""
    driven = Driven(blade(width_mm))
    for depth_mm in (2.0, 5.0, 9.0):
        force = driven.go((0, 0, -depth_mm))
        width = 1e-3 * width_mm
        deep = driven.cut.place_m[1]
        assert force[2] == pytest.approx(J * width + 2.0 * TAU * width * deep, rel=WITHIN)
        assert np.abs(force[:2]).max() < 1e-9


def test_the_surface_yields_until_the_energy_release_reaches_the_toughness():
    """Before the cut F = k z. The cut begins at F = J w, where the energy release F / w is J."""
    driven = Driven(blade())
    onset_m = J * 6e-3 / TISSUE.stiffness_N_m
    for share in (0.3, 0.6, 0.9):
        depth_m = share * onset_m
        assert driven.go((0, 0, -1e3 * depth_m))[2] == pytest.approx(
            TISSUE.stiffness_N_m * depth_m, rel=1e-9
        )
        assert driven.model.area_m2 < 1e-12
    driven.go((0, 0, -1.2e3 * onset_m))
    assert driven.model.area_m2 == pytest.approx(6e-3 * driven.cut.place_m[1], rel=1e-6)
    assert driven.model.area_m2 > 0.0


@pytest.mark.parametrize("edge_deg", [20.0, 45.0, 70.0])
def test_a_pointed_blade_pushed_in_resists_with_its_width_at_the_surface(edge_deg):
    """F = J l tan(a) + tau l² tan(a), until the edge is in as a whole."""
    driven = Driven(blade(12.0, edge_deg))
    tangent = np.tan(np.radians(edge_deg))
    for wide_mm in (2.0, 4.0, 8.0):
        force = driven.go((0, 0, -wide_mm / tangent))
        deep = driven.cut.place_m[1]
        assert 1e-3 < deep * tangent < 12e-3
        expected = J * deep * tangent + TAU * deep**2 * tangent
        assert force[2] == pytest.approx(expected, rel=WITHIN)


@pytest.mark.parametrize(
    ("edge_deg", "depth_mm"), [(30.0, 2.0), (45.0, 4.0), (60.0, 2.0), (90.0, 4.0)]
)
def test_a_slice_resists_with_its_depth_at_any_angle_of_the_edge(edge_deg, depth_mm):
    """F = J d + 2 tau M against the motion, J d cot(a) upwards at a slanting edge.

    M is the part of the blade's side in the tissue.
    """
    driven = Driven(blade(6.0, edge_deg))
    force = driven.go((0, 0, -depth_mm), (20, 0, -depth_mm))
    deep = driven.cut.place_m[1]
    slant = 1.0 / np.tan(np.radians(edge_deg))
    reached = min(6e-3, deep / slant) if edge_deg < 90.0 else 6e-3
    walls = deep * reached - 0.5 * slant * reached**2
    assert -force[0] == pytest.approx(J * deep + 2.0 * TAU * walls, rel=WITHIN)
    if edge_deg < 90.0:
        assert force[2] == pytest.approx(J * reached, rel=WITHIN)


@pytest.mark.parametrize("stroke_deg", [15.0, 40.0, 75.0])
def test_an_oblique_stroke_resists_with_the_area_that_it_cuts(stroke_deg):
    """F against the motion = J (w sin(b) + d cos(b)) + 2 tau w d at an angle b below the surface."""
    driven = Driven(blade(4.0))
    stroke = np.array([np.cos(np.radians(stroke_deg)), 0.0, -np.sin(np.radians(stroke_deg))])
    force = driven.go((0, 0, -3), np.array([0, 0, -3.0]) + 8.0 * stroke)
    deep = driven.cut.place_m[1]
    expected = J * (4e-3 * -stroke[2] + deep * stroke[0]) + 2.0 * TAU * 4e-3 * deep
    assert -force @ stroke == pytest.approx(expected, rel=WITHIN)


@pytest.mark.parametrize("lean_deg", [-35.0, -10.0, 20.0, 40.0])
def test_a_leaning_chisel_pushed_along_its_axis_resists_with_its_width(lean_deg):
    """F along the axis = J w + 2 tau w l, with l the mean depth along the axis."""
    driven = Driven(blade(3.0), lean_deg=lean_deg)
    axis = driven.motion.rotation[:, 2]
    force = driven.go(-9.0 * axis)
    mean = driven.cut.place_m[1] + 1.5e-3 * np.tan(np.radians(lean_deg))
    assert driven.model.area_m2 == pytest.approx(3e-3 * mean, rel=WITHIN)
    assert force @ axis == pytest.approx(J * 3e-3 + 2.0 * TAU * 3e-3 * mean, rel=WITHIN)


def area_m2(places, tool):
    """Area above the deepest edge over all places of an upright blade, on a fine line [m2]."""
    places = np.array(places)
    line = np.arange(places[:, 0].min() - 1e-4, places[:, 0].max() + tool.width_m + 1e-4, 5e-6)
    deepest = np.zeros(len(line))
    for along, deep in places:
        inside = (line >= along) & (line <= along + tool.width_m)
        edge = deep - tool.rise * (line[inside] - along)
        deepest[inside] = np.maximum(deepest[inside], edge)
    return float(deepest.sum() * 5e-6)


@pytest.mark.parametrize(("edge_deg", "seed"), [(30.0, 0), (45.0, 1), (90.0, 2)])
def test_work_is_toughness_times_area_and_friction(edge_deg, seed):
    """A wandering blade that ends outside: no energy is left in the tissue.

    The area is that of the blade's places, found without the model's columns.
    """
    random = np.random.default_rng(seed)
    tool = blade(6.0, edge_deg)
    driven = Driven(tool)
    points = np.column_stack([random.uniform(-10, 10, 6), np.zeros(6), random.uniform(-7, 1, 6)])
    driven.go((0, 0, -5), *points, (*points[-1, :2], 15.0))
    assert not driven.force_N.any()
    cut_J = J * area_m2(driven.places, tool)
    assert driven.model.area_m2 * J == pytest.approx(cut_J, rel=WITHIN)
    assert driven.work_J == pytest.approx(cut_J + driven.model.friction_J, rel=WITHIN)
    assert driven.model.friction_J > 0.01 * cut_J


def test_a_second_pass_meets_no_tissue():
    """A second pass meets no tissue.

    It follows the blade's places of the first pass, where the tissue had yielded. A deeper one cuts.
    """
    driven = Driven(blade(6.0, 45.0))
    first = driven.go((0, 0, -4), (20, 0, -4))
    deep_mm = 1e3 * driven.cut.place_m[1]
    reached_mm = 1e3 * driven.cut.place_m[0]
    driven.go((20, 0, 5), (2, 0, 5))
    cut = driven.model.area_m2
    largest = 0.0
    for x in np.arange(2.0, reached_mm - 0.1, 0.5):
        force = driven.go((x, 0, -deep_mm + 0.05))
        largest = max(largest, float(np.linalg.norm(force)))
    assert largest < 1e-9 < 1.0 < np.linalg.norm(first)
    assert driven.model.area_m2 == cut and len(driven.model.cuts) == 1
    assert np.linalg.norm(driven.go((5, 0, -6))) > 1.0


def test_the_steady_force_does_not_depend_on_stiffness():
    """The steady force per depth does not depend on the stiffness, which only sets the depth."""
    found = []
    for stiffness in (2e3, 2e5):
        driven = Driven(blade(6.0), tissue=replace(TISSUE, stiffness_N_m=stiffness, friction_Pa=0))
        force = driven.go((0, 0, -8), (25, 0, -8))
        found.append(-force[0] / driven.cut.place_m[1])
    assert found == pytest.approx([J, J], rel=1e-6)


@pytest.mark.parametrize(("material", "onset_mm"), [("skin", 2.25), ("liver", 9.89)])
def test_constants_of_the_scene(material, onset_mm):
    """Deflection at which a chisel of 6 mm begins to cut: 10.2 N in skin, 0.98 N in liver."""
    tissue = incised_tissue(material, blade())
    assert 1e3 * tissue.toughness_J_m2 * 6e-3 / tissue.stiffness_N_m == pytest.approx(
        onset_mm, rel=5e-3
    )
