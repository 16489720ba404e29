"""Material constants that a scene uses, and values that the scene sets instead of constants."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from tissue.materials.constants import CUT_AS, Constant, listed, thermal_material
from tissue.materials.scene_constants import Materials
from tissue.scene.anatomy import BlockAnatomy
from tissue.scene.organ import IncisedAnatomy, LayersAnatomy, SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool

Part = tuple[str, str, tuple[str, ...] | None]
"""Table, material, and names of constants; None instead of names means all constants."""


@dataclass(frozen=True)
class Used:
    """Material constant that a scene uses.

    Attributes
    ----------
    of
        Text that names the table and the material to which the constant belongs.
    name
        Name of the constant, with its unit.
    cited
        Value, range, source and confidence. They come from the file named in the key `materials` if
        the file contains the constant; otherwise they are built in.
    full
        Full name ``TABLE.MATERIAL.NAME``. For a cutting constant that belongs to one layer,
        MATERIAL is the name of the layer.
    stated
        Value from a scene key that replaces the constant; None if there is no such key.
    """

    of: str
    name: str
    cited: Constant
    full: str
    stated: float | None = None


def used_constants(scene: Scene, layers: Sequence[str], *, varied: bool = False) -> list[Used]:
    """Return the constants of the tissue, the device and the hand of a scene.

    If all bone has the reference density, the density exponent has no effect and is left out. With
    `varied`, the exponent is included, because the reference density also varies.
    """
    return _used(
        scene.constants,
        _tables(scene, layers, varied),
        lambda table, material: _stated(scene, table, material),
    )


def used_of_cutting(
    given: Materials,
    layers: Sequence[str],
    *,
    bone: str,
    stated: Mapping[str, float],
    has_reference_density: bool,
) -> list[Used]:
    """Return the cutting constants that a cut through the given layers uses.

    `bone` is the material whose constants are used for bone. `stated` contains values that replace
    constants, keyed by the name of the constant. If all layers have the reference density, the
    density exponent has no effect and is left out.
    """
    parts = _cutting(given, layers, bone, has_reference_density=has_reference_density)
    return _used(given, parts, lambda table, material: stated)


def used_of_device(given: Materials, device: str | None, hand: str) -> list[Used]:
    """Return the constants of a haptic device and of the hand that holds it.

    If `device` is None, only the constants of the hand are returned.
    """
    return _used(given, _device(device, hand), lambda table, material: {})


def _used(
    given: Materials,
    parts: Iterable[Part],
    stated_of: Callable[[str, str], Mapping[str, float | None]],
) -> list[Used]:
    found: list[Used] = []
    for table, material, chosen in parts:
        stated = stated_of(table, material)
        # A file of constants may contain values for a single layer.
        is_listed = material in listed(table)
        known = given.constants(table, material) if is_listed else given.layer_constants(material)
        of = f"{table}, {material.replace('_', ' ')}"
        found += [
            Used(of, name, one, f"{table}.{material}.{name}", stated.get(name))
            for name, one in known.items()
            if chosen is None or name in chosen
        ]
    return found


def _tables(scene: Scene, layers: Sequence[str], varied: bool) -> Iterator[Part]:
    """Yield table, material and names of the constants that a scene uses."""
    anatomy = scene.anatomy
    if isinstance(scene.tool, Tool) and scene.tool.spin_rpm != 0.0:
        # At the reference density the exponent has no effect.
        even = not varied and _has_reference_density(scene)
        yield from _cutting(
            scene.constants, layers, scene.cutting.material, has_reference_density=even
        )
    yield from _tooth(scene, layers)
    if isinstance(anatomy, SoftAnatomy):
        organ = scene.organ
        elastic = ("modulus_kPa", "poisson_ratio")
        prefixes = (
            *elastic,
            *["density_kg_m3"] * organ.gravity,
            *["prony"] * organ.viscous,
            *["exponential_rate"] * (organ.law == "exponential"),
        )
        names = scene.constants.constants("soft", organ.material)
        yield "soft", organ.material, tuple(name for name in names if name.startswith(prefixes))
        if organ.capsule:
            yield "soft", f"{organ.material}_capsule", (*elastic, "thickness_um")
    if isinstance(anatomy, IncisedAnatomy):
        yield from _incised(anatomy)
    if isinstance(anatomy, LayersAnatomy):
        yield "needle", "liver", None
        stated = {"puncture_N": anatomy.membrane_punctures_N, "hold_N": anatomy.membrane_holds_N}
        count = len(anatomy.membranes)
        walls = tuple(key for key, given in stated.items() if len(given or {}) < count)
        if walls:
            yield "needle", "vessel_wall", walls
        if anatomy.interval_ms > 0.0:
            yield "soft", "liver", ("modulus_kPa",)
    if scene.device is not None and scene.device.kind in listed("devices"):
        yield from _device(scene.device.kind, scene.device.hand)


def _incised(anatomy: IncisedAnatomy) -> Iterator[Part]:
    """Yield the constants of a tissue that a blade cuts.

    The elastic constants of liver are used only to draw the deformed tissue.
    """
    is_drawn = anatomy.interval_ms > 0.0
    is_skin = anatomy.material == "skin"
    names = ["toughness_J_m2", "blade_friction_kPa"]
    names += ["modulus_kPa", "poisson_ratio"] * (is_skin or is_drawn) + ["prestrain"] * is_drawn
    yield "soft", anatomy.material, tuple(names)
    if not is_skin:
        yield "needle", "liver", ("linear_N_mm", "quadratic_N_mm2")


def _device(device: str | None, hand: str) -> Iterator[Part]:
    if device in listed("devices"):
        yield "devices", device, None
    yield "hands", "any", None
    if hand in listed("hands"):
        yield "hands", hand, None


def _cutting(
    given: Materials, layers: Sequence[str], bone: str, *, has_reference_density: bool
) -> Iterator[Part]:
    """Yield table, material and names of the cutting constants that layers use.

    If a constant has a value for one layer, the name of the layer replaces the material.
    """
    needed = dict[str, dict[str, None]]()
    # At the reference density, every exponent gives the same coefficients.
    fixed = {"density_exponent"} if has_reference_density else set()
    for layer in layers:
        material = CUT_AS.get(layer, bone)
        for name in given.constants("cutting", material):
            by = layer if f"cutting.{layer}.{name}" in given.given else material
            if name not in fixed:
                needed.setdefault(by, {})[name] = None
    for by, names in needed.items():
        yield "cutting", by, tuple(names)


def _tooth(scene: Scene, layers: Sequence[str]) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield elastic constants if stress is computed, and thermal constants if heat is computed.

    The modulus of caries is computed from its density and the modulus of dentin. The bone that
    holds the ligament is rigid. All layers of bone have the thermal constants of the material
    `bone`.
    """
    materials = [thermal_material(layer) for layer in layers]
    for material in dict.fromkeys((*materials, "ligament")):
        names = []
        if scene.stress is not None and material != "bone":
            names += ["poisson_ratio"] if material == "caries" else ["modulus_GPa", "poisson_ratio"]
        if scene.heat and material in materials:
            names += ["conductivity_W_mK", "heat_capacity_J_kgK", "density_kg_m3"]
        if names and material in listed("tooth"):
            yield "tooth", material, tuple(names)
    if scene.heat:
        yield "tooth", "bur", ("heat_share",)


def _has_reference_density(scene: Scene) -> bool:
    """Return whether all bone has the reference density of the cutting coefficients.

    The density exponent then has no effect.
    """
    if not isinstance(scene.anatomy, BlockAnatomy):
        return False
    reference = scene.constants.constants("cutting", scene.cutting.material)[
        "reference_density_kg_m3"
    ]
    return scene.anatomy.density_kg_m3 == reference.value


def _stated(scene: Scene, table: str, material: str) -> dict[str, float | None]:
    """Return values of scene keys that replace constants of a material, keyed by constant."""
    if table == "cutting":
        stated = scene.cutting.model_dump(exclude={"material"})
        if stated["minimum_chip_um"] == 0.0 and stated["size_exponent"] is None:
            stated["size_exponent"] = 0.0  # the linear law
        return dict(stated)
    if (table, material) == ("soft", scene.organ.material) and isinstance(
        scene.anatomy, SoftAnatomy
    ):
        return {
            "modulus_kPa": scene.organ.young_kPa,
            "poisson_ratio": scene.organ.poisson_ratio,
            "exponential_rate": scene.organ.exponential_rate,
        }
    return {}
