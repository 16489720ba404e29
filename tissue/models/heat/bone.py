"""Bone that a cutter mills and heats, and the thermal dose of the bone."""

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import distance_transform_edt

from meshes.base.arrays import Array, Bytes, Flags
from tissue.models.bone.model import BoneModel, MilledTissue
from tissue.models.heat.cutting_heat import CuttingHeat
from tissue.models.tissue_model import Response, ToolMotion

BODY_C = 37.0
"""Temperature of the bone at the start [degC]: core temperature of the body.

Exposed bone is cooler, so the computed dose is an upper bound.
"""
DOSE_LIMITS_MIN = {
    16.0: "the dose of 47 °C for 1 min, after which bone dies",
    240.0: "the usual lesion dose of soft tissue",
}
"""Limits of the thermal dose [minutes at 43 degC], and the meaning of each limit.

Eriksson and Albrektsson 1983, doi 10.1016/0022-3913(83)90174-9: 47 degC for 1 min impairs the
regeneration of bone. 240 min is the usual limit for soft tissue; the dose is defined by Sapareto
and Dewey 1984, doi 10.1016/0360-3016(84)90379-1.
"""
NEGLIGIBLE_C = 39.0
"""Temperature below which the dose is neglected [degC].

The dose rate at this temperature is 0.004 min of dose per min.
"""
FRONT_M = 1e-3
"""Margin around the points where the tool cuts [m]; a dose inside the margin raises no event.

The tool removes most of this bone next. Heat reaches ahead of the tool by the distance a / v: the
thermal diffusivity a divided by the feed speed v. This distance is 0.5 mm at 0.5 mm/s.
"""
THERMOCOUPLE_M = 0.5e-3
"""Distance from the cut surface at which the temperature rise is reported [m].

Most published measurements use thermocouples at this distance.
"""


def dose_rate(temperature_C: Array) -> Array:
    """Return the rate of the thermal dose, in equivalent minutes at 43 degC per minute.

    The rate is R ** (43 - T), with R = 0.5 at 43 degC and above, and R = 0.25 below (Sapareto and
    Dewey 1984).
    """
    return np.where(temperature_C >= 43.0, 0.5, 0.25) ** (43.0 - temperature_C)


