"""Build the thermal model of bone, or the stress and thermal models of a tooth, around the cut."""

import numpy as np

from meshes.base.progress import Progress
from meshes.voxels.volume import VoxelVolume
from meshes.voxels.voxelise import voxelise
from tissue.models.bone.model import BoneModel
from tissue.models.heat.bone import HeatedBone
from tissue.models.heat.cutting_heat import CuttingHeat
from tissue.models.tissue_model import TissueModel
from tissue.models.tooth import stress_process
from tissue.models.tooth.model import ToothModel
from tissue.motion.motion import Motion
from tissue.scene.anatomy import MolarLabels, Tooth
from tissue.scene.scene import Scene, Stress, Voxels
from tissue.simulation.builders.parts import reach
from tissue.simulation.builders.voxels import (
    anatomy_of,
    labelled_tooth,
    names_of_anatomy,
    volume_of,
)

CELLS = 16
CELL_MM = 0.125, 0.5
"""Lower and upper limit of the edge of a temperature cell [mm].

Within these limits, the tool's diameter is divided into `CELLS` cells.

The cells are never smaller than the voxels. In cortical bone under a 4 mm drill, the largest
temperature rise at 0.5 mm from the wall of the hole is 4.78, 3.42 and 3.33 K for 8, 16 and 32 cells
across the diameter.
"""
HEAT_CELL = 0.25
"""Ratio of the edge of temperature cells in reach of the bur to the edge of stress cells.

By default the temperature cells have an edge of 0.125 mm. The temperature rise of the pulp in the
molar scene is 0.685, 0.769 and 0.806 K with cells of 0.25, 0.125 and 0.075 mm.
"""


def tooth_around(
    scene: Scene, milling: BoneModel, motion: Motion, *, compute: str, report: Progress
) -> TissueModel:
    """Return a model of the tooth around the milled voxels, with stress and heat on request."""
    anatomy = scene.anatomy
    if not isinstance(anatomy, Tooth) or not (scene.stress or scene.heat):
        return ToothModel(milling, device=compute)
    stress = scene.stress or Stress()
    cell_m = stress.cell_mm * 1e-3
    field = None
    if scene.stress is not None:
        report("assembling the tooth's stiffness", 0.0)
        # Two voxels across a cell: one sample point in each octant of the cell.
        whole = _whole_tooth(scene, spacing_m=0.5 * cell_m, report=report)
        field = stress_process.StressProcess(
            whole,
            milling.store,
            cell_m=cell_m,
            ligament_thickness_m=anatomy.ligament_thickness_mm * 1e-3,
            contact_m=milling.cutter.profile.radius_m,
            constants=scene.constants,
            device=compute,
            cores=1,  # the ticks need their own core
        )
    heat = None
    if scene.heat:
        report("building the grid of the temperature", 0.0)
        heat = CuttingHeat(
            _whole_tooth(
                scene,
                spacing_m=max(HEAT_CELL * cell_m, milling.store.grid.spacing_m),
                report=report,
            ),
            milling,
            reach_m=reach(milling.cutter, motion, 0.0),
            constants=scene.constants,
            device=compute,
        )
    interval_s = stress.interval_ms * 1e-3
    return ToothModel(milling, stress=field, interval_s=interval_s, heat=heat, device=compute)


def _whole_tooth(scene: Scene, *, spacing_m: float, report: Progress) -> VoxelVolume:
    """Return the whole tooth of a scene before drilling, in coarser voxels."""
    parameters = scene.bone
    with names_of_anatomy(parameters):
        if isinstance(parameters, MolarLabels):
            return labelled_tooth(parameters, spacing_m=spacing_m, notes={}, report=report)
        return voxelise(anatomy_of(parameters, {}), spacing_m=spacing_m)


def heated_bone(
    scene: Scene, milling: BoneModel, motion: Motion, *, compute: str, report: Progress
) -> HeatedBone:
    """Return a model of milled bone that also computes the temperature of the bone."""
    report("building the grid of the temperature", 0.0)
    cutter = milling.cutter
    share = 2e3 * cutter.profile.radius_m / CELLS
    spacing_mm = max(float(np.clip(share, *CELL_MM)), scene.voxels.spacing_mm)
    voxels = Voxels(spacing_mm=spacing_mm, margin_mm=scene.voxels.margin_mm)
    coarse = scene.model_copy(update={"voxels": voxels})
    around = volume_of(coarse, cutter, motion, notes={}, report=report)
    heat = CuttingHeat(
        around,
        milling,
        reach_m=reach(cutter, motion, 0.0),
        constants=scene.constants,
        name="bone",
        device=compute,
    )
    return HeatedBone(milling, heat)
