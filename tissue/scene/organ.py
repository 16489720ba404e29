"""Soft organs of a scene: shape, support and material."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, Strict, model_validator

from meshes.base.errors import PRESENT, InputError
from tissue.scene.names import ORGAN_MATERIALS
from tissue.scene.part import FileName, Length_mm, Needs, OneOf, Part, Rule, Vector

__all__ = [
    "LAW_SHAPES",
    "Held",
    "IncisedAnatomy",
    "LayersAnatomy",
    "LiverAnatomy",
    "LiverFile",
    "Organ",
    "SlabAnatomy",
    "SoftAnatomy",
    "WithNodule",
]

LAYERS = ("capsule", "parenchyma")
"""Layers that a needle passes in every scene."""


class SoftAnatomy(Part):
    """Meshed organ."""

    source: ClassVar[str] = "procedural"
    """Origin of the shape, as used in messages."""
    reads: ClassVar[tuple[str, ...]] = ("organ",)
    """Tables of a scene that apply to this anatomy."""
    kind: str
    edge_mm: float = Field(20.0, ge=1, le=50)
    """Edge of a tetrahedron away from the tool."""
    touch_edge_mm: float | None = Field(None, ge=0.2, le=50, examples=[4.0])
    """Longest edge on the tool's path. Default: a quarter of the probe's diameter."""
    edge_growth: float = Field(0.5, gt=0, le=5)
    """Growth of the edges per distance from the tool's path, up to `edge_mm`."""

    @property
    def nodule_mm(self) -> float:
        """Diameter of the stiff ball in the tissue [mm]; 0 without one."""
        return float(getattr(self, "nodule_diameter_mm", 0.0))


class WithNodule(SoftAnatomy):
    """Meshed organ that may hold a nodule."""

    nodule_diameter_mm: float = Field(0.0, ge=0, le=60)
    """Diameter of a stiff ball in the tissue; 0 adds no ball."""
    nodule_centre_mm: Annotated[Vector, Needs("anatomy.nodule_diameter_mm")] = (0.0, 0.0, -15.0)
    """Centre of the stiff ball in the site's frame."""


class Held(SoftAnatomy):
    """Liver, held at a part of its surface."""

    kind: Literal["liver"] = "liver"
    """A liver, or the organ in `file`."""
    held: Literal["below", "back", "plane", "part"] = "below"
    """Support of the organ. `below` holds the surface it rests on, `back` its back, `plane` the
    surface below `held_below_mm`, and `part` the part `held_part`.
    """
    held_below_mm: Annotated[float, Needs("anatomy.held", "plane")] = Field(-80.0, ge=-1000, le=0)
    """Height below which the surface is held by `held = "plane"`."""
    held_part: Annotated[str | None, Needs("anatomy.held", "part")] = Field(
        None, examples=["ligament"]
    )
    """Part of the file that is held by `held = "part"`, by its name or number."""


class LiverAnatomy(Held, WithNodule):
    """A liver.

    The origin is on top of the right lobe, with z to the head and x to the patient's left.
    """


class LiverFile(Held):
    """An organ from a file.

    Its origin is the surface point nearest to `centre_mm`. Without `centre_mm`, it is the highest
    surface point along `normal`.
    """

    source: ClassVar[str] = "from a file"
    file: FileName = Field(examples=["liver.vtu"])
    """Tetrahedra (.vtk .vtu .msh .mesh) or a closed surface (.stl .obj .ply .vtk .vtp). A surface
    is meshed.
    """
    scale_mm: float | None = Field(None, gt=0, le=1e5, examples=[1.0])
    """Millimetres per unit of the file."""
    centre_mm: Vector | None = Field(None, examples=[(0.0, 0.0, 50.0)])
    """Entry point of the tool in the file's frame. The nearest point of the surface becomes the
    origin.
    """
    normal: Vector = (0.0, 0.0, 1.0)
    """Direction in the file's frame that points up to the tool."""
    along: Vector | None = Field(None, examples=[(1.0, 0.0, 0.0)])
    """Direction in the file's frame whose component perpendicular to the normal becomes x."""


class SlabAnatomy(WithNodule):
    """A block of soft tissue with its top face at z = 0, bonded to the ground.

    It is a phantom for palpation.
    """

    kind: Literal["slab"] = "slab"
    """A slab."""
    size_mm: Annotated[tuple[Length_mm, Length_mm, Length_mm], Strict(False)] = (120.0, 80.0, 40.0)
    """Edge lengths along x, y and z."""
    edge_mm: float = Field(8.0, ge=0.5, le=20)
    """Edge of a tetrahedron at the top, away from the tool. The edges grow downwards."""


