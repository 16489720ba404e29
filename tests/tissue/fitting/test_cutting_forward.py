"""Loads along a log's poses, which constants are free, and candidate cuts against closed forms."""

import numpy as np
import pytest
from cut_logs import BLOCK, forward_along

from meshes.base.errors import InputError
from tissue.fitting.cutting import cutting_candidates
from tissue.fitting.problem import block_averages, shift_operators
from tissue.materials.constants import constants
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.simulation.simulate import simulate

USUAL = [
    f"{kind}_{part}" for part in ("chip_N_mm2", "edge_N_mm") for kind in ("tangential", "radial")
] + ["size_exponent", "minimum_chip_um"]
SLANT = [[-1, 0, 0.2], [-1, 0, -0.8], [1, 0, -1.0]]


def values(forward):
    return np.array([each.prior.value for each in forward.parameters])


def test_loads_of_a_log_are_those_of_a_run_along_it():
    forward = forward_along([[-1, 0, 0.2], [1, 0, -0.8]], [2.0, 2.1])
    assert [each.name for each in forward.parameters] == [
        f"cutting.cortical.{name}" for name in USUAL
    ] + ["density.cortical"]
    cited = constants("cutting", "bone")
    assert values(forward)[:6].tolist() == [cited[name].value for name in USUAL]
    x = np.array([97.0, 31.0, 2.9, 3.3, 0.1, 0.4, 1.0])
    motion = {
        "kind": "path",
        "points_mm": [[-1, 0, 0.2], [1, 0, -0.8]],
        "feed_mm_s": float(np.sqrt(500.0)),
    }
    run = Scene(**(BLOCK | {"motion": motion, "duration_s": 0.1}))
    run = changed(
        run, {f"cutting.{name}": value for name, value in zip(USUAL, x.tolist(), strict=False)}
    )
    trace = simulate(run, cores=1).trace
    want = np.hstack([trace.vectors("model_force", "N"), trace.vectors("model_torque", "Nm")])
    # One step of the path is rounded otherwise in a replay: elements at the edge of a voxel change
    # sides.
    assert forward.loads(x)[1:] == pytest.approx(want[1:], abs=1e-3 * np.abs(want[:, :3]).max())
    assert forward.times_s[[0, -1]] == pytest.approx([2.0, 2.099])
    exponent = constants("cutting", "bone")["density_exponent"].value
    denser = np.append(x[:6], 1.1)
    assert forward.loads(denser) == pytest.approx(
        1.1**exponent * forward.loads(x), rel=1e-9, abs=1e-12
    )


def test_derivatives_by_the_parameters():
    forward = forward_along(SLANT, [0.0, 0.05, 0.1], free=("cutting", "density"))
    # four coefficients, the exponents of density and size, the minimum chip, the density
    assert len(forward.parameters) == 8
    x = values(forward) * 1.1
    slopes = forward.jacobian(x)
    for column, step in enumerate(1e-5 * np.maximum(x, 1.0)):
        up, down = (forward.loads(x + sign * step * np.eye(len(x))[column]) for sign in (1.0, -1.0))
        central = (up - down) / (2.0 * step)
        assert slopes[:, :, column] == pytest.approx(central, abs=1e-7 * np.abs(central).max())


