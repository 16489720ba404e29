"""A CT that was never taken: a body with a humerus and a vertebra above a pad of density rods, for tests and tutorials.

Hounsfield units follow from composition: each voxel's linear attenuation at one energy by volume shares of the
materials of ``attenuation.toml``, bone of every density being dense bone in marrow. Noise and 12-bit steps are added.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import require_positive, require_range
from meshes.ct.attenuation import density_of, linear_attenuation
from meshes.ct.labels import Labels
from meshes.images.frame import Image, StoredImage, along_lps

__all__ = ["HEAD_CENTRE_MM", "HEAD_RADIUS_MM", "RODS_KG_M3", "CtPhantom", "Person", "ct_phantom"]

RODS_KG_M3 = (200.0, 400.0, 600.0, 800.0, 1000.0, 1200.0, 1400.0, 1600.0, 1800.0)
"""Apparent density of the rods [kg/m3], labelled rod_200, rod_400 ... from the patient's right to the left."""
HEAD_CENTRE_MM = (35.0, -8.0, 20.0)
HEAD_RADIUS_MM = 22.0
"""Ball of the humerus's head [mm, LPS]."""
_SHAFT_X_MM, _SHAFT_MM, _NECK_MM, _RIM_MM, _RIM_RADIUS_MM = 40.0, 13.0, -20.0, 18.0, 28.0
"""Axis and radius of the shaft, where the metaphysis begins in it, where its rim is, and that rim's radius [mm]."""
CORTEX_KG_M3, SUBCHONDRAL_KG_M3, TRABECULAR_KG_M3 = 1850.0, 1200.0, 350.0
_VERTEBRA_SHELL_KG_M3, _VERTEBRA_CORE_KG_M3, _ARCH_KG_M3 = 1000.0, 250.0, 1100.0
_HALF_MM = (108.0, 80.0, 52.0)
"""Half size of the image [mm]; the shaft is cut off at its lower edge."""
_LOWEST_HU, _HIGHEST_HU = -1024, 3071
"""Values of 12 bits."""

Distance = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Person:
    """What differs between persons and scanners from the tables.

    Attributes
    ----------
    attenuation
        Factor of the linear attenuation of adipose, muscle, blood and cortex (the shaft's alone), 1 where not given.
    mineral
        Factor of what the attenuation of bone, but for the shaft's cortex, has over that of marrow at the same density.
    marrow_fat
        Share of fat in marrow.
    water_HU, scale
        Error of the scanner: Hounsfield units of water, and the factor of all.
    """

    attenuation: Mapping[str, float] = field(default_factory=dict)
    mineral: float = 1.0
    marrow_fat: float = 0.6
    water_HU: float = 0.0
    scale: float = 1.0


@dataclass(frozen=True, eq=False)
class CtPhantom:
    """A synthetic CT and what is true of it.

    Attributes
    ----------
    stored
        Hounsfield units on the scanner's grid, 12-bit values, int16.
    labels
        Number of each voxel's label on that grid, uint8.
    names
        Names of the labels by their numbers, those of TotalSegmentator where it has them.
    density_kg_m3
        Apparent density of bone [kg/m3] on that grid, 0 outside bone.
    energy_keV
        Effective energy.
    """

    stored: StoredImage
    labels: StoredImage
    names: dict[int, str]
    density_kg_m3: NDArray[np.float32]
    energy_keV: float

    def image(self) -> Image:
        """The CT in LPS."""
        return along_lps(self.stored, "phantom")

    def named_labels(self) -> Labels:
        """The labels in LPS, on the grid of `image`."""
        return Labels(along_lps(self.labels, "phantom labels", labels=True), self.names)

    def rod_means(self) -> dict[float, float]:
        """Mean [HU] of each rod's inner voxels by its density [kg/m3]."""
        from scipy.ndimage import binary_erosion

        number = {name: number for number, name in self.names.items()}
        masks = {rod: self.labels.values == number[f"rod_{rod:g}"] for rod in RODS_KG_M3}
        return {
            rod: float(self.stored.values[binary_erosion(mask, iterations=2)].mean()) for rod, mask in masks.items()
        }


@dataclass(frozen=True)
class _Part:
    """A body with its label, distance [mm, negative inside], and bone density [kg/m3] or, where None, its tissue."""

    label: str
    distance: Distance
    density_kg_m3: float | None = None
    tissue: str = "cortex"


