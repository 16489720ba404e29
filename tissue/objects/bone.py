"""Bone that tools can cut, made from a surface file, a block, an array or an image."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError, by, counted, enumerated, names_of_caller, require_range
from meshes.base.file_limits import memory_limit
from meshes.base.hints import suggests_arguments
from meshes.shapes.anatomy import (
    CORTICAL_KG_M3,
    TRABECULAR_KG_M3,
    Anatomy,
    cortical_block,
)
from meshes.voxels.volume import VoxelVolume, density_volume

if TYPE_CHECKING:
    import pyvista

    from meshes.images.reading import Spacing
    from tissue.cutters.cutter import Cutter
    from tissue.materials.scene_constants import Materials
    from tissue.models.bone.bricks_on_demand import BricksOnDemand
    from tissue.objects.bone_surface import Removed
    from tissue.objects.cutting import Cut, Structures

SHOWN_VOXELS = 4e6
"""Largest number of voxels for drawing the surface of a bone whose shape is a formula.

This surface shows the bone before any cut. It is computed from voxels that may be coarser than the
voxels of the bone. With 4 million voxels, a ball has about 200,000 triangles.
"""
KEY = "anatomy."
"""Prefix of keys in the notes of file readers; it is removed, because a `Bone` has no scene."""


class BoneOptions(TypedDict, total=False):
    """Options of all functions that make a bone; see `tissue.Bone.from_file`."""

    material: str
    cutting: Mapping[str, float] | None
    materials: "str | PathLike[str] | Materials | None"


@dataclass(frozen=True)
class BoneSource:
    """Data from which uncut copies of a bone are made.

    Attributes
    ----------
    voxels
        Function that returns all voxels, or a store that makes voxels only near a tool.
    outer
        Function that returns the surface before any cut [mm]; None if all voxels are made at the
        start.
    notes
        Notes on what was found in the file and what was assumed, keyed by subject.
    density_kg_m3
        Density of a bone with a single density [kg/m3]; None for other bones.
    made_from
        Shape and densities of a bone whose voxels are made only near a tool; empty for other bones.
    """

    voxels: "Callable[[], VoxelVolume | BricksOnDemand]"
    outer: "Callable[[], pyvista.PolyData] | None" = None
    notes: Mapping[str, str] = field(default_factory=dict)
    density_kg_m3: float | None = None
    made_from: tuple[object, ...] = ()


@suggests_arguments
class Bone:
    """Bone that tools can cut; coordinates are in the frame of its file or array [mm].

    `from_file`, `block`, `from_array` and `from_image` make a bone.

    Attributes
    ----------
    notes
        Notes on what was found in the file and what was assumed, keyed by subject.
    spacing_mm
        Edge of a voxel [mm].
    """

    def __init__(self, source: BoneSource, **options: Unpack[BoneOptions]) -> None:
        # Not at the top of this file: `tissue.Bone` should not wait for Warp and SciPy.
        from tissue.materials.scene_constants import Materials
        from tissue.scene.scene import Cutting
        from tissue.scene.used_constants import used_of_cutting
        from tissue.simulation.builders.arguments import given_note, require_known, stated
        from tissue.simulation.builders.cutting import VoxelBone

        require_known(options, BoneOptions, of="Bone")
        self._source = source
        self._options = options
        given = Materials.of(options.get("materials"))
        changes = options.get("cutting") or {}
        if not isinstance(changes, Mapping):
            raise InputError(
                "cutting",
                "be a dictionary of names and coefficients",
                f"an object of type {type(changes).__name__}",
                "use a dict",
            )
        table = {"material": options.get("material"), **changes}
        cutting = stated(Cutting, table, prefix="cutting.")
        self.voxel_bone = VoxelBone.stated(source.voxels(), cutting, given)
        layers = self.layer_names
        used = used_of_cutting(
            given,
            layers,
            bone=cutting.material,
            stated=changes,
            has_reference_density=all(
                source.density_kg_m3 == each.reference_density_kg_m3
                for each in self.voxel_bone.coefficients
            ),
        )
        self.notes = dict(source.notes) | given_note(given, used, layers=layers, by="bone")
        self.spacing_mm = 1e3 * self.voxel_bone.store.grid.spacing_m

    @classmethod
    def from_file(
        cls,
        file: str | PathLike[str],
        *,
        spacing_mm: float = 0.1,
        scale_mm: float | None = None,
        cortical_thickness_mm: float = 1.5,
        cortical_density_kg_m3: float = CORTICAL_KG_M3,
        trabecular_density_kg_m3: float = TRABECULAR_KG_M3,
        **options: Unpack[BoneOptions],
    ) -> "Bone":
        """Make a bone from a closed surface: a uniform cortical shell around trabecular bone.

        Parameters
        ----------
        file
            Surface (.stl .obj .ply .vtk .vtp).
        spacing_mm
            Edge of a voxel [mm], at most a quarter of the tool's diameter.
        scale_mm
            Millimetres per unit of the file. If it is not given, the unit is guessed, and `notes`
            reports the guess.
        cortical_thickness_mm
            Thickness of the shell [mm], 0 (no shell) to 10. A surface file does not contain this
            thickness.
        cortical_density_kg_m3, trabecular_density_kg_m3
            Apparent densities [kg/m3], 50 to 2500.
        options
            ``material``: name of the material whose cutting coefficients are used, ``bone`` (built
            in) or a registered material. ``cutting``: coefficients that replace those of the
            material; the keys are the names used in a scene. ``materials``: file of constants, in
            the format that `tissue fit` writes.

        Raises
        ------
        InputError
            If a file cannot be used, or a number is out of range.
        """
        from meshes.surfaces.glenoid import surface_anatomy
        from meshes.surfaces.site import Site
        from meshes.surfaces.surface import read_surface
        from tissue.scene.part import SURFACE_SUFFIXES
        from tissue.simulation.builders.arguments import require_known

        require_known(options, BoneOptions, of="Bone")
        path = Path(file)
        if path.suffix.lower() not in SURFACE_SUFFIXES:
            raise InputError(
                "file",
                f"be a surface file that ends in {enumerated(SURFACE_SUFFIXES, 'or')}",
                path.name,
                "to read an image, use Bone.from_image",
            )
        with names_of_caller({"anatomy.scale_mm": "scale_mm"}):
            surface = read_surface(path, scale_mm=scale_mm, cut_off=True)
        anatomy = surface_anatomy(
            surface,
            Site(np.zeros(3), np.eye(3), "the file's own frame"),
            cortical_thickness_mm=cortical_thickness_mm,
            cortical_density_kg_m3=cortical_density_kg_m3,
            trabecular_density_kg_m3=trabecular_density_kg_m3,
        )

        def outer() -> "pyvista.PolyData":
            """Return the surface that the file contains."""
            import pyvista

            return pyvista.PolyData.from_regular_faces(
                1e3 * surface.vertices_m, surface.faces.astype(int)
            )

        source = _anatomy_source(anatomy, spacing_mm=spacing_mm, outer=outer)
        densities = (cortical_thickness_mm, cortical_density_kg_m3, trabecular_density_kg_m3)
        made_from = (surface.vertices_m, surface.faces, *densities)
        return cls(replace(source, made_from=made_from), **options)

    @classmethod
    def block(
        cls,
        size_mm: tuple[float, float, float] = (20.0, 12.0, 8.0),
        *,
        density_kg_m3: float = CORTICAL_KG_M3,
        spacing_mm: float = 0.1,
        **options: Unpack[BoneOptions],
    ) -> "Bone":
        """Make a block of uniform density, with the origin at the middle of the block's top face.

        Parameters
        ----------
        size_mm
            Edge lengths along x, y and z [mm], each 0.1 to 500.
        density_kg_m3
            Apparent density, 100 to 2500 kg/m3. Cortical bone has 1800 kg/m3.
        spacing_mm, options
            As for `from_file`.
        """
        anatomy = cortical_block(size_mm=size_mm, density_kg_m3=density_kg_m3)
        source = _anatomy_source(anatomy, spacing_mm=spacing_mm)
        made_from = (*size_mm, density_kg_m3)
        return cls(replace(source, density_kg_m3=density_kg_m3, made_from=made_from), **options)

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
        """Make a bone from an array of densities; a density of 0 means no bone.

        Parameters
        ----------
        density_kg_m3
            Apparent density of each voxel, 0 to 20000 kg/m3, shape (nx, ny, nz). The axes are along
            x, y and z.
        spacing_mm
            Edge of a voxel [mm].
        origin_mm
            Corner of voxel (0, 0, 0) with the lowest x, y and z [mm].
        layer
            Index into `layer_names` for each voxel, shape (nx, ny, nz); default 0 everywhere.
        layer_names
            Name of each layer. The layers enamel, dentin, caries, pulp and ligament have cutting
            coefficients of their own. The other layers have the coefficients of the option
            ``material``.
        options
            As for `from_file`.

        Raises
        ------
        InputError
            If an array has a wrong shape, contains values that are not finite or out of range, or
            holds no bone.
        """
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
        density_kg_m3: float = CORTICAL_KG_M3,
        spacing_mm: "Spacing | None" = None,
        max_memory_GB: float | None = None,
        **options: Unpack[BoneOptions],
    ) -> "Bone":
        """Make a bone of uniform density from the image voxels above a grey-value threshold.

        The bone lies in the patient's frame (LPS, in millimetres).

        Parameters
        ----------
        file
            Image (.nii .nii.gz .nrrd .mhd .mha .vti), or folder with a DICOM series or with TIFF,
            PNG or BMP slices.
        threshold
            Grey value above which a voxel is bone: about 200 HU in a CT.
        density_kg_m3
            Apparent density of the bone, 50 to 20000 kg/m3.
        spacing_mm
            Edge of the bone's voxels [mm], to which the image is resampled; default the finest
            spacing of the file. For TIFF, PNG and BMP slices, which contain no spacing, give the
            spacing of the image. Three numbers, one for each axis, replace the spacing of the image
            in any format.
        max_memory_GB
            Memory that the image may take [GB]; default half of the free memory.
        options
            As for `from_file`.

        Raises
        ------
        InputError
            If the file cannot be used, no voxel lies above the threshold, or the bone would not fit
            in memory.
        """
        from meshes.images.bone_image import image_cuts, image_volume
        from meshes.images.plane_files import plane_files
        from meshes.images.reading import read_image
        from tissue.simulation.builders.arguments import require_known

        require_known(options, BoneOptions, of="Bone")
        remarks: list[str] = []
        names = {
            "anatomy.threshold": "threshold",
            "anatomy.spacing_mm": "spacing_mm",
            "resample_mm": "spacing_mm",
        }
        path = Path(file)
        edge_mm = float(spacing_mm) if isinstance(spacing_mm, int | float | np.number) else None
        is_stated = edge_mm is None or bool(plane_files(path))
        with memory_limit(max_memory_GB), names_of_caller(names):
            image = read_image(path, spacing_mm=spacing_mm if is_stated else None)
            found = image_volume(
                image,
                threshold=threshold,
                density_kg_m3=density_kg_m3,
                resample_mm=edge_mm,
                remark=remarks.append,
            )
        if cuts := image_cuts(image, threshold=threshold):
            places = counted(len(cuts), "place")
            remarks.append(f"The bone is cut off at {places} by the edge of the image.")
        assert found.placement is not None
        volume = replace(
            found, origin_m=found.origin_m + 1e-3 * found.placement.origin_mm, placement=None
        )
        notes = {"image": " ".join(remarks).replace(KEY, "")} if remarks else {}
        source = BoneSource(lambda: volume, notes=notes, density_kg_m3=density_kg_m3)
        return cls(source, **options)

    def cut(
        self,
        tool: "Cutter",
        poses: ArrayLike,
        times_s: ArrayLike,
        *,
        axis: ArrayLike | None = None,
        depth_mm: float = 0.1,
        tolerance: float = 0.01,
        keep_clear: "Structures | None" = None,
    ) -> "Cut":
        """Move a rotating tool through poses, remove bone in its path, and compute the forces.

        The removed bone stays removed in later calls. A second call with the same tool continues
        the cut if its first pose is the last pose of the first call. Between two poses the tool
        moves along a straight line. The velocity of the tool at a pose is computed from the
        difference to the previous pose. The first pose has no previous pose, so its force and
        torque are 0. Bone that lies inside the tool at the first pose is removed.

        A Python warning is issued if the feed per tooth exceeds 0.1 mm, or if a smooth part of the
        tool, such as a peg, is pushed into bone. `Cut.notes` and `Cut.events` contain the text of
        the warning too.

        Parameters
        ----------
        tool
            Cutter from `tissue.cutters`.
        poses, times_s
            Poses of the tool, and their times [s], shape (n,). The times must increase. Three forms
            of poses are accepted: tip positions [mm], shape (n, 3); tip positions and quaternions
            (x, y, z, w), shape (n, 7); or homogeneous matrices from tool frame to bone frame [mm],
            shape (n, 4, 4). The z axis of the tool runs from tip to shank.
        axis
            Direction from tip to shank if the poses are tip positions only; default z.
        depth_mm, tolerance
            `depth_mm` is a depth of cut [mm], 0.001 to 100. `tolerance` is the accepted relative
            error of the force at this depth, 0.001 to 0.1. Both determine the number of cutting
            elements on the tool's surface. Give the smallest depth of cut that matters. The voxels
            should be smaller than this depth.
        keep_clear
            Closed surfaces that the tool must not touch, keyed by name. Each surface is a file or a
            pyvista surface in the frame of the bone [mm]. The trace has a column
            ``distance_NAME_mm`` for each surface. An overlap of the tool with a surface is recorded
            as an event.

        Raises
        ------
        InputError
            If an argument cannot be used, or a tooth would remove a chip that is thicker than the
            radius of the tool.
        """
        from tissue.objects.cutting import TimedPoses, clearance_of, cut_along, poses_of, times_of
        from tissue.simulation.builders.cutting import element_spacing_m

        tips, turns = poses_of(poses, axis)
        times = times_of(times_s, len(tips))
        self.require_cutter(tool)
        depth_m = 1e-3 * require_range("depth_mm", depth_mm, 1e-3, 100.0, "use a value such as 0.1")
        share = require_range("tolerance", tolerance, 1e-3, 0.1, "use a value such as 0.01")
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
        """Raise an error if an object is not a tool that can cut this bone."""
        from tissue.cutters.cutter import Cutter

        if not isinstance(tool, Cutter):
            raise InputError(
                "tool",
                "be a cutter",
                f"an object of type {type(tool).__name__}",
                "make a cutter, for example with tissue.cutters.ball_burr",
            )
        width_mm = 2e3 * tool.profile.radius_m
        # Fewer than four voxels across a tool do not show its shape. The suggestion has twenty
        # voxels.
        if width_mm < 4.0 * self.spacing_mm:
            raise InputError(
                "tool",
                f"be at least four voxels wide, with voxels of {self.spacing_mm:g} mm",
                f"a width of {width_mm:.3g} mm",
                f"make the bone with spacing_mm={width_mm / 20:.2g}",
            )

    def uncut(self) -> "Bone":
        """Return a new bone without cuts, made from the source of this bone."""
        return Bone(self._source, **self._options)

    @property
    def layer_names(self) -> tuple[str, ...]:
        """Names of the layers."""
        return self.voxel_bone.store.grid.layer_names

    @property
    def bounds_mm(self) -> Array:
        """Lowest and highest corner of a box around the bone [mm], shape (2, 3)."""
        return 1e3 * self.voxel_bone.bounds_m

    @property
    def removed(self) -> "Removed":
        """Bone that tools have removed so far."""
        from tissue.objects.bone_surface import Removed

        return Removed(self.voxel_bone)

    def surface(self) -> "pyvista.PolyData":
        """Return the current surface of the bone [mm], with the cell array ``layer``."""
        from tissue.objects.bone_surface import bone_surface

        outer = self._source.outer
        return bone_surface(self.voxel_bone, outer() if outer is not None else None)

    def plot(self, **options: Any) -> Any:
        """Show the current bone, coloured by layer; `options` are passed to
        ``pyvista.PolyData.plot``.
        """
        from tissue.objects.bone_surface import plot_surface

        return plot_surface(self.surface(), self.layer_names, **options)

    def __repr__(self) -> str:
        size = by(np.ptp(self.bounds_mm, axis=0), ".4g")
        cut = self.removed.volume_mm3
        return (
            f"Bone({size} mm, {', '.join(self.layer_names)}, voxels of {self.spacing_mm:g} mm"
            f"{f', {cut:.4g} mm3 removed' if cut else ''})"
        )


def constants_of(bone: Bone) -> tuple[object, ...]:
    """Return the constant data of a bone, which must match when a snapshot is restored.

    The data are the cutting coefficients, the voxel grid, the shape, and the material and initial
    filled fraction of each voxel. If voxels are made only near a tool, the shape determines these
    voxels, and the two arrays are None.
    """
    made = bone.voxel_bone
    store = made.store
    if made.on_demand:
        return made.coefficients, store.grid, bone._source.made_from, None, None
    material = store.material.numpy()[: len(store.places)]
    assert store.volume is not None
    fraction = store.volume.fraction
    return made.coefficients, store.grid, bone._source.made_from, material, fraction


def _anatomy_source(
    anatomy: Anatomy, *, spacing_mm: float, outer: "Callable[[], pyvista.PolyData] | None" = None
) -> BoneSource:
    """Return the source of a bone from an anatomy; its voxels are made only near a tool.

    The frame is the frame of the anatomy. `outer` is an argument of `BoneSource`.
    """
    from tissue.models.bone.bricks_on_demand import BricksOnDemand

    spacing_m = 1e-3 * require_range("spacing_mm", spacing_mm, 1e-3, 5.0, "use about 0.1")

    def drawn() -> "pyvista.PolyData":
        """Return the surface, computed with coarse voxels."""
        from meshes.voxels.voxelise import voxelise
        from tissue.simulation.bone_surface import bone_surface

        sides = np.subtract(anatomy.shape.upper_m, anatomy.shape.lower_m)
        coarse_m = max(spacing_m, float(np.prod(sides) / SHOWN_VOXELS) ** (1.0 / 3.0))
        volume = voxelise(anatomy, spacing_m=coarse_m)
        return bone_surface(volume, volume.fraction)

    # A bone stays in the frame of its file. It has no site, and needs no note on a site.
    notes = {name: note.replace(KEY, "") for name, note in anatomy.notes.items() if name != "site"}
    return BoneSource(lambda: BricksOnDemand(anatomy, spacing_m=spacing_m), outer or drawn, notes)
