"""Loads of a run for samples of its constants, from its geometry that was recorded once."""

import re
from collections.abc import Iterator
from functools import cached_property

import numpy as np

from meshes.base.arrays import Array, Ints
from tissue.fitting.bands.sample import Ranges, ranges_of, sampled
from tissue.materials.constants import CuttingCoefficients
from tissue.materials.prior import Prior
from tissue.simulation.load_record import LoadRecord

__all__ = ["CHANNELS", "DENSITY", "Reweighed", "density_prior"]

CHANNELS = (
    "force_x_N",
    "force_y_N",
    "force_z_N",
    "force_N",
    "torque_x_Nm",
    "torque_y_Nm",
    "torque_z_Nm",
    "torque_Nm",
)
"""Components and sizes of the loads on the tool in the world, as the model gives them."""
DENSITY = "density.bone"
BLOCK = 500_000
"""Numbers of loads that are held at once: 4 MB, about a cache."""
LAW = re.compile(r"median ([\d.]+) kg/m3, 90 % between ([\d.]+) and ([\d.]+)")


class Reweighed:
    """A run's loads as a function of the constants that vary.

    Parameters
    ----------
    record
        The geometry of the run, every tick of it.
    """

    def __init__(self, record: LoadRecord) -> None:
        self.record = record
        self._contact = record.trace["contact_mm2"] > 0.0
        units = [layer.unit.any(axis=(0, 1, 3)) for layer in record.layers.values()]
        self._loaded = (
            np.flatnonzero(np.logical_or.reduce(units, axis=0))
            if units
            else np.zeros(0, dtype=np.int64)
        )

    @cached_property
    def ranges(self) -> Ranges:
        """Constants with a range, for the layers that the tool touched.

        Constants that the scene sets itself are left out.
        """
        met = [self.record.layer_names[at] for at in sorted(self.record.layers)]
        density = density_prior(self.record.notes.get("density law", ""))
        further = {} if density is None else {DENSITY: density}
        return ranges_of(self.record.scene, met, table="cutting.", further=further)

    def coefficients(self, x: Array) -> tuple[CuttingCoefficients, ...]:
        """Return cutting coefficients of each layer for values of the constants, shape (p,)."""
        cutting = self.record.scene.cutting
        changes = cutting.model_dump(exclude={"material"})
        held = sampled(self.record.scene.constants, self.ranges.names, x)
        return held.coefficients(self.record.layer_names, changes, bone=cutting.material)

    def nominal(self) -> Array:
        """Return the values of the constants at which the run was simulated, shape (p,)."""
        return np.array([prior.value for prior in self.ranges.priors])

    def weights(self, x: Array) -> Array:
        """Return the factors of all unit loads, shape (samples, units).

        The values `x` have shape (samples, p).
        """
        layers = len(self.record.layer_names)
        place = self.ranges.names.index(DENSITY) if DENSITY in self.ranges.names else None
        rows = []
        for each in x:
            factors = None if place is None else np.full(layers, each[place])
            rows.append(
                np.concatenate(list(self.record.weights(self.coefficients(each), factors).values()))
            )
        return np.array(rows)

    def figures(self, x: Array) -> Array:
        """Return `tissue.fitting.bands.rerun.LOADS` of samples, shape (samples, 4)."""
        weights = self.weights(x)
        peak = np.zeros((len(x), 2))
        sums = np.zeros((len(x), 2))
        for ticks, loads in self._blocks(weights):
            parts = loads.reshape(*loads.shape[:2], 2, 3)
            sizes = np.sqrt(np.einsum("sncd,sncd->snc", parts, parts))
            peak = np.maximum(peak, sizes.max(axis=1))
            sums += sizes[:, self._contact[ticks]].sum(axis=1)
        means = sums / max(int(self._contact.sum()), 1)
        return np.stack([peak[:, 0], means[:, 0], peak[:, 1], means[:, 1]], axis=1)

    def quantiles(self, x: Array, levels: tuple[float, ...]) -> Array:
        """Return quantiles over the samples of `CHANNELS` at each tick, shape (levels, n, 8)."""
        found = np.zeros((len(levels), len(self.record.times_s), len(CHANNELS)))
        for ticks, loads in self._blocks(self.weights(x)):
            found[:, ticks] = np.quantile(with_sizes(loads), levels, axis=0)
        return found

    def _blocks(self, weights: Array) -> Iterator[tuple[Ints, Array]]:
        """Yield blocks of loads, shape (samples, ticks, 6), and the indices of their ticks.

        A block holds a few consecutive loaded ticks.
        """
        step = max(BLOCK // (6 * len(weights)), 1)
        for first in range(0, len(self._loaded), step):
            ticks = self._loaded[first : first + step]
            unit = [layer.unit[:, :, ticks] for layer in self.record.layers.values()]
            rows = np.concatenate(
                [each.reshape(each.shape[0] * each.shape[1], -1) for each in unit]
            )
            yield ticks, (weights @ rows).reshape(len(weights), -1, 6)


def with_sizes(loads: Array) -> Array:
    """Return `CHANNELS` of forces and torques: shape (..., 8) from shape (..., 6)."""
    force = loads[..., :3]
    torque = loads[..., 3:]
    sizes = [np.linalg.norm(each, axis=-1, keepdims=True) for each in (force, torque)]
    return np.concatenate([force, sizes[0], torque, sizes[1]], axis=-1)


def density_prior(law: str) -> Prior | None:
    """Return the prior of a density factor from the law that an image of densities records.

    The result is None if the image records no law. The band of the law is the band of the median
    density; it is applied as a relative band to every voxel.
    """
    found = LAW.search(law)
    if found is None:
        return None
    median, low, high = map(float, found.groups())
    return Prior(1.0, low / median, high / median)
