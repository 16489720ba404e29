"""Heat conduction against closed forms (Carslaw and Jaeger 1959, ch. X; Jaeger 1942), with
material that is removed.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erfc, k0

from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.materials.constants import constants, cutting_coefficients
from tissue.materials.scene_constants import Materials
from tissue.models.bone.model import BoneModel
from tissue.models.heat.conduction import Conduction, HeatGrid
from tissue.models.heat.cutting_heat import CuttingHeat
from tissue.models.tissue_model import ToolMotion

CONDUCTIVITY, CAPACITY = 0.6, 3.4e6  # of the order of dentin [W/(m K)], [J/(m3 K)]
DIFFUSIVITY = CONDUCTIVITY / CAPACITY


def grid_of(conductivity, capacity, edges_m, filled=None):
    """Cells of given material, full where they hold any."""
    filled = (conductivity > 0.0).astype(float) if filled is None else filled
    return HeatGrid(
        edges_m,
        filled,
        conductivity,
        capacity,
        np.zeros(conductivity.shape, dtype=bool),
        np.zeros((0, 3)),
    )


def medium(shape, spacing_m):
    """One material in cubic cells."""
    edges = tuple(spacing_m * np.arange(n + 1.0) for n in shape)
    return Conduction(grid_of(np.full(shape, CONDUCTIVITY), np.full(shape, CAPACITY), edges))


def test_plane_source_at_an_insulated_face_over_growing_cells():
    """A plane source at an insulated face over growing cells follows the closed form.

    For constant flux into a half space, T(0, t) = 2 q sqrt(t / (pi k rho c)); the error at the
    face's first cell centre is 2 %.
    """
    time, flux = 1.0, 1000.0
    widths = np.concatenate(
        [np.full(20, 5e-5), np.full(10, 1e-4), np.full(10, 2e-4), np.full(6, 4e-4)]
    )
    edges = (
        np.concatenate([[0.0], np.cumsum(widths)]),
        5e-5 * np.arange(3.0),
        1e-4 * np.arange(3.0),
    )
    shape = (len(widths), 2, 2)
    body = Conduction(grid_of(np.full(shape, CONDUCTIVITY), np.full(shape, CAPACITY), edges))
    power = np.zeros(shape)
    power[0] = flux * 5e-5 * 1e-4
    body.advance(power, time)
    spread = 2.0 * np.sqrt(DIFFUSIVITY * time)
    for cell in (0, 12, 22, 27):
        depth = 0.5 * (edges[0][cell] + edges[0][cell + 1])
        exact = spread / np.sqrt(np.pi) * np.exp(-((depth / spread) ** 2)) - depth * erfc(
            depth / spread
        )
        peak = spread / np.sqrt(np.pi)
        assert body.rise_K[cell, 0, 0] == pytest.approx(
            flux / CONDUCTIVITY * exact, abs=0.01 * flux / CONDUCTIVITY * peak
        )


@pytest.mark.parametrize("thickness", range(8, 17))
def test_rise_at_the_pulp_wall_does_not_depend_on_the_cells_outside_the_reach(thickness):
    """The rise at the wall over large cells is within 2 % of the rise over equal cells.

    Measured: 1.4 %. Dentin of 8 to 16 voxels lies between a plane source and the pulp. The wall falls on a face of a
    large cell, or inside such a cell.
    """
    count = 60
    layer = np.zeros((3, 3, count), np.uint8)
    layer[..., : count - thickness] = 1
    full = np.full(layer.shape, 255, np.uint8)
    density = np.full(layer.shape, 1000, np.uint16)
    spacing = 1.25e-4
    column = VoxelVolume(np.zeros(3), spacing, full, layer, density, ("dentin", "pulp"))
    top = spacing * np.array([3.0, 3.0, count])
    rises = []
    for lowest in (0, count - 2):
        reach = spacing * np.array([0.0, 0.0, lowest]), top
        grid = HeatGrid.of_volume(column, reach_m=reach, constants=Materials.cited)
        body = Conduction(grid)
        power = np.zeros(grid.filled.shape)
        power[..., -1] = 1e-3
        body.advance(power, 10.0)
        at_wall = grid.interpolation(grid.pulp_wall_m) @ body.rise_K.reshape(-1)
        rises.append(at_wall.max())
    assert rises[1] == pytest.approx(rises[0], rel=0.02)


@pytest.mark.slow
def test_moving_band_against_jaeger():
    """A moving band follows Jaeger (1942).

    A band of width 2 l moves with V over an insulated half space, in two dimensions:

    T = q / (pi k) integral over the band of exp(-V (x - s) / 2a) K0(V sqrt((x - s)^2 + z^2) / 2a)
    ds.
    """
    h, half, speed, flux = 5e-5, 4e-4, 1.5e-3, 1e4
    shape = (220, 1, 60)
    body = medium(shape, h)
    step, ticks = 5e-3, 1200
    for tick in range(ticks):
        middle = 1.5e-3 + speed * (tick + 0.5) * step
        low = h * np.arange(shape[0])
        covered = np.clip(
            np.minimum(low + h, middle + half) - np.maximum(low, middle - half), 0.0, h
        )
        power = np.zeros(shape)
        power[:, 0, 0] = flux * covered * h
        body.advance(power, step)
    middle = 1.5e-3 + speed * ticks * step
    found = body.rise_K[:, 0, :]

    def exact(x, z):
        def part(s):
            return np.exp(-speed * (x - s) / (2 * DIFFUSIVITY)) * k0(
                speed * np.hypot(x - s, z) / (2 * DIFFUSIVITY)
            )

        return (
            flux
            / (np.pi * CONDUCTIVITY)
            * quad(part, -half, half, points=[x] if abs(x) < half else None)[0]
        )

    peak = exact(-half, 0.5 * h)
    for x, z in ((0.0, 0.5), (-3e-4, 0.5), (2e-4, 0.5), (-6e-4, 4.5), (-1e-3, 8.5), (0.0, 6.5)):
        at = round((middle + x) / h - 0.5)
        place = (at + 0.5) * h - middle
        assert found[at, int(z)] == pytest.approx(exact(place, z * h), abs=0.03 * peak), (x, z)


def receded(spacing_m, speed=1.5e-3, time_s=1.0, interval_s=0.01):
    """Return the heat left under a face that recedes under a flux of 1 W/m2, relative to q a / v^2.

    The value belongs to the steady state. T = q / (rho c v) exp(-v x / a) ahead of the face, so
    that q a / v^2 is left for each area and the rest is removed.
    """
    count = int(4e-3 / spacing_m)
    body = medium((count, 1, 1), spacing_m)
    area, volume, face, left = spacing_m**2, spacing_m**3, 0.0, []
    for _ in range(round(time_s / interval_s)):
        filled = body.filled[:, 0, 0]
        cell = int(np.argmax(filled >= 0.5))
        power = np.zeros(count)
        power[cell] = area
        body.advance(power, interval_s)
        warmer = 0.5 * area * filled[cell] * spacing_m / (CONDUCTIVITY * area)
        face += speed * interval_s
        lost = filled - np.clip(
            (spacing_m * np.arange(1, count + 1) - face) / spacing_m, 0.0, 1.0
        ) * (filled > 0.0)
        cells = np.flatnonzero(lost > 1e-12)
        body.remove(cells, lost[cells], np.full(len(cells), warmer))
        left.append(body.stored_J)
    assert body.stored_J + body.removed_J == pytest.approx(area * time_s, rel=1e-4)
    assert (body.rise_K[: int(face / spacing_m), 0, 0] == 0.0).all()
    assert volume * CAPACITY * float((body.rise_K * body.filled).sum()) == pytest.approx(
        body.stored_J, rel=1e-6
    )
    period = max(round(spacing_m / speed / interval_s), 1)
    return np.mean(left[-4 * period :]) / area * speed**2 / DIFFUSIVITY


def test_removed_material_takes_its_heat_along():
    """Removed material takes its heat along.

    The heat left is within 10 % in cells of v h / a = 1.1, as by default in dentin, and in cells a
    quarter of that.
    """
    coarse, fine = receded(1.25e-4), receded(3.125e-5)
    print(f"\nreceding face: {coarse:.3f} and {fine:.3f} of the closed form is left")
    assert coarse == pytest.approx(1.0, abs=0.1)
    assert fine == pytest.approx(1.0, abs=0.08)


@dataclass(frozen=True)
class Plunge:
    """A ball of a bur, its speed into the material, and the material's constants in SI."""

    radius: float
    flutes: int
    omega: float
    feed: float
    chip: float
    edge: float
    conductivity: float
    capacity: float
    share: float

    def flux(self, angle):
        """Return the power per area at a polar angle from the feed direction [W/m2].

        It is the tangential load times the surface speed.
        """
        thickness = self.feed * np.cos(angle) * 2.0 * pi / (self.flutes * self.omega)
        return self.omega * self.flutes / (2.0 * pi) * (self.chip * thickness + self.edge)

    def engaged(self, depth, count=400):
        """Polar angles and areas of the surface elements below the face [rad], [m2]."""
        top = np.arccos(max(1.0 - depth / self.radius, 0.0))
        angle = (np.arange(count) + 0.5) * top / count
        return angle, 2.0 * pi * self.radius**2 * np.sin(angle) * top / count


