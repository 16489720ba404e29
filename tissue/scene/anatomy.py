"""Anatomies of a scene for cutters: bone and teeth, procedural or from files.

Each class has only the keys that its shape needs.
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
    """Bone or tooth that a cutter removes."""

    kind: str

    source: ClassVar[str] = "procedural"
    """Origin of the shape, as named in messages."""
    reads: ClassVar[tuple[str, ...]] = ("voxels", "cutting", "keep_clear", "heat")
    """Tables of a scene that apply to this anatomy."""

    @property
    def from_file(self) -> str | None:
        """File that contains the whole shape; None if there is no such file.

        A procedural anatomy and a tooth with one file per layer have no such file.
        """
        file: str | None = getattr(self, "file", None)
        return file

    @property
    def structure_files(self) -> dict[str, str]:
        """Surface files of the structures for `keep_clear.names`, keyed by structure."""
        return {}

    @property
    def guide_hole_mm(self) -> tuple[float, float]:
        """Diameter and depth of the guide hole [mm]; zeros without a guide hole."""
        return getattr(self, "guide_hole_diameter_mm", 0.0), getattr(
            self, "guide_hole_depth_mm", 0.0
        )


class Drilled(CutAnatomy):
    """Bone or tooth that may have a guide hole."""

    guide_hole_diameter_mm: Annotated[float, Needs("anatomy.guide_hole_depth_mm")] = Field(
        0.0, ge=0, le=50
    )
    """Diameter of a guide hole that is drilled along the tool's axis before the run. With 0 there
    is no hole.
    """
    guide_hole_depth_mm: Annotated[float, Needs("anatomy.guide_hole_diameter_mm")] = Field(
        0.0, ge=0, le=100
    )
    """Depth of the guide hole below the working face, along the tool's axis."""


class Placed(Drilled):
    """Bone from a file, moved and rotated so that the centre of its working face is the origin."""

    file: FileName = Field(examples=["scapula.stl"])
    """Surface file (.stl .obj .ply .vtk .vtp), image volume, or folder of TIFF or PNG slices."""
    centre_mm: Vector | None = Field(None, examples=[(0.0, 0.0, 0.0)])
    """Centre of the working face in the file's frame [mm]. Without this key, the program searches
    for the face of a glenoid.
    """
    normal: Annotated[Vector | None, Needs("anatomy.centre_mm")] = Field(
        None, examples=[(0.0, 0.0, 1.0)]
    )
    """Outward normal of the working face in the file's frame."""
    along: Vector | None = Field(None, examples=[(1.0, 0.0, 0.0)])
    """Direction in the file's frame. The component of this direction perpendicular to `normal`
    becomes the x axis of the site.
    """
    cortical_thickness_mm: float = Field(1.5, gt=0, le=10)
    """Thickness of the cortical shell below the surface of a bone from a file."""


class SurfaceAnatomy(Placed):
    """Bone from a surface file."""

    source: ClassVar[str] = "from a surface"
    scale_mm: float | None = Field(None, gt=0, le=1e5, examples=[1.0])
    """Millimetres per unit of a surface file. Without this key, the unit is guessed, and a note of
    the run shows the guess.
    """


class Image(Part):
    """Image volume in which the voxels above a threshold are bone."""

    spacing_mm: float | None = Field(None, gt=0, le=10, examples=[0.0195])
    """Edge of a voxel, for an image that does not contain the voxel size, such as TIFF or PNG
    slices.
    """
    threshold: float | None = Field(None, ge=-1e9, le=1e9, examples=[200.0])
    """Image value above which a voxel is bone."""


class ImageAnatomy(Placed, Image):
    """Bone from an image volume."""

    source: ClassVar[str] = "from an image"


class Glenoid(Part):
    """Glenoid."""

    kind: Literal["glenoid"] = "glenoid"
    """A glenoid."""


class GlenoidAnatomy(Glenoid, Drilled):
    """A glenoid. It has a concave face with a subchondral plate, and trabecular bone below the
    plate.

    The origin is at the centre of the face, with +z outward.
    """

    width_mm: float = Field(27.8, ge=20, le=34)
    """Largest width of the face, anterior to posterior."""
    height_mm: float = Field(37.5, ge=28, le=45)
    """Height of the face, inferior to superior. It must be at least 1.1 times the width of the
    face.
    """
    curvature_radius_mm: float = Field(35.0, ge=22, le=80)
    """Radius of the sphere that shapes the concave face. It must be more than half the height of
    the face.
    """
    subchondral_thickness_mm: float = Field(1.9, ge=1.2, le=2.9)
    """Mean thickness of the subchondral plate."""
    subchondral_density_kg_m3: float = Field(1300.0, ge=200, le=2200)
    """Apparent density of the subchondral plate."""
    trabecular_density_below_plate_kg_m3: float = Field(450.0, ge=50, le=1200)
    """Apparent density of the trabecular bone at the plate. Within 5 mm below the plate, the
    density changes to the density of the vault.
    """
    trabecular_density_kg_m3: float = Field(300.0, ge=50, le=1200)
    """Apparent density of the trabecular bone in the vault."""


