"""Soft organs of a scene: shape, support and material."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, Strict, model_validator

from meshes.base.errors import InputError
from tissue.scene.names import ORGAN_MATERIALS
from tissue.scene.part import FileName, Length_mm, Needs, OneOf, Part, Rule, Vector

__all__ = [
    "Held",
    "LayersAnatomy",
    "LiverAnatomy",
    "LiverFile",
    "Organ",
    "SlabAnatomy",
    "SoftAnatomy",
    "WithNodule",
]

LAYERS = ("capsule", "parenchyma")
"""What a needle meets in every scene."""


class SoftAnatomy(Part):
    """Meshed organ."""

    source: ClassVar[str] = "procedural"
    """Origin of the shape, as messages call it."""
    reads: ClassVar[tuple[str, ...]] = ("organ",)
    """Tables of a scene that describe it."""
    kind: str
    edge_mm: float = Field(20.0, ge=1, le=50)
    """Edge of a tetrahedron away from the tool."""
    touch_edge_mm: float | None = Field(None, ge=0.2, le=50, examples=[4.0])
    """Longest edge where the tool goes; without it a quarter of the probe's diameter."""
    edge_growth: float = Field(0.5, gt=0, le=5)
    """Growth of the edges with the distance from the tool's path, as far as `edge_mm`."""

    @property
    def nodule_mm(self) -> float:
        """Diameter of the stiff ball in the tissue [mm]; 0 without one."""
        return float(getattr(self, "nodule_diameter_mm", 0.0))


class WithNodule(SoftAnatomy):
    """Meshed organ that may hold a nodule."""

    nodule_diameter_mm: float = Field(0.0, ge=0, le=60)
    """Diameter of a stiff ball in the tissue; 0 has none."""
    nodule_centre_mm: Annotated[Vector, Needs("anatomy.nodule_diameter_mm")] = (0.0, 0.0, -15.0)
    """Its centre in the site's frame."""


class Held(SoftAnatomy):
    """Liver, held at a part of its surface."""

    kind: Literal["liver"] = "liver"
    """A liver, or the organ in `file`."""
    held: Literal["below", "back", "plane", "part"] = "below"
    """What holds it: the surface it rests on, its back, all below `held_below_mm`, or the part
    `held_part`.
    """
    held_below_mm: Annotated[float, Needs("anatomy.held", "plane")] = Field(-80.0, ge=-1000, le=0)
    """Height below which the surface is held by `held = "plane"`."""
    held_part: Annotated[str | None, Needs("anatomy.held", "part")] = Field(
        None, examples=["ligament"]
    )
    """Part of the file, by its name or number, that is held by `held = "part"`."""


class LiverAnatomy(Held, WithNodule):
    """A liver. Origin on top of the right lobe, z to the head, x to the patient's left."""


class LiverFile(Held):
    """An organ from a file. Its origin is the surface point nearest to `centre_mm`, else the
    highest along `normal`.
    """

    source: ClassVar[str] = "from a file"
    file: FileName = Field(examples=["liver.vtu"])
    """Tetrahedra (.vtk .vtu .msh .mesh) or a closed surface (.stl .obj .ply .vtk .vtp), which is
    meshed.
    """
    scale_mm: float | None = Field(None, gt=0, le=1e5, examples=[1.0])
    """Millimetres per unit of the file."""
    centre_mm: Vector | None = Field(None, examples=[(0.0, 0.0, 50.0)])
    """Where the tool comes in, in the file's frame; the nearest point of the surface becomes the
    origin.
    """
    normal: Vector = (0.0, 0.0, 1.0)
    """Direction in the file's frame that points up to the tool."""
    along: Vector | None = Field(None, examples=[(1.0, 0.0, 0.0)])
    """Direction in the file's frame that becomes x, as far as it lies across the normal."""


class SlabAnatomy(WithNodule):
    """A block of soft tissue with its top face at z = 0, bonded to the ground: a phantom for
    palpation.
    """

    kind: Literal["slab"] = "slab"
    """A slab."""
    size_mm: Annotated[tuple[Length_mm, Length_mm, Length_mm], Strict(False)] = (120.0, 80.0, 40.0)
    """Edge lengths along x, y and z."""
    edge_mm: float = Field(8.0, ge=0.5, le=20)
    """Edge of a tetrahedron at the top, away from the tool; they grow downwards."""