def warmed(plunge, *, time_s, cell_m, probes_m, radius_m=4.0e-3, height_m=5.0e-3):
    """Compute temperature rise at probes and the energies [J] after a time.

    Probes are (r, depth). The energies are the energy of cutting, the heat removed and the heat
    left.
    """
    h = cell_m
    rings, rows = round(radius_m / h), round(height_m / h)
    r, z = (np.arange(rings) + 0.5) * h, (np.arange(rows) + 0.5) * h
    volume = (2.0 * pi * r * h * h)[:, None] * np.ones(rows)
    heat_capacity = plunge.capacity * volume
    # between ring i and i + 1 [W/K]
    across = plunge.conductivity * 2.0 * pi * np.arange(1, rings) * h * h / h
    along = plunge.conductivity * 2.0 * pi * r * h / h  # between rows [W/K]
    solid, rise = np.ones((rings, rows), bool), np.zeros((rings, rows))
    step = 0.9 * h * h * plunge.capacity / (4.0 * plunge.conductivity)
    steps = int(np.ceil(time_s / step))
    step = time_s / steps
    cutting = removed = 0.0
    for at in range(steps):
        depth = plunge.feed * (at + 0.5) * step
        centre = depth - plunge.radius
        inside = (r[:, None] ** 2 + (z[None, :] - centre) ** 2 < plunge.radius**2) | (
            (r[:, None] < plunge.radius) & (z[None, :] < centre)
        )
        goes = solid & inside
        removed += float((heat_capacity * rise)[goes].sum())
        solid &= ~inside
        rise[goes] = 0.0
        angle, area = plunge.engaged(depth)
        power = plunge.flux(angle) * area
        cutting += float(power.sum()) * step
        gained = np.zeros((rings, rows))
        left = np.ones(len(angle), bool)
        for inward in np.arange(0.0, 3.1, 0.25) * h:
            i = np.minimum(((plunge.radius + inward) * np.sin(angle) / h).astype(int), rings - 1)
            j = np.clip(
                ((centre + (plunge.radius + inward) * np.cos(angle)) / h).astype(int), 0, rows - 1
            )
            there = left & solid[i, j]
            np.add.at(gained, (i[there], j[there]), plunge.share * power[there])
            left &= ~there
        assert not left.any()
        flow = across[:, None] * np.diff(rise, axis=0) * (solid[1:] & solid[:-1])
        gained[:-1] += flow
        gained[1:] -= flow
        flow = along[:, None] * np.diff(rise, axis=1) * (solid[:, 1:] & solid[:, :-1])
        gained[:, :-1] += flow
        gained[:, 1:] -= flow
        rise += step * gained / heat_capacity
    found = [
        float(np.interp(depth, z, rise[min(int(radius / h), rings - 1)]))
        for radius, depth in probes_m
    ]
    return np.array(found), cutting, removed, float((heat_capacity * rise).sum())


