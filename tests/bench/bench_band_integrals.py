"""Bands of forces in closed form, the reference for ``bench_band.py --published``.

They are computed from the tables of constants alone.

A ball straight down into enamel and dentin (the integral over the hemisphere), the leading half of
a spherical cap in bone, and the root of the polynomial of a needle before its puncture, each with
random samples of the laws of their constants. Nothing of the package is used but its data files.
"""

import tomllib
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

MATERIALS = Path(__file__).resolve().parents[2] / "tissue/materials"
COUNT = 400_000
Z_95, W_95 = 1.6448536, 1.9599640
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
DENSITY_KG_M3 = {"enamel": 2900.0, "dentin": 2100.0, "bone": 1800.0}
rng = np.random.default_rng(5)


def constants(table, material):
    return tomllib.loads((MATERIALS / f"{table}.toml").read_text("utf-8"))[material]


def drawn(entry):
    """Samples of a constant whose value is the median and whose range the 5 and 95 % quantiles."""
    value, (low, high), z = entry["value"], entry["range"], rng.standard_normal(COUNT)
    if low == high:
        return np.full(COUNT, value)
    if value == low:
        return value + (high - value) * np.abs(z) / W_95
    to, back = np.log, np.exp
    if low == 0.0:
        low, squeeze = 0.035 * value, 0.05 * value
        to, back = (
            lambda x: squeeze * np.log(np.expm1(x / squeeze)),
            lambda y: squeeze * np.logaddexp(0.0, y / squeeze),
        )
    ends = to(low), to(value), to(high)
    share = (ends[2] - ends[1]) / (ends[1] - ends[0])
    skew = np.log(share) / Z_95
    grown = z / Z_95 if abs(skew) < 1e-9 else np.expm1(skew * z) / (share - 1.0)
    return back(ends[1] + (ends[2] - ends[1]) * grown)


def strength(of, material):
    return (DENSITY_KG_M3[material] / of["reference_density_kg_m3"]) ** of["density_exponent"]


def plunged(of, material):
    """Thrust [N] of a ball of 0.5 mm with 6 edges at 400,000 turns a minute and 1.5 mm/s."""
    chip_mm = 1.5 * 60.0 / (6 * 400_000.0)
    # share of the edge force: 1 from the tip to the angle where the chip is as thin as the minimum
    thin = np.minimum(1e-3 * of["minimum_chip_um"] / chip_mm, 1.0)
    angle = np.arccos(thin)
    rim = (np.pi / 2.0 - angle - np.sin(angle) * np.cos(angle)) / 2.0
    share = np.sin(angle) + chip_mm / (1e-3 * of["minimum_chip_um"]) * rim
    chip = np.pi / 4.0 * of["radial_chip_N_mm2"] * chip_mm
    return 6 * 0.5 * strength(of, material) * (chip + of["radial_edge_N_mm"] * share)


def dragged(of):
    """Return the force [N] on a ball of 3 mm, 0.1 mm deep, that moves sideways at 5 mm/s.

    It has 6 edges and 10,000 turns a minute.
    """
    most, cells = np.arccos(1.0 - 0.1 / 3.0), 400
    middles = (np.arange(cells) + 0.5) / cells
    polar, azimuth = np.meshgrid(most * middles, np.pi * (middles - 0.5), indexing="ij")
    # N A / (2 pi r) of each cell
    length = 6 * 3.0 / (2.0 * np.pi) * (most / cells) * (np.pi / cells)
    chip = 5.0 * np.sin(polar) * np.cos(azimuth) * 60.0 / (6 * 10_000.0)
    flat = np.zeros_like(polar)
    normal = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)
    along = {
        "radial": np.array(normal),
        "tangential": np.array([np.sin(azimuth), -np.cos(azimuth), flat]),
    }
    # both integrals on a table over minimum chip thickness and size exponent
    least_mm = 1e-3 * np.geomspace(*spread(of["minimum_chip_um"]), 40)
    exponents = np.linspace(0.0, of["size_exponent"].max(), 30)
    at = np.column_stack([np.log(1e-3 * of["minimum_chip_um"]), of["size_exponent"]])
    force = np.zeros((COUNT, 3))
    for name, direction in along.items():
        weight = length * direction
        chips = np.empty((len(least_mm), len(exponents), 3))
        edges = np.empty((len(least_mm), len(exponents), 3))
        for row, least in enumerate(least_mm):
            edges[row] = (weight * np.minimum(chip / least, 1.0)).sum(axis=(1, 2))
            for column, exponent in enumerate(exponents):
                cut = chip * (np.maximum(chip, least) / 0.1) ** -exponent
                chips[row, column] = (weight * cut).sum(axis=(1, 2))
        for kind, table in (("chip_N_mm2", chips), ("edge_N_mm", edges)):
            unit = RegularGridInterpolator((np.log(least_mm), exponents), table)(at)
            force += of[f"{name}_{kind}"][:, None] * unit
    return np.linalg.norm(force, axis=1) * strength(of, "bone")


def spread(values):
    """Return slightly more than the range of values."""
    return 0.999 * values.min(), 1.001 * values.max()


def show(label, values):
    print(f"{label}:", ", ".join(f"{end:.3g}" for end in np.quantile(values, LEVELS)))


if __name__ == "__main__":
    print("5, 25, 50, 75, 95 % quantiles")
    for material in ("enamel", "dentin"):
        of = {name: drawn(entry) for name, entry in constants("cutting", material).items()}
        show(f"molar at 1.5 mm/s: axial force in {material} / N", plunged(of, material))
    of = {name: drawn(entry) for name, entry in constants("cutting", "bone").items()}
    show("milling, middle of the first pass: size of the force / N", dragged(of))
    needle = constants("needle", "liver")
    linear, quadratic, force = (
        drawn(needle[name]) for name in ("linear_N_mm", "quadratic_N_mm2", "capsule_puncture_N")
    )
    travel_mm = (np.sqrt(linear**2 + 4.0 * quadratic * force) - linear) / (2.0 * quadratic)
    show("needle: time of the capsule's puncture / s", (5.0 + travel_mm) / 20.0)
