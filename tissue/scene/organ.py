"""Soft organs of a scene: shape, support and material."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, Strict

from meshes.base.errors import PRESENT, InputError
from tissue.scene.names import ORGAN_MATERIALS
from tissue.scene.part import FileName, Length_mm, Needs, OneOf, Part, Rule, Vector

LAYERS = ("capsule", "parenchyma")
"""Layers that a needle passes in any scene with a needle."""


class SoftAnatomy(Part):
    """Meshed organ."""

    source: ClassVar[str] = "procedural"
    """Origin of the shape, as used in messages."""
    reads: ClassVar[tuple[str, ...]] = ("organ",)
    """Tables of a scene that apply to this anatomy."""
    kind: str
    edge_mm: float = Field(20.0, ge=1, le=50)
    """Edge length of the tetrahedra far from the tool."""
    touch_edge_mm: float | None = Field(None, ge=0.2, le=50, examples=[4.0])
    """Longest edge of the tetrahedra on the tool's path. Default: a quarter of the probe's
    diameter.
    """
    edge_growth: float = Field(0.5, gt=0, le=5)
    """Growth of the edge length [mm] for each millimetre of distance from the tool's path. The
    edges grow up to `edge_mm`.
    """

    @property
    def nodule_mm(self) -> float:
        """Diameter of the stiff ball in the tissue [mm]; 0 without a ball."""
        return float(getattr(self, "nodule_diameter_mm", 0.0))


class WithNodule(SoftAnatomy):
    """Meshed organ that may hold a nodule."""

    nodule_diameter_mm: float = Field(0.0, ge=0, le=60)
    """Diameter of a stiff ball (nodule) in the tissue. With 0 there is no ball."""
    nodule_centre_mm: Annotated[Vector, Needs("anatomy.nodule_diameter_mm")] = (0.0, 0.0, -15.0)
    """Centre of the stiff ball in the site's frame."""


class Held(SoftAnatomy):
    """Liver that is fixed at a part of its surface."""

    kind: Literal["liver"] = "liver"
    """A liver, or the organ in `file`."""
    held: Literal["below", "back", "plane", "part"] = "below"
    """Support of the organ. `below` fixes the lower surface of the organ, and `back` fixes its
    back. `plane` fixes the surface below `held_below_mm`, and `part` fixes the part `held_part`.
    """
    held_below_mm: Annotated[float, Needs("anatomy.held", "plane")] = Field(-80.0, ge=-1000, le=0)
    """Height below which the surface is fixed if `held = "plane"`."""
    held_part: Annotated[str | None, Needs("anatomy.held", "part")] = Field(
        None, examples=["ligament"]
    )
    """Name or number of the part of the file that is fixed if `held = "part"`."""


class LiverAnatomy(Held, WithNodule):
    """A liver.

    The origin is on top of the right lobe, with z to the head and x to the patient's left.
    """


class LiverFile(Held):
    """An organ from a file.

    The origin is the surface point nearest to `centre_mm`. Without `centre_mm`, the origin is the
    highest surface point along `normal`.
    """

    source: ClassVar[str] = "from a file"
    file: FileName = Field(examples=["liver.vtu"])
    """File of tetrahedra (.vtk .vtu .msh .mesh) or of a closed surface (.stl .obj .ply .vtk .vtp).
    The program fills a closed surface with tetrahedra.
    """
    scale_mm: float | None = Field(None, gt=0, le=1e5, examples=[1.0])
    """Millimetres per unit of the file."""
    centre_mm: Vector | None = Field(None, examples=[(0.0, 0.0, 50.0)])
    """Entry point of the tool in the file's frame. The surface point nearest to this point becomes
    the origin.
    """
    normal: Vector = (0.0, 0.0, 1.0)
    """Direction in the file's frame from the organ to the tool."""
    along: Vector | None = Field(None, examples=[(1.0, 0.0, 0.0)])
    """Direction in the file's frame. The component of this direction perpendicular to `normal`
    becomes the x axis of the site.
    """


class SlabAnatomy(WithNodule):
    """A block of soft tissue with its top face at z = 0, bonded to the ground.

    The block is a phantom for palpation.
    """

    kind: Literal["slab"] = "slab"
    """A slab."""
    size_mm: Annotated[tuple[Length_mm, Length_mm, Length_mm], Strict(False)] = (120.0, 80.0, 40.0)
    """Edge lengths along x, y and z."""
    edge_mm: float = Field(8.0, ge=0.5, le=20)
    """Edge length of the tetrahedra at the top face, far from the tool. The edges grow downwards.
    """