RADIUS_M, FLUTES, OMEGA, FEED_M_S = 0.5e-3, 6, 400000.0 * 2.0 * np.pi / 60.0, 1.5e-3


DENTIN = cutting_coefficients("dentin")


def block(spacing_m, low_m, high_m, names=("dentin",)):
    """Full voxels of the first layer."""
    n = np.rint((high_m - low_m) / spacing_m).astype(int)
    full, layer, density = (
        np.full(n, 255, np.uint8),
        np.zeros(n, np.uint8),
        np.full(n, 2100, np.uint16),
    )
    return VoxelVolume(low_m, spacing_m, full, layer, density, names)


def box(corner, other, axes, shift):
    """Return the lowest and highest corner of a box in another frame.

    The frame's axes equal the grid's axes in some order.
    """
    corners = np.array([corner, other]) @ axes.T + shift
    return corners.min(axis=0), corners.max(axis=0)


def plunged(time_s, *, axes=None, shift=(0.0, 0.0, 0.0), cell_m=1.25e-4):
    """Return a ball burr that plunges into a block of dentin.

    Columns of ``axes`` are the block's own axes.
    """
    axes, shift, at = np.eye(3) if axes is None else axes, np.array(shift), 1e-3
    fine = block(
        5e-5, *box((-1.2 * at, -1.2 * at, -2.8 * at), (1.2 * at, 1.2 * at, 0.0), axes, shift)
    )
    whole = block(cell_m, *box((-4 * at, -4 * at, -5 * at), (4 * at, 4 * at, 0.0), axes, shift))
    cutter = Cutter(ball_burr(diameter_m=2 * RADIUS_M), FLUTES, OMEGA)
    model = BoneModel(fine, cutter, (DENTIN,), shell_spacing_m=3.3e-5)
    reach = box((-RADIUS_M, -RADIUS_M, -2.0 * at), (RADIUS_M, RADIUS_M, 1.0 * at), axes, shift)
    heat = CuttingHeat(whole, model, reach_m=reach)
    motion = ToolMotion(tip_m=shift.copy(), rotation=axes.copy(), speed_m_s=FEED_M_S)
    motion.heading[0] = -axes[:, 2]
    model.place(motion)
    energy = 0.0
    for tick in range(1, round(time_s / 1e-3) + 1):
        motion.tip_m[:] = shift - FEED_M_S * 1e-3 * tick * axes[:, 2]
        model.advance(motion)
        energy += abs(model.respond(motion).wrench[3:] @ axes[:, 2] * OMEGA) * 1e-3
        if tick % 20 == 0:
            heat.begin(energy, 0.02, motion, model.store.take_touched())
            energy = 0.0
        else:
            heat.go_to(tick % 20 / 20)
    heat.finish()
    return heat


