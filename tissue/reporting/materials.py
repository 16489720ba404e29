"""The cited constants that a scene rests on, and those that it states itself."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from tissue.materials.constants import Constant, constants, listed
from tissue.materials.cutting import CUT_AS
from tissue.scene.organ import LayersAnatomy, SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool

__all__ = ["Used", "used_constants"]


@dataclass(frozen=True)
class Used:
    """A constant of a scene.

    Attributes
    ----------
    of
        Table and material.
    name
        Its name, with its unit.
    cited
        Value, range, source and confidence.
    stated
        What the scene states in its place, None where the cited value is used.
    """

    of: str
    name: str
    cited: Constant
    stated: float | None = None


def used_constants(scene: Scene, layers: Sequence[str]) -> list[Used]:
    """Constants of the tissue's layers, and of device and hand where there are any, in the order of their tables."""
    found = []
    for table, material, chosen in _tables(scene, layers):
        stated = _stated(scene, table)
        found += [
            Used(f"{table}, {material.replace('_', ' ')}", name, one, stated.get(name))
            for name, one in constants(table, material).items()
            if chosen is None or name in chosen
        ]
    return found


def _tables(scene: Scene, layers: Sequence[str]) -> Iterator[tuple[str, str, tuple[str, ...] | None]]:
    """Tables and materials, with the names that are used where it is not all of them."""
    anatomy, tool = scene.anatomy, scene.tool
    if isinstance(tool, Tool) and tool.spin_rpm != 0.0:
        for material in dict.fromkeys(CUT_AS.get(layer, scene.cutting.material) for layer in layers):
            yield "cutting", material, None
    if scene.stress is not None or scene.heat:
        elastic = ("modulus_GPa", "poisson_ratio") if not scene.heat else None
        for layer in [layer for layer in dict.fromkeys((*layers, "ligament")) if layer in listed("tooth")]:
            yield "tooth", layer, elastic
        if scene.heat:
            yield "tooth", "bur", None
    if isinstance(anatomy, SoftAnatomy):
        organ = scene.organ
        names = ["modulus_kPa", "poisson_ratio"] + ["density_kg_m3"] * organ.gravity
        if organ.viscous:
            names += [name for name in constants("soft", organ.material) if name.startswith("prony")]
        yield "soft", organ.material, tuple(names)
        if organ.capsule:
            yield "soft", f"{organ.material}_capsule", None
    if isinstance(anatomy, LayersAnatomy):
        yield "needle", "liver", None
        if anatomy.vessel_wall_depth_mm is not None:
            yield "needle", "vessel_wall", None
        if anatomy.interval_ms > 0.0:
            yield "soft", "liver", ("modulus_kPa", "poisson_ratio")
    if scene.device in listed("devices"):
        yield "devices", scene.device, None
        yield "hands", "any", None
        if scene.hand in listed("hands"):
            yield "hands", scene.hand, None


def _stated(scene: Scene, table: str) -> dict[str, float | None]:
    """What a scene states in place of a table's constants."""
    if table == "cutting":
        return dict(scene.cutting.model_dump())
    if table == "soft":
        return {"modulus_kPa": scene.organ.young_kPa, "poisson_ratio": scene.organ.poisson_ratio}
    return {}
