"""Bone object: made from a file, a block, an array or an image, cut by tools, and shown."""

from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.errors import require_range
from meshes.base.file_limits import memory_limit
from meshes.shapes.anatomy import cortical_block
from meshes.voxels.volume import VoxelVolume, density_volume
from tissue.cutters.cutter import Cutter
from tissue.objects.bone_materials import BoneOptions, cut_as, require_known
from tissue.objects.bone_source import BoneSource, anatomy_source, image_source, surface_source
from tissue.objects.bone_surface import Removed
from tissue.objects.cut import Cut
from tissue.objects.cutting import TimedPoses, cut_along, require_cutter
from tissue.objects.kept_clear import Structures, clearance_of
from tissue.objects.poses import poses_of, times_of
from tissue.simulation.builders.bone import VoxelBone, element_spacing_m

if TYPE_CHECKING:
    import pyvista

__all__ = ["Bone"]


class Bone:
    """Bone in the frame of its file or array [mm].

    `from_file`, `block`, `from_array` and `from_image` make one.

    Attributes
    ----------
    notes
        Notes on findings and assumptions about a file, by subject.
    spacing_mm
        Edge of a voxel [mm].
    """

    def __init__(self, source: BoneSource, **options: Unpack[BoneOptions]) -> None:
        require_known(options, maker="Bone")
        self._source = source
        self._options = options
        made = source.voxels()
        names = made.layer_names if isinstance(made, VoxelVolume) else made.store.grid.layer_names
        coefficients, note = cut_as(options, names, source.density_kg_m3)
        self.voxel_bone = VoxelBone(made, coefficients)
        self.notes = dict(source.notes) | note
        self.spacing_mm = 1e3 * self.voxel_bone.store.grid.spacing_m

    @classmethod
    def from_file(
        cls,
        file: str | PathLike[str],
        *,
        spacing_mm: float = 0.1,
        scale_mm: float | None = None,
        cortical_thickness_mm: float = 1.5,
        cortical_density_kg_m3: float = 1800.0,
        trabecular_density_kg_m3: float = 350.0,
        **options: Unpack[BoneOptions],
    ) -> "Bone":
        """Make bone in a closed surface: a cortical shell of even thickness over trabecular bone.

        Parameters
        ----------
        file
            Surface (.stl .obj .ply .vtk .vtp).
        spacing_mm
            Edge of a voxel [mm], at most a quarter of the tool's diameter.
        scale_mm
            Millimetres per unit of the file; without it the unit is guessed and noted.
        cortical_thickness_mm
            Thickness of the shell [mm], 0 (none) to 10; a surface does not contain it.
        cortical_density_kg_m3, trabecular_density_kg_m3
            Apparent densities [kg/m3], 50 to 2500.
        options
            ``material``: name of the cited cutting coefficients, bone or a registered one;
            ``cutting``: coefficients in place of these, by their names in a scene; ``materials``:
            file of constants, as `tissue fit` writes it.

        Raises
        ------
        InputError
            If a file cannot be used, or a number is out of range.
        """
        require_known(options, maker="Bone.from_file")
        source = surface_source(
            Path(file),
            spacing_mm=spacing_mm,
            scale_mm=scale_mm,
            cortical_thickness_mm=cortical_thickness_mm,
            cortical_density_kg_m3=cortical_density_kg_m3,
            trabecular_density_kg_m3=trabecular_density_kg_m3,
        )
        return cls(source, **options)

    @classmethod
    def block(
        cls,
        size_mm: tuple[float, float, float] = (20.0, 12.0, 8.0),
        *,
        density_kg_m3: float = 1800.0,
        spacing_mm: float = 0.1,
        **options: Unpack[BoneOptions],
    ) -> "Bone":
        """Make a block of one density, its top face at z = 0 with the origin at its middle.

        Parameters
        ----------
        size_mm
            Edge lengths along x, y and z [mm], each 0.1 to 500.
        density_kg_m3
            Apparent density, 100 to 2500 kg/m3; 1800 is cortical bone.
        spacing_mm, options
            As for `from_file`.
        """
        require_known(options, maker="Bone.block")
        anatomy = cortical_block(size_mm=size_mm, density_kg_m3=density_kg_m3)
        source = anatomy_source(anatomy, spacing_mm=spacing_mm)
        return cls(replace(source, density_kg_m3=density_kg_m3), **options)

    @classmethod
    def from_array(
        cls,
        density_kg_m3: ArrayLike,
        *,
        spacing_mm: float,
        origin_mm: ArrayLike = (0.0, 0.0, 0.0),
        layer: ArrayLike | None = None,
        layer_names: tuple[str, ...] = ("bone",),
        **options: Unpack[BoneOptions],
    ) -> "Bone":
        """Make bone from an array of densities, with 0 where there is no bone.

        Parameters
        ----------
        density_kg_m3
            Apparent density of each voxel [kg/m3], shape (nx, ny, nz), axes along x, y and z, 0 to
            20000.
        spacing_mm
            Edge of a voxel [mm].
        origin_mm
            Corner of the first voxel with the lowest coordinates [mm].
        layer
            Number of each voxel's layer, same shape; default all 0.
        layer_names
            Name of each layer; enamel, dentin, caries, pulp and ligament are cut with their own
            coefficients, other layers with the coefficients of `material`.
        options
            As for `from_file`.

        Raises
        ------
        InputError
            If an array has another shape, is not finite or out of range, or holds no bone.
        """
        require_known(options, maker="Bone.from_array")
        volume = density_volume(
            density_kg_m3,
            spacing_mm=spacing_mm,
            origin_mm=origin_mm,
            layer=layer,
            layer_names=layer_names,
            margin=1,
        )
        return cls(BoneSource(lambda: volume), **options)

    @classmethod
    def from_image(
        cls,
        file: str | PathLike[str],
        *,
        threshold: float,
        density_kg_m3: float = 1800.0,
        spacing_mm: float | None = None,
        max_memory_GB: float | None = None,
        **options: Unpack[BoneOptions],
    ) -> "Bone":
        """Make bone of one density from an image volume, where its grey value exceeds a threshold.

        The frame is the patient's frame (LPS, mm).

        Parameters
        ----------
        file
            Image (.nii .nii.gz .nrrd .mhd .mha .vti), or folder with a DICOM series or TIFF slices.
        threshold
            Grey value above which a voxel is bone: about 200 HU of a CT.
        density_kg_m3
            Apparent density of the bone, 50 to 20000 kg/m3.
        spacing_mm
            Edge of a voxel [mm] to resample to; default the finest spacing of the file. For TIFF
            slices it is the spacing of their voxels.
        max_memory_GB
            Memory that the image may take [GB]; default half of the free memory.
        options
            As for `from_file`.

        Raises
        ------
        InputError
            If the file cannot be used, nothing lies above the threshold, or the bone would not fit
            in memory.
        """
        require_known(options, maker="Bone.from_image")
        with memory_limit(max_memory_GB):
            source = image_source(
                Path(file), threshold=threshold, density_kg_m3=density_kg_m3, spacing_mm=spacing_mm
            )
        return cls(source, **options)

    def cut(
        self,
        tool: Cutter,
        poses: ArrayLike,
        times_s: ArrayLike,
        *,
        axis: ArrayLike | None = None,
        depth_mm: float = 0.1,
        tolerance: float = 0.01,
        keep_clear: Structures | None = None,
    ) -> Cut:
        """Move a turning tool through poses; remove the swept bone and compute the forces.

        The bone keeps the cut. The same tool continues the cut if it begins where it ended. Between
        poses the tool moves straight. Its velocity at a pose is the difference to the pose before,
        so force and torque at the first pose are 0; bone inside the tool at that pose is removed.

        A warning is issued if the feed per tooth exceeds 0.1 mm, or if a smooth part of the tool,
        such as a peg, is pushed into bone. The warning is also in `Cut.notes` and `Cut.events`.

        Parameters
        ----------
        tool
            Cutter of `tissue.cutters`.
        poses, times_s
            Tips [mm], shape (n, 3); tips and quaternions (x, y, z, w), shape (n, 7); or matrices
            from the tool's frame to the bone's [mm], shape (n, 4, 4), with z from tip to shank; and
            increasing times [s], shape (n,).
        axis
            Direction from tip to shank if the poses are tips only; default z.
        depth_mm, tolerance
            Smallest depth of cut that matters [mm], 0.001 to 100, and the relative error of its
            force, 0.001 to 0.1. They set the number of elements of the tool's surface. Voxels
            should be finer than the depth.
        keep_clear
            Closed surfaces that the tool must not touch, by name: files or pyvista surfaces in the
            frame of the bone [mm]. The trace has ``distance_NAME_mm`` of each, and a breach is an
            event.

        Raises
        ------
        InputError
            If an argument cannot be used, or a tooth would take a chip thicker than the tool's
            radius.
        """
        tips, turns = poses_of(poses, axis)
        times = times_of(times_s, len(tips))
        self.require_cutter(tool)
        depth_m = 1e-3 * require_range("depth_mm", depth_mm, 1e-3, 100.0, "use 0.1")
        share = require_range("tolerance", tolerance, 1e-3, 0.1, "use 0.01")
        reach_m = np.linalg.norm([tool.profile.radius_m, *tool.profile.height_range_m])
        box_m = np.array([tips.min(axis=0) - reach_m, tips.max(axis=0) + reach_m])
        return cut_along(
            self.voxel_bone,
            tool,
            TimedPoses(times, tips, turns),
            shell_spacing_m=element_spacing_m(tool, depth_m=depth_m, tolerance=share),
            keep_clear=clearance_of(keep_clear, tool, box_m=box_m, times_s=times),
        )

    def require_cutter(self, tool: object) -> None:
        """Refuse an object that cannot cut this bone."""
        require_cutter(tool, spacing_mm=self.spacing_mm)

    def uncut(self) -> "Bone":
        """Return the bone before any cut."""
        return Bone(self._source, **self._options)

    @property
    def layer_names(self) -> tuple[str, ...]:
        """Names of the layers."""
        return self.voxel_bone.store.grid.layer_names

    @property
    def bounds_mm(self) -> NDArray[np.float64]:
        """Lowest and highest corner of a box around the bone [mm], shape (2, 3)."""
        return 1e3 * self.voxel_bone.bounds_m

    @property
    def removed(self) -> "Removed":
        """Bone that tools have removed so far."""
        return Removed(self.voxel_bone)

    def surface(self) -> "pyvista.PolyData":
        """Return the bone's present surface [mm], with the cell array ``layer``."""
        from tissue.objects.bone_surface import bone_surface

        outer = self._source.outer
        return bone_surface(self.voxel_bone, outer() if outer is not None else None)

    def plot(self, **options: Any) -> Any:
        """Show the present bone by layer; `options` are options of ``pyvista.PolyData.plot``."""
        from tissue.objects.bone_surface import plot_surface

        return plot_surface(self.surface(), self.layer_names, **options)

    def __repr__(self) -> str:
        size = " x ".join(f"{side:.4g}" for side in np.ptp(self.bounds_mm, axis=0))
        cut = self.removed.volume_mm3
        return (
            f"Bone({size} mm, {', '.join(self.layer_names)}, voxels of {self.spacing_mm:g} mm"
            f"{f', {cut:.4g} mm3 removed' if cut else ''})"
        )