def _apart(depths_mm: dict[str, float]) -> dict[str, float] | None:
    """Refuse membranes that lie at one depth or have the name of a layer; of none, None."""
    listed = sorted(depths_mm.items(), key=lambda each: each[1])
    for name, _ in listed:
        if name in LAYERS:
            raise InputError(
                "anatomy.membrane_depths_mm", f"not name the {name}", "it", "choose another name"
            )
    for (above, depth_mm), (below, other_mm) in pairwise(listed):
        if depth_mm == other_mm:
            raise InputError(
                "anatomy.membrane_depths_mm",
                "differ",
                f"{depth_mm:g} for {above} and {below}",
                "move one of them",
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
    """What a needle meets: a capsule at z = 0, the tissue under it and, where given, membranes
    in it.
    """

    reads: ClassVar[tuple[str, ...]] = ()
    kind: Literal["layers"] = "layers"
    """Layers, one below the other."""
    membrane_depths_mm: Depths_mm | None = Field(None, examples=[{"vessel wall": 40.0}])
    """Depths of membranes under the capsule by their names, such as the two walls of a vessel;
    without them none.
    """
    membrane_punctures_N: Punctures_N | None = Field(None, examples=[{"vessel wall": 1.8}])
    """Forces of the tip at which they break; of those that are not named the force of
    `needle.vessel_wall`.
    """
    membrane_holds_N: Holds_N | None = Field(None, examples=[{"vessel wall": 0.3}])
    """Forces with which the edges of their holes cling to the shaft; likewise."""
    interval_ms: float = Field(100.0, ge=0, le=10_000)
    """Time between two frames of displacement, strain and stress around the needle; 0 computes
    none.
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


Modulus_kPa = Annotated[float, Field(ge=0.1, le=1e5, examples=[80.0])]
Moduli_kPa = Annotated[dict[str, Modulus_kPa], AfterValidator(lambda moduli: moduli or None)]
"""Of no part: the same as without the table."""


class Organ(Part):
    """What a soft organ is made of, and how it is solved."""

    material: Annotated[str, OneOf(ORGAN_MATERIALS)] = "liver"
    """Tissue whose cited constants are used where nothing else is stated."""
    young_kPa: float | None = Field(None, ge=0.1, le=1e5, examples=[5.4])
    """Young's modulus; without it the cited one."""
    young_end_kPa: float | None = Field(None, ge=0.1, le=1e5, examples=[50.0])
    """Young's modulus at the greatest x; between, it is graded from `young_kPa` at the least x."""
    grading_exponent: Annotated[float, Needs("organ.young_end_kPa")] = Field(1.0, ge=0.2, le=5)
    """Power of the distance from one end to the other by which it is graded; 1 is linear."""
    parts: Moduli_kPa | None = Field(None, examples=[{"nodule": 80.0}])
    """Young's moduli of parts, by their names or numbers in the file [kPa]; the ball is
    `nodule`, without it 50 kPa.
    """
    poisson_ratio: float | None = Field(None, gt=-1, lt=0.5, examples=[0.45])
    """Poisson's ratio; without it the cited one."""
    fibre_direction: Annotated[Vector | None, Needs("organ.fibre_modulus_ratio")] = Field(
        None, examples=[(1.0, 0.0, 0.0)]
    )
    """Direction of fibres; with it the tissue is transversely isotropic."""
    fibre_modulus_ratio: Annotated[float, Needs("organ.fibre_direction")] = Field(
        1.0, ge=0.25, le=10
    )
    """Young's modulus along the fibres over that across them. The bulk modulus is that of the
    tissue without fibres.
    """
    capsule: bool = False
    """Whether a capsule of the cited thickness and modulus lies on the surface."""
    gravity: bool = False
    """Whether the organ hangs in its own weight, along -z."""
    viscous: bool = False
    """Whether it relaxes by the cited Prony series."""
    law: Literal["linear", "neo-hookean", "mooney-rivlin", "yeoh", "ogden"] = "linear"
    """Law of large strains, its small strains by the moduli above; all but the first are solved
    between ticks.
    """
    second_share: Annotated[float | None, Needs("organ.law", "mooney-rivlin")] = Field(
        None, ge=0, le=1, examples=[0.3]
    )
    """Share of the second invariant's term in the shear modulus of a Mooney-Rivlin law."""
    square_ratio: Annotated[float | None, Needs("organ.law", "yeoh")] = Field(
        None, ge=-1, le=100, examples=[0.1]
    )
    """Coefficient of the second power of a Yeoh law over that of the first."""
    cube_ratio: Annotated[float, Needs("organ.law", "yeoh")] = Field(0.0, ge=-1, le=100)
    """The same of the third power."""
    exponent: Annotated[float | None, Needs("organ.law", "ogden")] = Field(
        None, ge=-30, le=30, examples=[8.0]
    )
    """Exponent of the stretches of an Ogden law of one term; not 0."""
    law_interval_ms: Annotated[float, Needs("organ.law")] = Field(25.0, ge=5, le=1000)
    """Time between two solves of a law that is not linear."""
    law_edge_ratio: Annotated[float, Needs("organ.law")] = Field(1.4, ge=1, le=4)
    """Edges of the mesh on which that law is solved, over those of the organ's."""
    friction: float = Field(0.3, ge=0, le=2)
    """Coulomb friction between tool and organ."""
    order: Literal[1, 2] = 2
    """Order of the tetrahedra: linear ones lock near incompressibility, quadratic ones take
    longer to set up.
    """
    path: Literal["condensed", "lazy", "reduced"] = "condensed"
    """How the compliance at 1 kHz is had: whole, column by column where the tool is, or from a
    reduced basis.
    """
    basis_size: Annotated[int, Needs("organ.path", "reduced")] = Field(300, ge=10, le=3000)
    """Vectors of a reduced basis."""
    interval_ms: float = Field(100.0, ge=0, le=10_000)
    """Time between two frames of displacement, strain and stress; 0 computes none."""

    def rules(self) -> Iterator[Rule]:
        """Yield the rule of a material none of whose constants is used."""
        is_stated = self.young_kPa is not None and self.poisson_ratio is not None
        is_cited = self.capsule or self.gravity or self.viscous
        both = "with both organ.young_kPa and organ.poisson_ratio"
        yield "material", is_stated and not is_cited, both, "remove one of them"