class HeatedBone(MilledTissue):
    """Bone that a cutter mills and heats: the bone model, extended by the temperature of the bone.

    The trace contains the largest temperature rise in the bone at every tick. The summary describes
    the bone that remains after the run. The summary contains the largest temperature rise during
    the run, and the largest rise at 0.5 mm from the cut surface. For each dose limit, it contains
    the volume of bone above the limit, and the largest distance of this bone from the cut surface.
    An event reports that the dose exceeds a limit in bone that the tool has left behind.

    Parameters
    ----------
    milling
        Voxels of the bone, and the cutter.
    heat
        Computation of the temperature of this bone.
    """

    measure_names: tuple[str, ...] = ("bone_rise_K",)

    def __init__(self, milling: BoneModel, heat: CuttingHeat) -> None:
        super().__init__(milling)
        self.heat = heat
        self.notices = milling.notices
        self._response: Response | None = None
        cells = heat.field.filled.shape
        self.peak_K = np.zeros(cells)
        """Largest rise of each cell so far [K]."""
        self.dose_min = np.zeros(cells)
        """Thermal dose of each cell so far [min at 43 degC]."""
        centres = [0.5 * (edges[1:] + edges[:-1]) for edges in heat.grid.edges_m]
        self._centres_m = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1)
        self._rise_K = 0.0
        self._largest_min = 0.0
        self._time_s = 0.0
        self._summary: dict[str, float] = {}

    @property
    def heat_balance_J(self) -> dict[str, float]:
        """Energy of cutting, and energies in chips, removed material and remaining tissue [J]."""
        return self.heat.balance_J

    def respond(self, motion: ToolMotion) -> Response:
        """Return force and torque on the tool, and the largest temperature rise of the bone."""
        response = self.milling.respond(motion)
        if response is not self._response:
            self._response = response
            response.measures = np.zeros(1)
        response.measures[0] = self._rise_K
        return response

    def start_background(self, time_s: float, motion: ToolMotion) -> None:
        """Advance the heat conduction by one tick; called at the end of a tick."""
        assert self._response is not None
        if self.heat.add_tick(self._response.wrench, motion, self.milling.store.take_touched):
            self._record()

    def finish(self) -> None:
        """Complete the carving and the heat conduction that were postponed to later ticks."""
        super().finish()
        if self.heat.end(self.milling.store.take_touched):
            self._record()
        self.heat.finish()
        self._record()
        self._report_dose(self.heat.field.filled > 0.0)
        self._summary = self._remaining_figures()

    def remaining(self) -> Bytes:
        """Return the amount of bone left in every voxel, from 0 to 255 (full voxel).

        The array has the same shape as the voxel volume.
        """
        return self.milling.remaining()

    def summary(self) -> dict[str, object]:
        """Return the temperatures and doses of the remaining bone for the summary of the run."""
        return {"bone_heat": self._summary}

    def _record(self) -> None:
        """Update the largest temperature rise and the thermal dose of every cell."""
        field = self.heat.field
        rise = field.rise_K
        minutes = (field.time_s - self._time_s) / 60.0
        self._time_s = field.time_s
        self._rise_K = float(rise.max())
        np.maximum(self.peak_K, rise, out=self.peak_K)
        warm = np.nonzero(rise > NEGLIGIBLE_C - BODY_C)
        self.dose_min[warm] += minutes * dose_rate(BODY_C + rise[warm].astype(np.float64))
        if self._largest_min < max(DOSE_LIMITS_MIN) and len(warm[0]):
            self._report_dose(self._is_behind())

    def _is_behind(self) -> Flags:
        """Return a mask of the cells with bone that the tool has left behind, see `FRONT_M`."""
        is_left: Flags = self.heat.field.filled > 0.0
        points = self.heat.cut_points_m
        if len(points) == 0:
            return is_left
        is_near = (self._centres_m > points.min(axis=0) - FRONT_M) & (
            self._centres_m < points.max(axis=0) + FRONT_M
        )
        return is_left & ~is_near.all(axis=-1)

    def _report_dose(self, counts: Flags) -> None:
        """Report when the dose exceeds a limit in one of the given cells."""
        before = self._largest_min
        self._largest_min = max(before, float(self.dose_min[counts].max(initial=0.0)))
        for limit_min, meaning in DOSE_LIMITS_MIN.items():
            if before < limit_min <= self._largest_min:
                self.notices.append(
                    f"the thermal dose of bone passes {limit_min:g} min at 43 °C, {meaning}"
                )

    def _remaining_figures(self) -> dict[str, float]:
        """Return temperature rises of the remaining bone, and the extent of its thermal dose.

        The extent is the volume of bone beyond each dose limit, and the depth of this bone.
        """
        field = self.heat.field
        is_left = field.filled > 0.0
        depth_m = self._depths_m()
        figures = {
            "largest_rise_K": float(self.peak_K[is_left].max(initial=0.0)),
            "rise_at_half_mm_K": _largest_at(depth_m, THERMOCOUPLE_M, self.peak_K, is_left),
        }
        volumes_m3 = field.filled * self.heat.grid.volumes_m3
        for limit_min in DOSE_LIMITS_MIN:
            is_beyond = self.dose_min >= limit_min
            deepest_m = depth_m[is_beyond & is_left & np.isfinite(depth_m)].max(initial=0.0)
            figures[f"dose_{limit_min:g}_min_mm3"] = 1e9 * float(volumes_m3[is_beyond].sum())
            figures[f"dose_{limit_min:g}_min_depth_mm"] = 1e3 * float(deepest_m)
        return figures

    def _depths_m(self) -> Array:
        """Return the distance of each cell's centre from the material that was cut [m].

        The distance is infinite for cells outside the voxel volume. If nothing was cut, it is
        infinite for all cells.
        """
        volume = self.milling.store.volume
        assert volume is not None, "the bone under a scene's cutter is one volume"
        lost = volume.fraction.astype(np.int64) - self.milling.remaining()
        is_cut = lost > 127
        if not is_cut.any():
            return np.full(self.peak_K.shape, np.inf)
        size = volume.spacing_m
        depth = distance_transform_edt(~is_cut, sampling=size) - 0.5 * size
        axes = [
            origin + size * (np.arange(count) + 0.5)
            for origin, count in zip(volume.origin_m, volume.shape, strict=True)
        ]
        sampled = RegularGridInterpolator(axes, depth, bounds_error=False, fill_value=np.inf)
        return sampled(self._centres_m)


def _largest_at(depth_m: Array, wanted_m: float, values: Array, is_left: Flags) -> float:
    """Return the largest of `values` at a depth [m], interpolated between neighbouring cells.

    The result is 0 if no two neighbouring cells lie on opposite sides of this depth.
    """
    largest = 0.0
    is_known = is_left & np.isfinite(depth_m)
    for axis in range(3):
        depth = np.moveaxis(depth_m, axis, 0)
        value = np.moveaxis(values, axis, 0)
        known = np.moveaxis(is_known, axis, 0)
        crosses = (depth[:-1] < wanted_m) != (depth[1:] < wanted_m)
        pair = known[:-1] & known[1:] & crosses
        first = depth[:-1][pair]
        weight = (wanted_m - first) / (depth[1:][pair] - first)
        between = (1.0 - weight) * value[:-1][pair] + weight * value[1:][pair]
        largest = max(largest, float(between.max(initial=0.0)))
    return largest