def ct_phantom(
    rng: np.random.Generator,
    *,
    energy_keV: float = 70.0,
    noise_HU: float = 20.0,
    spacing_mm: tuple[float, float, float] = (0.9, 0.9, 1.5),
    tilt_deg: float = 0.0,
    person: Person | None = None,
) -> CtPhantom:
    """CT of the phantom.

    Parameters
    ----------
    rng
        Makes the noise.
    energy_keV
        Effective energy of the X-rays.
    noise_HU
        Standard deviation of a voxel.
    spacing_mm
        Of the columns, rows and slices [mm].
    tilt_deg
        Tilt of the gantry about x [degrees]: slices lean, their centres stay on a line along z.
    person
        What differs from the tables.

    Raises
    ------
    InputError
        If an option is out of range.
    """
    energy = require_range("energy_keV", energy_keV, 30.0, 150.0, "use 70")
    noise = require_range("noise_HU", noise_HU, 0.0, 500.0, "use 20")
    tilt = math.radians(require_range("tilt_deg", tilt_deg, -30.0, 30.0, "use 0"))
    spacing = np.array([require_positive("spacing_mm", each, "use 0.9") for each in spacing_mm])
    directions = np.array([[1.0, 0.0, 0.0], [0.0, math.cos(tilt), 0.0], [0.0, math.sin(tilt), 1.0]])
    shape = tuple(int(2.0 * half // size) for half, size in zip(_HALF_MM, spacing_mm, strict=True))
    steps = directions * spacing
    origin = -0.5 * steps @ (np.array(shape) - 1.0)
    person = person or Person()
    parts = _parts()
    names = list(dict.fromkeys(part.label for part in parts))
    attenuation, density = np.empty(shape, np.float32), np.empty(shape, np.float32)
    labels = np.empty(shape, np.uint8)
    plane = np.stack(np.meshgrid(*map(np.arange, shape[:2]), [0], indexing="ij"), axis=-1)[:, :, 0] @ steps.T + origin
    for k in range(shape[2]):
        at = plane + k * steps[:, 2]
        attenuation[:, :, k], density[:, :, k], labels[:, :, k] = _painted(parts, names, at, energy, person, spacing)
    true = 1000.0 * (attenuation / linear_attenuation("water", energy) - 1.0)
    values = person.scale * true + person.water_HU + rng.normal(0.0, noise, shape)
    values = np.clip(np.rint(values), _LOWEST_HU, _HIGHEST_HU).astype(np.int16)
    frame = (spacing_mm, directions, origin)
    numbers = {number: name for number, name in enumerate(names, 1) if name != "pad"}
    return CtPhantom(StoredImage(values, *frame), StoredImage(labels, *frame), numbers, density, energy)


def _painted(
    parts: list[_Part],
    names: list[str],
    at: NDArray[np.float64],
    energy_keV: float,
    person: Person,
    spacing: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]:
    """Linear attenuation [1/m], bone density [kg/m3] and label at points; edges are as wide as a voxel."""
    total = np.full(at.shape[:-1], linear_attenuation("air", energy_keV))
    density, labels = np.zeros_like(total), np.zeros(total.shape, np.uint8)
    width = float(np.mean(spacing))
    for part in parts:
        distance = part.distance(at)
        share = np.clip(0.5 - distance / width, 0.0, 1.0)
        total += share * (_attenuation(part, energy_keV, person) - total)
        density += share * ((part.density_kg_m3 or 0.0) - density)
        labels[distance < 0.0] = 0 if part.label == "pad" else names.index(part.label) + 1
    return total, density, labels


def _attenuation(part: _Part, energy_keV: float, person: Person) -> float:
    """Linear attenuation [1/m] of a part's material."""
    factor = person.attenuation.get(part.tissue, 1.0)
    if part.density_kg_m3 is None:
        return factor * linear_attenuation(part.tissue, energy_keV)
    fat = person.marrow_fat
    marrow = fat * linear_attenuation("adipose", energy_keV) + (1.0 - fat) * linear_attenuation("muscle", energy_keV)
    share = part.density_kg_m3 / density_of("cortex")
    over_marrow = share * (linear_attenuation("cortex", energy_keV) - marrow)
    is_shaft = part.density_kg_m3 == CORTEX_KG_M3
    return factor * (marrow + over_marrow) if is_shaft else marrow + person.mineral * over_marrow


def _parts() -> list[_Part]:
    """Bodies in the order in which they are painted over each other."""
    head, shaft, spine = HEAD_CENTRE_MM, (_SHAFT_X_MM, HEAD_CENTRE_MM[1]), (-40.0, -8.0)
    canal = (spine[0], 21.5)
    rods = [
        _Part(f"rod_{rod:g}", partial(_cylinder, centre=(22.0 * (k - 4), 70.0), radius=6.5), rod)
        for k, rod in enumerate(RODS_KG_M3)
    ]
    return [
        _Part("subcutaneous_fat", partial(_ellipse, centre=(0.0, -8.0), radii=(100.0, 62.0)), tissue="adipose"),
        _Part("muscle", partial(_ellipse, centre=(0.0, -8.0), radii=(88.0, 52.0)), tissue="muscle"),
        _Part("aorta", partial(_cylinder, centre=(0.0, -12.0), radius=9.0), tissue="blood"),
        _Part("humerus_left", partial(_cylinder, centre=shaft, radius=_SHAFT_MM, top=-18.0), CORTEX_KG_M3),
        _Part("humerus_left", partial(_cylinder, centre=shaft, radius=_SHAFT_MM - 5.0, top=-18.0), 60.0),
        _Part("humerus_left", partial(_metaphysis, inside=0.0), SUBCHONDRAL_KG_M3),
        _Part("humerus_left", partial(_ball, centre=head, radius=HEAD_RADIUS_MM), SUBCHONDRAL_KG_M3),
        _Part("humerus_left", partial(_metaphysis, inside=2.0), TRABECULAR_KG_M3),
        _Part("humerus_left", partial(_ball, centre=head, radius=HEAD_RADIUS_MM - 2.0), TRABECULAR_KG_M3),
        _Part("vertebrae_L1", partial(_arch, spine_x=spine[0]), _ARCH_KG_M3),
        _Part(
            "vertebrae_L1", partial(_cylinder, centre=spine, radius=20.0, top=14.0, bottom=-14.0), _VERTEBRA_SHELL_KG_M3
        ),
        _Part(
            "vertebrae_L1", partial(_cylinder, centre=spine, radius=18.0, top=12.0, bottom=-12.0), _VERTEBRA_CORE_KG_M3
        ),
        _Part("spinal_canal", partial(_cylinder, centre=canal, radius=7.0), tissue="muscle"),
        _Part("pad", _pad, tissue="water"),
        *rods,
    ]


def _ellipse(
    at: NDArray[np.float64], *, centre: tuple[float, float], radii: tuple[float, float]
) -> NDArray[np.float64]:
    """About the distance from an elliptic cylinder along z: its level function over the function's slope."""
    x, y = ((at[..., k] - centre[k]) / radii[k] for k in (0, 1))
    level = np.hypot(x, y)
    return np.asarray((level - 1.0) * level / np.maximum(np.hypot(x / radii[0], y / radii[1]), 1e-9))


def _cylinder(
    at: NDArray[np.float64],
    *,
    centre: tuple[float, float],
    radius: float,
    top: float = math.inf,
    bottom: float = -math.inf,
) -> NDArray[np.float64]:
    around = np.hypot(at[..., 0] - centre[0], at[..., 1] - centre[1]) - radius
    return np.asarray(np.maximum(around, np.maximum(at[..., 2] - top, bottom - at[..., 2])))


def _metaphysis(at: NDArray[np.float64], *, inside: float) -> NDArray[np.float64]:
    """A cone that widens from the shaft to a rim about the head's lower half, `inside` it by so much [mm]."""
    up = np.clip((at[..., 2] - _NECK_MM) / (_RIM_MM - _NECK_MM), 0.0, 1.0)
    radius = _SHAFT_MM + up * (_RIM_RADIUS_MM - _SHAFT_MM) - inside
    around = np.hypot(at[..., 0] - _SHAFT_X_MM, at[..., 1] - HEAD_CENTRE_MM[1]) - radius
    return np.asarray(np.maximum(around, np.maximum(at[..., 2] + inside - _RIM_MM, _NECK_MM + inside - at[..., 2])))


def _ball(at: NDArray[np.float64], *, centre: tuple[float, float, float], radius: float) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(at - np.array(centre), axis=-1) - radius)


def _arch(at: NDArray[np.float64], *, spine_x: float) -> NDArray[np.float64]:
    """Two pedicles from the body backward, the laminae that join them behind the canal, and a spinous process."""
    across, y, z = np.abs(at[..., 0] - spine_x), at[..., 1], at[..., 2]
    pedicle = np.maximum(np.maximum(np.abs(across - 12.0) - 4.0, np.abs(y - 16.0) - 14.0), np.abs(z - 5.0) - 6.5)
    lamina = np.maximum(np.maximum(across - 16.0, np.abs(y - 31.5) - 3.0), np.abs(z) - 11.0)
    spinous = np.maximum(np.maximum(across - 3.0, np.abs(y - 36.0) - 5.0), np.abs(z + 3.0) - 7.0)
    return np.asarray(np.minimum(np.minimum(pedicle, lamina), spinous))


def _pad(at: NDArray[np.float64]) -> NDArray[np.float64]:
    """A pad of water below the body."""
    return np.asarray(np.maximum(np.abs(at[..., 0]) - 100.0, np.abs(at[..., 1] - 70.0) - 8.5))
