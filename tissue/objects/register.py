"""Registration of user-defined parts under the names that scenes use: `tissue.register`."""

import re
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from meshes.base.errors import InputError, enumerated
from meshes.base.file_limits import require_regular
from meshes.base.hints import suggests_arguments
from meshes.base.text_tables import read_toml
from tissue.materials.constants import LINEAR, Entry, add_material, constants, listed
from tissue.materials.scene_constants import checked_constant
from tissue.objects.part_checks import (
    NAME,
    check_callable,
    check_name,
    check_parameters,
    check_profile,
    checked_numbers,
)
from tissue.scene.registry import (
    ANATOMIES,
    CUTTERS,
    CUTTING_MATERIALS,
    DEVICES,
    HANDS,
    MOTIONS,
    NEEDLES,
    ORGAN_MATERIALS,
    PERCEPTIONS,
    PREDICTORS,
    PROBES,
    RENDERERS,
    SCENES,
    TABLES,
    AnatomyEntry,
    CutterEntry,
    DeviceEntry,
    MotionEntry,
    PredictorEntry,
    ProbeEntry,
)

if TYPE_CHECKING:
    from tissue.haptics.device.device import DeviceParameters
    from tissue.scene.anatomy import Part

F = TypeVar("F")


@suggests_arguments
class register:
    """Registration of user-defined parts by name.

    A part is a class or function that a scene selects by name, such as a tool, a device or a
    predictor. After registration, the key accepts the name of the part, and the part appears in the
    schema, the charts and the stability check.

    Each method takes a name and the class or function. Without the class or function, the method
    returns a decorator for it. An error is raised if the name is in use, or if a required method is
    missing. A registered part is available in this process. An installed package can offer parts to
    all processes through entry points, in groups such as ``tissue.predictors``.
    """

    @staticmethod
    def tool(name: str, profile: F | None = None, *, keys: tuple[str, ...] = ()) -> Any:
        """Register a rotating cutter that is defined by a half section through its axis.

        Parameters
        ----------
        name
            Name that selects the tool in a scene: a value of the key ``tool.kind``.
        profile
            Function that returns a `tissue.cutters.profile.Profile`. Its arguments are
            ``diameter_m`` and one argument for each of `keys`, in metres or radians. Examples are
            ``length_m`` for the key ``length_mm``, and ``point_angle_rad`` for the key
            ``point_angle_deg``.
        keys
            Keys in a scene's `tool` table that define the shape in addition to the diameter.
        """

        def entry(part: Any) -> CutterEntry:
            check_profile(name, part, keys)
            return CutterEntry(part, tuple(keys))

        return _added("tool", name, profile, CUTTERS, entry)

    @staticmethod
    def probe(name: str, make: F | None = None, *, keys: tuple[str, ...] = ("diameter_mm",)) -> Any:
        """Register a smooth pressing tool; the function ``make(tool)`` returns its `ProbeShape`."""

        return _added("probe", name, make, PROBES, lambda part: ProbeEntry(part, tuple(keys)))

    @staticmethod
    def needle(name: str, make: F | None = None) -> Any:
        """Register a needle.

        ``make(walls=...)`` returns the `NeedleTissue`: the parameters of the tissue for this
        needle. ``walls`` are the membranes in the tissue of the scene.
        """

        return _added("needle", name, make, NEEDLES)

    @staticmethod
    def motion(name: str, parameters: "type[Part]", make: F | None = None) -> Any:
        """Register a motion of the tool.

        ``make(parameters, step_s)`` returns a `tissue.motion.motion.Motion`.

        Parameters
        ----------
        name
            Name that selects the motion in a scene: a value of the key ``motion.kind``.
        parameters
            Parameters of the motion in a scene: a subclass of `tissue.scene.anatomy.Part` whose
            ``kind`` is the name.
        make
            Function that makes a motion from these parameters, for ticks of `step_s` seconds.
        """

        def entry(part: Any) -> MotionEntry:
            check_parameters("motion", name, parameters)
            return MotionEntry(parameters, part)

        methods = ("sweep_m", "rotations", "begin", "advance")
        return _added("motion", name, make, MOTIONS, entry, methods=methods)

    @staticmethod
    def tissue(
        name: str,
        parameters: "type[Part]",
        build: F | None = None,
        *,
        tool: "type[Part]",
        force_N: Callable[..., float] | None = None,
        pictures: Mapping[str, Callable[..., None]] | None = None,
        faces: Callable[..., Any] | None = None,
    ) -> Any:
        """Register a tissue.

        ``build(scene, motion, *, step_s, compute, cores, report)`` returns `Parts`: the tissue
        model and the other objects that a run needs.

        Parameters
        ----------
        name
            Name that selects the tissue in a scene: a value of the key ``anatomy.kind``.
        parameters
            Parameters of the tissue in a scene: a subclass of `tissue.scene.anatomy.Part` whose
            ``kind`` is the name.
        build
            Function that returns `tissue.simulation.builders.parts.Parts`, which contains a
            `tissue.models.tissue_model.TissueModel`.
        tool
            Class of the tools that can work on this tissue: ``Tool``, ``Probe`` or ``Needle`` from
            `tissue.scene.tool`.
        force_N, pictures, faces
            See `tissue.scene.registry.AnatomyEntry`.
        """

        def entry(part: Any) -> AnatomyEntry:
            check_parameters("tissue", name, parameters)
            return AnatomyEntry((parameters,), tool, part, force_N, pictures or {}, faces)

        return _added("tissue", name, build, ANATOMIES, entry)

    @staticmethod
    def device(
        name: str,
        numbers: "Mapping[str, float] | DeviceParameters",
        make: Callable[[tuple[float, float, float]], object] | None = None,
    ) -> Callable[[F], F]:
        """Register a haptic device by its parameters and a function that opens the real device.

        Parameters
        ----------
        name
            Name that selects the device in a scene: a value of the key ``device.kind``.
        numbers
            Parameters of the device in SI units, as in
            `tissue.haptics.device.device.DeviceParameters`, for the stability check. ``mass_kg``
            and ``damping_N_s_m`` are required.
        make
            Function that opens the device for `tissue.simulate` and ``tissue run``. It is called
            with the position [m] at which the tool starts in the scene, and returns a
            `tissue.haptics.device.device.Device`. Without this function, runs use a simulated
            device with the parameters `numbers`, held by a simulated hand. Charts, studies and
            training always use the simulated device and hand.

        Returns
        -------
        Callable
            Decorator for `make`, if `make` is not given.
        """
        from tissue.haptics.device.device import DeviceParameters

        check_name("device", name)
        given = checked_numbers(DeviceParameters, numbers, needed=("mass_kg", "damping_N_s_m"))

        def opens(part: Any) -> Any:
            check_callable("device", name, part, ("read", "command"))
            DEVICES.put(name, DeviceEntry(given, part))
            return part

        if make is None:
            DEVICES.add(name, DeviceEntry(given))
        else:
            opens(make)
        return opens

    @staticmethod
    def hand(name: str, numbers: Mapping[str, float], *, like: str = "expert") -> None:
        """Register a simulated hand, defined by values of `HandParameters` in SI units.

        Values that are not given are taken from the known hand with the name `like`.
        """
        from tissue.haptics.hand.hand import HandParameters

        check_name("hand", name)
        HANDS.add(name, checked_numbers(HandParameters, {**HANDS[like], **numbers}))

    @staticmethod
    def renderer(name: str, make: F | None = None) -> Any:
        """Register a rendering law, which converts contact of the tool into a force at the device.

        ``make(loop)`` returns the law for a `WallLoop`. The law has the methods `render` and
        `pause`. The stability check assumes that the law renders the stiffness
        ``loop.stiffness_N_m``; it cannot detect a higher one.
        """
        return _added("renderer", name, make, RENDERERS, methods=("render", "pause"))

    @staticmethod
    def predictor(
        name: str,
        make: F | None = None,
        *,
        trained: bool = False,
    ) -> Any:
        """Register a predictor of the force: a class with the methods `observe` and `predict`.

        A guard monitors the predictor. While holding the last force would give smaller errors than
        the predictions, the guard uses the last force; see `tissue.prediction.guard`. The stability
        check includes the predictor.

        Parameters
        ----------
        name
            Name that selects the predictor in a scene: a value of the key ``device.prediction``.
        make
            Class or function that makes the predictor. If `trained` is True, `make` is called with
            the `tissue.prediction.trained.Trained` that ``tissue train`` wrote for the scene.
            Otherwise it is called without arguments.
        trained
            Whether `make` takes a `Trained`.
        """

        def entry(part: Any) -> PredictorEntry:
            from tissue.prediction.guard import GuardedMaker

            return PredictorEntry(GuardedMaker(name, part, trained=trained), trained)

        return _added("predictor", name, make, PREDICTORS, entry, methods=("observe", "predict"))

    @staticmethod
    def perception(name: str, make: F | None = None) -> Any:
        """Register a perception model, which scales the forces at the device for one person.

        ``make(argument, *, rng, force_limit_N, tick_s, friction_N)`` returns a `Perception`. A
        model may be registered with a name such as ``share:NUMBER``. A scene may then use any text
        after the colon, which is passed as ``argument``.
        """
        return _added("perception", name, make, PERCEPTIONS, methods=("step", "pause"))

    @staticmethod
    def offered(kind: str, name: str, load: Callable[[], Any]) -> None:
        """Register the part that an entry point of an installed package offers.

        If importing the part already registers it, for example by a decorator, the method does
        nothing more. If the program has already registered a part under this name, that part is
        kept.

        Raises
        ------
        InputError
            If a built-in part has this name, or the part cannot be registered.
        """
        tables = TABLES[kind]
        if any(name in table.built_in for table in tables):
            raise InputError(f"{name} is the name of a built-in {kind}")
        part = load()
        if kind in ("material", "scene"):
            if not Path(part).is_file():
                raise InputError(
                    f"the package was built without the file {part}; its author lists the file in "
                    "package-data"
                )
            getattr(register, kind)(part)
            return
        if not any(name in table.known for table in tables):
            getattr(register, kind)(name, part)
        if not any(name in table.known for table in tables):
            raise InputError(
                "the module registers no part with this name: decorate the part by "
                f"@tissue.register.{kind}"
            )

    @staticmethod
    def material(file: str | Path) -> tuple[str, ...]:
        """Register the materials of a TOML file and return their names.

        The tables of the file are ``[cutting.NAME.CONSTANT]`` for materials that are cut, and
        ``[soft.NAME.CONSTANT]`` for organs. Each constant has value, range, source and confidence,
        as in the files of `tissue/materials`.
        """
        return _add_materials(Path(file))

    @staticmethod
    def scene(file: str | Path) -> str:
        """Register the scene in a TOML file under the name that the file states."""
        path = Path(file).resolve()
        name = _scene_name(path)
        SCENES.add(name, path)
        return name