class GlenoidSurface(Glenoid, SurfaceAnatomy):
    """A glenoid on the surface of a scapula."""


class GlenoidImage(Glenoid, ImageAnatomy):
    """A glenoid in an image of a scapula."""


class Block(Part):
    """Block of bone with uniform density."""

    kind: Literal["block"] = "block"
    """A block, or the unchanged image in `file`."""
    density_kg_m3: float = Field(1800.0, ge=100, le=2500)
    """Apparent density. Cortical bone has 1800 to 2000 kg/m3. For a surface from a file, this is
    the density of the cortical shell.
    """


class BlockAnatomy(Block, Drilled):
    """A block of bone with its top face at z = 0."""

    size_mm: Annotated[tuple[Length_mm, Length_mm, Length_mm], Strict(False)] = (20.0, 12.0, 8.0)
    """Edge lengths along x, y and z."""


class BlockSurface(Block, SurfaceAnatomy):
    """Bone from a surface, with a cortical shell of uniform density.

    The scene states the site on the surface.
    """


class BlockImage(Block, ImageAnatomy):
    """Bone from an image, either at a site or as the whole unchanged image.

    With `centre_mm`, the bone lies at that site. Without `centre_mm`, the top of the image is at z
    = 0.
    """

    @property
    def is_whole(self) -> bool:
        """True if the whole image is used unchanged, because the scene gives no site."""
        return self.centre_mm is None

    def idle(self) -> dict[str, Idle]:
        """Return the keys without effect.

        An image without `centre_mm` is used unchanged. The keys for a site, a cortical shell and a
        guide hole then have no effect.
        """
        whole = Idle("for an image as it is, without anatomy.centre_mm", "set anatomy.centre_mm")
        placing = (
            "along",
            "cortical_thickness_mm",
            "guide_hole_diameter_mm",
            "guide_hole_depth_mm",
        )
        return super().idle() | (dict.fromkeys(placing, whole) if self.is_whole else {})


class Bone(Part):
    """Bone from a file, at a site on its surface.

    The layers inside the bone follow from one of three inputs: an image of the density, a surface
    around the trabecular core, or the uniform thickness of the cortical shell.
    """

    kind: Literal["bone"] = "bone"
    """The bone in `file` at a site on its surface."""
    density_file: FileName | None = Field(None, examples=["density.nrrd"])
    """Image of the apparent density [kg/m3] in the frame of `file`. The layers of the bone follow
    from this density.
    """
    cortical_above_kg_m3: Annotated[float, Needs("anatomy.density_file")] = Field(
        1000.0, ge=300, le=2000
    )
    """Lowest apparent density of cortical bone in a `density_file`."""
    articular_radius_mm: Annotated[float, Needs("anatomy.density_file")] = Field(0.0, ge=0, le=100)
    """Distance from the site. Within this distance, dense bone near the surface is subchondral. Use
    0 for a bone without a joint surface.
    """
    core_file: Annotated[FileName | None, Needs("anatomy.density_file", is_absent=True)] = Field(
        None, examples=["cancellous.stl"]
    )
    """Closed surface around the trabecular bone, in the frame of `file`."""
    cortical_thickness_mm: Annotated[
        float,
        Needs("anatomy.density_file", is_absent=True),
        Needs("anatomy.core_file", is_absent=True),
    ] = Field(1.5, gt=0, le=10)
    """Thickness of the cortical shell below the surface."""


class BoneSurface(Bone, SurfaceAnatomy):
    """A bone from a surface file, for example from the file that `tissue import` writes for a CT
    image.

    The origin is at the site on the surface of the bone, with +z outward.
    """


class BoneImage(Bone, ImageAnatomy):
    """A bone from an image.

    The origin is at the site on the surface of the bone, with +z outward.
    """


class Tooth(CutAnatomy):
    """Tooth in its socket.

    The origin is at the bottom of the central fossa, with +z out of the tooth.
    """

    reads: ClassVar[tuple[str, ...]] = (*CutAnatomy.reads, "stress")
    kind: Literal["molar"] = "molar"
    """A molar."""
    ligament_thickness_mm: float = Field(0.22, ge=0.1, le=0.5)
    """Thickness of the periodontal ligament. For a tooth from files, it affects only the stress."""

    @property
    def layer_files(self) -> dict[str, str]:
        """Names of the surface files, keyed by layer."""
        return {}