def _apart(depths_mm: dict[str, float]) -> dict[str, float] | None:
    """Refuse membranes that lie at the same depth or have the name of a layer.

    For an empty table, the result is None.
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
    """Layers for a needle. A capsule lies at z = 0, tissue lies below the capsule, and the tissue
    may contain membranes.
    """

    reads: ClassVar[tuple[str, ...]] = ()
    kind: Literal["layers"] = "layers"
    """Layers, one below the other."""
    membrane_depths_mm: Depths_mm | None = Field(None, examples=[{"vessel wall": 40.0}])
    """Depth of each membrane below the capsule, by the name of the membrane. Membranes are, for
    example, the two walls of a vessel. Default: no membranes.
    """
    membrane_punctures_N: Punctures_N | None = Field(None, examples=[{"vessel wall": 1.8}])
    """Tip force at which each membrane breaks, by the name of the membrane. Membranes that are not
    listed use the force of `needle.vessel_wall`.
    """
    membrane_holds_N: Holds_N | None = Field(None, examples=[{"vessel wall": 0.3}])
    """Friction force between the shaft and the edge of the hole in each membrane, by the name of
    the membrane. Membranes that are not listed use the force of `needle.vessel_wall`.
    """
    interval_ms: float = Field(100.0, ge=0, le=10_000)
    """Time between two frames (saved fields) of displacement, strain and stress around the needle.
    With 0 no frames are computed.
    """

    def require_valid(self) -> None:
        """Check that forces are given only for membranes that have a depth."""
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
                        "add this membrane with its depth to anatomy.membrane_depths_mm",
                    )

    @property
    def membranes(self) -> list[tuple[str, float]]:
        """Names and depths [mm] of the membranes below the capsule, ordered by depth."""
        return sorted((self.membrane_depths_mm or {}).items(), key=lambda each: each[1])


class IncisedAnatomy(Part):
    """Soft tissue below z = 0 that a blade cuts."""

    reads: ClassVar[tuple[str, ...]] = ()
    kind: Literal["soft-tissue"] = "soft-tissue"
    """A tissue without layers."""
    material: Literal["skin", "liver"] = "skin"
    """Tissue whose constants are used."""
    interval_ms: float = Field(100.0, ge=0, le=10_000)
    """Time between two frames (saved states) of the opening of the cut. With 0 no frames are
    computed.
    """


Modulus_kPa = Annotated[float, Field(ge=0.1, le=1e5, examples=[80.0])]
Moduli_kPa = Annotated[dict[str, Modulus_kPa], AfterValidator(lambda moduli: moduli or None)]
"""Young's modulus of each part [kPa]. An empty table counts as no table."""


LAW_SHAPES = {
    "mooney-rivlin": ("second_share",),
    "yeoh": ("square_ratio", "cube_ratio"),
    "ogden": ("exponent",),
    "exponential": ("exponential_rate",),
}
"""Keys that define the shape of a law, in addition to the modulus and Poisson's ratio.

The first key of a law is required. An exception is the exponential law, whose rate has a built-in
value for a pressed liver.
"""


