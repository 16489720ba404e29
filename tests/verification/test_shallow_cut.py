"""Force of `Bone.cut` in shallow slots, against an integral over the engaged cap of the ball.

The integral is taken of the cutting law.
"""

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss

import tissue

FLUTES, SPIN_RPM, FEED_MM_S = 6, 20_000, 10.0
N_M2, N_M = 1e6, 1e3


def integral(radius_m, depth_m, tilt, chip, edge):
    """Force of a ball in a first straight slot along x in flat bone, its axis tilted about y.

    Elements in front of the ball and below z = 0 cut: dF = -N dA / (2 pi r) [(K_t h + E_t) t + (K_r
    h + E_r) n].
    """
    axis = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    nodes, weights = leggauss(300)
    polar = 0.5 * np.arccos(1.0 - depth_m / radius_m) * (nodes + 1.0)
    around = 0.5 * np.pi * nodes
    theta, phi = np.meshgrid(polar, around, indexing="ij")
    share = np.outer(weights * 0.5 * np.arccos(1.0 - depth_m / radius_m), weights * 0.5 * np.pi)
    area = share * np.sin(theta) * radius_m**2
    normal = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)], axis=-1
    )
    off_axis = normal - (normal @ axis)[..., None] * axis
    lever = np.linalg.norm(off_axis, axis=-1)
    tangent = np.cross(-axis, off_axis / lever[..., None])  # clockwise as seen from the shank
    thick = normal[..., 0] * 1e-3 * FEED_MM_S * 60.0 / (FLUTES * SPIN_RPM)
    length = FLUTES * area / (2.0 * np.pi * radius_m * lever)
    along = length * (chip[0] * thick + edge[0])
    across = length * (chip[1] * thick + edge[1])
    return -(along[..., None] * tangent + across[..., None] * normal).sum(axis=(0, 1))


@pytest.mark.slow
@pytest.mark.parametrize("tilt_deg", [0.0, 30.0])
@pytest.mark.parametrize(("diameter_mm", "depth_mm"), [(8.0, 0.1), (4.0, 0.1), (4.0, 0.4)])
def test_a_shallow_slot(diameter_mm, depth_mm, tilt_deg):
    """Within the tolerance of 1 %; 6,000 elements are off by up to 2.6 % there."""
    chip, edge = (150.0 * N_M2, 60.0 * N_M2), (5.0 * N_M, 4.0 * N_M)
    bone = tissue.Bone.block((6, 6, 2), spacing_mm=0.05)
    tilt, radius = np.radians(tilt_deg), 0.5 * diameter_mm
    axis = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    start, end = (np.array([x, 0.0, radius - depth_mm]) - radius * axis for x in (-4.5, 0.0))
    burr = tissue.cutters.ball_burr(diameter_mm=diameter_mm, flutes=FLUTES, spin_rpm=SPIN_RPM)
    cut = bone.cut(burr, *tissue.feed_along([start, end], FEED_MM_S), axis=axis, depth_mm=depth_mm)
    exact = integral(1e-3 * radius, 1e-3 * depth_mm, tilt, chip, edge)
    error = np.linalg.norm(cut.force_N[-50:].mean(axis=0) - exact) / np.linalg.norm(exact)
    print(f"\n{100 * error:.2f} %")
    assert error < 0.01
