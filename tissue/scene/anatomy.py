"""Anatomies that a tool cuts, as tables of a scene: bone and teeth, procedural or from files.

A scene contains one of these classes as its table ``anatomy``. Each class has only the keys that
its shape needs.
"""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, Strict

from tissue.scene.part import LAYERS, FileName, Idle, Length_mm, Needs, Part, Vector

__all__ = [
    "BlockAnatomy",
    "BlockImage",
    "BlockSurface",
    "BoneImage",
    "BoneSurface",
    "CutAnatomy",
    "GlenoidAnatomy",
    "GlenoidImage",
    "GlenoidSurface",
    "ImageAnatomy",
    "MolarAnatomy",
    "MolarLabels",
    "MolarSurfaces",
    "Part",
    "SurfaceAnatomy",
    "Tooth",
    "VertebraAnatomy",
    "WallAnatomy",
]


class CutAnatomy(Part):
    """Table ``anatomy`` of a scene, for a bone or tooth that a tool cuts."""

    kind: str

    source: ClassVar[str] = "procedural"
    """Origin of the shape, as error messages name it."""
    reads: ClassVar[tuple[str, ...]] = ("voxels", "cutting", "keep_clear", "heat")
    """Other tables of a scene that have an effect with this anatomy."""

    @property
    def from_file(self) -> str | None:
        """File that contains the whole shape, or None.

        It is None for a shape defined by formulas, and for a tooth with one file per layer.
        """
        file: str | None = getattr(self, "file", None)
        return file

    @property
    def structure_files(self) -> dict[str, str]:
        """Surface files of the structures that `keep_clear.names` may contain, keyed by
        structure.
        """
        return {}

    @property
    def guide_hole_mm(self) -> tuple[float, float]:
        """Diameter and depth of the guide hole [mm]; zeros without a guide hole."""
        return getattr(self, "guide_hole_diameter_mm", 0.0), getattr(
            self, "guide_hole_depth_mm", 0.0
        )


class Drilled(CutAnatomy):
    """Bone or tooth in which the scene may have a guide hole before the run."""

    guide_hole_diameter_mm: Annotated[float, Needs("anatomy.guide_hole_depth_mm")] = Field(
        0.0, ge=0, le=50
    )
    """Diameter of the guide hole that the bone has before the run, along the tool's axis. With 0
    there is no hole.
    """
    guide_hole_depth_mm: Annotated[float, Needs("anatomy.guide_hole_diameter_mm")] = Field(
        0.0, ge=0, le=100
    )
    """Depth of the guide hole below the surface at which the tool starts, along the tool's axis."""


class Placed(Drilled):
    """Bone from a file, placed so that the site where the tool works is at the origin."""

    file: FileName = Field(examples=["scapula.stl"])
    """Surface file (.stl .obj .ply .vtk .vtp), image volume, or folder of TIFF or PNG slices."""
    centre_mm: Vector | None = Field(None, examples=[(0.0, 0.0, 0.0)])
    """Centre of the site where the tool works, in the file's frame. The centre becomes the origin.
    Without this key, the program searches for the articular surface of a glenoid.
    """
    normal: Annotated[Vector | None, Needs("anatomy.centre_mm")] = Field(
        None, examples=[(0.0, 0.0, 1.0)]
    )
    """Outward normal of the bone's surface at the site, in the file's frame. The normal becomes the
    z axis.
    """
    along: Vector | None = Field(None, examples=[(1.0, 0.0, 0.0)])
    """Direction in the file's frame; its component perpendicular to `normal` becomes the x axis."""
    cortical_thickness_mm: float = Field(1.5, gt=0, le=10)
    """Thickness of the cortical bone below the surface of the bone."""


class SurfaceAnatomy(Placed):
    """Bone from a surface file."""

    source: ClassVar[str] = "from a surface"
    scale_mm: float | None = Field(None, gt=0, le=1e5, examples=[1.0])
    """Millimetres per length unit of the file. Without this key, the unit is guessed, and a note of
    the run reports the guess.
    """