class Organ(Part):
    """Material of a soft organ, and the method by which the deformation is computed."""

    material: Annotated[str, OneOf(ORGAN_MATERIALS)] = "liver"
    """Tissue whose built-in constants replace the keys that are left out."""
    young_kPa: float | None = Field(None, ge=0.1, le=1e5, examples=[5.4])
    """Young's modulus. Default: the value of `organ.material`."""
    young_end_kPa: float | None = Field(None, ge=0.1, le=1e5, examples=[50.0])
    """Young's modulus at the largest x of the organ. Along x, the modulus changes from `young_kPa`
    at the smallest x to this value.
    """
    grading_exponent: Annotated[float, Needs("organ.young_end_kPa")] = Field(1.0, ge=0.2, le=5)
    """Exponent of the change of the modulus with the distance from the smallest x. With 1 the
    change is linear.
    """
    parts: Moduli_kPa | None = Field(None, examples=[{"nodule": 80.0}])
    """Young's modulus of each part [kPa], by the name or number of the part in the file. The stiff
    ball has the name `nodule` and a default of 50 kPa.
    """
    poisson_ratio: float | None = Field(None, gt=-1, lt=0.5, examples=[0.45])
    """Poisson's ratio. Default: the value of `organ.material`."""
    fibre_direction: Annotated[Vector | None, Needs("organ.fibre_modulus_ratio")] = Field(
        None, examples=[(1.0, 0.0, 0.0)]
    )
    """Direction of the fibres. With fibres, the tissue is transversely isotropic."""
    fibre_modulus_ratio: Annotated[float, Needs("organ.fibre_direction")] = Field(
        1.0, ge=0.25, le=10
    )
    """Young's modulus along the fibres divided by Young's modulus across the fibres. The bulk
    modulus equals the bulk modulus of the tissue without fibres.
    """
    capsule: bool = False
    """Addition of a capsule to the surface. Its thickness and modulus are built-in constants."""
    gravity: bool = False
    """Deformation of the organ by its own weight, along -z."""
    viscous: bool = False
    """Viscous relaxation of the organ, by a Prony series with built-in constants."""
    law: Literal["linear", "neo-hookean", "mooney-rivlin", "yeoh", "ogden", "exponential"] = (
        "linear"
    )
    """Material law at large strains. At small strains, all laws have the moduli given above. Laws
    other than `linear` are solved between ticks.
    """
    second_share: Annotated[float | None, Needs("organ.law", "mooney-rivlin")] = Field(
        None, ge=0, le=1, examples=[0.3]
    )
    """Share of the shear modulus that belongs to the term of the second invariant in a
    Mooney-Rivlin law.
    """
    square_ratio: Annotated[float | None, Needs("organ.law", "yeoh")] = Field(
        None, ge=-1, le=100, examples=[0.1]
    )
    """Coefficient of the second power in a Yeoh law, divided by the coefficient of the first power.
    """
    cube_ratio: Annotated[float, Needs("organ.law", "yeoh")] = Field(0.0, ge=-1, le=100)
    """Coefficient of the third power in a Yeoh law, divided by the coefficient of the first power.
    """
    exponent: Annotated[float | None, Needs("organ.law", "ogden")] = Field(
        None, ge=-30, le=30, examples=[8.0]
    )
    """Exponent of the stretches in a one-term Ogden law. It must not be 0."""
    exponential_rate: Annotated[float | None, Needs("organ.law", "exponential")] = Field(
        None, gt=0, le=100, examples=[3.0]
    )
    """Rate of an exponential law of the first invariant. Default: the value of `organ.material`."""
    law_interval_ms: Annotated[float, Needs("organ.law")] = Field(25.0, ge=5, le=1000)
    """Time between two solves of a nonlinear law."""
    friction: float = Field(0.3, ge=0, le=2)
    """Coefficient of Coulomb friction between tool and organ."""
    order: Literal[1, 2] = 2
    """Order of the tetrahedra. Linear tetrahedra (1) lock if the tissue is nearly incompressible.
    Quadratic tetrahedra (2) take longer to set up.
    """
    path: Literal["condensed", "lazy", "reduced"] = "condensed"
    """Method used to evaluate the compliance of the surface in the 1 kHz loop. `condensed` computes
    the whole compliance matrix before the run. `lazy` computes only the columns of this matrix for
    the nodes near the tool. `reduced` approximates the matrix with a reduced basis.
    """
    basis_size: Annotated[int, Needs("organ.path", "reduced")] = Field(300, ge=10, le=3000)
    """Number of vectors of a reduced basis."""
    interval_ms: float = Field(100.0, ge=0, le=10_000)
    """Time between two frames (saved fields) of displacement, strain and stress. With 0 no frames
    are computed.
    """

    def rules(self) -> Iterator[Rule]:
        """Yield the rule for a material whose constants the organ does not use."""
        is_stated = self.young_kPa is not None and self.poisson_ratio is not None
        takes_rate = self.law == "exponential" and self.exponential_rate is None
        is_cited = self.capsule or self.gravity or self.viscous or takes_rate
        both = "with both organ.young_kPa and organ.poisson_ratio"
        yield "material", is_stated and not is_cited, both, "remove one of them"

    def require_valid(self) -> None:
        """Check that the exponent of an Ogden law is not 0."""
        if self.exponent == 0.0:
            raise InputError("organ.exponent", "not be 0", "0", "use 8")
