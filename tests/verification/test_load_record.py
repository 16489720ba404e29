"""Recorded unit loads of each coefficient and layer, against quadrature over the exact geometry."""

from dataclasses import fields, replace

import numpy as np
import pytest

from tissue.evaluation.reference.force import wrench_at
from tissue.evaluation.reference.history import path_of_trace, solid_of_scene
from tissue.materials.constants import CuttingCoefficients
from tissue.scene.load import load_scene
from tissue.simulation.builders.cutting import cutter_of
from tissue.simulation.load_record import record_loads

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
