"""Soft organs, as tables of a scene: shape, support and material."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, Strict

from meshes.base.errors import PRESENT, InputError
from tissue.scene.names import ORGAN_MATERIALS
from tissue.scene.part import FileName, Length_mm, Needs, OneOf, Part, Rule, Vector

LAYERS = ("capsule", "parenchyma")
"""Names of the layers that every tissue for a needle has."""


class SoftAnatomy(Part):
    """Table ``anatomy`` of a scene, for a soft organ with a mesh of tetrahedra."""

    source: ClassVar[str] = "procedural"
    """Origin of the shape, as error messages name it."""
    reads: ClassVar[tuple[str, ...]] = ("organ",)
    """Other tables of a scene that have an effect with this anatomy."""
    kind: str
    edge_mm: float = Field(20.0, ge=1, le=50)
    """Edge length of the tetrahedra far from the path of the tool."""
    touch_edge_mm: float | None = Field(None, ge=0.2, le=50, examples=[4.0])
    """Longest edge of the tetrahedra on the tool's path. Default: a quarter of the probe's
    diameter.
    """
    edge_growth: float = Field(0.5, gt=0, le=5)
    """Increase of the edge length [mm] for each millimetre of distance from the tool's path, up to
    the length `edge_mm`.
    """

    @property
    def nodule_mm(self) -> float:
        """Diameter of the nodule, a stiff ball in the tissue [mm]; 0 without a nodule."""
        return float(getattr(self, "nodule_diameter_mm", 0.0))


class WithNodule(SoftAnatomy):
    """Soft organ that may contain a nodule (a stiff ball)."""

    nodule_diameter_mm: float = Field(0.0, ge=0, le=60)
    """Diameter of a stiff ball (nodule) in the tissue. With 0 there is no nodule."""
    nodule_centre_mm: Annotated[Vector, Needs("anatomy.nodule_diameter_mm")] = (0.0, 0.0, -15.0)
    """Centre of the nodule, in the frame of the scene."""


class Held(SoftAnatomy):
    """Liver, or organ from a file, that is fixed at a part of its surface."""

    kind: Literal["liver"] = "liver"
    """A liver, or the organ in `file`."""
    held: Literal["below", "back", "plane", "part"] = "below"
    """Fixed part of the organ: `below` is the lower surface, `back` the back surface, `plane` the
    surface below the height `held_below_mm`, and `part` the part `held_part` of the file.
    """
    held_below_mm: Annotated[float, Needs("anatomy.held", "plane")] = Field(-80.0, ge=-1000, le=0)
    """Height below which the surface is fixed if `held = "plane"`."""
    held_part: Annotated[str | None, Needs("anatomy.held", "part")] = Field(
        None, examples=["ligament"]
    )
    """Name or number of the part in the file that is fixed if `held = "part"`."""


class LiverAnatomy(Held, WithNodule):
    """A liver.

    The origin is on top of the right lobe; z points to the head, x to the patient's left.
    """


class LiverFile(Held):
    """An organ from a file.

    The origin is the surface point nearest to `centre_mm`. Without `centre_mm`, the origin is the
    surface point that is farthest in the direction `normal`.
    """

    source: ClassVar[str] = "from a file"
    file: FileName = Field(examples=["liver.vtu"])
    """File with tetrahedra (.vtk .vtu .msh .mesh) or a closed surface (.stl .obj .ply .vtk .vtp),
    which the program fills with tetrahedra.
    """
    scale_mm: float | None = Field(None, gt=0, le=1e5, examples=[1.0])
    """Millimetres per length unit of the file."""
    centre_mm: Vector | None = Field(None, examples=[(0.0, 0.0, 50.0)])
    """Point in the file's frame where the tool touches the organ. The nearest point of the surface
    becomes the origin.
    """
    normal: Vector = (0.0, 0.0, 1.0)
    """Direction from the organ to the tool, in the file's frame. This direction becomes the z
    axis.
    """
    along: Vector | None = Field(None, examples=[(1.0, 0.0, 0.0)])
    """Direction in the file's frame; its component perpendicular to `normal` becomes the x axis.
    """


class SlabAnatomy(WithNodule):
    """A block of soft tissue with its top face at z = 0 and a fixed bottom face.

    The block is a phantom for palpation.
    """

    kind: Literal["slab"] = "slab"
    """A slab."""
    size_mm: Annotated[tuple[Length_mm, Length_mm, Length_mm], Strict(False)] = (120.0, 80.0, 40.0)
    """Edge lengths along x, y and z."""
    edge_mm: float = Field(8.0, ge=0.5, le=20)
    """Edge length of the tetrahedra at the top face, far from the tool.

    The edge length increases downwards.
    """


def _apart(depths_mm: dict[str, float]) -> dict[str, float] | None:
    """Raise an error if two membranes have the same depth, or one has the name of a layer.

    Return the depths; None for an empty table.
    """
    listed = sorted(depths_mm.items(), key=lambda each: each[1])
    for name, _ in listed:
        if name in LAYERS:
            raise InputError(
                "anatomy.membrane_depths_mm",
                f"not contain the name {name}, which is the name of a layer",
                PRESENT,
                "choose another name",
            )
    for (above, depth_mm), (below, other_mm) in pairwise(listed):
        if depth_mm == other_mm:
            raise InputError(
                "anatomy.membrane_depths_mm",
                "have a different depth for each membrane",
                f"{depth_mm:g} mm for {above} and {below}",
                "change one of the two depths",
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
    """Tissue for a needle: a capsule at z = 0, and soft tissue with membranes below the capsule."""

    reads: ClassVar[tuple[str, ...]] = ()
    kind: Literal["layers"] = "layers"
    """Layered tissue."""
    membrane_depths_mm: Depths_mm | None = Field(None, examples=[{"vessel wall": 40.0}])
    """Depth below the capsule of each membrane, keyed by the membrane's name. The two walls of a
    vessel, for example, are two membranes. Default: no membranes.
    """
    membrane_punctures_N: Punctures_N | None = Field(None, examples=[{"vessel wall": 1.8}])
    """Force at the needle's tip at which a membrane breaks, keyed by the membrane's name. Default:
    the built-in value for the wall of a vessel.
    """
    membrane_holds_N: Holds_N | None = Field(None, examples=[{"vessel wall": 0.3}])
    """Friction force between the needle's shaft and the edge of the hole in a membrane, keyed by
    the membrane's name. Default: the built-in value for the wall of a vessel.
    """
    interval_ms: float = Field(100.0, ge=0, le=10_000)
    """Time between two saved fields of displacement, strain and stress around the needle. With 0 no
    fields are computed.
    """

    def require_valid(self) -> None:
        """Check that each membrane with a given puncture or hold force also has a depth."""
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
    """Tissue whose built-in constants are used."""
    interval_ms: float = Field(100.0, ge=0, le=10_000)
    """Time between two saved shapes of the opened cut. With 0 no shapes are computed."""


Modulus_kPa = Annotated[float, Field(ge=0.1, le=1e5, examples=[80.0])]
Moduli_kPa = Annotated[dict[str, Modulus_kPa], AfterValidator(lambda moduli: moduli or None)]
"""Type of a table with Young's modulus of each part [kPa]; an empty table becomes None."""


