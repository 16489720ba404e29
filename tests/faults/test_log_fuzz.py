"""Force logs broken at random: each is fitted, or refused in one sentence."""

import random

import numpy as np
import pytest

import tissue

SCENE = {
    "voxels.spacing_mm": 0.8,
    "tool.shell_spacing_mm": 0.8,
    "duration_s": 0.8,
    "cutting.axial_chip_N_mm2": 0.0,
}
CELLS = (
    "",
    "nan",
    "inf",
    "-inf",
    "1e300",
    "-1e300",
    "1e-300",
    "1_0",
    "1,5",
    "0",
    "abc",
    "12:30",
    "99999999",
    "\u0661",
)
FACTORS = (-1.0, 0.0, 1e3, 1e-3, 1e6, 1e-6, -1e3, 1e12)
NAMES = (
    "time_s",
    "tool_z_mm",
    "force_x_N",
    "force_z_N",
    "torque_z_Nm",
    "load_time_s",
    "tool_qw",
    "tool_rx_rad",
    "x",
    "",
)
UNITS = ("mN", "kN", "m", "mm", "us", "ms", "Nmm", "deg", "furlong", "")


def planted_log():
    """Header and rows of a log of a milled block, with noise and a torque."""
    table = tissue.simulate(tissue.load_scene("milling", SCENE)).to_pandas()
    log = table.filter(regex="^(time_s|tool_|model_force_|model_torque_z)").iloc[::4]
    log = log.rename(columns=lambda name: name.removeprefix("model_"))
    rng = np.random.default_rng(0)
    for name in log.columns[8:]:
        size = float(log[name].abs().max())
        log[name] += 0.02 * size * rng.standard_t(4, len(log))
    return list(log.columns), log.to_numpy()


def mutated(names, rows, chance):
    """Text of a log with one to three faults, and the flags that map its columns."""
    names, rows, flags, delimiter = list(names), rows.copy(), [], ","
    cells = {}
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(len(names))
        match chance.randrange(12):
            case 0:
                rows[:, at] *= chance.choice(FACTORS)
            case 1:
                rows[:, chance.sample(range(len(names)), 3)] *= chance.choice(FACTORS)
            case 2:
                names[at] = chance.choice(NAMES)
            case 3:
                names = [*names, names[at]]
                rows = np.column_stack([rows, rows[:, at]])
            case 4 if len(names) > 4:
                names = names[:at] + names[at + 1 :]
                rows = np.delete(rows, at, axis=1)
            case 5:
                cells[chance.randrange(len(rows)), at] = chance.choice(CELLS)
            case 6:
                rows = rows[
                    chance.choice(
                        [slice(None, None, -1), slice(0, 60), slice(None, None, 7), slice(0, 1)]
                    )
                ]
            case 7:
                rows[chance.randrange(len(rows)) :, at] = chance.choice([0.0, 1e9, float("nan")])
            case 8:
                flags.append(
                    f"{chance.choice(NAMES)}={chance.choice(['-', ''])}{names[at]}:{chance.choice(UNITS)}"
                )
            case 9:
                rows = rows[np.array(chance.sample(range(len(rows)), len(rows)))]
            case 10:
                delimiter = chance.choice([";", "\t", " ", "|"])
            case _:
                rows[:, at] = chance.uniform(-10.0, 10.0)
    lines = [delimiter.join(names)]
    for number, row in enumerate(rows.tolist()):
        lines.append(
            delimiter.join(cells.get((number, at), f"{value:.6g}") for at, value in enumerate(row))
        )
    return "\n".join(lines) + "\n", flags


def outcome(text, flags, path, scene):
    """The sentence of a refusal, or the number of constants that a fit calls determined."""
    path.write_text(text, "utf-8")
    try:
        fit = tissue.fit(scene, path, free=["cutting.edge"], columns=flags, cores=1)
    except tissue.InputError as refusal:
        assert "\n" not in str(refusal)
        return str(refusal)
    assert all(isinstance(each, str) for each in (*fit.verdicts, *fit.fitted.sentences))
    assert np.isfinite(fit.to_pandas()[["p05", "p50", "p95"]].to_numpy()).all()
    return int((fit.to_pandas()["state"] == "determined").sum())


@pytest.mark.slow
def test_broken_logs_are_fitted_or_refused_in_one_sentence(tmp_path):
    names, rows = planted_log()
    scene = tissue.load_scene("milling", SCENE)
    found = [
        outcome(*mutated(names, rows, random.Random(seed)), tmp_path / f"{seed}.csv", scene)
        for seed in range(12)
    ]
    assert any(isinstance(each, str) for each in found) and any(
        isinstance(each, int) for each in found
    )
