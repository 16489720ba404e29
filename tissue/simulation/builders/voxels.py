"""Voxels that a tool can reach in a scene's bone, which is procedural or read from files."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.cache import RecentResults
from meshes.base.errors import InputError, in_brackets, is_file, names_of_caller
from meshes.base.grid import BLOCK
from meshes.base.progress import Progress
from meshes.shapes import sdf
from meshes.shapes.anatomy import CORTICAL_KG_M3, Anatomy, cortical_block
from meshes.surfaces.glenoid import glenoid
from meshes.tooth import label_volume
from meshes.tooth.layered_surfaces import layered_surfaces
from meshes.tooth.layers import TOOTH_LAYERS
from meshes.tooth.molar import molar
from meshes.vertebra.lumbar import lumbar_vertebra
from meshes.voxels.volume import VoxelVolume
from meshes.voxels.voxelise import AROUND_VOXELS, voxelise
from tissue.cutters.cutter import Cutter
from tissue.motion.motion import Motion
from tissue.scene.anatomy import (
    BlockAnatomy,
    BlockImage,
    Bone,
    CutAnatomy,
    Glenoid,
    GlenoidAnatomy,
    ImageAnatomy,
    MolarAnatomy,
    MolarLabels,
    MolarSurfaces,
    Placed,
    SurfaceAnatomy,
    Tooth,
    VertebraAnatomy,
)
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import (
    FILE_WORDS,
    Corners,
    box_text,
    reach_of_tool,
    require_whole,
)

if TYPE_CHECKING:
    from meshes.surfaces.site import Site
    from meshes.surfaces.surface import Surface

DENSE_BYTES_PER_VOXEL = 18
"""Peak memory per voxel of the simulated region [bytes], measured in the scene `glenoid`.