def _apart(depths_mm: dict[str, float]) -> dict[str, float] | None:
    """Refuse membranes that lie at one depth or have the name of a layer.

    An empty table gives None.
    """
    listed = sorted(depths_mm.items(), key=lambda each: each[1])
    for name, _ in listed:
        if name in LAYERS:
            raise InputError(
                "anatomy.membrane_depths_mm", f"not name the {name}", PRESENT, "choose another name"
            )
    for (above, depth_mm), (below, other_mm) in pairwise(listed):
        if depth_mm == other_mm:
            raise InputError(
                "anatomy.membrane_depths_mm",
                "have different depths",
                f"{depth_mm:g} for {above} and {below}",
                "change one of them",
            )
    return depths_mm or None


Depths_mm = Annotated[
    dict[str, Annotated[float, Field(gt=0, le=200, examples=[40.0])]], AfterValidator(_apart)
]
Punctures_N = Annotated[
    dict[str, Annotated[float, Field(gt=0, le=100, examples=[1.8])]],
    AfterValidator(lambda given: given or None),
]
Holds_N = Annotated[
    dict[str, Annotated[float, Field(ge=0, le=100, examples=[0.3])]],
    AfterValidator(lambda given: given or None),
]


class LayersAnatomy(Part):
    """Layers for a needle: a capsule at z = 0, tissue below it, and optional membranes in it."""

    reads: ClassVar[tuple[str, ...]] = ()
    kind: Literal["layers"] = "layers"
    """Layers, one below the other."""
    membrane_depths_mm: Depths_mm | None = Field(None, examples=[{"vessel wall": 40.0}])
    """Depths of membranes below the capsule by name, such as the two walls of a vessel. Default: no
    membranes.
    """
    membrane_punctures_N: Punctures_N | None = Field(None, examples=[{"vessel wall": 1.8}])
    """Tip forces at which membranes break, by name. Other membranes use the force of
    `needle.vessel_wall`.
    """
    membrane_holds_N: Holds_N | None = Field(None, examples=[{"vessel wall": 0.3}])
    """Forces with which the edges of the holes cling to the shaft, by membrane. Other membranes use
    the force of `needle.vessel_wall`.
    """
    interval_ms: float = Field(100.0, ge=0, le=10_000)
    """Time between two frames of displacement, strain and stress around the needle. 0 computes no
    frames.
    """

    @model_validator(mode="after")
    def _names_its_membranes(self) -> "LayersAnatomy":
        for key in ("membrane_punctures_N", "membrane_holds_N"):
            for name in getattr(self, key) or {}:
                if name not in (self.membrane_depths_mm or {}):
                    raise InputError(
                        f"anatomy.{key}",
                        (
                            "name membranes of anatomy.membrane_depths_mm "
                            f"({', '.join(self.membrane_depths_mm or {}) or 'none'})"
                        ),
                        name,
                        "give its depth there",
                    )
        return self

    @property
    def membranes(self) -> list[tuple[str, float]]:
        """Names and depths [mm] of the membranes under the capsule, from the surface downwards."""
        return sorted((self.membrane_depths_mm or {}).items(), key=lambda each: each[1])


class IncisedAnatomy(Part):
    """Soft tissue under z = 0 that a blade cuts."""

    reads: ClassVar[tuple[str, ...]] = ()
    kind: Literal["soft-tissue"] = "soft-tissue"
    """A tissue without layers."""
    material: Literal["skin", "liver"] = "skin"
    """Tissue whose constants are used."""
    interval_ms: float = Field(100.0, ge=0, le=10_000)
    """Time between two frames of the opening of the cut. 0 computes no frames."""


Modulus_kPa = Annotated[float, Field(ge=0.1, le=1e5, examples=[80.0])]
Moduli_kPa = Annotated[dict[str, Modulus_kPa], AfterValidator(lambda moduli: moduli or None)]
"""Young's moduli by part [kPa]; an empty table counts as no table."""


LAW_SHAPES = {
    "mooney-rivlin": ("second_share",),
    "yeoh": ("square_ratio", "cube_ratio"),
    "ogden": ("exponent",),
    "exponential": ("exponential_rate",),
}
"""Keys that give a law its shape, in addition to the modulus and Poisson's ratio.

The first key of a law is required. Only the rate of an exponential law is cited, for a pressed
liver.
"""


