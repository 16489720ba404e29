"""Loads of recorded geometry for other coefficients, against runs with those coefficients."""

from dataclasses import replace

import numpy as np
import pytest
from scene_kinds import kinds, write_files

from tissue.materials.scene_constants import Materials
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import Response, ToolMotion
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.simulation.builders.cutting import cutter_of, milled_voxels
from tissue.simulation.builders.parts import motion_of
from tissue.simulation.load_record import SENSITIVITIES, record_loads
from tissue.simulation.simulate import simulate

EQUAL = 1e-6
"""Tolerance of a linear law relative to the run's largest force or torque.

The force kernel adds in single precision, 1e-7 a chunk of elements.
"""
CLOSE = 2e-3
"""Tolerance of a law with a size effect, which is interpolated between nodes of chip thickness."""
LINEAR = {"cutting.minimum_chip_um": 0.0}
OTHERS = {
    "cutting.tangential_chip_N_mm2": 97.3,
    "cutting.radial_chip_N_mm2": 31.7,
    "cutting.axial_chip_N_mm2": 11.3,
    "cutting.tangential_edge_N_mm": 2.9,
    "cutting.radial_edge_N_mm": 3.3,
    "cutting.axial_edge_N_mm": 1.7,
}


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    return kinds(write_files(tmp_path_factory.mktemp("files")))


def coefficients_in(scene, names):
    return Materials.cited.coefficients(
        names, scene.cutting.model_dump(exclude={"material"}), bone=scene.cutting.material
    )


def wrenches(trace):
    return np.hstack([trace.vectors("model_force", "N"), trace.vectors("model_torque", "Nm")])


def largest_difference(got, want):
    """Return the largest difference of force and torque, relative to the run's largest value."""
    size = [np.linalg.norm(want[:, part], axis=1).max() for part in (slice(3), slice(3, 6))]
    off = [np.linalg.norm((got - want)[:, part], axis=1).max() for part in (slice(3), slice(3, 6))]
    return max(np.array(off) / size)


@pytest.mark.parametrize(
    ("law", "tolerance"),
    [
        (LINEAR, EQUAL),
        ({"cutting.minimum_chip_um": 0.4, "cutting.size_exponent": 0.4}, CLOSE),
    ],
    ids=["linear", "size effect"],
)
@pytest.mark.parametrize(
    ("kind", "exponent"),
    [
        ("bone, density", 2.3),
        pytest.param("molar, caries", 0.8, marks=pytest.mark.slow),
        pytest.param("block", None, marks=pytest.mark.slow),
        pytest.param("block, replay", None, marks=pytest.mark.slow),
        pytest.param("glenoid", 1.2, marks=pytest.mark.slow),
        pytest.param("vertebra", 2.6, marks=pytest.mark.slow),
    ],
)
def test_reweighing_equals_rerunning(tables, kind, exponent, law, tolerance):
    scene = changed(Scene(**tables[kind]), LINEAR if law is LINEAR else {})
    record = record_loads(scene, cores=1)
    other = changed(
        scene, OTHERS | law | ({} if exponent is None else {"cutting.density_exponent": exponent})
    )
    trace = simulate(other, cores=1).trace
    loads, want = record.loads(coefficients_in(other, record.layer_names)), wrenches(trace)
    assert largest_difference(loads, want) < tolerance
    assert largest_difference(record.loads(coefficients_in(scene, record.layer_names)), want) > 0.1
    for name in ("tool_z_mm", "removed_mm3"):
        assert np.array_equal(record.trace[name], trace[name])
    assert 1e6 * record.engaged_m2.sum(axis=1) == pytest.approx(
        trace["contact_mm2"], rel=EQUAL, abs=1e-6
    )


def test_a_density_factor_is_another_reference_density(tables):
    """A density factor is another reference density.

    Bone s times as dense is cut as bone whose coefficients were measured at a density 1 / s times
    as high.
    """
    scene = Scene(**tables["bone, density"])
    record = record_loads(scene, cores=1)
    given = coefficients_in(scene, record.layer_names)
    factors = np.linspace(1.1, 0.8, len(given))
    scaled = tuple(
        replace(each, reference_density_kg_m3=each.reference_density_kg_m3 / factor)
        for each, factor in zip(given, factors, strict=True)
    )
    volume, cutter, motion = (
        milled_voxels(scene),
        cutter_of(scene.tool),
        motion_of(scene),
    )
    model, tool, found = BoneModel(volume, cutter, scaled, cores=1), ToolMotion(), []
    motion.begin(tool)
    model.place(tool)
    for tick in range(len(record.times_s)):
        motion.advance(1e-3 * tick, 1e-3, Response.empty(1), tool)
        model.advance(tool)
        found.append(model.respond(tool).wrench.copy())
    assert largest_difference(record.loads(given, factors), np.array(found)) < CLOSE


def test_derivatives_are_those_of_the_loads(tables):
    record = record_loads(Scene(**tables["bone, density"]), every=3, cores=1)
    given = Materials.cited.coefficients(
        record.layer_names, {"size_exponent": 0.2, "minimum_chip_um": 3.3}
    )
    names = [name for name in SENSITIVITIES if name != "density_factor"]
    steps = {"density_exponent": 1e-4, "size_exponent": 1e-4, "minimum_chip_m": 1e-10}
    factors = np.full(len(given), 1.05)
    slopes = record.jacobian(given, factors)
    for at in record.layers:
        for name in names:
            column = SENSITIVITIES.index(name)
            step = steps.get(name, 1e3)  # linear in all others
            up, down = (
                record.loads(
                    (
                        *given[:at],
                        replace(given[at], **{name: getattr(given[at], name) + d}),
                        *given[at + 1 :],
                    ),
                    factors,
                )
                for d in (step, -step)
            )
            central = (up - down) / (2.0 * step)
            assert slopes[:, :, at, column] == pytest.approx(
                central, abs=1e-6 * np.abs(central).max()
            )
        step = 1e-4 * np.eye(len(given))[at]
        central = (record.loads(given, factors + step) - record.loads(given, factors - step)) / 2e-4
        assert slopes[:, :, at, 7] == pytest.approx(central, abs=1e-6 * np.abs(central).max())