The peak occurs while bricks (blocks of voxels) are made and results are written.
"""
MOST_KEPT = 1e7
"""Largest number of voxels of a volume that stays in memory for the next run (60 MB)."""
_volumes: RecentResults[VoxelVolume] = RecentResults(2)
"""Cached volumes of procedural bone, keyed by parameters, region and guide hole."""
NO_SHAPE = {"kind", "guide_hole_diameter_mm", "guide_hole_depth_mm"}
"""Keys of an anatomy that do not change the shape of the bone."""


def volume_of(
    scene: Scene, cutter: Cutter, motion: Motion, *, notes: dict[str, str], report: Progress
) -> VoxelVolume:
    """Return the voxels of bone that the tool can reach; the guide hole is already removed."""
    spacing = scene.voxels.spacing_mm * 1e-3
    parameters = scene.bone
    hole = _guide_hole(scene, motion)
    region = requested_region(scene, cutter, motion)
    with names_of_anatomy(parameters):
        if isinstance(parameters, BlockImage) and parameters.is_whole:
            return whole_image(parameters, spacing_mm=scene.voxels.spacing_mm, notes=notes)
        if isinstance(parameters, MolarLabels):
            return labelled_tooth(
                parameters, spacing_m=spacing, region=region, notes=notes, report=report
            )
        anatomy = anatomy_of(parameters, notes)
    if anatomy.caps_m:
        require_whole(anatomy, region, is_image=isinstance(parameters, ImageAnatomy))
    bone = np.array(anatomy.shape.lower_m), np.array(anatomy.shape.upper_m)
    low = np.maximum(region[0], bone[0])
    high = np.minimum(region[1], bone[1])
    if (low >= high).any():
        remedy = f"move the tool to the bone, which lies {box_text(bone)}"
        if anatomy.placement is not None:
            remedy += (
                ". If the motion is in the frame of the anatomy files, transform it by "
                "placement.file_to_scene_mm, a matrix in summary.json of a run with another motion"
            )
        raise InputError(
            "motion",
            "bring the tool to the bone",
            f"a motion that, with the tool and a margin, stays {box_text(region)}",
            remedy,
        )
    low, high = _covered(region, bone, spacing)
    _require_memory(region, bone, spacing)
    voxels = partial(
        voxelise,
        anatomy,
        spacing_m=spacing,
        region_m=(low, high),
        minus=hole,
        progress=lambda share: report("voxelising", share),
    )
    if not is_procedural(parameters) or np.prod((high - low) / spacing) > MOST_KEPT:
        return voxels()
    start = motion.sweep_m()[0].tobytes(), motion.rotations()[0].tobytes()
    return _volumes.of(
        (parameters.model_dump_json(), spacing, low.tobytes(), high.tobytes(), *start), voxels
    )


def requested_region(scene: Scene, cutter: Cutter, motion: Motion) -> Corners:
    """Return the region for which voxels of bone are requested: lowest and highest corner [m]."""
    # A hand can press the peg against the hole, so the region contains all of the peg.
    hole = _guide_hole(scene, motion) if scene.device is None else None
    return reach_of_tool(cutter, motion, 1e-3 * scene.voxels.margin_mm, guide_hole=hole)


def is_procedural(parameters: CutAnatomy) -> bool:
    """Return True if an anatomy is a function of position and is not read from a file."""
    return type(parameters) in PROCEDURAL


def structures(parameters: CutAnatomy) -> Mapping[str, sdf.Shape]:
    """Return the structures that a scene can protect from the tool, keyed by name.

    The structures are functions of position. Only procedural anatomies have such structures.
    """
    return anatomy_of(parameters, {}).structures if is_procedural(parameters) else {}


def solid_of(scene: Scene, motion: Motion) -> tuple[Anatomy, sdf.Shape | None]:
    """Return the bone of a scene and its guide hole as functions of position.

    The guide hole is drilled before the run.

    Raises
    ------
    InputError
        If the anatomy comes from a file, for which no function of position is known.
    """
    parameters = scene.bone
    if not is_procedural(parameters):
        raise InputError(
            "anatomy",
            "be procedural, because a shape from a file is not known exactly",
            f"a {scene.anatomy.kind} from a file",
            "remove the file names from [anatomy]",
        )
    return anatomy_of(parameters, {}), _guide_hole(scene, motion)


PROCEDURAL: dict[type[CutAnatomy], Callable[..., Anatomy]] = {
    MolarAnatomy: molar,
    GlenoidAnatomy: glenoid,
    VertebraAnatomy: lumbar_vertebra,
    BlockAnatomy: cortical_block,
}
"""Functions that make a procedural anatomy from its scene table."""


def anatomy_of(parameters: CutAnatomy, notes: dict[str, str]) -> Anatomy:
    """Return the procedural bone, or the bone read from a file, in the frame of the scene."""
    if isinstance(parameters, MolarSurfaces):
        anatomy = layered_surfaces(
            parameters.layer_files,
            scale_mm=parameters.scale_mm,
            socket_mm=parameters.socket_mm,
            at_lesion=parameters.site == "caries",
        )
    elif isinstance(parameters, Placed):
        anatomy = bone_from_file(parameters, notes)
    else:
        anatomy = PROCEDURAL[type(parameters)](**parameters.model_dump(exclude=NO_SHAPE))
    notes.update(anatomy.notes)
    return anatomy


def names_of_anatomy(parameters: CutAnatomy) -> AbstractContextManager[None]:
    """Return a context in which error messages of geometry functions contain keys of the scene.

    Without this context, these messages contain the names of the functions' arguments.
    """
    keys = {name: f"anatomy.{name}" for name in type(parameters).model_fields}
    names = dict.fromkeys(FILE_WORDS, "anatomy.file") | keys
    layers = parameters.layer_files if isinstance(parameters, Tooth) else {}
    if layers:
        names |= {
            f"{layer} {word}": f"anatomy.{layer}_file" for layer in layers for word in FILE_WORDS
        }
        both = "anatomy.enamel_file and anatomy.dentin_file"
        names |= {"paths_by_layer": both, "layers": both, "pulp": "anatomy.pulp_file"}
    return names_of_caller(names | {"resample_mm": "voxels.spacing_mm"})


def _guide_hole(scene: Scene, motion: Motion) -> sdf.Shape | None:
    """Return the hole that guides the peg of a tool; None if the scene has no hole.

    The axis of the hole is the tool's axis at the start. The hole extends from above the surface of
    the bone to the depth that the scene gives.
    """
    diameter, depth = (1e-3 * size for size in scene.bone.guide_hole_mm)
    if diameter == 0.0 or depth == 0.0:
        return None
    axis = motion.rotations()[0][:, 2]
    tip = motion.sweep_m()[0]
    on_face = tip - axis * float(tip @ axis)
    # The hole starts 50 mm above the face, so it is open for any surface.
    return sdf.cylinder(0.5 * diameter, tuple(on_face - depth * axis), tuple(on_face + 0.05 * axis))


def _covered(region: Corners, bone: Corners, spacing: float) -> Corners:
    """Return a box of whole bricks (blocks of voxels) around the bone within a region [m].

    The box includes some air next to the bone. The bricks belong to a fixed lattice, so a voxel has
    the same position in every region. Where a tool only grazes voxels, results in a few ticks can
    still depend on the region, because float32 coordinates are relative to the origin of the
    region.
    """
    brick = BLOCK * spacing
    around = AROUND_VOXELS * spacing
    low = np.maximum(region[0], bone[0] - around)
    high = np.minimum(region[1], bone[1] + around)
    # 1e-6 prevents that rounding enlarges a box of whole bricks.
    return brick * np.floor(low / brick + 1e-6), brick * np.ceil(high / brick - 1e-6)


def _require_memory(region: Corners, bone: Corners, spacing: float) -> None:
    """Raise an error if a grid of voxels does not fit in the free memory."""
    import psutil

    def needed(size: float) -> float:
        low, high = _covered(region, bone, size)
        return float(np.prod(high - low)) / size**3 * DENSE_BYTES_PER_VOXEL

    free = psutil.virtual_memory().available
    # A tenth of the memory is left for the rest of the run. The suggested spacing leaves a fifth.
    if needed(spacing) > 0.9 * free:
        fits = np.ceil(spacing * 1e5) / 1e5
        while needed(fits) > 0.8 * free:
            fits += 1e-5
        raise InputError(
            "voxels.spacing_mm",
            f"fit the bone into the free memory of {free / 1e9:.1f} GB",
            f"{spacing * 1e3:g}, which needs {needed(spacing) / 1e9:.1f} GB",
            f"use a spacing such as {round(fits * 1e3, 2):g}",
        )


def bone_from_file(parameters: Placed, notes: dict[str, str]) -> Anatomy:
    """Return the bone of a surface file or image file, in the frame of the scene."""
    from meshes.images.bone_image import image_cuts, image_triangles
    from meshes.images.reading import read_image
    from meshes.surfaces.glenoid import surface_anatomy
    from meshes.surfaces.surface import read_surface, surface_from_triangles

    if isinstance(parameters, ImageAnatomy):
        threshold = _threshold(parameters)
        image = read_image(parameters.file, spacing_mm=parameters.spacing_mm)
        triangles = image_triangles(image, threshold=threshold)
        surface = surface_from_triangles(
            *triangles, source=image.source, scale_mm=1.0, cut_off=True
        )
        cuts = image_cuts(image, threshold=threshold)
        surface = replace(surface, caps_m=surface.caps_m + cuts)
        remarks = list(image.notes)
        if cuts:
            places = f"{len(cuts)} places" if len(cuts) > 1 else "one place"
            remarks.append(f"The bone is cut off at {places} by the edge of the image.")
        if remarks:
            notes["image"] = " ".join(remarks)
    else:
        assert isinstance(parameters, SurfaceAnatomy)
        surface = read_surface(parameters.file, scale_mm=parameters.scale_mm, cut_off=True)
    site = _site(parameters, surface)
    if isinstance(parameters, Bone) and (parameters.density_file or parameters.core_file):
        return _filled(parameters, surface, site)
    return surface_anatomy(
        surface,
        site,
        cortical_thickness_mm=parameters.cortical_thickness_mm,
        # Anatomies without the key have cortical bone at the surface.
        cortical_density_kg_m3=getattr(parameters, "density_kg_m3", CORTICAL_KG_M3),
    )


def _filled(parameters: Bone, surface: "Surface", site: "Site") -> Anatomy:
    """Return a bone whose interior is defined by CT densities or by the surface of its core."""
    from meshes.ct.bone_inside import cored_anatomy, imaged_anatomy, stated_law
    from meshes.images.reading import read_image
    from meshes.surfaces.surface import read_surface

    if parameters.density_file is None:
        with names_of_caller(dict.fromkeys(FILE_WORDS, "anatomy.core_file")):
            core = read_surface(
                parameters.core_file or "", scale_mm=surface.report.scale_mm, cut_off=True
            )
        return cored_anatomy(surface, core, site)
    with names_of_caller(dict.fromkeys(FILE_WORDS, "anatomy.density_file")):
        density = read_image(parameters.density_file)
    anatomy = imaged_anatomy(
        surface,
        site,
        density,
        cortical_above_kg_m3=parameters.cortical_above_kg_m3,
        articular_radius_mm=parameters.articular_radius_mm,
    )
    law = stated_law(Path(parameters.density_file))
    return replace(anatomy, notes={**anatomy.notes, "density law": law}) if law else anatomy


def whole_image(parameters: BlockImage, *, spacing_mm: float, notes: dict[str, str]) -> VoxelVolume:
    """Return the bone of a whole image, without a site at the origin.

    The top of the bone is at z = 0.
    """
    from meshes.images.bone_image import image_volume
    from meshes.images.reading import read_image

    remarks: list[str] = []
    threshold = _threshold(parameters)
    volume = image_volume(
        read_image(parameters.file, spacing_mm=parameters.spacing_mm),
        threshold=threshold,
        density_kg_m3=parameters.density_kg_m3,
        resample_mm=spacing_mm,
        remark=remarks.append,
    )
    notes["image"] = " ".join(remarks) or f"{parameters.file}: {volume.shape} voxels"
    return volume


def labelled_tooth(
    parameters: MolarLabels,
    *,
    spacing_m: float,
    region: Corners | None = None,
    notes: dict[str, str],
    report: Progress,
) -> VoxelVolume:
    """Read a tooth from a label volume.

    If `region` is given, only the part within this box [m], in the frame of the scene, is read.
    """
    remarks: list[str] = []
    file = Path(parameters.file)
    stamp = file.stat() if is_file(file) else None
    report("reading the label volume", 0.0)
    over_lesion = parameters.site == "caries"
    tooth = _read_tooth(
        file, parameters.spacing_mm, over_lesion, stamp and (stamp.st_mtime_ns, stamp.st_size)
    )
    volume = tooth.volume(
        resample_mm=1e3 * spacing_m,
        region_m=region,
        remark=remarks.append,
        progress=lambda share: report("voxelising the tooth", share),
    )
    notes["labels"] = " ".join(remarks)
    if (found := _lesion(tooth)) is not None:
        notes["lesion"] = found
    return volume


def _site(parameters: Placed, surface: "Surface") -> "Site":
    """Return the site on a bone surface: the place where the tool works, and its axes.

    The scene gives the position and the normal of the site. For a glenoid without a given normal,
    the function searches for the glenoid on the surface.
    """
    from meshes.surfaces.landmarks import find_glenoid
    from meshes.surfaces.site import place_site

    centre = parameters.centre_mm
    normal = parameters.normal
    along = parameters.along
    if isinstance(parameters, Glenoid) and normal is None:
        return find_glenoid(surface, centre_mm=centre, along=along)
    if centre is None:
        box = surface.vertices_m.min(axis=0), surface.vertices_m.max(axis=0)
        raise InputError(
            "anatomy.centre_mm",
            f"be given for {parameters.file}",
            "none",
            (
                "set anatomy.normal, and set anatomy.centre_mm to a point on the surface of the "
                f"bone, which lies {box_text(box)}; or use anatomy.kind = glenoid"
            ),
        )
    return place_site(surface, centre_mm=centre, normal=normal, along=along)


def _threshold(parameters: ImageAnatomy) -> float:
    """Return the grey value of an image above which a voxel is bone."""
    from meshes.images.reading import require_image_name

    if parameters.threshold is None:
        require_image_name(Path(parameters.file))
        raise InputError(
            "anatomy.threshold",
            f"be given for the image {parameters.file}",
            "nothing",
            "set the grey value above which a voxel is bone",
        )
    return parameters.threshold


@lru_cache(maxsize=1)
def _read_tooth(
    file: Path, spacing_mm: float | None, over_lesion: bool, stamp: tuple[int, int] | None
) -> label_volume.LabelledTooth:
    """Read the tooth of a label volume, and keep the result for the next call.

    The tool and the stress model need the same tooth.
    """
    from meshes.ct.labels import header_names
    from meshes.images.reading import read_image

    image = read_image(file, spacing_mm=spacing_mm, labels=True)
    named = header_names(file)
    known = named if set(named.values()) & set(TOOTH_LAYERS) else label_volume.CARIES_LABELS
    tooth = label_volume.labelled_tooth(image, labels=known)
    return tooth.at_lesion() if over_lesion else tooth


def _lesion(tooth: label_volume.LabelledTooth) -> str | None:
    """Return a text with the extent of the caries of a whole tooth, in the frame of the scene.

    The text helps to place a motion at the caries. The result is None for a tooth without caries.
    """
    placed = tooth.placed
    at = np.argwhere(placed.layer == TOOTH_LAYERS.index("caries"))
    if len(at) == 0:
        return None
    points = 1e3 * ((at * placed.spacing - placed.origin) @ placed.rotation)
    low, high = (in_brackets(corner, ".3g") for corner in (points.min(axis=0), points.max(axis=0)))
    return f"caries between {low} and {high} mm of the site"
