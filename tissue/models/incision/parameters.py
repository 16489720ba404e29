"""Parameters of a blade and of the tissue that it cuts."""

from dataclasses import dataclass
from math import pi, radians, tan

from scipy.special import ellipk

from meshes.base.errors import InputError, require_positive, require_range
from tissue.materials.scene_constants import Materials
from tissue.models.needle.parameters import positive_root


@dataclass(frozen=True, kw_only=True)
class Blade:
    """Thin plate with a straight cutting edge at its lower end.

    The plane of the plate is spanned by the tool's axes x and z. The edge begins at the tip and
    ends at the distance `width_m` along x. The edge and the two sides cut.

    Attributes
    ----------
    width_m, thickness_m
        Width along x [m] and thickness [m].
    edge_rad
        Angle between the edge and the z axis [rad]: pi/2 for a chisel, less for a pointed blade.
    """

    width_m: float
    thickness_m: float
    edge_rad: float

    def __post_init__(self) -> None:
        require_positive("thickness_m", self.thickness_m, "a scalpel blade has 0.4e-3 m")
        if not self.width_m > self.thickness_m:
            raise InputError(
                "width_m",
                f"be greater than thickness_m ({self.thickness_m:g})",
                f"{self.width_m:g}",
                "a scalpel blade has 6e-3 m",
            )
        require_range(
            "edge_rad", self.edge_rad, radians(5.0), 0.5 * pi, "a chisel has a right angle, pi / 2"
        )

    @property
    def rise(self) -> float:
        """Slope of the edge: height above the tip, along z, per distance along x."""
        return 1.0 / tan(self.edge_rad)


@dataclass(frozen=True, kw_only=True)
class IncisedTissue:
    """Parameters of a tissue that a blade cuts.

    Attributes
    ----------
    name
        Name of the layer.
    toughness_J_m2
        Fracture toughness J: energy per cut area [J/m2].
    friction_Pa
        Friction tau per area of each wall that touches the blade [Pa].
    stiffness_N_m
        Force of the tissue on a blade divided by the deflection of the tissue [N/m]. The value is
        equal in all directions.
    young_Pa, poisson_ratio
        Young's modulus [Pa] and Poisson's ratio of the tissue block in the displayed fields.
    prestrain
        Strain of the uncut tissue across the plane of the cut. The strain relaxes when the cut
        opens. The prestrain affects only the width of the drawn cut.
    """

    name: str
    toughness_J_m2: float
    friction_Pa: float
    stiffness_N_m: float
    young_Pa: float
    poisson_ratio: float
    prestrain: float

    def __post_init__(self) -> None:
        for name in ("toughness_J_m2", "stiffness_N_m", "young_Pa"):
            require_positive(name, getattr(self, name), "give it in SI units")
        require_range("friction_Pa", self.friction_Pa, 0.0, 1e6, "give it in Pa")
        require_range("poisson_ratio", self.poisson_ratio, 0.0, 0.5, "use a value such as 0.49")
        require_range("prestrain", self.prestrain, 0.0, 1.0, "use 0 for a cut that stays closed")


def punch_stiffness_N_m(blade: Blade, *, young_Pa: float, poisson_ratio: float) -> float:
    """Return the stiffness of an elastic half space under the blade's lower end [N/m].

    The lower end is modelled as a rigid elliptical punch with half axes a and b. The stiffness
    under the punch is pi E* a / K(e). Here E* = E / (1 - nu²), e² = 1 - b²/a², and K is the
    complete elliptic integral of the first kind (Johnson 1985).
    """
    modulus = young_Pa / (1.0 - poisson_ratio**2)
    flat = 1.0 - (blade.thickness_m / blade.width_m) ** 2
    return pi * modulus * 0.5 * blade.width_m / float(ellipk(flat))


def secant_stiffness_N_m(force_N: float, *, constants: Materials) -> float:
    """Return the secant stiffness that the needle model gives for liver at a given force [N/m].

    The stiffness is not computed from the small-strain modulus of liver. With this modulus, a half
    space under a blade would deflect by centimetres. This is several times the deflection of liver
    under the needle.
    """
    liver = constants.values("needle", "liver")
    deflection = positive_root(1e6 * liver["quadratic_N_mm2"], 1e3 * liver["linear_N_mm"], force_N)
    return force_N / deflection


def incised_tissue(
    name: str, blade: Blade, *, constants: Materials = Materials.cited
) -> IncisedTissue:
    """Return the parameters of a tissue, with the material constants of the file `soft.toml`.

    The stiffness of skin is the stiffness of a half space, see `punch_stiffness_N_m`. The stiffness
    of liver is `secant_stiffness_N_m` for the force with which the whole edge cuts.
    """
    found = constants.values("soft", name)
    young = 1e3 * found["modulus_kPa"]
    toughness = found["toughness_J_m2"]
    if name == "liver":
        stiffness = secant_stiffness_N_m(toughness * blade.width_m, constants=constants)
    else:
        stiffness = punch_stiffness_N_m(blade, young_Pa=young, poisson_ratio=found["poisson_ratio"])
    return IncisedTissue(
        name=name,
        toughness_J_m2=toughness,
        friction_Pa=1e3 * found["blade_friction_kPa"],
        stiffness_N_m=stiffness,
        young_Pa=young,
        poisson_ratio=found["poisson_ratio"],
        prestrain=found["prestrain"],
    )