class MolarAnatomy(Tooth, Drilled):
    """A molar in its socket.

    The origin is at the bottom of the central fossa, with +z out of the tooth. The shape of a real
    tooth is read from one surface file per layer (`enamel_file` ...), or from a label volume
    (`file` with `spacing_mm`).
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
    """Diameter of the lesion."""


class ToothSite(Tooth):
    """Tooth from files, with the choice of the site at which the tool enters."""

    site: Literal["enamel", "caries"] = "enamel"
    """Entry site of the tool on a tooth from files. With `enamel` the tool enters along the axis of
    the tooth, and with `caries` directly above the lesion.
    """


class MolarSurfaces(ToothSite, Drilled):
    """A tooth from one closed surface per layer, all in one frame."""

    source: ClassVar[str] = "from surfaces"
    scale_mm: float | None = Field(None, gt=0, le=1e5, examples=[1.0])
    """Millimetres per unit of the surface files. Without this key, the unit is guessed, and a note
    of the run shows the guess.
    """
    enamel_file: FileName | None = Field(None, examples=["enamel.stl"])
    """Closed surface of the enamel, in the frame of the other layers."""
    dentin_file: FileName | None = Field(None, examples=["dentin.stl"])
    """Closed surface of the dentin."""
    pulp_file: FileName | None = Field(None, examples=["pulp.stl"])
    """Closed surface of the pulp. It is the structure `pulp` for `keep_clear.names`."""
    caries_file: FileName | None = Field(None, examples=["caries.stl"])
    """Closed surface of a carious lesion."""
    ligament_file: FileName | None = Field(None, examples=["ligament.stl"])
    """Closed surface of the periodontal ligament."""
    socket_mm: float = Field(0.0, ge=0, le=10)
    """Thickness of the bone that is added around the ligament of a tooth from surfaces."""

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
    """Label volume, in which each layer of the tooth has a label."""
    spacing_mm: float | None = Field(None, gt=0, le=10, examples=[0.0195])
    """Edge of a voxel, for a label volume that does not contain the voxel size, such as TIFF or PNG
    slices.
    """


class VertebraAnatomy(Drilled):
    """A lumbar vertebra.

    The origin is behind the left pedicle, with +z outward along the pedicle's axis and +y up. The
    spinal canal lies at +x. In `keep_clear.names`, the spinal canal has the name `canal`.
    """

    kind: Literal["vertebra"] = "vertebra"
    """A lumbar vertebra, L4 by default."""
    body_width_mm: float = Field(48.0, ge=36, le=60)
    """Width of the body."""
    body_depth_mm: float = Field(34.5, ge=26, le=45)
    """Depth of the body, front to back."""
    body_height_mm: float = Field(25.0, ge=20, le=34)
    """Height of the body."""
    canal_width_mm: float = Field(25.4, ge=16, le=32)
    """Width of the spinal canal."""
    canal_depth_mm: float = Field(18.6, ge=11, le=26)
    """Depth of the spinal canal, front to back."""
    pedicle_width_mm: float = Field(12.9, ge=5, le=22)
    """Width of the pedicle. It must be more than three times the thickness of the pedicle's cortex.
    """
    pedicle_height_mm: float = Field(14.8, ge=8, le=22)
    """Height of the pedicle."""
    pedicle_angle_deg: float = Field(17.7, ge=0, le=35)
    """Angle by which the pedicle's axis turns towards the midline, from back to front."""
    pedicle_cortex_mm: float = Field(1.0, ge=0.3, le=3)
    """Thickness of the cortical bone of pedicle and arch."""
    trabecular_density_kg_m3: float = Field(180.0, ge=50, le=1200)
    """Apparent density of the trabecular bone in the body."""
    pedicle_density_kg_m3: float = Field(280.0, ge=50, le=1200)
    """Apparent density of the trabecular bone in pedicle and arch."""
    cortical_density_kg_m3: float = Field(1800.0, ge=200, le=2200)
    """Apparent density of the cortex."""


class WallAnatomy(Part):
    """A stiff virtual wall. Its face is at z = 0, and a ball is pushed against the face."""

    reads: ClassVar[tuple[str, ...]] = ()
    kind: Literal["wall"] = "wall"
    """A wall."""
    stiffness_kN_m: float = Field(10.0, ge=1, le=40)
    """Stiffness of the wall, which has no friction or damping."""
