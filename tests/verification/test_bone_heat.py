"""Heat of drilling bone: closed form of a heated hole, and the published rise next to a hole.

The published cells are those of Pourgiv 2024 (doi 10.1016/j.heliyon.2024.e26248, table 2): ovine
vertebra, 4 mm drill, 22 degC at the start. The peak 0.5 mm from the wall is 25.0 to 28.2 degC over
the six cells, so that the rise is 3.0 to 6.2 K. The paper's abstract does not state the density of
the bone and the depth of the hole. Both are assumptions here.
"""

from functools import cache
from math import atan, cos, pi, radians, sin, sqrt, tan

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.special import kve

from tissue import load_scene
from tissue.models.heat.conduction import Conduction, HeatGrid
from tissue.simulation.simulate import simulate

CONDUCTIVITY, CAPACITY, SHARE = 0.58, 1800.0 * 1300.0, 0.1
"""Cited constants of bone [W/(m K)], [J/(m3 K)], and the share of the power; typed in."""
RADIUS_M = 2e-3
FROM_HOLE_M = 2.5e-3
"""Distance of the thermocouple from the axis [m], half a millimetre from the wall."""


def heated_hole(radius_m, time_s, *, wall_m, flux):
    """Return the rise around a long hole with a constant flux into its wall [K].

    Carslaw and Jaeger 1959, ch. 13.5. The Laplace transform is q K0(p r) / (k p s K1(p a)) with p =
    sqrt(s / alpha). It is inverted by the fixed Talbot contour (Abate and Valko 2004).
    """
    count = 32
    angle = pi * np.arange(1, count) / count
    cot = 1.0 / np.tan(angle)
    scale = 2.0 * count / (5.0 * time_s)
    points = np.append(scale, scale * angle * (cot + 1j))
    turn = np.append(0.5, 1.0 + 1j * (angle + (angle * cot - 1.0) * cot))
    p = np.sqrt(points * CAPACITY / CONDUCTIVITY)
    decay = np.exp(-p * (radius_m - wall_m))
    transform = flux * kve(0, p * radius_m) * decay / kve(1, p * wall_m)
    transform /= CONDUCTIVITY * p * points
    return float((np.exp(points * time_s) * transform * turn).real.sum() * scale / count)


def test_the_wall_of_a_hole_with_a_constant_flux():
    """The rise half a millimetre from the wall is within 3 % of the closed form.

    The hole has no cells of its own shape: its wall crosses cells of 0.25 mm, which are partly
    full.
    """
    size = 0.25e-3
    half = 8e-3
    flux = 1000.0
    time_s = 5.0
    edges = np.arange(-half, half + 0.5 * size, size)
    count = len(edges) - 1
    inside = (np.arange(16 * count) + 0.5) * size / 16.0 - half
    fine = np.hypot(inside[:, None], inside) > RADIUS_M
    filled = fine.reshape(count, 16, count, 16).mean(axis=(1, 3))[:, :, None]
    shape = filled.shape
    grid = HeatGrid(
        (edges, edges, np.array([0.0, size])),
        filled,
        np.full(shape, CONDUCTIVITY),
        np.full(shape, CAPACITY),
        np.zeros(shape, bool),
        np.zeros((0, 3)),
    )
    body = Conduction(grid)
    angle = np.linspace(0.0, 2.0 * pi, 2000, endpoint=False)
    around = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    power = np.zeros(filled.size)
    for direction in around:
        points = direction * (RADIUS_M + 0.5 * size * np.arange(4))[:, None]
        cells = grid.cells_at(points + np.array([0.0, 0.0, 0.5 * size]))
        first = cells[np.argmax(filled.reshape(-1)[cells] >= 0.5)]
        power[first] += flux * 2.0 * pi * RADIUS_M * size / len(angle)
    body.advance(power, time_s)
    centres = 0.5 * (edges[1:] + edges[:-1])
    rise = RegularGridInterpolator((centres, centres), body.rise_K[:, :, 0].astype(float))
    for radius in (FROM_HOLE_M, 3e-3, 4e-3):
        found = rise(radius * around[:, :2]).mean()
        exact = heated_hole(radius, time_s, wall_m=RADIUS_M, flux=flux)
        wall = heated_hole(RADIUS_M, time_s, wall_m=RADIUS_M, flux=flux)
        assert found == pytest.approx(exact, abs=0.03 * wall), radius