def _added(
    kind: str,
    name: str,
    part: Any,
    table: Any,
    entry: Callable[[Any], Any] = lambda part: part,
    methods: tuple[str, ...] = (),
) -> Any:
    """Validate a part and add it to a registry; without a part, return a decorator."""

    def add(each: Any) -> Any:
        check_name(kind, name, argument=kind == "perception")
        check_callable(kind, name, each, methods)
        table.add(name, entry(each))
        return each

    return add if part is None else add(part)


SOFT = ("modulus_kPa", "poisson_ratio", "density_kg_m3")
"""Constants that every material of a soft organ must have."""
CAPSULE = "_capsule"
"""Suffix of the names of capsules: membranes on organs, which cannot be an organ's material."""


def _scene_name(path: Path) -> str:
    """Return the name in a scene file; raise an error if a scene of this name exists."""
    from tissue.scene.load import library_names

    found = _table(path, "scene").get("name")
    check_name("scene", found)
    taken = [*library_names(), *SCENES.known]
    if found in taken:
        raise InputError(
            "name",
            f"not be one of {', '.join(taken)}",
            f"{found} in {path}",
            "choose another name for this scene",
        )
    return str(found)


def _add_materials(path: Path) -> tuple[str, ...]:
    """Add all materials of a file; if one of them is invalid, add none and raise an error."""
    found = _table(path, "material")
    if not found or any(table not in ("cutting", "soft") for table in found):
        raise InputError(
            "material",
            "have only the tables cutting and soft",
            f"{enumerated(found) or 'none'} in {path}",
            "use these two tables",
        )
    for table, materials in found.items():
        for material, entries in materials.items():
            _require_material(path, table, material, entries)
    for table, materials in found.items():
        for material, entries in materials.items():
            add_material(table, material, entries)
            if not material.endswith(CAPSULE):
                (CUTTING_MATERIALS if table == "cutting" else ORGAN_MATERIALS).add(
                    material, (table, material)
                )
    return tuple(dict.fromkeys(material for materials in found.values() for material in materials))


