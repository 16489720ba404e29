"""Membranes under the capsule as a fit of a needle has them: where they lie, and whose forces are free."""

from collections.abc import Sequence
from dataclasses import dataclass

from tissue.fitting.parameter import Parameter
from tissue.materials.prior import Prior
from tissue.scene.organ import LayersAnatomy

__all__ = ["CITED", "KEYS", "Wall", "stated_forces", "walls_of"]

KEYS = "anatomy.membrane_"
"""Beginning of the names of forces that are keys of a scene."""
CITED = ("needle.vessel_wall.puncture_N", "needle.vessel_wall.hold_N")
"""Constants of the membranes whose forces a scene does not state: one value for all of them."""
STATED = (0.5, 2.0)
"""5 and 95 % of a force that a scene states, over it: assumed, as wide as membranes of one organ differ."""


@dataclass(frozen=True)
class Wall:
    """A membrane under the capsule.

    Attributes
    ----------
    depth_m
        Along the needle's axis from the undeformed surface [m].
    puncture, hold
        Names of its forces: constants, or keys of a scene.
    """

    depth_m: float
    puncture: str = CITED[0]
    hold: str = CITED[1]


def walls_of(anatomy: LayersAnatomy) -> tuple[Wall, ...]:
    """Membranes of a scene, from the surface downwards."""
    keys = ("membrane_punctures_N", "membrane_holds_N")
    return tuple(
        Wall(
            1e-3 * depth_mm,
            *(
                f"anatomy.{key}.{name}" if name in (getattr(anatomy, key) or {}) else cited
                for key, cited in zip(keys, CITED, strict=True)
            ),
        )
        for name, depth_mm in anatomy.membranes
    )


def stated_forces(anatomy: LayersAnatomy) -> tuple[dict[str, float], Sequence[Parameter]]:
    """Forces that a scene states by their keys [N], and those of them that are free: a hold of 0 has no range."""
    given = {"punctures_N": anatomy.membrane_punctures_N, "holds_N": anatomy.membrane_holds_N}
    known = {f"{KEYS}{kind}.{name}": force for kind, forces in given.items() for name, force in (forces or {}).items()}
    low, high = STATED
    free = [Parameter(name, Prior(force, low * force, high * force)) for name, force in known.items() if force > 0.0]
    return known, free
