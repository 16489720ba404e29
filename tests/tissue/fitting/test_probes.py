"""Fits to presses without times: reading, planted constants, coverage of intervals, refusals."""

from pathlib import Path

import numpy as np
import pytest

import tissue
from meshes.base.errors import InputError
from tissue.fitting.log_files import read_columns
from tissue.fitting.probe_fit import (
    ProbeFit,
    common_pattern,
    fit_curves,
    fit_probes,
    median_curve,
)
from tissue.fitting.probe_laws import layer_scene, probe_curves
from tissue.fitting.probe_table import (
    FEWEST_PROBES,
    ProbeTable,
    at_common_depths,
    is_probe_table,
    read_presses,
)
from tissue.scene.load import load_scene

COARSE = 0.25
"""Edge of the cells under the ball over its radius, where a mesh is compared with itself."""
TABLES = 80
"""Tables of a planted shape."""
DEPTHS_M = 1e-3 * np.array([0.0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.4, 2.8])


FLAT = {
    "anatomy.size_mm": [80, 80, 10],
    "anatomy.nodule_diameter_mm": 0.0,
    "tool.diameter_mm": 8.0,
    "organ.parts": None,
    "organ.young_kPa": None,
    "organ.young_end_kPa": None,
}


def read_probes(path, found, columns=()):
    """Return presses at common depths."""
    return at_common_depths(path, *read_presses(path, found, columns))


def slab(**organ):
    """A layer of 10 mm of liver and a ball of 8 mm."""
    return load_scene("palpation", FLAT | {f"organ.{name}": value for name, value in organ.items()})


def presses(unit_N_Pa, modulus_Pa, count, *, seed, spread=0.4, noise_N=0.01, bias_N=0.02):
    """Forces of presses whose moduli scatter by a log-normal law."""
    random = np.random.default_rng(seed)
    moduli = modulus_Pa * np.exp(spread * random.standard_normal(count))
    noise = noise_N * random.standard_normal((count, len(unit_N_Pa)))
    return moduli[:, None] * unit_N_Pa + bias_N + noise


def written(path, forces_N, *, numbered=True):
    """Write presses as a table."""
    rows = ["probe,depth_mm,force_N" if numbered else "depth_mm,force_N"]
    for at, press in enumerate(forces_N):
        for depth, force in zip(DEPTHS_M, press, strict=True):
            start = f"{at}," if numbered else ""
            rows.append(f"{start}{1e3 * depth:.6g},{force:.9g}")
    path.write_text("\n".join(rows) + "\n", "utf-8")
    return path


@pytest.mark.parametrize("numbered", [True, False])
def test_presses_are_read_at_common_depths(tmp_path, numbered):
    forces = presses(1e-4 * (1e3 * DEPTHS_M) ** 1.5, 1e3, 5, seed=1)
    path = written(tmp_path / "presses.csv", forces, numbered=numbered)
    found = read_columns(path)
    assert is_probe_table(found.names, ())
    table = read_probes(path, found)
    assert table.depths_m == pytest.approx(DEPTHS_M, abs=1e-9)
    assert table.forces_N == pytest.approx(forces, rel=1e-6)


def test_a_short_press_is_left_out(tmp_path):
    forces = presses(1e-4 * (1e3 * DEPTHS_M) ** 1.5, 1e3, 5, seed=1)
    path = written(tmp_path / "presses.csv", forces)
    lines = path.read_text("utf-8").splitlines()
    path.write_text("\n".join(lines[:-4]) + "\n", "utf-8")
    table = read_probes(path, read_columns(path))
    assert len(table.forces_N) == 4
    assert "1 of 5 presses are short" in table.notes[-1]