class Image(Part):
    """Image volume in which the voxels above a threshold are bone."""

    spacing_mm: float | None = Field(None, gt=0, le=10, examples=[0.0195])
    """Edge of a voxel of the image, for files without this information, such as TIFF or PNG slices.
    """
    threshold: float | None = Field(None, ge=-1e9, le=1e9, examples=[200.0])
    """Image value above which a voxel is bone."""


class ImageAnatomy(Placed, Image):
    """Bone from an image volume."""

    source: ClassVar[str] = "from an image"


class Glenoid(Part):
    """Glenoid (articular surface of the scapula)."""

    kind: Literal["glenoid"] = "glenoid"
    """A glenoid."""


class GlenoidAnatomy(Glenoid, Drilled):
    """A glenoid: a concave articular surface, a subchondral plate and trabecular bone below it.

    The origin is at the centre of the articular surface; +z points outward.
    """

    width_mm: float = Field(27.8, ge=20, le=34)
    """Largest width of the articular surface, anterior to posterior."""
    height_mm: float = Field(37.5, ge=28, le=45)
    """Height of the articular surface, inferior to superior. It must be at least 1.1 times
    `width_mm`.
    """
    curvature_radius_mm: float = Field(35.0, ge=22, le=80)
    """Radius of curvature of the concave articular surface. It must be more than half of
    `height_mm`.
    """
    subchondral_thickness_mm: float = Field(1.9, ge=1.2, le=2.9)
    """Mean thickness of the subchondral plate."""
    subchondral_density_kg_m3: float = Field(1300.0, ge=200, le=2200)
    """Apparent density of the subchondral plate."""
    trabecular_density_below_plate_kg_m3: float = Field(450.0, ge=50, le=1200)
    """Apparent density of the trabecular bone next to the subchondral plate. Within 5 mm below the
    plate, the density changes to `trabecular_density_kg_m3`.
    """
    trabecular_density_kg_m3: float = Field(300.0, ge=50, le=1200)
    """Apparent density of the trabecular bone more than 5 mm below the subchondral plate."""


class GlenoidSurface(Glenoid, SurfaceAnatomy):
    """A glenoid on the surface of a scapula."""


class GlenoidImage(Glenoid, ImageAnatomy):
    """A glenoid in an image of a scapula."""


class Block(Part):
    """Block of bone with uniform density."""

    kind: Literal["block"] = "block"
    """A block, or the bone in `file`."""
    density_kg_m3: float = Field(1800.0, ge=100, le=2500)
    """Apparent density of the bone. Cortical bone has 1800 to 2000 kg/m3. If `file` is a surface,
    this is the density of the cortical shell.
    """


class BlockAnatomy(Block, Drilled):
    """A block of bone with its top face at z = 0."""

    size_mm: Annotated[tuple[Length_mm, Length_mm, Length_mm], Strict(False)] = (20.0, 12.0, 8.0)
    """Edge lengths along x, y and z."""


class BlockSurface(Block, SurfaceAnatomy):
    """Bone from a surface file, with a cortical shell of uniform density.

    The keys `centre_mm` and `normal` define the site, where the tool works.
    """


class BlockImage(Block, ImageAnatomy):
    """Bone from an image volume: either with a site at the origin, or the whole image.

    If `centre_mm` is given, this point of the image becomes the origin. Without `centre_mm`, the
    top of the image is at z = 0.
    """

    @property
    def is_whole(self) -> bool:
        """True if the whole image is used, because the scene has no `centre_mm`."""
        return self.centre_mm is None

    def idle(self) -> dict[str, Idle]:
        """Return the keys that have no effect, with the reasons.

        Without `centre_mm`, the key `along` and the keys for a cortical shell and a guide hole have
        no effect.
        """
        whole = Idle("for an image that is used as a whole", "set anatomy.centre_mm")
        placing = (
            "along",
            "cortical_thickness_mm",
            "guide_hole_diameter_mm",
            "guide_hole_depth_mm",
        )
        return super().idle() | (dict.fromkeys(placing, whole) if self.is_whole else {})


