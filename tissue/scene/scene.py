"""Scenes: frozen, validated descriptions of a simulation.

A scene is a TOML file. Every quantity carries its unit in its name. A scene is invalid if a key is
unknown or missing, or if a value is out of range or not finite. The error message contains the key,
the value, the requirement and a remedy.
"""

import math
from collections.abc import Iterator
from functools import partial
from html import escape
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, StringConstraints

from meshes.base.errors import InputError, enumerated
from meshes.base.hints import suggests_arguments
from tissue.materials.scene_constants import Materials
from tissue.scene.anatomy import (
    BlockAnatomy,
    BlockImage,
    CutAnatomy,
    MolarAnatomy,
    Tooth,
    WallAnatomy,
)
from tissue.scene.coupling import Device, Fidelity
from tissue.scene.organ import IncisedAnatomy, LayersAnatomy, LiverFile, Organ, SoftAnatomy
from tissue.scene.part import READ_BACK, ByKind, FileName, OneOf, Part, Rule, kinds_of
from tissue.scene.registry import ANATOMIES, CUTTERS, CUTTING_MATERIALS, MOTIONS, NEEDLES, PROBES
from tissue.scene.tool import (
    Blade,
    Needle,
    PathMotion,
    Probe,
    ReplayMotion,
    ThrustMotion,
    Tool,
    tool_parts,
)

__all__ = [
    "OR_NONE",
    "BlockAnatomy",
    "Cutting",
    "KeepClear",
    "Output",
    "Scene",
    "Stress",
    "Voxels",
]

ENTERED: dict[type[Part], str] = {
    Needle: "needle.liver.linear_N_mm",
    Blade: "soft.skin.toughness_J_m2",
}
"""Example of a tissue constant for error messages, keyed by the class of the tool.

The keys are the tools that enter soft tissue.
"""
Name = Annotated[str, StringConstraints(pattern=r"^[a-z0-9][a-z0-9_]*$")]


def _as_list(value: object) -> object:
    """Return a list with the text as its entry; return other values unchanged."""
    return [value] if isinstance(value, str) else value


OWN_DISTANCES = (
    "replace keep_clear by your own computation of distances from the tip positions and directions "
    "in the trace (for a needle, deflection_mm is the displacement of the tissue along its axis)"
)
"""Remedy for `keep_clear` in a scene whose tool is a needle, a blade or a probe."""


class KeepClear(Part):
    """Structures that the tool must not touch.

    The trace contains the distance of the tool from each structure. If the tool enters a structure,
    the run records an event, called a breach.
    """

    names: Annotated[tuple[str, ...], BeforeValidator(_as_list)] = Field(
        (), strict=False, examples=[("canal",)]
    )
    """Names of structures in the anatomy: `canal` for a vertebra; `pulp` for a molar that is
    procedural or has `anatomy.pulp_file`. If the tool is more than 10 mm away from the motion of
    the scene, the distance from a procedural structure may be overestimated.
    """
    files: dict[Name, str] = Field(default_factory=dict, examples=[{"canal": "canal.ply"}])
    """File of a closed surface for each additional structure, keyed by the name of the structure.
    The surface has the frame and the unit of `anatomy.file`. Without `anatomy.file`, it has the
    frame of the scene and the unit mm.
    """
    margin_mm: float = Field(0.0, ge=0, le=10, examples=[1.0])
    """Distance that the tool must keep from each structure. An event reports the first time at
    which the distance is smaller. With 0, only breaches are reported.
    """

    def require_valid(self) -> None:
        """Check that at least one structure is given, and that none is given twice."""
        if not self.names and not self.files:
            raise InputError(
                "keep_clear",
                "have names or files",
                "neither",
                "name a structure, or remove the table [keep_clear]",
            )
        both = set(self.names) & set(self.files)
        if both or len(set(self.names)) < len(self.names):
            repeated = {each for each in self.names if self.names.count(each) > 1}
            twice = enumerated(sorted(both or repeated))
            raise InputError(
                "keep_clear", "name each structure once", f"{twice} twice", "remove the repetition"
            )