@pytest.mark.parametrize(
    ("head", "columns"),
    [
        ("Press;Depth [µm];Force [mN]", ("probe=Press",)),
        ("probe;Indentation (um);Load (mN)", ()),
        ("probe;z;F", ("depth_mm=-z:um", "force_N=F:mN")),
    ],
)
def test_presses_in_other_units_and_names(tmp_path, head, columns):
    forces = presses(1e-4 * (1e3 * DEPTHS_M) ** 1.5, 1e3, 5, seed=1)
    path = tmp_path / "presses.csv"
    sign = -1.0 if "z" in head else 1.0
    rows = [
        f"{at};{sign * 1e6 * depth:.6g};{1e3 * force:.9g}".replace(".", ",")
        for at, press in enumerate(forces)
        for depth, force in zip(DEPTHS_M, press, strict=True)
    ]
    path.write_text("\n".join([head, *rows]), "utf-8")
    found = read_columns(path)
    assert is_probe_table(found.names, columns)
    table = read_probes(path, found, columns)
    assert table.depths_m == pytest.approx(DEPTHS_M, abs=1e-9)
    assert table.forces_N == pytest.approx(forces, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "columns", "sentence"),
    [
        (
            "depth_mm,load\n0,1\n1,2\n",
            (),
            "have the column force_N, got the columns depth_mm and load",
        ),
        (
            "depth_mm,force_N\n0,0\n1,1\n2,2\n3,3\n",
            (),
            f"contain at least {FEWEST_PROBES} complete presses",
        ),
        ("depth_mm,force_N\n0,0\n1,1\n", ("load=force_N",), "column"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused(tmp_path, text, columns, sentence):
    path = tmp_path / "presses.csv"
    path.write_text(text, "utf-8")
    with pytest.raises(InputError, match=sentence):
        read_probes(path, read_columns(path), columns)


@pytest.mark.parametrize(
    ("scene", "sentence"),
    [
        (lambda: load_scene("liver-press"), "anatomy.kind must be slab"),
        (lambda: load_scene("palpation"), "organ.young_end_kPa must be left out"),
        (lambda: slab(capsule=True), "organ.capsule must be left out"),
    ],
)
def test_a_scene_that_is_no_uniform_slab_is_refused(scene, sentence):
    with pytest.raises(InputError, match=sentence):
        layer_scene(scene())


def test_a_ball_that_is_pressed_too_deep_is_refused():
    with pytest.raises(
        InputError,
        match=r"depths of at most 3\.2 mm, the smaller of 0\.8 radii .* got a depth of 5 mm",
    ):
        probe_curves(layer_scene(slab()), np.array([1e-3, 5e-3]), ())


def test_all_reasons_against_a_table_are_given_in_one_message(tmp_path):
    path = written(tmp_path / "presses.csv", [2.0 * DEPTHS_M])
    with pytest.raises(
        InputError, match=r"at least 3 complete presses.*\. anatomy\.kind must be slab"
    ):
        tissue.fit(load_scene("liver-press"), path)
    with pytest.raises(InputError, match=r"at least 3 complete presses.*depths of at most 0\.8 mm"):
        tissue.fit(load_scene("palpation", FLAT | {"tool.diameter_mm": 2.0}), path)


def fit_of(forces_N, fitted_N, bias_N):
    """Result of a fit with given curves, without the computation of forces."""
    table = ProbeTable(Path("presses.csv"), DEPTHS_M, forces_N)
    middle = median_curve(forces_N)
    misfit = float(np.linalg.norm(fitted_N - middle) / np.linalg.norm(middle))
    return ProbeFit("slab", table.path, table, "linear", (), fitted_N, bias_N, misfit, ())


def test_a_zero_above_the_smallest_force_is_a_doubt():
    forces = np.array([1.0, 1.1, 0.9])[:, None] * (1e3 * DEPTHS_M) ** 1.5
    smallest = forces[0, 1]
    for bias, count in ((-0.9 * smallest, 0), (-1.1 * smallest, 1), (1.1 * smallest, 1)):
        doubts = fit_of(forces, forces[0], bias).doubts
        assert len(doubts) == count
        assert all("larger than the smallest measured force" in each for each in doubts)


def test_residuals_that_all_presses_share_are_a_doubt():
    """The presses stiffen more than the fitted curve, or differ from it by noise only."""
    curve = (1e3 * DEPTHS_M) ** 1.5
    scale = np.array([1.0, 1.1, 0.9, 1.05])[:, None]
    random = np.random.default_rng(1)
    noisy = scale * curve + 0.2 * random.standard_normal((4, len(curve)))
    assert common_pattern(noisy, curve) < 2.0
    assert fit_of(noisy, curve, 0.0).doubts == ()
    stiffening = scale * (1e3 * DEPTHS_M) ** 2.5 + 0.01 * random.standard_normal((4, len(curve)))
    fitted = curve * stiffening[0, -1] / curve[-1]
    assert common_pattern(stiffening, fitted) > 10.0
    (doubt,) = fit_of(stiffening, fitted, 0.0).doubts
    assert "all presses show the same deviation from the law linear" in doubt


@pytest.mark.parametrize("name", ["organ.exponent", "other.exponential_rate", "modulus_kPa.x"])
def test_a_free_name_that_is_no_constant_of_the_table_is_refused(name):
    table = ProbeTable(Path("presses.csv"), DEPTHS_M, np.ones((3, len(DEPTHS_M))))
    known = r"Choose among soft\.liver\.modulus_kPa, organ\.exponential_rate$"
    with pytest.raises(InputError, match=f"got {name}. {known}"):
        fit_probes(slab(law="exponential", exponential_rate=3.0), table, free=[name])


def test_a_planted_modulus_and_bias_are_found():
    """On the linear law: exactly, from presses without noise."""
    scene = slab()
    curves = probe_curves(layer_scene(scene), DEPTHS_M, ())
    found = fit_curves(curves, 0.03 + 8e3 * curves.unit_N_Pa)
    assert found.modulus_Pa == pytest.approx([8e3])
    assert found.bias_N == pytest.approx([0.03])


@pytest.mark.slow
def test_the_interval_of_a_modulus_covers_it():
    """90 % intervals of the median modulus from 5 and from 40 presses, in 100 tables of each."""
    scene = slab()
    unit = probe_curves(layer_scene(scene), DEPTHS_M, ()).unit_N_Pa[0]
    shares = {}
    for count in (5, 40):
        inside = 0
        for seed in range(100):
            table = ProbeTable(Path("presses.csv"), DEPTHS_M, presses(unit, 8e3, count, seed=seed))
            constant = fit_probes_fast(scene, table)
            inside += constant.low < 8.0 < constant.high
        shares[count] = inside / 100
    print(shares)
    # Four standard errors of a share of 0.9 from 100 tables are 0.12.
    assert min(shares.values()) > 0.78


_curves = {}


def fit_probes_fast(scene, table):
    """Fit a modulus with the solutions of the layer kept between tables."""
    from tissue.fitting import probe_fit

    def kept(layer, depths_m, keys, *, first=0.0, progress=None):
        place = layer.thickness_m, first, keys
        if place not in _curves:
            given = {"first": first} if first else {}
            _curves[place] = probe_curves(layer, depths_m, keys, **given)
        return _curves[place]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(probe_fit, "probe_curves", kept)
        return fit_probes(scene, table).constants[0]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_planted_shape_is_found_and_covered():
    """The force between nodes is solved within 0.3 %; 90 % intervals cover shape and modulus.

    The presses come from a solution at the planted shape, not from the interpolation. All solutions
    have the same coarse cells.
    """
    law, key, value = "exponential", "exponential_rate", 5.3
    scene = slab(law=law, **{key: value})
    layer = layer_scene(scene)
    fixed = probe_curves(layer, DEPTHS_M, (), first=COARSE)
    curves = probe_curves(layer, DEPTHS_M, (key,), first=COARSE)
    at = int(np.argmin(np.abs(np.log(curves.shapes[:, 0] / value))))
    shape = curves.shapes[at, 0]
    planted = layer_scene(slab(law=law, **{key: shape}))
    exact = probe_curves(planted, DEPTHS_M, (), first=COARSE)
    print(law, curves.unit_N_Pa[at][1:] / exact.unit_N_Pa[0][1:] - 1.0)
    assert curves.unit_N_Pa[at] == pytest.approx(exact.unit_N_Pa[0], rel=0.003)
    inside = np.zeros(2)
    for seed in range(TABLES):
        forces = presses(fixed.unit_N_Pa[0], 8e3, 30, seed=seed)
        random = np.random.default_rng(seed)
        drawn = fit_curves(curves, median_curve(forces, random.integers(0, 30, (400, 30))))
        for place, (values, truth) in enumerate(
            ((drawn.modulus_Pa, 8e3), (drawn.shape[:, 0], value))
        ):
            low, high = np.quantile(values, [0.05, 0.95])
            inside[place] += low < truth < high
    print(law, inside / TABLES)
    # Two standard errors of a share of 0.9 from 80 tables are 0.067.
    assert (inside / TABLES > 0.83).all()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_command_writes_constants_and_report(tmp_path):
    layer = layer_scene(slab())
    unit = probe_curves(layer, DEPTHS_M, ()).unit_N_Pa[0]
    path = written(tmp_path / "presses.csv", presses(unit, 8e3, 20, seed=4))
    found = tissue.fit(slab(), path)
    folder = found.save(tmp_path / "fit")
    assert {each.name for each in folder.iterdir()} >= {"fitted.toml", "report.html", "fit.json"}
    constant = found.fitted.constants[0]
    assert constant.name == "soft.liver.modulus_kPa"
    assert constant.low < 8.0 < constant.high
    assert "soft liver modulus" in found.verdicts[0]
    assert load_scene("palpation", {"materials": str(folder / "fitted.toml")})