class Bone(Part):
    """Bone from a file; the origin is at the site, where the tool works on the surface.

    The cortical and trabecular layers are determined by an image of the density, a surface around
    the trabecular bone, or a uniform cortical thickness.
    """

    kind: Literal["bone"] = "bone"
    """The bone in `file`."""
    density_file: FileName | None = Field(None, examples=["density.nrrd"])
    """Image of the apparent density [kg/m3], in the frame of `file`. It determines which bone is
    cortical and which is trabecular.
    """
    cortical_above_kg_m3: Annotated[float, Needs("anatomy.density_file")] = Field(
        1000.0, ge=300, le=2000
    )
    """Apparent density in `density_file` above which bone is cortical."""
    articular_radius_mm: Annotated[float, Needs("anatomy.density_file")] = Field(0.0, ge=0, le=100)
    """Distance from the site within which dense bone near the surface is subchondral. With 0 there
    is no subchondral bone.
    """
    core_file: Annotated[FileName | None, Needs("anatomy.density_file", is_absent=True)] = Field(
        None, examples=["cancellous.stl"]
    )
    """File of a closed surface around the trabecular bone, in the frame of `file`."""
    cortical_thickness_mm: Annotated[
        float,
        Needs("anatomy.density_file", is_absent=True),
        Needs("anatomy.core_file", is_absent=True),
    ] = Field(1.5, gt=0, le=10)
    """Thickness of the cortical bone below the surface."""


class BoneSurface(Bone, SurfaceAnatomy):
    """A bone from a surface file, for example from a file that `tissue import` writes.

    The origin is at the site, the surface point where the tool works; +z points outward.
    """


class BoneImage(Bone, ImageAnatomy):
    """A bone from an image volume.

    The origin is at the site, the surface point where the tool works; +z points outward.
    """


class Tooth(CutAnatomy):
    """Tooth in its socket.

    The origin is at the bottom of the central fossa, with +z out of the tooth.
    """

    reads: ClassVar[tuple[str, ...]] = (*CutAnatomy.reads, "stress")
    kind: Literal["molar"] = "molar"
    """A molar."""
    ligament_thickness_mm: float = Field(0.22, ge=0.1, le=0.5)
    """Thickness of the periodontal ligament. For a tooth from files, it affects only the computed
    stress.
    """

    @property
    def layer_files(self) -> dict[str, str]:
        """Names of the surface files, keyed by layer."""
        return {}


class MolarAnatomy(Tooth, Drilled):
    """A molar in its socket.

    The origin is at the bottom of the central fossa, with +z out of the tooth. The shape is
    procedural. To read the shape of a real tooth, give one surface file per layer (`enamel_file`
    and so on), or a label volume (`file`).
    """

    crown_width_mm: float = Field(11.0, ge=9, le=13)
    """Mesiodistal size of the crown."""
    crown_length_mm: float = Field(10.5, ge=8.5, le=12.5)
    """Buccolingual size of the crown."""
    enamel_thickness_mm: float = Field(2.2, ge=1, le=3)
    """Thickness of the enamel over the highest cusp. In the fossa, the thickness is 62 % of this
    value.
    """
    pulp_roof_mm: float = Field(5.0, ge=3.5, le=6.5)
    """Depth of the roof of the pulp chamber below the central fossa."""
    caries_depth_mm: float = Field(0.0, ge=0, le=6)
    """Depth of a carious lesion below the central fossa. A sound tooth has 0."""
    caries_diameter_mm: Annotated[float, Needs("anatomy.caries_depth_mm")] = Field(3.0, gt=0, le=8)
    """Diameter of the carious lesion."""


class ToothSite(Tooth):
    """Tooth from files, with a choice of the place where the tool enters."""

    site: Literal["enamel", "caries"] = "enamel"
    """Place where the tool enters a tooth from files. With `enamel` the tool enters along the axis
    of the tooth, and with `caries` it enters directly above the lesion.
    """