class Voxels(Part):
    """Voxels of the bone, and the method by which a tool removes them."""

    spacing_mm: float = Field(0.1, gt=0, le=2, examples=[0.1])
    """Edge of a voxel."""
    removal: Literal["subvoxel", "binary"] = "subvoxel"
    """Method of removal: `subvoxel` removes the part of a voxel that is inside the tool.

    `binary` removes a whole voxel once its centre is inside the tool.
    """
    margin_mm: float = Field(3.0, ge=0.5, le=50)
    """Distance within which bone is simulated around the tool and its peg, along the motion of the
    scene. Without a device, a peg that stays in its guide hole does not count, because it touches
    no bone. If a hand moves the tool out of this region, an event reports it.
    """


class Cutting(Part):
    """Changes to the built-in cutting coefficients of bone.

    Coefficients that are left out have built-in values from published measurements.
    """

    material: Annotated[str, OneOf(CUTTING_MATERIALS)] = "bone"
    """Material whose cutting coefficients are used for bone. The layers of a tooth have materials
    of their own. The other keys of this table replace the coefficients of all layers, including
    those of a tooth. To replace the coefficients of one layer, such as dentin, use a file in the
    key `materials`.
    """

    tangential_chip_N_mm2: float | None = Field(None, ge=0, le=5000, examples=[150.0])
    """Chip force along the cutting velocity, divided by the area of the chip's cross-section."""
    radial_chip_N_mm2: float | None = Field(None, ge=0, le=5000, examples=[60.0])
    """Chip force normal to the tool's surface, divided by the area of the chip's cross-section."""
    axial_chip_N_mm2: float | None = Field(None, ge=0, le=5000, examples=[0.0])
    """Chip force along the edge, divided by the area of the chip's cross-section."""
    tangential_edge_N_mm: float | None = Field(None, ge=0, le=500, examples=[5.0])
    """Edge force along the cutting velocity, divided by the length of the edge."""
    radial_edge_N_mm: float | None = Field(None, ge=0, le=500, examples=[4.0])
    """Edge force normal to the tool's surface, divided by the length of the edge."""
    axial_edge_N_mm: float | None = Field(None, ge=0, le=500, examples=[0.0])
    """Edge force along the edge, divided by the length of the edge."""
    density_exponent: float | None = Field(None, ge=0, le=5, examples=[1.5])
    """Exponent n of the density: all coefficients are scaled by (density / reference density) **
    n.
    """
    size_exponent: float | None = Field(None, ge=0, lt=1, examples=[0.5])
    """Exponent m of the size effect: the three chip coefficients are proportional to (chip
    thickness) ** -m. With 0 there is no size effect.
    """
    minimum_chip_um: float | None = Field(None, ge=0, le=50, examples=[1.0])
    """Chip thickness below which the force is proportional to the chip thickness. With 0, the full
    edge force acts even on the thinnest chip.
    """


class Output(Part):
    """Processing of the tissue's force before it is sent to a device."""

    low_pass_ms: float = Field(1.0, ge=0, le=1000)
    """Time constant a of the low-pass filter of the force: y += (1 - exp(-T/a)) (u - y), where T is
    the duration of a tick, u the input and y the output. With 0 the force is not filtered.
    """
    vibration_share: float = Field(0.0, ge=0, le=1)
    """Amplitude of the vibration that the teeth of the tool cause, divided by the average force.
    The vibration is added to the force, with a frequency of at most 250 Hz.
    """
    cue_N: float = Field(0.0, ge=0, le=1, examples=[0.3])
    """Amplitude of a short vibration that is added to the force at events: first contact, contact
    with another layer, and a puncture. With 0 there is no vibration.
    """


class Stress(Part):
    """Computation of displacement and stress in a tooth.

    The method uses finite elements (cells) that contain material particles. Without this table,
    displacement and stress are not computed.
    """

    cell_mm: float = Field(0.5, ge=0.2, le=1.5)
    """Edge of a finite element. Half of it must be a whole multiple of `voxels.spacing_mm`."""
    interval_ms: float = Field(100.0, ge=10, le=10_000)
    """Time between two solutions. The shown stress is never older than this time."""


def _without_stress(value: object) -> object:
    """Return None for the text ``none``; return other values unchanged."""
    return None if value == "none" else value


OR_NONE = BeforeValidator(_without_stress, json_schema_input_type=Stress | Literal["none"] | None)
"""Annotation for a table of a scene; the text ``none`` removes it, as in ``--set stress=none``."""


