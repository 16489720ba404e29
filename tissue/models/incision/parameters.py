"""Blade, and tissue that it cuts."""

from dataclasses import dataclass, fields
from math import pi, radians, tan

from scipy.special import ellipk

from meshes.base.errors import InputError, require_positive, require_range
from tissue.materials.scene_constants import Materials

__all__ = ["Blade", "IncisedTissue", "incised_tissue"]


@dataclass(frozen=True, kw_only=True)
class Blade:
    """Thin plate with a straight cutting edge at its lower end.

    Its plane is spanned by the tool's x axis and its axis z. The edge begins at the tip and ends at
    a distance along x. Both sides and the edge cut.

    Attributes
    ----------
    width_m, thickness_m
        Width along x, and thickness [m].
    edge_rad
        Angle between edge and axis [rad]: a right angle for a chisel, less for a pointed blade.
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
        """Height of the edge above the tip, per distance along x."""
        return max(1.0 / tan(self.edge_rad), 0.0)


@dataclass(frozen=True, kw_only=True)
class IncisedTissue:
    """Parameters of a tissue that a blade cuts.

    Attributes
    ----------
    name
        Name in layers.
    toughness_J_m2
        Energy that a unit of cut area takes, J [J/m2].
    friction_Pa
        Friction per area of each wall that touches the blade, tau [Pa].
    young_Pa, poisson_ratio
        Elastic constants: Young's modulus [Pa] and Poisson's ratio.
    prestrain
        Strain across the cut that relaxes when it opens. It only widens the drawn cut.
    """

    name: str
    toughness_J_m2: float
    friction_Pa: float
    young_Pa: float
    poisson_ratio: float
    prestrain: float

    def __post_init__(self) -> None:
        for entry in fields(self):
            if entry.name in ("toughness_J_m2", "young_Pa"):
                require_positive(entry.name, getattr(self, entry.name), "give it in SI units")
        require_range("friction_Pa", self.friction_Pa, 0.0, 1e6, "give it in Pa")
        require_range("poisson_ratio", self.poisson_ratio, 0.0, 0.5, "use 0.49")
        require_range("prestrain", self.prestrain, 0.0, 1.0, "use 0 for a cut that stays closed")

    def stiffness_N_m(self, blade: Blade) -> float:
        """Return the stiffness of the tissue under the blade's lower end [N/m].

        It is that of a rigid elliptical punch on a half space, pi E* a / K(e) with half axes a and
        b, e² = 1 - b²/a² and K the complete elliptic integral (Johnson 1985). It is used in all
        directions and does not change with the depth of the cut.
        """
        modulus = self.young_Pa / (1.0 - self.poisson_ratio**2)
        flat = 1.0 - (blade.thickness_m / blade.width_m) ** 2
        return pi * modulus * 0.5 * blade.width_m / float(ellipk(flat))


def incised_tissue(name: str, *, constants: Materials = Materials.cited) -> IncisedTissue:
    """Return a tissue with its constants in `soft.toml`."""
    found = {key: entry.value for key, entry in constants.constants("soft", name).items()}
    return IncisedTissue(
        name=name,
        toughness_J_m2=found["toughness_J_m2"],
        friction_Pa=1e3 * found["blade_friction_kPa"],
        young_Pa=1e3 * found["modulus_kPa"],
        poisson_ratio=found["poisson_ratio"],
        prestrain=found["prestrain"],
    )
