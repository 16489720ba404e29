"""Stress and displacement of a tooth during drilling, computed at intervals of many ticks."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from meshes.base.arrays import Array, Bytes, Flags, Integers, Ints
from meshes.base.errors import InputError
from meshes.tooth.layers import caries_softness
from meshes.voxels.volume import VoxelVolume
from tissue.fem.fields import FieldSeries, Frame, principal_stresses, von_mises
from tissue.materials.scene_constants import Materials
from tissue.models.tooth.body import ParticleBody
from tissue.models.tooth.grid import (
    FULL_STEPS,
    HexGrid,
    NodeSupports,
    ParticleSet,
    PointSprings,
    bed_springs,
    bed_stiffness,
)
from tissue.models.tooth.recovery import (
    REACH_M,
    FirstGuess,
    StressRecovery,
    SupportCompliance,
    support_compliance,
)

TOOTH = ("enamel", "dentin", "pulp", "caries")
"""Names of the layers whose voxels become particles.

The ligament is modelled as springs, and the bone behind it does not move.
"""
VTK_ORDER = (0, 4, 6, 2, 1, 5, 7, 3)
"""Corners of a cell in the order of VTK's hexahedron."""
INFECTED_SHARE = 0.05
"""Modulus of fully softened dentin, divided by the modulus of sound dentin.

The moduli are about 1 GPa and 18.6 GPa. Measured values of carious dentin are 0.015 to 14.55 GPa
(Angker et al. 2004).
"""

TOLERANCE = 7e-4
"""Relative error in the energy norm at which the solver stops.

One more correction after the last iteration reduces the error to a third of this value. With cells
of 0.3 mm, the discretisation error next to a cut is a hundred times larger.
"""
_MARGIN = 6
"""Number of layers of air voxels that are added around the voxel volume of a tooth.

The tooth may reach the border of its volume. The surface normals are smoothed with a Gaussian with
a standard deviation of 1.5 voxels, which is cut off at four standard deviations, or 6 voxels.
"""


@dataclass(frozen=True)
class SolveRecord:
    """Duration and outcome of one stress computation."""

    time_s: float
    iterations: int
    outcome: str
    solve_s: float
    debris_m3: float