def anatomy_parts() -> tuple[type[Part], ...]:
    """Return the table classes of all known anatomies."""
    return tuple(part for kind in ANATOMIES.known for part in ANATOMIES[kind].parameters)


def motion_parts() -> tuple[type[Part], ...]:
    """Return the classes that describe the configuration tables of all known motions."""
    return tuple(MOTIONS[kind].parameters for kind in MOTIONS.known)


AnyAnatomy = Annotated[
    CutAnatomy | SoftAnatomy | LayersAnatomy | IncisedAnatomy | WallAnatomy,
    ByKind(anatomy_parts, (ANATOMIES.group,)),
]
AnyTool = Annotated[
    Tool | Probe | Needle | Blade, ByKind(tool_parts, (CUTTERS.group, PROBES.group, NEEDLES.group))
]
AnyMotion = Annotated[
    PathMotion | ThrustMotion | ReplayMotion, ByKind(motion_parts, (MOTIONS.group,))
]


@suggests_arguments
class Scene(Part):
    """Complete description of one simulation; equal scenes give equal traces."""

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", examples=["glenoid-2"])
    """Name of the scene, and of its folder in runs/. The name may contain lower-case letters,
    digits, - and _.
    """
    description: str = ""
    """Description of the simulation in one line."""
    seed: int = Field(0, ge=0, lt=2**63)
    """Seed of all random draws."""
    duration_s: float | None = Field(None, ge=1e-3, le=3600, examples=[5.0])
    """Simulated time. Default: the duration of the motion. A simulated hand needs more time to
    react and to come to rest: 0.73 s (expert), 0.82 s (intermediate) or 0.9 s (novice). This time
    is added, unless `duration_s` ends the run before the end of the motion.
    """
    anatomy: AnyAnatomy
    """Anatomy on which the tool acts."""
    voxels: Voxels = Voxels()
    """Voxels of the bone, and the method by which a tool removes them."""
    tool: AnyTool
    """Tool that acts on the anatomy."""
    motion: AnyMotion
    """Motion of the tool."""
    keep_clear: KeepClear | None = None
    """Structures that the tool must not touch. The tool must cut bone or teeth. For a needle,
    compute distances from the tip positions and directions in the trace; `deflection_mm` is the
    displacement of the tissue along the needle.
    """
    cutting: Cutting = Cutting()
    """Changes to the built-in cutting coefficients."""
    output: Output = Output()
    """Processing of the force before a device plays it."""
    device: Device | None = None
    """Haptic device through which a hand moves the tool. Without this table, the tool follows the
    table `motion`.
    """
    stress: Annotated[Stress | None, OR_NONE] = None
    """Cell size and interval for the displacement and stress of a tooth. `stress = "none"` computes
    neither.
    """
    heat: bool = False
    """True to compute the temperature of the bone or the tooth."""
    organ: Organ = Organ()
    """Material of a soft organ, and the method by which the deformation is computed."""
    materials: FileName = Field("", examples=["fitted.toml"])
    """TOML file with constants that replace built-in constants; `tissue fit` writes such files. If
    the text is empty, the built-in constants are used.
    """

    fidelity: Fidelity | None = None
    """Required accuracy or speed of the run. With this table, the program chooses settings, such as
    the voxel size, from measurements on this machine.
    """

    @property
    def bone(self) -> CutAnatomy:
        """The table `anatomy` of a scene in which a tool cuts bone or a tooth."""
        assert isinstance(self.anatomy, CutAnatomy), self.anatomy.kind
        return self.anatomy

    @property
    def held(self) -> Device:
        """The table `device`; only for scenes that have a device."""
        assert self.device is not None, "the scene has no device"
        return self.device

    @property
    def motion_scale(self) -> float:
        """Ratio of the tool's displacement to the device's displacement; 1 without a device."""
        return 1.0 if self.device is None else self.device.coupling.motion_scale

    @property
    def predictor_file(self) -> str:
        """File of a trained predictor; empty if the predictor that comes with the scene is used."""
        return "" if self.device is None else self.device.coupling.predictor_file

    @property
    def constants(self) -> Materials:
        """Material constants for the scene.

        They are the built-in constants. The file named by the key `materials` may replace some of
        them.

        Raises
        ------
        InputError
            If the file cannot be used.
        """
        return Materials.read(self.materials) if self.materials else Materials.cited

    def require_valid(self) -> None:
        """Check that anatomy, tool, voxel size and stress grid can be used together."""
        kind = self.anatomy.kind
        wanted = ANATOMIES[kind].tool
        if not isinstance(self.tool, wanted):
            kinds = [
                kind for part in tool_parts() if issubclass(part, wanted) for kind in kinds_of(part)
            ]
            names = enumerated(kinds, "or")
            got = self.tool.kind
            remedy = f"choose {names}" if len(kinds) == 1 else "choose one of these"
            fitting = (
                each for each in ANATOMIES.known if isinstance(self.tool, ANATOMIES[each].tool)
            )
            if (other := next(fitting, None)) is not None:
                remedy += f', or set anatomy.kind = "{other}" for a {got}'
            raise InputError("tool.kind", f"be {names} for anatomy.kind = {kind}", got, remedy)
        # The model of the wall is one spring at the lowest point of a ball.
        if kind == "wall" and self.tool.kind != "sphere-probe":
            raise InputError(
                "tool.kind", "be sphere-probe for a wall", self.tool.kind, "use a sphere-probe"
            )
        if isinstance(self.tool, Tool) and isinstance(self.anatomy, CutAnatomy):
            self._cutter_fits(self.tool, self.anatomy)

    def _cutter_fits(self, tool: Tool, anatomy: CutAnatomy) -> None:
        hole, depth = anatomy.guide_hole_mm
        peg, length = tool.peg_mm
        if peg > 0.0 and (hole < peg or depth < length):
            raise InputError(
                "tool.peg_diameter_mm",
                f"fit the guide hole ({hole:g} mm wide, {depth:g} mm deep)",
                f"a peg {peg:g} mm wide and {length:g} mm long",
                (
                    "increase anatomy.guide_hole_diameter_mm or anatomy.guide_hole_depth_mm, or "
                    "use a smaller peg"
                ),
            )
        # Fewer than four voxels across a tool do not show its shape. The suggestion has twenty
        # voxels.
        if tool.diameter_mm < 4.0 * self.voxels.spacing_mm:
            raise InputError(
                "voxels.spacing_mm",
                f"be at most a quarter of tool.diameter_mm = {tool.diameter_mm:g}",
                f"{self.voxels.spacing_mm:g}",
                f"use a spacing such as {tool.diameter_mm / 20:g}",
            )
        if self.stress is not None and isinstance(anatomy, Tooth):
            self._stress_fits(self.stress)

    def _stress_fits(self, stress: Stress) -> None:
        spacing = self.voxels.spacing_mm
        ratio = 0.5 * stress.cell_mm / spacing
        # 0.1 and 0.75 mm are half of the smallest and of the largest cell. 1e-6 allows for
        # rounding.
        if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
            least = math.ceil(0.1 / spacing - 1e-6)
            most = math.floor(0.75 / spacing + 1e-6)
            fits = 2 * min(max(round(ratio), least), most) * spacing
            raise InputError(
                "stress.cell_mm",
                f"be an even multiple of voxels.spacing_mm ({spacing:g})",
                f"{stress.cell_mm:g}",
                f"use {(f'{fits:g}' if most > 0 else 'voxels.spacing_mm = 0.1')}",
            )

    @classmethod
    def read_back(cls, text: str) -> "Scene":
        """Read a scene from JSON text that this program has written."""
        return cls.model_validate_json(text, context=READ_BACK)

    def rules(self) -> Iterator[Rule]:
        """Yield conditions under which keys have no effect because of another table."""
        yield from self._anatomy_rules()
        yield from self._tool_rules()
        yield from self._device_rules()

    def _anatomy_rules(self) -> Iterator[Rule]:
        anatomy = self.anatomy
        is_cut = isinstance(self.tool, Tool)
        reads = getattr(anatomy, "reads", CutAnatomy.reads if is_cut else ())
        others = {"organ": "liver", "stress": "molar"}
        for table in ("voxels", "cutting", "keep_clear", "stress", "heat", "organ"):
            where = f"for a {anatomy.kind}" + (
                ", which is not cut" if not is_cut and table != "organ" else ""
            )
            remedy = f"set anatomy.kind = {others.get(table, 'block')}"
            if table == "organ" and isinstance(self.tool, Needle | Blade):
                where = f"for a {self.tool.kind}"
                remedy = (
                    f"give constants of the tissue, such as {ENTERED[type(self.tool)]}, in the "
                    "file that materials names"
                )
            if table == "keep_clear" and not is_cut:
                where = f"for a {self.tool.kind}, which cuts neither bone nor teeth"
                remedy = OWN_DISTANCES
            yield table, table not in reads, where, remedy
        if isinstance(anatomy, BlockImage):
            yield (
                "voxels.margin_mm",
                anatomy.is_whole,
                "for an image that is used as a whole",
                "set anatomy.centre_mm",
            )
        if isinstance(anatomy, Tooth):
            no_stress = not isinstance(anatomy, MolarAnatomy) and self.stress is None
            ligament = "for a tooth from files without stress"
            yield "anatomy.ligament_thickness_mm", no_stress, ligament, "add [stress]"
        if isinstance(anatomy, SoftAnatomy):
            is_even = anatomy.nodule_mm == 0.0 and not isinstance(anatomy, LiverFile)
            yield "organ.parts", is_even, "without a nodule", "set anatomy.nodule_diameter_mm"

    def _tool_rules(self) -> Iterator[Rule]:
        if not isinstance(self.tool, Tool):
            toothless = f"for a {self.tool.kind}, which has no teeth"
            yield "output.vibration_share", True, toothless, "set tool.kind = ball-burr"
            return
        is_still = self.tool.spin_rpm == 0.0
        where = "for a tool that does not turn and therefore cuts nothing"
        yield (
            "cutting voxels.removal stress heat output.vibration_share",
            is_still,
            where,
            "set tool.spin_rpm",
        )

    def _device_rules(self) -> Iterator[Rule]:
        is_held = self.device is not None
        nothing = "without a device, because the run then has no random numbers"
        yield "seed", not is_held, nothing, "set device = touch"
        yield "output.cue_N", not is_held, "without a device", "set device = touch"
        if is_held:
            wall = "for a wall, which is infinitely large"
            is_wall = isinstance(self.anatomy, WallAnatomy)
            yield "device.coupling.roam_mm", is_wall, wall, "set motion.points_mm"
            yield (
                "device.coupling.roam_mm",
                isinstance(self.tool, Needle | Blade),
                f"for a {self.tool.kind}",
                "set motion.points_mm",
            )
        if is_held and isinstance(self.motion, ThrustMotion):
            yield (
                "motion.mass_kg",
                True,
                "with a device, because the masses of device and hand are used",
                "choose another device or hand",
            )
            lasts = self.duration_s is not None
            yield (
                "motion.max_feed_mm_s",
                lasts,
                "with a device and duration_s, because the hand sets the speed",
                "remove duration_s",
            )
        if self.fidelity is not None:
            where = "with fidelity, which chooses it"
            remedy = "leave fidelity out"
            yield "device.prediction", is_held, where, remedy
            yield "voxels.removal", not is_held and isinstance(self.tool, Tool), where, remedy
            yield "organ.order", not is_held and isinstance(self.tool, Probe), where, remedy

    def to_toml(self) -> str:
        """Return the whole scene as TOML, with defaults and without keys that have no effect."""
        import tomli_w

        return tomli_w.dumps(self.effective_table())

    def _repr_html_(self) -> str:
        """Return HTML for a notebook: keys that were set, and all keys in a collapsed section."""
        import tomli_w

        stated = self.model_dump(
            mode="json", exclude_unset=True, exclude_none=True, exclude={"name", "description"}
        )
        head = (
            f"<p><b>{escape(self.name)}</b> "
            f"{escape(self.description)}</p><pre>{escape(tomli_w.dumps(stated))}</pre>"
        )
        return (
            f"{head}<details><summary>all "
            f"keys</summary><pre>{escape(self.to_toml())}</pre></details>"
        )


for table in (ANATOMIES, CUTTERS, PROBES, NEEDLES, MOTIONS):
    table.on_change.append(partial(Scene.model_rebuild, force=True))


def without_fields(scene: Scene) -> Scene:
    """Return a copy of a scene in which no fields are saved; forces do not depend on the fields."""
    for name in ("anatomy", "organ"):
        part = getattr(scene, name)
        if "interval_ms" in type(part).model_fields:
            still = part.model_copy(update={"interval_ms": 0.0})
            scene = scene.model_copy(update={name: still})
    return scene