class Drill:
    """Power of a twist drill from the formulas of the law, on its cone and its chisel edge.

    The constants are typed in: point 118 degrees, web 0.18 of the diameter, helix 30 degrees, chip
    250 N/mm2 and edge 5 N/mm, friction angle of Merchant atan(160 / 250).
    """

    half = radians(59.0)
    flutes = 2
    chip = 250e6
    edge = 5e3

    def __init__(self, feed_m_s, rpm, *, radius=RADIUS_M, web=0.18, helix_deg=30.0):
        self.radius = radius
        self.omega = rpm * 2.0 * pi / 60.0
        self.feed = feed_m_s
        self.web = web * 2.0 * radius
        self.helix = radians(helix_deg)
        self.chisel = 0.5 * self.web / sin(radians(130.0))

    def depth(self, radius):
        """Height of the surface above the tip at a radius [m]."""
        return max(radius - self.chisel, 0.0) / tan(self.half)

    def flux(self, radius):
        """Power per area of the surface of revolution at a radius [W/m2]."""
        per_turn = self.feed * 2.0 * pi / (self.flutes * self.omega)
        lines = self.flutes * self.omega / (2.0 * pi)
        if radius < self.chisel:
            return lines * (self.chip * per_turn + self.edge)
        aside = self.web / (2.0 * radius)
        turn = radius / self.radius * tan(self.helix)
        rake = atan(
            turn * sqrt(1.0 - aside**2) / (sin(self.half) - turn * aside * cos(self.half))
        ) - atan(aside / sqrt(1.0 - aside**2) * cos(self.half))
        friction = atan(160.0 / 250.0)
        ratio = (cos(friction - rake) / (1.0 - sin(friction - rake))) / (
            cos(friction) / (1.0 - sin(friction))
        )
        return lines * ratio * (self.chip * per_turn * sin(self.half) + self.edge)

    @property
    def rings(self):
        """Radii, and areas of the surface there [m], [m2]."""
        radius = (np.arange(2000) + 0.5) * self.radius / 2000
        slope = np.where(radius < self.chisel, 1.0, 1.0 / sin(self.half))
        return radius, 2.0 * pi * radius * slope * self.radius / 2000


def finite_differences(drill, *, depth_m, rest_s, cell_m=0.05e-3, conductivity=CONDUCTIVITY):
    """Drill a hole in (r, z) with finite differences; share no code with the engine.

    Returns
    -------
    Largest rise so far in (r, z), r, z, and the mean power of the whole drill [W].
    """
    h = cell_m
    rings, rows = round(7e-3 / h), round((depth_m + 5e-3) / h)
    r, z = (np.arange(rings) + 0.5) * h, (np.arange(rows) + 0.5) * h
    capacity = CAPACITY * (2.0 * pi * r * h * h)[:, None] * np.ones(rows)
    across = conductivity * 2.0 * pi * np.arange(1, rings)[:, None] * h
    along = conductivity * 2.0 * pi * r[:, None]
    solid = np.ones((rings, rows), bool)
    rise, peak = np.zeros((rings, rows)), np.zeros((rings, rows))
    drilling_s = depth_m / drill.feed
    step = 0.9 * h * h * CAPACITY / (4.0 * conductivity)
    radius, area = drill.rings
    power = SHARE * area * np.array([drill.flux(each) for each in radius])
    shape = np.array([drill.depth(each) for each in radius])
    profile = np.array([drill.depth(each) for each in r])
    for at in range(round((drilling_s + rest_s) / step)):
        tip = min((at + 0.5) * step, drilling_s) * drill.feed
        gained = np.zeros((rings, rows))
        if at * step < drilling_s:
            surface = tip - profile
            cut = solid & (r < drill.radius)[:, None] & (z[None, :] < surface[:, None])
            rise[cut] = 0.0
            solid &= ~cut
            height = tip - shape
            heats = height > 0.0
            i = np.minimum((radius[heats] / h).astype(int), rings - 1)
            first = np.argmax(solid[i], axis=1)
            np.add.at(gained, (i, first), power[heats])
        flow = across * np.diff(rise, axis=0) * (solid[1:] & solid[:-1])
        gained[:-1] += flow
        gained[1:] -= flow
        flow = along * np.diff(rise, axis=1) * (solid[:, 1:] & solid[:, :-1])
        gained[:, :-1] += flow
        gained[:, 1:] -= flow
        rise += step * gained / capacity
        np.maximum(peak, rise, out=peak)
    return peak, r, z, float(power.sum()) / SHARE