def _require_material(path: Path, table: str, material: str, entries: dict[str, Entry]) -> None:
    """Raise an error if a material's name is in use, or a constant or source is missing."""
    where = f"{table}.{material}"
    if not re.fullmatch(NAME, material) or material in listed(table):
        known = enumerated(listed(table))
        raise InputError(
            table,
            "have new names of lower-case letters, digits, - and _ for its materials, other than "
            f"{known}",
            f"{material} in {path}",
            "choose another name",
        )
    cutting = tuple(name for name in constants("cutting", "bone") if name not in LINEAR)
    needed = cutting if table == "cutting" else SOFT
    missing = enumerated(each for each in needed if each not in entries)
    if missing:
        raise InputError(
            where,
            f"have the constants {enumerated(needed)}",
            f"no value for {missing} in {path}",
            f"add {missing}",
        )
    extra = enumerated(each for each in entries if each not in needed)
    if extra and table == "cutting":
        raise InputError(
            where,
            f"have only the constants {enumerated(needed)}",
            f"{extra} in {path}",
            f"remove {extra}",
        )
    for constant, entry in entries.items():
        checked_constant(f"{where}.{constant}", entry, str(path))


def _table(path: Path, kind: str) -> dict[str, Any]:
    """Read a TOML file."""
    require_regular(path)
    try:
        return read_toml(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            kind, "be a readable TOML file", f"{path} ({reason})", "check the path, or fix the file"
        ) from None
