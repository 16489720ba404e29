"""Scenes: frozen, validated descriptions of what to simulate.

A scene is a TOML file. Every quantity carries its unit in its name; anything unknown, missing, out of range or not
finite is refused with one sentence that names the key, the value, the requirement and a remedy.
"""

import math
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from meshes.base.errors import InputError
from tissue.materials.scene_constants import Materials
from tissue.scene.anatomy import AnatomyFile, BlockAnatomy, BoneAnatomy, GlenoidAnatomy, MolarAnatomy, Part
from tissue.scene.choices import ByKind, OneOf, kinds_of
from tissue.scene.coupling import (
    Coupling,
    DeviceName,
    Fidelity,
    HandName,
    PerceptionName,
    PredictionName,
    RendererName,
    WallAnatomy,
)
from tissue.scene.hardware import Hardware
from tissue.scene.keep_clear import KeepClear
from tissue.scene.named_parts import loaded
from tissue.scene.organ import LayersAnatomy, LiverAnatomy, Organ, SlabAnatomy
from tissue.scene.registry import ANATOMIES, CUTTERS, CUTTING_MATERIALS, MOTIONS, NEEDLES, PERCEPTIONS, PROBES
from tissue.scene.tool import Needle, PathMotion, Probe, ReplayMotion, ThrustMotion, Tool
from tissue.scene.unused_keys import unused_keys
from tissue.scene.vertebra import VertebraAnatomy

__all__ = ["PARTS_WITH_FILES", "Cutting", "Output", "Scene", "Stress", "Voxels", "is_file_key"]


PARTS_WITH_FILES = ("anatomy", "motion", "tool", "coupling")
"""Parts of a scene with keys that name files."""


LONGEST_PATH = 1000
"""Characters of a file's path: more is no path of a person's."""


def is_file_key(name: str) -> bool:
    """Whether a key of such a part names a file."""
    return name == "file" or name.endswith("_file")


class Voxels(Part):
    """How the bone is divided and removed."""

    spacing_mm: float = Field(0.1, gt=0, le=2, examples=[0.1])
    """Edge of a voxel."""
    removal: Literal["subvoxel", "binary"] = "subvoxel"
    """Whether a voxel loses the part inside the tool, or all of itself once its centre is inside."""
    margin_mm: float = Field(3.0, ge=0.5, le=50)
    """Bone kept around what the tool can reach."""


class Cutting(Part):
    """Changes to the cited cutting coefficients of bone; empty entries keep the cited value."""

    material: Annotated[str, OneOf(CUTTING_MATERIALS)] = "bone"
    """Material whose cited coefficients bone has; layers of a tooth keep their own."""

    tangential_chip_N_mm2: float | None = Field(None, ge=0, le=5000, examples=[150.0])
    """Chip force along the cutting speed, per area of the chip's section."""
    radial_chip_N_mm2: float | None = Field(None, ge=0, le=5000, examples=[60.0])
    """Chip force normal to the tool's surface, per area of the chip's section."""
    axial_chip_N_mm2: float | None = Field(None, ge=0, le=5000, examples=[0.0])
    """Chip force along the edge, per area of the chip's section."""
    tangential_edge_N_mm: float | None = Field(None, ge=0, le=500, examples=[5.0])
    """Edge force along the cutting speed, per length of the edge."""
    radial_edge_N_mm: float | None = Field(None, ge=0, le=500, examples=[4.0])
    """Edge force normal to the tool's surface, per length of the edge."""
    axial_edge_N_mm: float | None = Field(None, ge=0, le=500, examples=[0.0])
    """Edge force along the edge, per length of it."""
    density_exponent: float | None = Field(None, ge=0, le=5, examples=[1.5])
    """Power of the density over its reference that scales all coefficients."""


class Output(Part):
    """What is made of the model's force before it is commanded to a device."""

    low_pass_ms: float = Field(1.0, ge=0, le=1000)
    """Time constant of the low-pass y += (1 - exp(-T/a)) (u - y); 0 passes the model's force on."""
    vibration_share: float = Field(0.0, ge=0, le=1)
    """Amplitude of the teeth's vibration relative to the average force, at 250 Hz at most; a device plays it too."""
    cue_N: float = Field(0.0, ge=0, le=1, examples=[0.3])
    """Amplitude of the transient that a device plays at first contact, another layer and a puncture; 0 plays none."""


