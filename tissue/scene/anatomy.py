"""What a scene states of the anatomy: procedural, or read from files."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, Strict, field_validator, model_validator

from meshes.base.errors import InputError

__all__ = [
    "AnatomyFile",
    "BlockAnatomy",
    "BoneAnatomy",
    "GlenoidAnatomy",
    "Length_mm",
    "MolarAnatomy",
    "Part",
    "Vector",
]

Vector = Annotated[tuple[float, float, float], Strict(False)]
SURFACE_SUFFIXES = (".stl", ".obj", ".ply", ".vtk", ".vtp")
Length_mm = Annotated[float, Field(ge=0.1, le=500)]


class Part(BaseModel):
    """A frozen part of a scene."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class AnatomyFile(Part):
    """Bone read from a file instead of the procedural default."""

    file: str | None = Field(None, examples=["scapula.stl"])
    """Surface (.stl .obj .ply .vtk .vtp), image volume, or folder of TIFF slices; empty uses the procedural bone."""
    scale_mm: float | None = Field(None, gt=0, le=1e5, examples=[1.0])
    """Millimetres per unit of a surface file; without it the unit is guessed and shown."""
    centre_mm: Vector | None = Field(None, examples=[(0.0, 0.0, 0.0)])
    """Centre of the working face in the file's frame [mm]; without it that of a glenoid is searched for."""
    normal: Vector | None = Field(None, examples=[(0.0, 0.0, 1.0)])
    """Outward normal of the working face in the file's frame."""
    along: Vector | None = Field(None, examples=[(1.0, 0.0, 0.0)])
    """Direction in the file's frame that becomes x, as far as it lies across the normal."""
    spacing_mm: float | None = Field(None, gt=0, le=10, examples=[0.0195])
    """Voxel edge of an image that does not state one, such as TIFF slices."""
    threshold: float | None = Field(None, ge=-1e9, le=1e9, examples=[200.0])
    """Image value above which a voxel is bone."""
    cortical_thickness_mm: float = Field(1.5, gt=0, le=10)
    """Thickness of the cortical shell laid under a surface from a file."""
    guide_hole_diameter_mm: float = Field(0.0, ge=0, le=50)
    """Diameter of a guide hole drilled along the tool's axis before the run; 0 drills none."""
    guide_hole_depth_mm: float = Field(0.0, ge=0, le=100)
    """Depth of the guide hole under the face."""

    @property
    def is_image(self) -> bool:
        """Whether the bone comes from an image volume or a folder of slices, and from no surface."""
        return self.file is not None and Path(self.file).suffix.lower() not in SURFACE_SUFFIXES

    @field_validator("file", mode="before")
    @classmethod
    def _empty_is_none(cls, value: object) -> object:
        return None if value == "" else value


class GlenoidAnatomy(AnatomyFile):
    """A glenoid: concave face with a subchondral plate over a trabecular vault. Origin at its centre, +z outward."""

    kind: Literal["glenoid"] = "glenoid"
    """A glenoid."""
    width_mm: float = Field(27.8, ge=20, le=34)
    """Greatest width of the face, anterior to posterior."""
    height_mm: float = Field(37.5, ge=28, le=45)
    """Height of the face, inferior to superior; at least 1.1 times its width."""
    curvature_radius_mm: float = Field(35.0, ge=22, le=80)
    """Radius of the sphere that dishes the face; above half its height."""
    subchondral_thickness_mm: float = Field(1.9, ge=1.2, le=2.9)
    """Mean thickness of the subchondral plate."""


class BlockAnatomy(AnatomyFile):
    """A block of bone with its top face at z = 0."""

    kind: Literal["block"] = "block"
    """A block, or the image in `file` as it is."""
    size_mm: Annotated[tuple[Length_mm, Length_mm, Length_mm], Strict(False)] = (20.0, 12.0, 8.0)
    """Edge lengths along x, y and z."""
    density_kg_m3: float = Field(1800.0, ge=100, le=2500)
    """Apparent density; 1800 to 2000 is cortical bone. Of a surface from a file that of its shell."""


class BoneAnatomy(AnatomyFile):
    """A bone from a file, such as `tissue import` writes of a CT. Origin at the site on its surface, +z outward."""

    kind: Literal["bone"] = "bone"
    """The bone in `file` at a site on its surface."""
    density_file: str | None = Field(None, examples=["density.nrrd"])
    """Image of the apparent density [kg/m3] in the frame of `file`; layers follow from it."""
    cortical_above_kg_m3: float = Field(1000.0, ge=300, le=2000)
    """Apparent density from which bone of a `density_file` is cortical."""
    articular_radius_mm: float = Field(0.0, ge=0, le=100)
    """Distance from the site within which dense bone near the surface is the subchondral plate; 0 for no joint."""
    core_file: str | None = Field(None, examples=["cancellous.stl"])
    """Closed surface around the trabecular bone, in the frame of `file`."""

    @model_validator(mode="after")
    def _has_its_file(self) -> "BoneAnatomy":
        if self.file is None:
            raise InputError("anatomy.file must be given for a bone, got nothing: add its surface, or use kind = block")
        return self


class MolarAnatomy(AnatomyFile):
    """A molar in its socket. Origin at the bottom of the central fossa, +z out of the tooth.

    Real teeth come from one surface a layer (`enamel_file` ...), or from a label volume (`file` with `spacing_mm`).
    """

    kind: Literal["molar"] = "molar"
    """A molar."""
    crown_width_mm: float = Field(11.0, ge=9, le=13)
    """Mesiodistal size of the crown."""
    crown_length_mm: float = Field(10.5, ge=8.5, le=12.5)
    """Buccolingual size of the crown."""
    enamel_thickness_mm: float = Field(2.2, ge=1, le=3)
    """Enamel over the highest cusp; 62 % of it in the fossa."""
    pulp_roof_mm: float = Field(5.0, ge=3.5, le=6.5)
    """Depth of the pulp chamber's roof below the fossa."""
    ligament_thickness_mm: float = Field(0.22, ge=0.1, le=0.5)
    """Thickness of the periodontal ligament."""
    caries_depth_mm: float = Field(0.0, ge=0, le=6)
    """Depth of a lesion under the fossa; 0 is a sound tooth."""
    caries_diameter_mm: float = Field(3.0, gt=0, le=8)
    """Width of the lesion."""
    enamel_file: str | None = Field(None, examples=["enamel.stl"])
    """Closed surface of the enamel, in one frame with the other layers."""
    dentin_file: str | None = Field(None, examples=["dentin.stl"])
    """Closed surface of the dentin."""
    pulp_file: str | None = Field(None, examples=["pulp.stl"])
    """Closed surface of the pulp."""
    caries_file: str | None = Field(None, examples=["caries.stl"])
    """Closed surface of a lesion."""
    ligament_file: str | None = Field(None, examples=["ligament.stl"])
    """Closed surface of the periodontal ligament."""
    site: Literal["enamel", "caries"] = "enamel"
    """Where the tool comes in: down the axis of a tooth from files, or straight over its lesion."""
    socket_mm: float = Field(0.0, ge=0, le=10)
    """Bone laid around the ligament of a tooth from surfaces."""

    @property
    def layer_files(self) -> dict[str, str]:
        """Surface file of each layer that has one."""
        names = ("enamel", "dentin", "pulp", "caries", "ligament")
        return {name: file for name in names if (file := getattr(self, f"{name}_file")) is not None}