class MolarSurfaces(ToothSite, Drilled):
    """A tooth from one closed surface per layer; all surfaces are in the same frame."""

    source: ClassVar[str] = "from surfaces"
    scale_mm: float | None = Field(None, gt=0, le=1e5, examples=[1.0])
    """Millimetres per length unit of the surface files. Without this key, the unit is guessed, and
    a note of the run reports the guess.
    """
    enamel_file: FileName | None = Field(None, examples=["enamel.stl"])
    """File of the closed surface of the enamel."""
    dentin_file: FileName | None = Field(None, examples=["dentin.stl"])
    """File of the closed surface of the dentin."""
    pulp_file: FileName | None = Field(None, examples=["pulp.stl"])
    """File of the closed surface of the pulp. With this file, `keep_clear.names` may contain
    `pulp`.
    """
    caries_file: FileName | None = Field(None, examples=["caries.stl"])
    """File of the closed surface of a carious lesion."""
    ligament_file: FileName | None = Field(None, examples=["ligament.stl"])
    """File of the closed surface of the periodontal ligament."""
    socket_mm: float = Field(0.0, ge=0, le=10)
    """Thickness of the bone that is added around the periodontal ligament."""

    @property
    def layer_files(self) -> dict[str, str]:
        """Names of the surface files, keyed by layer."""
        files = {name: getattr(self, f"{name}_file") for name in LAYERS}
        return {name: file for name, file in files.items() if file is not None}

    @property
    def structure_files(self) -> dict[str, str]:
        """Surface files of the structures for `keep_clear.names`, keyed by structure."""
        return {} if self.pulp_file is None else {"pulp": self.pulp_file}


class MolarLabels(ToothSite):
    """A tooth from a label volume."""

    source: ClassVar[str] = "from labels"
    file: FileName = Field(examples=["labels.nii.gz"])
    """File of a label volume, in which each layer of the tooth has a label."""
    spacing_mm: float | None = Field(None, gt=0, le=10, examples=[0.0195])
    """Edge of a voxel of the label volume, for files without this information, such as TIFF or PNG
    slices.
    """


class VertebraAnatomy(Drilled):
    """A lumbar vertebra.

    The origin is behind the left pedicle; +z points outward along the pedicle's axis, and +y points
    up. The spinal canal lies at +x. In `keep_clear.names`, the spinal canal has the name `canal`.
    """

    kind: Literal["vertebra"] = "vertebra"
    """A lumbar vertebra, L4 by default."""
    body_width_mm: float = Field(48.0, ge=36, le=60)
    """Width of the vertebral body."""
    body_depth_mm: float = Field(34.5, ge=26, le=45)
    """Depth of the vertebral body, front to back."""
    body_height_mm: float = Field(25.0, ge=20, le=34)
    """Height of the vertebral body."""
    canal_width_mm: float = Field(25.4, ge=16, le=32)
    """Width of the spinal canal."""
    canal_depth_mm: float = Field(18.6, ge=11, le=26)
    """Depth of the spinal canal, front to back."""
    pedicle_width_mm: float = Field(12.9, ge=5, le=22)
    """Width of the pedicle. It must be more than three times `pedicle_cortex_mm`."""
    pedicle_height_mm: float = Field(14.8, ge=8, le=22)
    """Height of the pedicle."""
    pedicle_angle_deg: float = Field(17.7, ge=0, le=35)
    """Angle between the pedicle's axis and the front-back direction. The axis approaches the
    midline towards the front.
    """
    pedicle_cortex_mm: float = Field(1.0, ge=0.3, le=3)
    """Thickness of the cortical bone of pedicle and arch."""
    trabecular_density_kg_m3: float = Field(180.0, ge=50, le=1200)
    """Apparent density of the trabecular bone in the vertebral body."""
    pedicle_density_kg_m3: float = Field(280.0, ge=50, le=1200)
    """Apparent density of the trabecular bone in pedicle and arch."""
    cortical_density_kg_m3: float = Field(1800.0, ge=200, le=2200)
    """Apparent density of the cortical bone."""


class WallAnatomy(Part):
    """A stiff virtual wall with its face at z = 0, against which a ball is pushed."""

    reads: ClassVar[tuple[str, ...]] = ()
    kind: Literal["wall"] = "wall"
    """A wall."""
    stiffness_kN_m: float = Field(10.0, ge=1, le=40)
    """Stiffness of the wall, which has no friction or damping."""