DEPTH_MM, REST_S = 5.0, 3.0
"""Depth of the hole, an assumption, and time for which the drill rests at its end."""
FEEDS_MM_MIN, SPEEDS_RPM = (30.0, 60.0), (500.0, 1200.0, 2000.0)
INDEPENDENT = {(30.0, 2000.0), (60.0, 500.0)}
"""Cells with the largest and the smallest rise, which are compared with finite differences."""
THRUST_N = {
    (30.0, 500.0): 9.59,
    (30.0, 1200.0): 6.16,
    (30.0, 2000.0): 4.91,
    (60.0, 500.0): 12.23,
    (60.0, 1200.0): 7.15,
    (60.0, 2000.0): 6.28,
}
"""Measured thrust of each cell, mean of three holes."""
MEASURED_K = 3.0, 6.2
"""Smallest and largest measured rise; the cells that they belong to are not known here."""
HEAT_SHARES = 0.02, 0.5
"""Cited range of the share."""


@cache
def drilled(feed_mm_min, rpm, diameter_mm=4.0):
    """Drill cortical bone of 1800 kg/m3 in a scene with heat.

    Returns
    -------
    Thrust [N] and torque [N mm] of the whole drill, the rise next to the hole [K] and the run.
    """
    feed_mm_s = feed_mm_min / 60.0
    scene = load_scene(
        "milling",
        {
            "anatomy.size_mm": [14.0, 14.0, 10.0],
            "tool.kind": "twist-drill",
            "tool.diameter_mm": diameter_mm,
            "tool.length_mm": 30.0,
            "tool.flutes": 2,
            "tool.spin_rpm": rpm,
            "voxels.spacing_mm": 0.1,
            "motion.points_mm": [[0.0, 0.0, 0.1], [0.0, 0.0, -DEPTH_MM]],
            "motion.feed_mm_s": feed_mm_s,
            "duration_s": (DEPTH_MM + 0.1) / feed_mm_s + REST_S,
            "heat": True,
        },
    )
    run = simulate(scene)
    trace = run.trace
    whole = (trace["tool_z_mm"] < -3.0) & (trace["tool_z_mm"] > -DEPTH_MM + 0.1)
    tissue = run.parts.tissue
    centres = [0.5 * (edges[1:] + edges[:-1]) for edges in tissue.heat.grid.edges_m]
    peak = RegularGridInterpolator(centres, tissue.peak_K)
    angle = np.linspace(0.0, 2.0 * pi, 48, endpoint=False)
    probe_m = 5e-4 * diameter_mm + FROM_HOLE_M - RADIUS_M
    around = np.column_stack([probe_m * np.cos(angle), probe_m * np.sin(angle)])
    heights = np.linspace(-3.5e-3, -2e-3, 7)
    rises = [peak(np.column_stack([around, np.full(len(angle), z)])).mean() for z in heights]
    thrust = float(np.abs(trace["model_force_z_N"][whole]).mean())
    torque = 1e3 * float(np.abs(trace["model_torque_z_Nm"][whole]).mean())
    return thrust, torque, float(np.mean(rises)), run