class Stress(Part):
    """Displacement and stress of a tooth by particle finite elements; a scene without it builds none."""

    cell_mm: float = Field(0.5, ge=0.2, le=1.5)
    """Edge of a cell; its half, the particles' spacing, must be a whole multiple of voxels.spacing_mm."""
    interval_ms: float = Field(100.0, ge=10, le=10_000)
    """Time between two solves; the stress belongs to a state at most this old."""


AnyAnatomy = Annotated[
    VertebraAnatomy
    | GlenoidAnatomy
    | BlockAnatomy
    | BoneAnatomy
    | MolarAnatomy
    | LiverAnatomy
    | SlabAnatomy
    | LayersAnatomy
    | WallAnatomy,
    ByKind(ANATOMIES),
]
AnyTool = Annotated[Tool | Probe | Needle, ByKind()]
AnyMotion = Annotated[PathMotion | ThrustMotion | ReplayMotion, ByKind(MOTIONS)]


class Scene(Part):
    """Everything one simulation needs; equal scenes give equal traces."""

    name: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", examples=["glenoid-2"])
    """Name of the scene and of the folder under runs/; lower-case letters, digits, - and _."""
    description: str = ""
    """What it models, in a line."""
    seed: int = Field(0, ge=0, lt=2**63)
    """Seed of every random draw."""
    duration_s: float | None = Field(None, ge=1e-3, le=3600, examples=[5.0])
    """Simulated time; without it as long as the motion lasts. One that holds the whole motion waits for a late hand."""
    anatomy: AnyAnatomy
    """What the tool meets."""
    voxels: Voxels = Voxels()
    """How the bone is divided and removed."""
    tool: AnyTool
    """What meets it."""
    motion: AnyMotion
    """How the tool moves."""
    keep_clear: KeepClear | None = None
    """Structures that the tool must not touch."""
    cutting: Cutting = Cutting()
    """Changes to the cutting coefficients."""
    output: Output = Output()
    """What becomes of the force."""
    device: DeviceName = "none"
    """Device by which a hand moves the tool; none lets the motion move it."""
    hand: HandName = "expert"
    """Whose hand holds the device."""
    renderer: RendererName = "proxy"
    """Law by which the device plays what the tool meets."""
    prediction: PredictionName = "none"
    """What predicts the device's force ahead of latency and slow models."""
    perception: PerceptionName = "none"
    """For whom the device's force is scaled: none, population, or observer:FILE, as `tissue calibrate` writes it."""
    coupling: Coupling = Coupling()
    """How the device is coupled to the tool."""
    hardware: Hardware = Hardware()
    """Where a real device is, how its axes lie in the scene, and what protects the hand that holds it."""
    stress: Stress | None = None
    """Whether and how finely displacement and stress are computed."""
    heat: bool = False
    """Whether the temperature of a tooth and its pulp is computed."""
    organ: Organ = Organ()
    """What a soft organ is made of, and how it is solved."""
    materials: str = Field("", max_length=LONGEST_PATH, examples=["fitted.toml"])
    """TOML file of constants in place of the cited ones, such as `tissue fit` writes; empty takes the cited ones."""

    fidelity: Fidelity | None = None
    """The fidelity demanded of the run; its settings are then chosen by what was measured on this machine."""

    @property
    def bone(self) -> AnatomyFile:
        """The anatomy of a scene in which a tool cuts."""
        assert isinstance(self.anatomy, AnatomyFile), self.anatomy.kind
        return self.anatomy

    @property
    def constants(self) -> Materials:
        """Constants that the scene rests on: the cited ones, with those of its file in their place.

        Raises
        ------
        InputError
            If the file cannot be used.
        """
        return Materials.read(self.materials) if self.materials else Materials.cited

    @property
    def force_scale(self) -> float:
        """Newtons at the device for each newton at the tool."""
        return self.chosen_scale[0]

    @property
    def chosen_scale(self) -> tuple[float, str]:
        """The scale of forces, and from what it was chosen, in words; nothing where the scene states it."""
        given = self.coupling.force_scale
        if given != "auto":
            return given, ""
        chosen: tuple[float, str] = loaded("tissue.builders.force_met:chosen_scale")(self)
        return chosen

    @model_validator(mode="after")
    def _parts_fit(self) -> "Scene":
        for part in PARTS_WITH_FILES:
            for name, value in getattr(self, part):
                if is_file_key(name) and isinstance(value, str) and len(value) > LONGEST_PATH:
                    least = f"at most {LONGEST_PATH} characters, got {len(value)}"
                    raise InputError(f"{part}.{name} must be a path of {least}: shorten it")
        kind, wanted = self.anatomy.kind, loaded(ANATOMIES[self.anatomy.kind].tool)
        if not isinstance(self.tool, wanted):
            names = ", ".join(kinds_of(wanted))
            got = self.tool.kind
            raise InputError(f"tool.kind must be one of {names} for a {kind}, got {got}: choose one of these")
        if kind == "wall" and self.tool.kind != "sphere-probe":
            raise InputError(f"tool.kind must be sphere-probe for a wall, got {self.tool.kind}: use a ball")
        if isinstance(self.tool, Tool) and isinstance(self.anatomy, AnatomyFile):
            self._cutter_fits(self.tool, self.anatomy)
        return self

    def _cutter_fits(self, tool: Tool, anatomy: AnatomyFile) -> None:
        hole, peg = anatomy.guide_hole_diameter_mm, tool.peg_diameter_mm
        if tool.can_have_peg and peg > 0.0 and (hole < peg or anatomy.guide_hole_depth_mm < tool.peg_length_mm):
            depth, length = anatomy.guide_hole_depth_mm, tool.peg_length_mm
            raise InputError(
                f"tool.peg_diameter_mm must fit the guide hole ({hole:g} mm wide, {depth:g} mm deep), got a peg of "
                f"{peg:g} x {length:g} mm: widen or deepen it by anatomy.guide_hole_diameter_mm and "
                "anatomy.guide_hole_depth_mm"
            )
        if tool.diameter_mm < 4.0 * self.voxels.spacing_mm:
            raise InputError(
                f"voxels.spacing_mm must be at most a quarter of tool.diameter_mm ({tool.diameter_mm:g}), got "
                f"{self.voxels.spacing_mm:g}: use {tool.diameter_mm / 20:g}"
            )
        if self.stress is not None and isinstance(anatomy, MolarAnatomy):
            self._stress_fits(self.stress)

    def _stress_fits(self, stress: Stress) -> None:
        spacing = self.voxels.spacing_mm
        ratio = 0.5 * stress.cell_mm / spacing
        if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
            least, most = math.ceil(0.1 / spacing - 1e-6), math.floor(0.75 / spacing + 1e-6)
            fits = 2 * min(max(round(ratio), least), most) * spacing
            raise InputError(
                f"stress.cell_mm must be an even multiple of voxels.spacing_mm ({spacing:g}), got "
                f"{stress.cell_mm:g}: use {f'{fits:g}' if most > 0 else 'voxels.spacing_mm = 0.1'}"
            )

    def to_toml(self) -> str:
        """The whole scene, defaults included, as TOML, without keys that have no effect in it."""
        import tomli_w

        table = self.model_dump(mode="json", exclude_none=True)
        for key in unused_keys(self):
            part, _, name = key.partition(".")
            if name:
                table[part].pop(name, None)
            else:
                table.pop(part, None)
        return tomli_w.dumps({name: value for name, value in table.items() if value != {}})

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        shown: str = loaded("tissue.api.scene_html:scene_html")(self)
        return shown

    def with_files_at(self, folder: Path) -> "Scene":
        """The same scene with the paths of its files made absolute, relative ones taken from ``folder``."""
        changes: dict[str, object] = {}
        if (perception := PERCEPTIONS.with_file_at(self.perception, folder)) != self.perception:
            changes["perception"] = perception
        if self.materials:
            changes["materials"] = str((folder / self.materials).resolve())
        for part in PARTS_WITH_FILES:
            value: Part = getattr(self, part)
            names = filter(is_file_key, type(value).model_fields)
            files = {name: getattr(value, name) for name in names if getattr(value, name)}
            if files:
                absolute = {name: str((folder / file).resolve()) for name, file in files.items()}
                changes[part] = value.model_copy(update=absolute)
        if self.keep_clear is not None and self.keep_clear.files:
            files = {name: str((folder / file).resolve()) for name, file in self.keep_clear.files.items()}
            changes["keep_clear"] = self.keep_clear.model_copy(update={"files": files})
        return self.model_copy(update=changes)


for table in (ANATOMIES, CUTTERS, PROBES, NEEDLES, MOTIONS):
    table.on_change.append(partial(Scene.model_rebuild, force=True))
