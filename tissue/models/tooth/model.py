"""Tooth that a bur drills: removal, forces, distance to the pulp, optional stress and heat."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.elements import CHUNK
from kernels.launcher import SplitLaunch
from kernels.mirror import Mirror
from kernels.structure_distance import clearance
from meshes.base.arrays import Array, Bytes, Flags, Ints, Singles
from meshes.base.errors import InputError
from tissue.fem.fields import FieldSeries
from tissue.models.bone.model import BoneModel, MilledTissue
from tissue.models.heat.cutting_heat import CuttingHeat
from tissue.models.state import State, copied, put_back
from tissue.models.tissue_model import SLOW, Response, ToolMotion
from tissue.models.tooth.stress_process import Drilled, StressSolver
from tissue.system.child import HelperLostError

CENTROID_COLUMNS = ("tooth_centroid_x_um", "tooth_centroid_y_um", "tooth_centroid_z_um")
"""Names of the trace columns with the rigid displacement of the tooth at its centroid."""
BUR_COLUMNS = ("tooth_at_bur_x_um", "tooth_at_bur_y_um", "tooth_at_bur_z_um")
"""Names of the trace columns with the rigid displacement of the tooth at the bur.

The displacement of the point that the bur touches includes the translation and the rotation of the
tooth.
"""
PULP_LIMIT_K = 5.5
"""Temperature rise above which the pulp may not survive [K] (Zach and Cohen 1965)."""
WARN_M = (1.0e-3, 0.5e-3)
"""Two thicknesses of the dentin over the pulp; an event is reported below each of them [m].