def rise_K(heat, radius_m, depth_m, axes=None, shift=(0.0, 0.0, 0.0)):
    """Mean rise around the axis at a radius and a depth, between the centres of cells."""
    from scipy.interpolate import RegularGridInterpolator

    centres = [0.5 * (edges[1:] + edges[:-1]) for edges in heat.grid.edges_m]
    field = RegularGridInterpolator(centres, heat.field.rise_K.astype(float))
    angle = np.arange(16) * np.pi / 8.0
    points = np.column_stack(
        [radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(16, -depth_m)]
    )
    return float(field(points @ (np.eye(3) if axes is None else axes).T + np.array(shift)).mean())


@pytest.mark.slow
def test_plunge_against_finite_volumes_in_r_and_z():
    """A plunge agrees with finite volumes in r and z.

    At cells of 0.125 mm the heat left is within 10 %, and the rise half a millimetre from the hole
    within 15 %. The reference has rings of 0.04 mm; with 0.02 mm its rises change by 3 % and its
    heat left by 7 %. If removed material kept conducting, 1.0 of the heat would be left in place of
    0.4.
    """
    time_s, probes = 1.32, [(1.0e-3, 1.5e-3), (1.0e-3, 0.75e-3), (1.5e-3, 1.0e-3)]
    table = constants("tooth", "dentin")
    share = constants("tooth", "bur")["heat_share"].value
    capacity = table["heat_capacity_J_kgK"].value * table["density_kg_m3"].value
    bur = Plunge(
        RADIUS_M,
        FLUTES,
        OMEGA,
        FEED_M_S,
        DENTIN.tangential_chip_Pa,
        DENTIN.tangential_edge_N_m,
        table["conductivity_W_mK"].value,
        capacity,
        share,
    )
    rises, cutting, removed, left = warmed(bur, time_s=time_s, cell_m=4e-5, probes_m=probes)
    assert removed + left == pytest.approx(share * cutting, rel=1e-9)
    heat = plunged(time_s)
    balance = heat.balance_J
    found = np.array([rise_K(heat, *each) for each in probes])
    print(
        f"\nrises {found} for {rises} K, left {balance['left_in_tooth']:.4f} for {left:.4f} "
        f"J of {share * cutting:.4f}"
    )
    assert balance["cutting"] == pytest.approx(cutting, rel=5e-3)
    assert balance["left_in_tooth"] / (left + removed) == pytest.approx(
        left / (left + removed), abs=0.1
    )
    np.testing.assert_allclose(found, rises, rtol=0.15)
    coarse = plunged(time_s, cell_m=2.5e-4)
    off = [
        np.abs([rise_K(each, *place) for place in probes] / rises - 1.0).max()
        for each in (coarse, heat)
    ]
    assert off[0] > 1.3 * off[1]
    assert abs(coarse.balance_J["left_in_tooth"] - left) > abs(balance["left_in_tooth"] - left)