LAW_SHAPES = {
    "mooney-rivlin": ("second_share",),
    "yeoh": ("square_ratio", "cube_ratio"),
    "ogden": ("exponent",),
    "exponential": ("exponential_rate",),
}
"""Keys with the parameters of a hyperelastic law, besides Young's modulus and Poisson's ratio.

The first key of each law is required. Only for the exponential law it is optional, because the rate
has a built-in value for a pressed liver.
"""


class Organ(Part):
    """Material of a soft organ, and the method by which the deformation is computed."""

    material: Annotated[str, OneOf(ORGAN_MATERIALS)] = "liver"
    """Tissue whose built-in constants are used for keys that are left out."""
    young_kPa: float | None = Field(None, ge=0.1, le=1e5, examples=[5.4])
    """Young's modulus. Default: the value of `organ.material`."""
    young_end_kPa: float | None = Field(None, ge=0.1, le=1e5, examples=[50.0])
    """Young's modulus at the largest x of the organ. Along x, the modulus changes from `young_kPa`
    to this value.
    """
    grading_exponent: Annotated[float, Needs("organ.young_end_kPa")] = Field(1.0, ge=0.2, le=5)
    """Exponent n of the change of the modulus along x: the change is proportional to (distance from
    the smallest x) ** n.
    """
    parts: Moduli_kPa | None = Field(None, examples=[{"nodule": 80.0}])
    """Young's modulus of each part [kPa], keyed by the name or number of the part in the file. The
    key `nodule` is the stiff ball, whose default is 50 kPa.
    """
    poisson_ratio: float | None = Field(None, gt=-1, lt=0.5, examples=[0.45])
    """Poisson's ratio. Default: the value of `organ.material`."""
    fibre_direction: Annotated[Vector | None, Needs("organ.fibre_modulus_ratio")] = Field(
        None, examples=[(1.0, 0.0, 0.0)]
    )
    """Direction of the fibres in a transversely isotropic tissue. Default: isotropic tissue."""
    fibre_modulus_ratio: Annotated[float, Needs("organ.fibre_direction")] = Field(
        1.0, ge=0.25, le=10
    )
    """Young's modulus along the fibres divided by Young's modulus across the fibres. The ratio does
    not change the bulk modulus.
    """
    capsule: bool = False
    """True to add a capsule (a thin membrane) to the surface. Its thickness and modulus are
    built-in constants.
    """
    gravity: bool = False
    """True to deform the organ by its own weight, along -z."""
    viscous: bool = False
    """True to model viscous relaxation of the tissue, by a Prony series with built-in constants."""
    law: Literal["linear", "neo-hookean", "mooney-rivlin", "yeoh", "ogden", "exponential"] = (
        "linear"
    )
    """Elastic law of the tissue. At small strains, all laws have the given Young's modulus and
    Poisson's ratio. For laws other than `linear`, the deformation is solved less often than once
    per tick; see `law_interval_ms`.
    """
    second_share: Annotated[float | None, Needs("organ.law", "mooney-rivlin")] = Field(
        None, ge=0, le=1, examples=[0.3]
    )
    """Share of the second-invariant term in the shear modulus of a Mooney-Rivlin law."""
    square_ratio: Annotated[float | None, Needs("organ.law", "yeoh")] = Field(
        None, ge=-1, le=100, examples=[0.1]
    )
    """Coefficient of the second-power term in a Yeoh law, divided by the coefficient of the
    first-power term.
    """
    cube_ratio: Annotated[float, Needs("organ.law", "yeoh")] = Field(0.0, ge=-1, le=100)
    """Coefficient of the third-power term in a Yeoh law, divided by the coefficient of the
    first-power term.
    """
    exponent: Annotated[float | None, Needs("organ.law", "ogden")] = Field(
        None, ge=-30, le=30, examples=[8.0]
    )
    """Exponent of the stretches in a one-term Ogden law. It must not be 0."""
    exponential_rate: Annotated[float | None, Needs("organ.law", "exponential")] = Field(
        None, gt=0, le=100, examples=[3.0]
    )
    """Factor in the exponent of an exponential law, whose energy depends on the first invariant.
    Default: the value of `organ.material`.
    """
    law_interval_ms: Annotated[float, Needs("organ.law")] = Field(25.0, ge=5, le=1000)
    """Time between two solutions of the deformation with a law other than `linear`."""
    friction: float = Field(0.3, ge=0, le=2)
    """Coefficient of Coulomb friction between tool and organ."""
    order: Literal[1, 2] = 2
    """Order of the tetrahedra. Linear tetrahedra (1) are too stiff (locking) if the tissue is
    nearly incompressible. Quadratic tetrahedra (2) take longer before the run.
    """
    path: Literal["condensed", "reduced"] = "condensed"
    """Method used to evaluate the compliance of the surface in the 1 kHz loop. `condensed` computes
    the whole compliance matrix before the run. `reduced` approximates the matrix with a reduced
    basis.
    """
    basis_size: Annotated[int, Needs("organ.path", "reduced")] = Field(300, ge=10, le=3000)
    """Number of vectors in the reduced basis of `path = "reduced"`."""
    interval_ms: float = Field(100.0, ge=0, le=10_000)
    """Time between two saved fields of displacement, strain and stress. With 0 no fields are
    computed.
    """

    def rules(self) -> Iterator[Rule]:
        """Yield the condition under which the key `material` has no effect."""
        is_stated = self.young_kPa is not None and self.poisson_ratio is not None
        takes_rate = self.law == "exponential" and self.exponential_rate is None
        is_cited = self.capsule or self.gravity or self.viscous or takes_rate
        both = "with both organ.young_kPa and organ.poisson_ratio"
        yield "material", is_stated and not is_cited, both, "remove one of these two keys"

    def require_valid(self) -> None:
        """Check that the exponent of an Ogden law is not 0."""
        if self.exponent == 0.0:
            raise InputError("organ.exponent", "not be 0", PRESENT, "use a value such as 8")