Below 0.5 mm the pulp is at risk. This limit is quoted from memory.
"""


class ToothModel(MilledTissue):
    """Tooth that a bur drills.

    The bone model computes removal and forces. The distance between bur and pulp is measured to the
    voxels that the pulp filled at the start. Once the bur is in dentin, the smallest distance so
    far is the smallest thickness of the remaining dentin. Before that, the distance also includes
    enamel and air. The error of the distance is half a voxel. If the voxels contain no pulp, the
    distance is not measured. The pulp is then outside the voxels, which extend by a margin beyond
    the region that the bur can reach.

    If stress is computed, the tooth moves in every tick as a rigid body under the force, with the
    compliance of its ligament. The motion is reported at the centroid of the tooth's material, and
    at the point that the bur touches. Stress is computed in the background, from a copy of voxels
    and force that is made every ``interval_s``. The result is recorded one interval later, so the
    record does not depend on the computing time.

    Parameters
    ----------
    milling
        Model with the tooth's voxels and the bur. One layer is named ``pulp``.
    stress
        Stress solver of the whole tooth; None if the scene does not include stress.
    interval_s
        Time between two computations of the stress [s].
    heat
        Temperature of the whole tooth; None if the scene does not include heat.
    device
        Warp device name.
    """

    def __init__(
        self,
        milling: BoneModel,
        *,
        stress: StressSolver | None = None,
        interval_s: float = 0.1,
        heat: CuttingHeat | None = None,
        device: str = "cpu",
    ) -> None:
        super().__init__(milling)
        self.stress = stress
        self.heat = heat
        volume = milling.store.volume
        assert volume is not None, "the distance to the pulp is taken in the whole region"
        is_pulp = volume.layer == self.layer_names.index("pulp")
        distance = _distance_to_pulp(volume.fraction, is_pulp, volume.spacing_m)
        self._reach_m = float(distance.max())
        # Infinite if the voxels hold no pulp.
        self._pulp_near = bool(np.isfinite(self._reach_m))
        self._reports_pulp = True
        self.measure_names: tuple[str, ...] = ("dentin_over_pulp_mm",) if self._pulp_near else ()
        self._moves = slice(len(self.measure_names), len(self.measure_names) + 6)
        if stress is not None:
            self.measure_names += CENTROID_COLUMNS + BUR_COLUMNS
        if heat is not None:
            self.measure_names += ("pulp_rise_K",)
        self._pulp_rise_K = 0.0
        self._pulp_limit_reported = False
        self._touched = np.zeros(len(milling.store.places), np.bool_)
        self._interval_s = interval_s
        self._next_s = 0.0
        self._late_reported = False
        self._stress_lost = False
        self.notices = milling.notices
        if stress is not None and stress.root_guessed:
            self.notices.append(
                "neither ligament nor bone is given: the tooth's lower third is held as its root"
            )
        self._least_m = np.inf
        self._response: Response | None = None
        self._load = np.zeros(6)
        self._radius_m = milling.cutter.profile.radius_m
        chunks = -(-len(milling.shell.areas_m2) // CHUNK)
        self._nearest = Mirror(chunks, wp.float32, device)
        self._clearance = SplitLaunch(
            clearance,
            chunks,
            [milling.elements, milling.motion_rows, volume.spacing_m, distance],
            [self._nearest.device],
            device=device,
        )

    def place(self, motion: ToolMotion) -> None:
        """Put the bur at its first pose."""
        super().place(motion)
        self._measure_pulp(motion)

    def advance(self, motion: ToolMotion) -> None:
        """Carve the material that the bur reaches at its new pose."""
        super().advance(motion)
        self._measure_pulp(motion)

    def respond(self, motion: ToolMotion) -> Response:
        """Return force and torque on the bur, and the values that the tooth adds to the trace."""
        response = self.milling.respond(motion)
        if response is not self._response:
            self._response = response
            response.measures = np.zeros(len(self.measure_names))
        if self._pulp_near:
            response.measures[0] = 1e3 * min(self._least_m, self._reach_m)
        if self.stress is not None:
            self._load[:] = response.wrench
            self._load[3:] += _cross(motion.tip_m - self.stress.reference_m, response.wrench)
            moved = -1e6 * self.stress.compliance.matrix.dot(self._load)
            response.measures[self._moves][:3] = moved[:3]
            response.measures[self._moves][3:] = moved[:3]
            response.measures[self._moves][3:] += _cross(
                moved[3:], self._contact(motion) - self.stress.reference_m
            )
        if self.heat is not None:
            response.measures[-1] = self._pulp_rise_K
        return response

    def state(self) -> State:
        """Return a copy of the state on which later ticks depend.

        Raises
        ------
        InputError
            If stress or heat is computed. The state of the stress computation is in another
            process, and the temperature grid is not copied.
        """
        if self.stress is not None or self.heat is not None:
            raise InputError(
                "scene",
                "have no stress and no heat if its state is copied",
                "one of them",
                "leave out both",
            )
        return {"milling": self.milling.state(), "pulp": copied(self, ("_least_m",))}

    def restore(self, state: State) -> None:
        """Restore a state that `state` has returned."""
        self.milling.restore(state["milling"])
        put_back(self, state["pulp"])

    @property
    def scheduling(self) -> str:
        """Method, priority and cores of the stress computation; empty if stress is not computed."""
        return f"stress: {self.stress.scheduling}" if self.stress is not None else ""

    @property
    def heat_balance_J(self) -> dict[str, float] | None:
        """Energy of cutting, and energies in chips, removed material and remaining tissue [J].

        None if the scene does not compute heat.
        """
        return self.heat.balance_J if self.heat is not None else None

    @property
    def fields(self) -> FieldSeries | None:
        """Displacement and stress computed so far."""
        return self.stress.series if self.stress is not None else None

    def wait_for_background(self, time_s: float) -> None:
        """Wait for the stress that is due at the end of an interval.

        A run that is faster than real time waits here.
        """
        # 1e-9 s: the time of a tick is rounded.
        if time_s >= self._next_s - 1e-9:
            self._await()

    def start_background(self, time_s: float, motion: ToolMotion) -> None:
        """Add the heat of the present tick to the heat computation.

        At the end of an interval, begin a stress computation from a copy of the changed voxels.
        """
        if self.heat is not None:
            assert self._response is not None
            if self.heat.add_tick(self._response.wrench, motion, self._take_touched):
                self._see_pulp(self.heat)
        if self.stress is None or self._stress_lost or time_s < self._next_s - 1e-9:
            return
        self._next_s += self._interval_s
        self._take_touched()
        rows = np.flatnonzero(self._touched)
        self._touched[:] = False
        left = self.milling.store.remaining.numpy()[rows]
        self.stress.begin(Drilled(time_s, rows, left, -self._load[:3], self._contact(motion)))

    def _take_touched(self) -> tuple[Ints, NDArray[np.uint16]]:
        """Return the bricks that lost material since the last call.

        The bricks (blocks of voxels) are marked for the next stress computation.
        """
        rows, left = self.milling.store.take_touched()
        self._touched[rows] = True
        return rows, left

    def _contact(self, motion: ToolMotion) -> Array:
        """Return the point at which the bur's head touches the tooth [m].

        The point lies on the side of the head from which the tooth's force acts on the bur. Without
        force, the tip is returned.
        """
        force = float(np.linalg.norm(self._load[:3]))
        radius = self._radius_m
        toward = self._load[:3] / force if force > 0.0 else motion.rotation[:, 2]
        return motion.tip_m + radius * (motion.rotation[:, 2] - toward)

    def _see_pulp(self, heat: CuttingHeat) -> None:
        """Read the temperature of the pulp after an interval; report an exceeded limit once."""
        self._pulp_rise_K = heat.pulp_rise_K
        if self._pulp_rise_K >= PULP_LIMIT_K and not self._pulp_limit_reported:
            self._pulp_limit_reported = True
            self.notices.append(f"the pulp is {PULP_LIMIT_K:g} K warmer than at the start")

    def _await(self) -> None:
        if self.stress is None or self._stress_lost:
            return
        try:
            record = self.stress.wait()
        except HelperLostError as lost:
            self._lose_stress(lost)
            return
        if record is None:
            return
        if record.debris_m3 > 0.0:
            self.notices.append(
                f"{1e9 * record.debris_m3:.3g} mm3 of the tooth are cut loose and count as debris"
            )
        if record.outcome != "CONVERGED":
            self.notices.append(
                f"the stress at {record.time_s:.3f} s did not converge ({record.outcome.lower()})"
            )
        if record.solve_s > self._interval_s and not self._late_reported:
            self._late_reported = True
            self.notices.append(
                f"solving the stress took {record.solve_s:.2f} s, {SLOW} of "
                f"{self._interval_s:g} s: this run waits for "
                "the solution, a run with a real device does not"
            )

    def finish(self) -> None:
        """Complete the postponed carving and the last computations of stress and heat."""
        self._await()
        if self.stress is not None and not self._stress_lost:
            try:
                self.stress.finish()
            except HelperLostError as lost:
                self._lose_stress(lost)
        super().finish()
        if self.heat is not None:
            if self.heat.end(self._take_touched):
                self._see_pulp(self.heat)
            self.heat.finish()

    def _lose_stress(self, lost: HelperLostError) -> None:
        """Continue the run without stress after the process that solves the stress was lost.

        The run needs only the tooth's compliance, which was received from this process at the
        start.
        """
        self._stress_lost = True
        self.notices.append(
            f"{lost}: this run has no stress and no frames. Everything else continues"
        )

    def remaining(self) -> Bytes:
        """Return the amount of tooth left in every voxel, from 0 to 255 (full voxel).

        The array has the same shape as the voxel volume.
        """
        return self.milling.remaining()

    def _measure_pulp(self, motion: ToolMotion) -> None:
        """Measure the distance from the bur to the pulp at a pose where the bur cuts.

        At trial poses of a force balance, the distance is not measured.
        """
        if not (self._pulp_near and self._reports_pulp):
            return
        self.milling.send_pose(motion)
        self._clearance()
        self._nearest.pull()
        self._report_pulp(float(np.minimum.reduce(self._nearest.host)))
        if self._response is not None:
            self._response.measures[0] = 1e3 * min(self._least_m, self._reach_m)

    def stop_reporting(self) -> None:
        """Stop updating the smallest distance to the pulp, and stop reporting pulp exposures."""
        self._reports_pulp = False

    def _report_pulp(self, near_m: float) -> None:
        """Update the smallest distance to the pulp; report a distance below a limit, or zero."""
        before = self._least_m
        self._least_m = min(self._least_m, near_m)
        for limit in WARN_M:
            if self._least_m < limit <= before:
                self.notices.append(f"less than {1e3 * limit:g} mm of dentin is left over the pulp")
        if self._least_m <= 0.0 < before:
            self.notices.append("the pulp is exposed")


def _cross(a: Array, b: Array) -> tuple[float, float, float]:
    """Return the cross product of the first three entries of two arrays; faster than np.cross."""
    (ax, ay, az) = a.tolist()[:3]
    (bx, by, bz) = b.tolist()[:3]
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def _distance_to_pulp(fraction: Bytes, is_pulp: Flags, spacing_m: float) -> Singles:
    """Return the distance of every voxel's centre from the pulp's surface [m].

    The distance is 0 inside the pulp, and infinite if there is no pulp.
    """
    from scipy.ndimage import distance_transform_edt

    # 127: half of a full voxel, 255.
    pulp = is_pulp & (fraction > 127)
    if not pulp.any():
        return np.full(fraction.shape, np.inf, dtype=np.float32)
    away = distance_transform_edt(~pulp, sampling=spacing_m) - 0.5 * spacing_m
    return np.maximum(away, 0.0).astype(np.float32)