@cache
def independent(feed_mm_min, rpm, *, radius=RADIUS_M, conductivity=CONDUCTIVITY):
    """Return torque [N mm] and the rise next to the hole [K] by the finite differences."""
    drill = Drill(feed_mm_min / 6e4, rpm, radius=radius)
    peak, r, z, power_W = finite_differences(
        drill, depth_m=1e-3 * DEPTH_MM, rest_s=REST_S, conductivity=conductivity
    )
    rows = np.flatnonzero((z > 2e-3) & (z < 3.5e-3))
    probe_m = drill.radius + FROM_HOLE_M - RADIUS_M
    rises = [np.interp(probe_m, r, peak[:, row]) for row in rows]
    return 1e3 * power_W / drill.omega, float(np.mean(rises))


def check_rise(feed, rpm):
    """Check that the rise is within 7 % of finite differences in (r, z), and the torque within 1 %.

    The cells of the engine are 0.25 mm, and those of the finite differences 0.05 mm.
    """
    _, torque, rise, run = drilled(feed, rpm)
    expected_torque, expected = independent(feed, rpm)
    assert torque == pytest.approx(expected_torque, rel=0.01)
    assert rise == pytest.approx(expected, rel=0.07)
    balance = run.summary["heat_J"]
    parts = sum(value for name, value in balance.items() if name != "cutting")
    assert parts == pytest.approx(balance["cutting"], rel=1e-5)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_ovine_vertebra_and_the_trends_over_feed_and_speed():
    """In cortical bone, the band of the share overlaps the measured range. It spans a factor of 25.

    The cells of `INDEPENDENT` agree with finite differences. At the measured thrust, the cited
    share of 0.1 predicts a seventh of the measured rise. The trends agree with Augustin 2008 (doi
    10.1007/s00402-007-0427-3): the rise increases with the speed and the diameter, and decreases
    with the feed. The largest rise of the six cells is 3.9 times the smallest rise. The measured
    factor is 2.1.
    """
    print("\nfeed mm/min, rpm | thrust N: measured, cortical | rise K: engine, scaled")
    rises = {}
    scaled = []
    for (feed, rpm), measured_N in THRUST_N.items():
        thrust, _, rise, _ = drilled(feed, rpm)
        rises[feed, rpm] = rise
        scaled.append(rise * measured_N / thrust)
        forces = f"{measured_N:5.2f} {thrust:5.2f}"
        print(f"{feed:3.0f} {rpm:5.0f} | {forces} | {rise:.2f} {scaled[-1]:.2f}")
        if (feed, rpm) in INDEPENDENT:
            check_rise(feed, rpm)
    for feed in FEEDS_MM_MIN:
        assert rises[feed, 500.0] < rises[feed, 1200.0] < rises[feed, 2000.0]
    for rpm in SPEEDS_RPM:
        assert rises[60.0, rpm] < rises[30.0, rpm]
    narrow = drilled(60.0, 1200.0, 2.5)[2]
    alone = independent(60.0, 1200.0, radius=1.25e-3)[1]
    print(f"2.5 mm drill, 60 mm/min, 1200 rpm: {narrow:.2f} K, independent {alone:.2f} K")
    assert narrow < rises[60.0, 1200.0]
    assert narrow == pytest.approx(alone, rel=0.1)
    cortical = np.array(list(rises.values()))
    shares = np.array(HEAT_SHARES) / SHARE
    assert (cortical * shares[0] < MEASURED_K[0]).all()
    assert (cortical * shares[1] > MEASURED_K[0]).all()
    # What the model misses: at the measured thrust the cited share is too small, and four cells
    # stay below every measured rise even with the largest share.
    assert max(scaled) < 0.5 * MEASURED_K[0]
    assert (np.array(scaled) * shares[1] < MEASURED_K[0]).sum() == 4
    assert cortical.max() / cortical.min() > 1.5 * MEASURED_K[1] / MEASURED_K[0]