class Organ(Part):
    """Material of a soft organ, and the method of its solution."""

    material: Annotated[str, OneOf(ORGAN_MATERIALS)] = "liver"
    """Tissue whose cited constants are used for keys that are left out."""
    young_kPa: float | None = Field(None, ge=0.1, le=1e5, examples=[5.4])
    """Young's modulus. Default: the cited value."""
    young_end_kPa: float | None = Field(None, ge=0.1, le=1e5, examples=[50.0])
    """Young's modulus at the largest x. It is graded from `young_kPa` at the smallest x."""
    grading_exponent: Annotated[float, Needs("organ.young_end_kPa")] = Field(1.0, ge=0.2, le=5)
    """Exponent of the grading over the distance from one end to the other; 1 is linear."""
    parts: Moduli_kPa | None = Field(None, examples=[{"nodule": 80.0}])
    """Young's moduli of parts by name or number in the file [kPa]. The stiff ball is `nodule`; its
    default is 50 kPa.
    """
    poisson_ratio: float | None = Field(None, gt=-1, lt=0.5, examples=[0.45])
    """Poisson's ratio. Default: the cited value."""
    fibre_direction: Annotated[Vector | None, Needs("organ.fibre_modulus_ratio")] = Field(
        None, examples=[(1.0, 0.0, 0.0)]
    )
    """Direction of the fibres. With fibres, the tissue is transversely isotropic."""
    fibre_modulus_ratio: Annotated[float, Needs("organ.fibre_direction")] = Field(
        1.0, ge=0.25, le=10
    )
    """Ratio of Young's modulus along the fibres to Young's modulus across them. The bulk modulus is
    that of the tissue without fibres.
    """
    capsule: bool = False
    """Capsule of the cited thickness and modulus on the surface."""
    gravity: bool = False
    """Deformation of the organ by its own weight, along -z."""
    viscous: bool = False
    """Relaxation of the organ by the cited Prony series."""
    law: Literal["linear", "neo-hookean", "mooney-rivlin", "yeoh", "ogden", "exponential"] = (
        "linear"
    )
    """Material law at large strains; at small strains the given moduli apply. All laws but `linear`
    are solved between ticks.
    """
    second_share: Annotated[float | None, Needs("organ.law", "mooney-rivlin")] = Field(
        None, ge=0, le=1, examples=[0.3]
    )
    """Share of the second invariant's term in the shear modulus of a Mooney-Rivlin law."""
    square_ratio: Annotated[float | None, Needs("organ.law", "yeoh")] = Field(
        None, ge=-1, le=100, examples=[0.1]
    )
    """Ratio of the second-power coefficient of a Yeoh law to its first-power coefficient."""
    cube_ratio: Annotated[float, Needs("organ.law", "yeoh")] = Field(0.0, ge=-1, le=100)
    """Ratio of the third-power coefficient of a Yeoh law to its first-power coefficient."""
    exponent: Annotated[float | None, Needs("organ.law", "ogden")] = Field(
        None, ge=-30, le=30, examples=[8.0]
    )
    """Exponent of the stretches of a one-term Ogden law; not 0."""
    exponential_rate: Annotated[float | None, Needs("organ.law", "exponential")] = Field(
        None, gt=0, le=100, examples=[3.0]
    )
    """Rate of an exponential law of the first invariant. Default: the cited value."""
    law_interval_ms: Annotated[float, Needs("organ.law")] = Field(25.0, ge=5, le=1000)
    """Time between two solves of a nonlinear law."""
    friction: float = Field(0.3, ge=0, le=2)
    """Coulomb friction between tool and organ."""
    order: Literal[1, 2] = 2
    """Order of the tetrahedra. Linear ones lock near incompressibility; quadratic ones take longer
    to set up.
    """
    path: Literal["condensed", "lazy", "reduced"] = "condensed"
    """Method used to evaluate the compliance in the 1 kHz loop. `condensed` computes all of it,
    `lazy` computes columns where the tool is, and `reduced` uses a reduced basis.
    """
    basis_size: Annotated[int, Needs("organ.path", "reduced")] = Field(300, ge=10, le=3000)
    """Number of vectors of a reduced basis."""
    interval_ms: float = Field(100.0, ge=0, le=10_000)
    """Time between two frames of displacement, strain and stress; 0 computes no frames."""

    def rules(self) -> Iterator[Rule]:
        """Yield the rule for a material whose constants are not used."""
        is_stated = self.young_kPa is not None and self.poisson_ratio is not None
        takes_rate = self.law == "exponential" and self.exponential_rate is None
        is_cited = self.capsule or self.gravity or self.viscous or takes_rate
        both = "with both organ.young_kPa and organ.poisson_ratio"
        yield "material", is_stated and not is_cited, both, "remove one of them"

    @model_validator(mode="after")
    def _has_powers(self) -> "Organ":
        if self.exponent == 0.0:
            raise InputError("organ.exponent", "not be 0", "0", "use 8")
        return self