class StressField:
    """Solver for stress and displacement of a whole tooth, with particle finite elements.

    Parameters
    ----------
    tooth
        The whole tooth in voxels. Each voxel becomes a particle.
    cell_m
        Edge of a cell [m].
    ligament_thickness_m
        Thickness of the ligament [m].
    contact_m
        Radius over which the cutter's force is distributed [m], such as the radius of the cutter.
    constants
        Elastic constants of the layers.
    device, cores
        Warp device, and processor cores to use.

    Attributes
    ----------
    series
        Mesh of the tooth, with displacement and stress at all solved times.
    compliance
        Compliance of the tooth in its ligament.
    records
        Duration and outcome of every call of `solve`.
    root_guessed
        True if the voxels contain neither ligament nor bone. Springs then hold the lower third of
        the tooth, which is taken as the root.
    """

    def __init__(
        self,
        tooth: VoxelVolume,
        *,
        cell_m: float,
        ligament_thickness_m: float,
        contact_m: float = REACH_M,
        constants: Materials = Materials.cited,
        device: str = "cpu",
        cores: int | None = None,
    ) -> None:
        self._volume = tooth
        self._contact_m = contact_m
        self.root_guessed = not (
            (tooth.fraction > 0) & np.isin(tooth.layer, _bed_layers(tooth))
        ).any()
        index = [tooth.layer_names.index(name) for name in TOOTH if name in tooth.layer_names]
        solid = (tooth.fraction > 0) & np.isin(tooth.layer, index)
        places = np.argwhere(solid)
        self._particle_at = np.full(tooth.shape, -1, dtype=np.int64)
        self._particle_at[solid] = np.arange(len(places))
        particles = _particles(tooth, places, constants)
        # original volume of each particle in steps of 1/65535, and volume lost so far
        self._whole = tooth.fraction[solid] / 255.0 * FULL_STEPS
        self._lost = np.zeros(len(places))
        origin = cell_m * np.floor(particles.position_m.min(axis=0) / cell_m)
        grid = HexGrid.around(particles.position_m, edge_m=cell_m, origin_m=origin)
        springs = _ligament_springs(tooth, solid, ligament_thickness_m, constants)
        self.body = ParticleBody(
            particles,
            grid,
            NodeSupports.of(grid.node_count),
            springs=springs,
            device=device,
            cores=cores,
        )
        weights = np.zeros(grid.node_count)
        # Each of the eight corners gets an eighth of the cell's material.
        np.add.at(weights, grid.cell_nodes, (self.body.cells.fill * cell_m**3 / 8.0)[:, None])
        self.reference_m = np.average(grid.node_position_m, axis=0, weights=weights)
        self.compliance: SupportCompliance = support_compliance(
            self.body, weights=weights, reference_m=self.reference_m
        )
        if not self.compliance.converged:
            raise InputError(
                "stress.cell_mm",
                "give a mesh on which the stress can be solved",
                f"{1000.0 * cell_m:g} without convergence",
                # Suggest twice the edge, because a larger cell holds more material.
                f"use {2000.0 * cell_m:g}",
            )
        solved = [solution.displacement_m for solution in self.compliance.solutions]
        self._guess = FirstGuess(list(zip(solved, self.compliance.loads_N, strict=True)))
        layer = _cell_layers(self.body)
        # the nearest particles may be 0.87 of a voxel's edge from a cell's centre
        self._reach_m = max(REACH_M, tooth.spacing_m)
        self._recovery = StressRecovery(
            particles, self.body.cells, grid.cell_centre_m, layer, reach_m=self._reach_m
        )
        self.series = FieldSeries(
            grid.node_position_m,
            grid.cell_nodes[:, VTK_ORDER].astype(np.int64),
            layer,
            tooth.layer_names,
        )
        self.records: list[SolveRecord] = []

    def remove(
        self, voxels: Integers, steps: Integers, *, origin_m: Array, spacing_m: float
    ) -> None:
        """Reduce the particles by the volume that drilling removed from a finer voxel grid.

        Parameters
        ----------
        voxels, steps
            Indices of finer voxels, shape (n, 3), and the fraction that each voxel lost since the
            last call, in steps of 1/65535, shape (n,).
        origin_m, spacing_m
            Lowest corner of the finer voxel (0, 0, 0) [m], and edge of the finer voxels [m]. The
            faces of coarse and fine voxels lie at multiples of the finer edge.
        """
        ratio = round(self._volume.spacing_m / spacing_m)
        first = np.rint(origin_m / spacing_m).astype(int)
        shift = np.rint(self._volume.origin_m / self._volume.spacing_m).astype(int)
        at = (voxels + first) // ratio - shift
        inside = ((at >= 0) & (at < np.array(self._volume.shape))).all(axis=1)
        particle = self._particle_at[tuple(at[inside].T)]
        held = particle >= 0
        lost = np.bincount(particle[held], weights=steps[inside][held], minlength=len(self._lost))
        touched = np.flatnonzero(lost)
        self._lost[touched] += lost[touched]
        whole = self._whole[touched] * ratio**3
        share = np.clip(1.0 - self._lost[touched] / whole, 0.0, 1.0)
        self.body.set_remaining(touched, np.rint(share * FULL_STEPS).astype(np.uint16))

    def solve(self, time_s: float, force_N: Array, point_m: Array) -> Frame:
        """Solve for displacement and stress while a force acts on the tooth at a point.

        The iterations start from a guess that is computed from earlier solutions. The result is
        also added to `series`.
        """
        begun = perf_counter()
        change = self.body.update()
        load = self.load(force_N, point_m)
        solution = self.body.solve(load, tolerance=TOLERANCE, start_m=self._guess(load))
        if solution.converged:
            self._guess.add(solution.displacement_m, load)
        von_mises, principal = self.recover(solution.displacement_m)
        gone = self.body.cells.live == 0
        cells = {
            "von_mises_MPa": 1e-6 * von_mises,
            **{f"principal_{i + 1}_MPa": 1e-6 * principal[:, i] for i in range(3)},
        }
        values = {
            name: np.where(gone, np.nan, value).astype(np.float32) for name, value in cells.items()
        }
        moved = np.where(self.body.carrying[:, None], 1e6 * solution.displacement_m, 0.0).astype(
            np.float32
        )
        frame = Frame(time_s, {"displacement_um": moved}, values)
        self.series.frames.append(frame)
        left = self.body.cells.remaining[self.body.cells.rank[change.debris]] / FULL_STEPS
        loose = float((self.body.particles.volume_m3[change.debris] * left).sum())
        self.records.append(
            SolveRecord(
                time_s, solution.iterations, solution.outcome.name, perf_counter() - begun, loose
            )
        )
        return frame

    def load(self, force_N: Array, point_m: Array) -> Array:
        """Return nodal forces [N], shape (n, 3), for the cutter's force at a point."""
        return self.body.spread_over(point_m, force_N, radius_m=self._contact_m)

    def recover(self, displacement_m: Array) -> tuple[Array, Array]:
        """Return the averaged von Mises stress and principal stresses at the cell centres [Pa].

        The shapes are (c,) for the von Mises stress and (c, 3) for the principal stresses, with c
        cells.
        """
        stress_Pa = np.nan_to_num(self._recovery(displacement_m))
        return von_mises(stress_Pa), principal_stresses(stress_Pa)


