"""Parameters of a needle insertion: membranes, cutting force and shaft friction."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from math import sqrt

from meshes.base.errors import (
    InputError,
    enumerated,
    names_of_caller,
    require_positive,
    require_range,
)
from tissue.materials.scene_constants import Materials

LARGEST_N = 1e4
"""Largest allowed value of a force parameter [N]; a larger value probably has a wrong unit."""
LARGEST_N_M = 1e6
"""Largest allowed force per length [N/m], and largest allowed viscous coefficient [N s/m2]."""
LEAST_COSINE = 0.17
"""Smallest cosine between the needle's axis and the surface normal.

The angle between axis and surface must be larger than 10 degrees, because the model has no force
across the axis.
"""


@dataclass(frozen=True, kw_only=True)
class Membrane:
    """Thin layer that a needle's tip punctures at a certain force.

    Attributes
    ----------
    name
        Name of the membrane in events and in the list of layers.
    depth_m
        Depth [m] below the undeformed surface; 0 for the organ's capsule.
    puncture_N
        Force of the tip at which the membrane breaks [N].
    hold_N
        Elastic force [N] that the edge of the hole exerts on the shaft after the puncture. The
        force resists both insertion and withdrawal of the shaft.
    """

    name: str
    depth_m: float
    puncture_N: float
    hold_N: float

    def __post_init__(self) -> None:
        require_range(
            f"depth_m of the {self.name}",
            self.depth_m,
            0.0,
            1.0,
            "measure it in metres from the surface",
        )
        require_positive(
            f"puncture_N of the {self.name}",
            self.puncture_N,
            "leave out a membrane that has no resistance",
        )
        require_range(
            f"hold_N of the {self.name}",
            self.hold_N,
            0.0,
            LARGEST_N,
            "use 0 for a hole that does not hold the shaft",
        )


@dataclass(frozen=True, kw_only=True)
class ShaftFriction:
    """Karnopp's friction law along the inserted length, as modified by Okamura (2004).

    The coefficients differ between insertion and withdrawal.

    Attributes
    ----------
    sliding_in_N_m, sliding_out_N_m
        Coulomb friction per length while the shaft slides [N/m]: Okamura's C_p and the magnitude of
        his C_n.
    viscous_in_N_s_m2, viscous_out_N_s_m2
        Viscous friction coefficients per length [N s/m2]: Okamura's b_p and the magnitude of his
        b_n.
    static_in_N_m, static_out_N_m
        Friction per length at which a shaft at rest starts to move [N/m]: Okamura's D_p and the
        magnitude of his D_n.
    stick_band_m_s
        Width of the range of speeds around zero that is treated as rest [m/s]. At speeds below half
        of this width the friction is the static friction.
    """

    sliding_in_N_m: float
    sliding_out_N_m: float
    viscous_in_N_s_m2: float
    viscous_out_N_s_m2: float
    static_in_N_m: float
    static_out_N_m: float
    stick_band_m_s: float

    def __post_init__(self) -> None:
        for entry in fields(self):
            require_range(
                entry.name,
                getattr(self, entry.name),
                0.0,
                LARGEST_N_M,
                "give its size, in SI units",
            )
        for side in ("in", "out"):
            sliding = getattr(self, f"sliding_{side}_N_m")
            static = getattr(self, f"static_{side}_N_m")
            if static < sliding:
                raise InputError(
                    f"static_{side}_N_m",
                    f"be at least sliding_{side}_N_m ({sliding:g})",
                    f"{static:g}",
                    "use a static friction of at least the sliding friction",
                )


@dataclass(frozen=True, kw_only=True)
class NeedleTissue:
    """Parameters of an organ that determine the force on a needle along its axis.

    Attributes
    ----------
    linear_N_m, quadratic_N_m2
        Coefficients a1 [N/m] and a2 [N/m2] of the organ's force on the needle, a1 u + a2 u², at a
        deflection u of the organ's surface (Okamura 2004).
    cutting_N
        Force of the tip that cuts the tissue between membranes [N].
    friction
        Friction along the inserted length.
    membranes
        Membranes, from the surface downwards.

    Raises
    ------
    InputError
        If a number is not plausible, if membranes are not ordered by depth, or if the static
        friction per length is not smaller than `linear_N_m`. With such a large static friction, a
        needle would jump out of the organ during withdrawal.
    """

    linear_N_m: float
    quadratic_N_m2: float
    cutting_N: float
    friction: ShaftFriction
    membranes: tuple[Membrane, ...] = ()

    def __post_init__(self) -> None:
        require_positive("linear_N_m", self.linear_N_m, "give the stiffness of the organ")
        require_range(
            "quadratic_N_m2",
            self.quadratic_N_m2,
            0.0,
            # With this bound, the quadratic part reaches the largest force per length at a
            # deflection of 1 mm.
            1e3 * LARGEST_N_M,
            "give it in N/m2, or 0 for a linear organ",
        )
        require_range("cutting_N", self.cutting_N, 0.0, LARGEST_N, "give it in N")
        depths = [membrane.depth_m for membrane in self.membranes]
        if any(below <= above for above, below in pairwise(depths)):
            found = enumerated(f"{1e3 * depth:g} mm" for depth in depths)
            raise InputError(
                "membranes",
                "be listed from the surface downwards",
                f"depths of {found}",
                "sort the membranes",
            )
        names = [membrane.name for membrane in self.membranes]
        # Layers of the trace are named by membranes, and parenchyma is one of them.
        if len({*names, "parenchyma"}) <= len(names):
            raise InputError(
                "membranes",
                "have different names, none of them parenchyma",
                enumerated(names),
                "rename one membrane",
            )
        static = max(self.friction.static_in_N_m, self.friction.static_out_N_m)
        if static >= self.linear_N_m:
            raise InputError(
                "linear_N_m",
                f"be greater than the static friction per length ({static:g} N/m)",
                f"{self.linear_N_m:g}",
                (
                    "use a larger stiffness or less friction: otherwise the needle would "
                    "jump out when it is pulled back"
                ),
            )

    def pull_N(self, deflection_m: float) -> float:
        """Return the force of the organ on the needle [N], positive against insertion.

        The force is an odd function of the deflection.
        """
        return (self.linear_N_m + self.quadratic_N_m2 * abs(deflection_m)) * deflection_m

    def deflection_m(self, pull_N: float) -> float:
        """Return the deflection [m] at which the organ pulls with a given force (0 or larger)."""
        return positive_root(self.quadratic_N_m2, self.linear_N_m, pull_N)


def positive_root(a: float, b: float, c: float) -> float:
    """Return the root x >= 0 of a x² + b x = c for a >= 0 and b > 0, or 0 if c is negative."""
    # This form of the solution loses no digits for a small a.
    return 2.0 * c / (b + sqrt(b * b + 4.0 * a * c)) if c > 0.0 else 0.0


def vessel_wall(
    depth_m: float,
    *,
    name: str = "vessel wall",
    puncture_N: float | None = None,
    hold_N: float | None = None,
    constants: Materials = Materials.cited,
) -> Membrane:
    """Return the wall of a vessel, or another membrane inside an organ, at a depth [m].

    If a force is None, an assumed constant for the wall of a vessel is used. This constant has no
    source.
    """
    wall = constants.values("needle", "vessel_wall")
    return Membrane(
        name=name,
        depth_m=depth_m,
        puncture_N=wall["puncture_N"] if puncture_N is None else puncture_N,
        hold_N=wall["hold_N"] if hold_N is None else hold_N,
    )


def needle_tissue(
    *, walls: Sequence[Membrane] = (), constants: Materials = Materials.cited
) -> NeedleTissue:
    """Return bovine liver under its capsule, with inner membranes ordered by depth.

    The constants were measured with one needle in one organ (Okamura 2004).

    Raises
    ------
    InputError
        If a membrane does not lie below the capsule, or below the previous membrane.
    """
    liver = constants.values("needle", "liver")
    keys = {f"{name} of the capsule": f"capsule_{name}" for name in ("puncture_N", "hold_N")}
    with names_of_caller(keys):
        capsule = Membrane(
            name="capsule",
            depth_m=0.0,
            puncture_N=liver["capsule_puncture_N"],
            hold_N=liver["capsule_hold_N"],
        )
    # A user may give one of two constants that must fit each other.
    origins = {name: constants.origin("needle", "liver", name) for name in liver}
    labels = {
        name: f"{name} ({'built-in value' if origin == 'cited' else origin})"
        for name, origin in origins.items()
    }
    with names_of_caller(labels if constants.given else {}):
        friction = ShaftFriction(
            sliding_in_N_m=liver["sliding_in_N_m"],
            sliding_out_N_m=liver["sliding_out_N_m"],
            viscous_in_N_s_m2=liver["viscous_in_N_s_m2"],
            viscous_out_N_s_m2=liver["viscous_out_N_s_m2"],
            static_in_N_m=liver["static_in_N_m"],
            static_out_N_m=liver["static_out_N_m"],
            stick_band_m_s=1e-3 * liver["stick_band_mm_s"],
        )
    return NeedleTissue(
        linear_N_m=1e3 * liver["linear_N_mm"],
        quadratic_N_m2=1e6 * liver["quadratic_N_mm2"],
        cutting_N=liver["cutting_N"],
        friction=friction,
        membranes=(capsule, *walls),
    )
