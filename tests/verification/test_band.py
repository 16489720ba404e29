"""Band of a ball that moves straight down into a block, against closed forms.

The force is an integral over the hemisphere. With radial coefficients alone the sides cancel, and
the thrust is N R (pi / 4 K_rc h + K_re), with h = 60 v / (N n) the chip thickness at the tip. It is
a sum whose constants each have their own variance.
"""

from dataclasses import fields, replace

import numpy as np
import pytest
from scene_kinds import BLOCK, BURR
from scipy.special import ndtri

from tissue.evaluation.reference.force import wrench_at
from tissue.evaluation.reference.history import path_of_trace, solid_of_scene
from tissue.fitting.bands.band import band_of
from tissue.fitting.bands.figures import LEVELS
from tissue.materials.constants import CuttingCoefficients, constants
from tissue.materials.prior import Prior
from tissue.scene.load import load_scene
from tissue.scene.scene import Scene
from tissue.simulation.builders.cutting import cutter_of
from tissue.simulation.load_record import record_loads

FLUTES, RADIUS_MM, FEED_MM_S, SPIN_RPM = 6, 1.0, 10.0, 5000.0
CHIP_MM = 60.0 * FEED_MM_S / (FLUTES * SPIN_RPM)
FREE = ("radial_chip_N_mm2", "radial_edge_N_mm")
PER_UNIT = FLUTES * RADIUS_MM * np.array([np.pi / 4.0 * CHIP_MM, 1.0])
GEOMETRY = 0.01
"""Share of the force by which voxels and elements may miss the integral.

The voxels have 0.2 mm, the elements belong to a ball of 1 mm.
"""
SAMPLING = 0.03
"""Share by which 1,024 balanced samples may miss a quantile.

It is five times the value that bench_band.py measures at the median.
"""


def laws():
    return [Prior.of(constants("cutting", "bone")[name], f"cutting.bone.{name}") for name in FREE]


def parts():
    """The two terms of the thrust on midpoints of equal probability, shape (2, 2000) [N]."""
    z = ndtri((np.arange(2000) + 0.5) / 2000)
    return np.array([weight * law.x(z) for weight, law in zip(PER_UNIT, laws(), strict=True)])


@pytest.fixture(scope="module")
def band():
    others = {
        name: 0.0
        for name in constants("cutting", "bone")
        if name.endswith(("N_mm2", "N_mm")) and name not in FREE
    }
    scene = Scene(
        name="plunge",
        duration_s=0.2,
        anatomy=BLOCK | {"density_kg_m3": 1700.0},
        tool=BURR | {"flutes": FLUTES, "diameter_mm": 2.0 * RADIUS_MM, "spin_rpm": SPIN_RPM},
        voxels={"spacing_mm": 0.2, "margin_mm": 0.5},
        motion={"kind": "path", "points_mm": [[0, 0, 0.2], [0, 0, -1.8]], "feed_mm_s": FEED_MM_S},
        cutting=others | {"density_exponent": 0.0},
    )
    return band_of(scene, 1024, cores=1)


def test_the_peak_force_has_the_quantiles_of_the_sum(band):
    assert set(band.constants) == {
        f"cutting.bone.{name}" for name in (*FREE, "reference_density_kg_m3")
    }
    cited = PER_UNIT @ [law.value for law in laws()]
    assert band.nominal[-20:, 3] == pytest.approx(cited, rel=GEOMETRY)
    exact = np.quantile(np.add.outer(*parts()).ravel(), tuple(LEVELS.values()))
    found = np.array(list(band.summary["force_N"]["peak"].values()))
    print("quantiles of the peak force: found", found, "closed form", exact)
    assert found == pytest.approx(exact, rel=SAMPLING)
    assert band.quantiles[:, -1, 3] == pytest.approx(exact, rel=SAMPLING)
    alone = np.quantile(parts()[0] + parts()[1].mean(), tuple(LEVELS.values()))
    assert np.abs(found / alone - 1.0).max() > 5.0 * SAMPLING, (
        "of the chip alone the quantiles are others"
    )


def test_the_indices_of_a_sum_are_the_shares_of_its_variance(band):
    variances = parts().var(axis=1)
    exact = variances / variances.sum()
    for kind in ("first", "total"):
        indices = band.summary["sobol"]["force_N.peak"]
        found = [indices[f"cutting.bone.{name}"][kind] for name in FREE]
        assert indices["cutting.bone.reference_density_kg_m3"][kind] == pytest.approx(
            0.0, abs=1e-9
        ), "its exponent is 0"
        print(kind, found, exact)
        assert found == pytest.approx(exact, abs=0.05)


COEFFICIENTS = CuttingCoefficients.CHIP + CuttingCoefficients.EDGE


CLOSE = 0.02
"""Of the force: voxels of a tenth of the bur's radius are off by half a per cent here."""


@pytest.mark.slow
def test_each_coefficient_of_each_layer_against_the_quadrature():
    """A bur that goes down into a lesion, whose density varies."""
    scene = load_scene("caries", {"duration_s": 1.3}).model_copy(update={"stress": None})
    record = record_loads(scene)
    solid, cutter = solid_of_scene(scene), cutter_of(scene.tool)
    path, tick = path_of_trace(record.trace, cutter), len(record.times_s) - 1
    nothing = CuttingCoefficients(**{each.name: 0.0 for each in fields(CuttingCoefficients)})
    for at in np.flatnonzero(record.engaged_m2[tick] > 0.1 * record.engaged_m2[tick].sum()):
        layer = replace(nothing, reference_density_kg_m3=2100.0, density_exponent=2.2)
        for name in COEFFICIENTS:
            zero = [replace(nothing, reference_density_kg_m3=2100.0) for _ in record.layer_names]
            zero[at] = replace(layer, **{name: 1e3})
            want = wrench_at(tick, path, cutter, replace(solid, coefficients=tuple(zero)))
            got = record.loads(tuple(zero))[tick]
            # where the forces of a coefficient cancel, as those around a bur do, its torque is what
            # it is held to
            size = max(np.linalg.norm(want[:3]), np.linalg.norm(want[3:]) / cutter.profile.radius_m)
            assert got[:3] == pytest.approx(want[:3], abs=CLOSE * size)
            assert got[3:] == pytest.approx(want[3:], abs=CLOSE * size * cutter.profile.radius_m)