def _particles(tooth: VoxelVolume, places: Ints, constants: Materials) -> ParticleSet:
    """Return one particle for each voxel, with the elastic constants of its layer.

    In the layer of caries, Young's modulus depends on the softness of the voxel.
    """
    at = tuple(places.T)
    layer = tooth.layer[at]
    fraction = tooth.fraction[at]
    modulus = np.ones(len(places))
    # Placeholder: the value of every particle is set below, by layer.
    ratio = np.full(len(places), 0.3)
    for index, name in enumerate(tooth.layer_names):
        chosen = layer == index
        # Ligament and bone have no particles, so the table chosen for them has no effect.
        table = constants.values("tooth", name if name in TOOTH else "dentin")
        modulus[chosen] = 1e9 * table["modulus_GPa"]
        ratio[chosen] = table["poisson_ratio"]
        if name == "caries":
            softness = caries_softness(tooth.density_kg_m3[at][chosen].astype(np.float64))
            sound = 1e9 * constants.values("tooth", "dentin")["modulus_GPa"]
            modulus[chosen] = sound * INFECTED_SHARE**softness
    position = tooth.origin_m + tooth.spacing_m * (places + 0.5)
    volume = fraction / 255.0 * tooth.spacing_m**3
    full = np.full(len(places), FULL_STEPS, dtype=np.uint16)
    return ParticleSet(position, volume, modulus, ratio, layer.astype(np.uint8), full)


def _bed_layers(tooth: VoxelVolume) -> list[int]:
    """Return the indices of the layers that support the tooth: ligament or bone."""
    return [i for i, name in enumerate(tooth.layer_names) if name in ("ligament", "bone")]


def _ligament_springs(
    tooth: VoxelVolume, solid: Flags, thickness_m: float, constants: Materials = Materials.cited
) -> PointSprings:
    """Return springs at the faces between tooth and ligament or bone.

    If the voxels contain neither ligament nor bone, the springs act on the tooth's lower third.
    """
    table = constants.values("tooth", "ligament")
    across, along = bed_stiffness(1e9 * table["modulus_GPa"], table["poisson_ratio"], thickness_m)
    bed = (tooth.fraction > 0) & np.isin(tooth.layer, _bed_layers(tooth))
    origin_m = tooth.origin_m
    if not bed.any():
        solid = np.pad(solid, _MARGIN)
        origin_m = origin_m - _MARGIN * tooth.spacing_m
        depth = np.flatnonzero(solid.any(axis=(0, 1)))
        # The lower third represents the root, which the ligament holds.
        below = np.arange(solid.shape[2]) < depth[0] + (depth[-1] - depth[0]) // 3
        bed = ~solid & below[None, None, :]
    springs, area = bed_springs(
        solid,
        bed,
        origin_m=origin_m,
        spacing_m=tooth.spacing_m,
        across_N_m3=across,
        along_N_m3=along,
    )
    if area == 0.0:
        raise InputError(
            "anatomy",
            "contain a tooth with a support",
            "none",
            "give the ligament or the bone of the tooth",
        )
    return springs


def _cell_layers(body: ParticleBody) -> Bytes:
    """Return the index of the layer with the largest volume in each cell."""
    cells = body.cells
    particles = body.particles
    names = int(particles.layer.max()) + 1
    volume = np.zeros((body.grid.cell_count, names))
    np.add.at(
        volume,
        (cells.particle_cell, particles.layer[cells.order]),
        particles.volume_m3[cells.order],
    )
    return np.asarray(volume.argmax(axis=1), np.uint8)
