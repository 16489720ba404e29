"""Heat conduction against closed forms (Carslaw and Jaeger 1959, ch. X)."""

import numpy as np
import pytest

from tissue.models.tooth.heat import Conduction

CONDUCTIVITY, CAPACITY = 0.6, 3.4e6  # of the order of dentin [W/(m K)], [J/(m3 K)]
DIFFUSIVITY = CONDUCTIVITY / CAPACITY


def medium(shape, spacing_m):
    return Conduction(np.full(shape, CONDUCTIVITY), np.full(shape, CAPACITY), spacing_m=spacing_m)


def point_source_error(spacing_m, time_s=2.0, side_m=8e-3):
    """Largest error over a ball of 1.5 mm, against the peak, some time after 1 mJ came into one point."""
    count = int(side_m / spacing_m) | 1
    body = medium((count,) * 3, spacing_m)
    power = np.zeros((count,) * 3)
    burst = body.longest_step_s
    power[(count // 2,) * 3] = 1e-3 / burst
    body.advance(power, burst)
    body.advance(np.zeros_like(power), time_s - 0.5 * burst)
    axis = (np.arange(count) - count // 2) * spacing_m
    squared = axis[:, None, None] ** 2 + axis[None, :, None] ** 2 + axis[None, None, :] ** 2
    spread = 4.0 * DIFFUSIVITY * time_s
    exact = 1e-3 / (CAPACITY * (np.pi * spread) ** 1.5) * np.exp(-squared / spread)
    near = squared < 1.5e-3**2
    return float(np.abs(body.rise_K - exact)[near].max() / exact.max())


def test_point_source_converges_with_second_order():
    spacings = np.array([4e-4, 2.8e-4, 2e-4])
    errors = np.array([point_source_error(s) for s in spacings])
    slope = np.polyfit(np.log(spacings), np.log(errors), 1)[0]
    print(f"\npoint source: errors {errors}, slope {slope:.2f}")
    assert slope > 1.6
    assert errors[-1] < 0.02


def test_plane_source_at_an_insulated_face():
    """Constant flux into a half space: T(0, t) = 2 q sqrt(t / (pi k rho c)); 2 % at the face's first cell centre."""
    spacing, time, flux = 5e-5, 1.0, 1000.0
    body = medium((120, 2, 2), spacing)
    power = np.zeros((120, 2, 2))
    power[0] = flux * spacing**2
    body.advance(power, time)
    depth = 0.5 * spacing
    spread = 2.0 * np.sqrt(DIFFUSIVITY * time)
    from scipy.special import erfc

    exact = (
        flux
        / CONDUCTIVITY
        * (spread / np.sqrt(np.pi) * np.exp(-((depth / spread) ** 2)) - depth * erfc(depth / spread))
    )
    assert body.rise_K[0, 0, 0] == pytest.approx(exact, rel=0.02)


def test_energy_is_kept_across_materials():
    random = np.random.default_rng(0)
    shape = (12, 10, 9)
    conductivity = random.choice([0.0, 0.15, 0.6, 0.9], shape)
    capacity = random.uniform(1e6, 4e6, shape)
    body = Conduction(conductivity, capacity, spacing_m=2e-4)
    power = np.where(conductivity > 0.0, random.uniform(0.0, 1e-3, shape), 0.0)
    body.advance(power, 0.5)
    stored = (body.rise_K.astype(float) * capacity).sum() * 2e-4**3
    assert stored == pytest.approx(power.sum() * 0.5, rel=1e-4)  # single precision
    assert (body.rise_K[conductivity == 0.0] == 0.0).all()


def test_stays_bounded_at_its_longest_step_and_not_beyond():
    body = medium((16, 16, 16), 2e-4)
    rough = np.random.default_rng(1).uniform(0.0, 1.0, (16, 16, 16))
    body._temperature[0].assign(rough.astype(np.float32))
    body.advance(np.zeros_like(rough), 200 * body.longest_step_s)
    assert body.rise_K.min() >= 0.0 and body.rise_K.max() <= 1.0
    body._record(1.5 * body.longest_step_s)  # beyond the limit, as an explicit step must not be taken
    body._temperature[0].assign(rough.astype(np.float32))
    for _ in range(60):
        body._launches[0]()
        body._temperature.reverse()
        body._launches.reverse()
    assert np.abs(body.rise_K).max() > 1e3