def test_a_cut_averaged_as_a_log_has_the_loads_averaged():
    """Over the samples of a block, at any delay; between those kept, a cubic."""
    forward = forward_along(SLANT, [0.0, 0.2, 0.6])
    x = values(forward) * 1.1
    loads = forward.loads(x)
    log = block_averages(forward.times_s, loads, forward.channels, 9)
    averaged, plain = forward.averaged_as(log)
    assert len(averaged.times_s) == -(-len(forward.times_s) // 3) and plain.within_s == (0.0,)
    for delay in (0.0, 0.0031):
        middle = slice(2, -2)
        exact = (shift_operators(forward.times_s, log.times_s, delay, log.within_s)[0] @ loads)[
            middle
        ]
        kept = (shift_operators(averaged.times_s, log.times_s, delay)[0] @ averaged.loads(x))[
            middle
        ]
        assert kept == pytest.approx(exact, abs=0.05 * np.abs(loads[:, :3]).max())
        assert np.sqrt(np.mean((kept - exact) ** 2)) < 2e-3 * np.abs(loads[:, :3]).max()


@pytest.mark.parametrize(
    ("free", "names"),
    [
        (("cutting.edge",), ["tangential_edge_N_mm", "radial_edge_N_mm"]),
        (("cutting.cortical.radial",), ["radial_chip_N_mm2", "radial_edge_N_mm"]),
        (("cutting.bone.tangential_chip_N_mm2",), ["tangential_chip_N_mm2"]),
        (
            ("cutting.density_exponent", "cutting.chip.radial"),
            ["radial_chip_N_mm2", "density_exponent"],
        ),
        (("density.cortical",), []),
    ],
)
def test_patterns_choose_constants(free, names):
    forward = forward_along(SLANT, [0.0, 0.05, 0.1], free=free)
    chosen = [each.name for each in forward.parameters]
    assert chosen == [*(f"cutting.cortical.{name}" for name in names), "density.cortical"]


def test_a_stated_constant_is_fixed_unless_it_is_named():
    stated = {"cutting": {"radial_chip_N_mm2": 70.0}}
    forward = forward_along(SLANT, [0.0, 0.05, 0.1], **stated)
    assert "cutting.cortical.radial_chip_N_mm2" not in [each.name for each in forward.parameters]
    other = forward_along(SLANT, [0.0, 0.05, 0.1], free=("cutting.cortical",), **stated)
    at = [each.name for each in other.parameters].index("cutting.cortical.radial_chip_N_mm2")
    x = values(other)
    x[at] = 70.0
    assert other.loads(x) == pytest.approx(forward.loads(values(forward)), rel=1e-12, abs=1e-12)


def test_names_that_fit_nothing_list_what_there_is_and_air_is_refused():
    with pytest.raises(
        InputError, match=r"got cutting.enamel. Choose among cutting.cortical.tangential_chip_N_mm2"
    ):
        forward_along(SLANT, [0.0, 0.05, 0.1], free=("cutting.enamel",))
    with pytest.raises(InputError, match="must bring the tool to the bone"):
        forward_along([[0, 0, 1.0], [0, 0, 2.0]], [0.0, 0.1])


@pytest.mark.slow
def test_candidate_slots_of_a_cylinder_against_closed_forms():
    """Candidate slots of a cylinder follow closed forms.

    Half of its side a deep touches bone, with N a / (2 pi) dphi of edge: N a / pi of edge and N a /
    4 h of chip.
    """
    forward = forward_along([[0, 0, 0.2], [0, 0, -0.8]], [0.0, 0.1], free=("cutting",))
    found = cutting_candidates(forward)
    assert len(found) == 2 * 3 * 9
    name = "a slot 0.5 mm deep in cortical at 40 mm/s and 2500 rpm"
    slopes = found[name].jacobian(values(forward))[-1]  # 10 mm/s and 5000 rpm in the log
    names = [each.name.rpartition(".")[2] for each in forward.parameters]
    edge_mm = 4 * 0.5 / np.pi
    chip_mm = 40.0 / (4 * 2500.0 / 60.0)
    for kind, size, chip in (
        ("radial_edge_N_mm", edge_mm, None),
        ("radial_chip_N_mm2", 4 * 0.5 / 4.0, chip_mm),
        ("tangential_edge_N_mm", edge_mm, None),
        ("tangential_chip_N_mm2", 4 * 0.5 / 4.0, chip_mm),
    ):
        want = np.zeros(3)
        # clockwise from above, at +x of a tool that moves along +x the edge goes to -y and the bone
        # pushes it to +y
        axis, sign = {"radial": (0, -1.0), "tangential": (1, 1.0)}[kind.split("_")[0]]
        want[axis] = sign * size * (chip or 1.0)
        got = slopes[:3, names.index(kind)]
        assert got == pytest.approx(want, abs=0.02 * np.abs(want).max())