def test_heat_is_accounted_for_and_removed_cells_are_empty():
    heat = plunged(0.4)
    balance = heat.balance_J
    parts = sum(value for name, value in balance.items() if name != "cutting")
    assert parts == pytest.approx(balance["cutting"], rel=1e-5)
    assert 0.1 < balance["with_removed_tooth"] / balance["left_in_tooth"] < 3.0
    removed_m3 = ((1.0 - heat.field.filled) * heat.grid.volumes_m3).sum()
    depth = FEED_M_S * 0.4
    ball_m3 = np.pi * RADIUS_M**3 * 2.0 / 3.0 + np.pi * RADIUS_M**2 * (depth - RADIUS_M)
    assert removed_m3 == pytest.approx(ball_m3, rel=0.05)  # the carving lags by up to 0.02 mm
    assert not heat.field.rise_K[heat.field.filled == 0.0].any()
    centres = [0.5 * (edges[1:] + edges[:-1]) for edges in heat.grid.edges_m]
    inside = (
        centres[0][:, None, None] ** 2 + centres[1][None, :, None] ** 2 < (RADIUS_M - 1.3e-4) ** 2
    ) & (centres[2] > -(depth - RADIUS_M))
    # the hole behind the ball holds no heat
    assert inside.any() and not heat.field.filled[inside].any()
    assert heat.field.rise_K.max() == pytest.approx(
        heat.field.rise_K[:, :, centres[2] > -depth - 2e-4].max()
    )
