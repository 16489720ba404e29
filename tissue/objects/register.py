"""`tissue.register`: parts of one's own, by the names that a scene gives them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from meshes.base.errors import InputError
from tissue.objects import registering as check
from tissue.scene.registry import (
    ANATOMIES,
    CUTTERS,
    DEVICES,
    HANDS,
    MOTIONS,
    NEEDLES,
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

__all__ = ["register"]

F = TypeVar("F")
COLOUR = "#D55E00"
MARKER = "*"


class register:
    """Make a part known by a name: scenes, messages, the schema, charts and the judge of stability
    then know it.

    A function that takes what makes a part, or without it is a decorator of that. Each refuses, in
    one sentence, a name that is taken, and what lacks a method that a run calls. What is registered
    is known in this process; an installed package offers parts to all by entry points, in groups
    such as ``tissue.predictors``.
    """

    @staticmethod
    def tool(name: str, profile: F | None = None, *, keys: tuple[str, ...] = ()) -> Any:
        """Register a rotating cutter by its half section.

        Parameters
        ----------
        name
            Value of ``tool.kind``.
        profile
            Returns a `tissue.cutters.profile.Profile` from ``diameter_m`` and what `keys` add, in
            metres and radians: ``length_m`` of ``length_mm``, ``point_angle_rad`` of
            ``point_angle_deg``.
        keys
            Those of the tool's keys that shape it beside its diameter.
        """

        def entry(part: Any) -> CutterEntry:
            check.profile(name, part, keys)
            return CutterEntry(part, tuple(keys))

        return _added("tool", name, profile, CUTTERS, entry)

    @staticmethod
    def probe(name: str, make: F | None = None, *, keys: tuple[str, ...] = ("diameter_mm",)) -> Any:
        """Register a smooth tool that presses: ``make(tool)`` returns the `ProbeShape` of a
        scene's tool.
        """

        return _added("probe", name, make, PROBES, lambda part: ProbeEntry(part, tuple(keys)))

    @staticmethod
    def needle(name: str, make: F | None = None) -> Any:
        """Register a needle: ``make(walls=...)`` returns its `NeedleTissue`, ``walls`` are the
        scene's membranes.
        """

        return _added("needle", name, make, NEEDLES)

    @staticmethod
    def motion(name: str, parameters: "type[Part]", make: F | None = None) -> Any:
        """Register a motion of the tool: ``make(parameters, step_s)`` returns a
        `tissue.motion.motion.Motion`.

        Parameters
        ----------
        name
            Value of ``motion.kind``.
        parameters
            What a scene states of it: a subclass of `tissue.scene.anatomy.Part` whose ``kind`` is
            the name.
        make
            Makes one of that, for ticks of so many seconds.
        """

        def entry(part: Any) -> MotionEntry:
            check.parameters("motion", name, parameters)
            return MotionEntry(parameters, part)

        return _added(
            "motion",
            name,
            make,
            MOTIONS,
            entry,
            methods=("sweep_m", "rotations", "begin", "advance"),
        )

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
        """Register a tissue: ``build(scene, motion, *, step_s, compute, cores, report)`` returns
        the parts of a run.

        Parameters
        ----------
        name
            Value of ``anatomy.kind``.
        parameters
            What a scene states of it: a subclass of `tissue.scene.anatomy.Part` whose ``kind`` is
            the name.
        build
            Returns `tissue.simulation.builders.parts.Parts`, with a
            `tissue.models.tissue_model.TissueModel`.
        tool
            The part that describes the tools that it meets: ``Tool``, ``Probe`` or ``Needle`` of
            `tissue.scene.tool`.
        force_N, pictures, faces
            See `tissue.scene.registry.AnatomyEntry`.
        """

        def entry(part: Any) -> AnatomyEntry:
            check.parameters("tissue", name, parameters)
            return AnatomyEntry(parameters, tool, part, force_N, pictures or {}, faces)

        return _added("tissue", name, build, ANATOMIES, entry)

    @staticmethod
    def device(
        name: str,
        numbers: "Mapping[str, float] | DeviceParameters",
        make: Callable[[tuple[float, float, float]], object] | None = None,
    ) -> Callable[[F], F]:
        """Register a haptic device: the numbers of its stability check, and a function that opens
        the real one.

        Parameters
        ----------
        name
            Value of ``device``.
        numbers
            Those of `tissue.haptics.device.device.DeviceParameters` in SI, at least ``mass_kg`` and
            ``damping_N_s_m``.
        make
            Opens the device that `tissue.simulate` and ``tissue run`` then hold: called with the
            place [m] where the tool starts in the scene, it returns a
            `tissue.haptics.device.device.Device`. Without it, and where charts, studies and
            training run many trials, a simulated device of these numbers is held by the scene's
            hand.

        Returns
        -------
        Callable
            A decorator of the class that is `make`.
        """
        from tissue.haptics.device.device import DeviceParameters

        check.name("device", name)
        given = check.numbers_of(DeviceParameters, numbers, needed=("mass_kg", "damping_N_s_m"))

        def opens(part: Any) -> Any:
            check.callable_part("device", name, part, ("read", "command"))
            DEVICES.put(name, DeviceEntry(given, part))
            return part

        if make is None:
            DEVICES.add(name, DeviceEntry(given))
        else:
            opens(make)
        return opens

    @staticmethod
    def hand(name: str, numbers: Mapping[str, float], *, like: str = "expert") -> None:
        """Register a hand: numbers of `HandParameters` in SI; the others are those of a known
        hand.
        """
        from tissue.haptics.hand.hand import HandParameters

        check.name("hand", name)
        HANDS.add(name, check.numbers_of(HandParameters, {**HANDS[like], **numbers}))

    @staticmethod
    def renderer(name: str, make: F | None = None) -> Any:
        """Register a rendering law with `render` and `pause`: ``make(loop)`` takes a `WallLoop`.

        The loop is judged with ``loop.stiffness_N_m``; a law that is stiffer than that is not seen
        by the judge.
        """

        return _added("renderer", name, make, RENDERERS, methods=("render", "pause"))

    @staticmethod
    def predictor(
        name: str,
        make: F | None = None,
        *,
        trained: bool = False,
        colour: str = COLOUR,
        marker: str = MARKER,
    ) -> Any:
        """Register a predictor of the force: a class with `observe` and `predict`, see
        `tissue.prediction.outside`.

        It runs under the guard, which holds the last force where holding would miss less, and is
        judged with the loop.

        Parameters
        ----------
        name
            Value of ``prediction``.
        make
            Called with nothing, or with what ``tissue train`` wrote for the scene,
            `tissue.prediction.trained.Trained`.
        trained
            Whether it is given that.
        colour, marker
            Its own in charts, as matplotlib has them.
        """

        def entry(part: Any) -> PredictorEntry:
            from tissue.prediction.outside import GuardedMaker

            check.looks(colour, marker)
            return PredictorEntry(
                GuardedMaker(name, part, trained=trained), trained, colour, marker
            )

        return _added("predictor", name, make, PREDICTORS, entry, methods=("observe", "predict"))

    @staticmethod
    def perception(name: str, make: F | None = None) -> Any:
        """Register a map: ``make(argument, *, rng, force_limit_N, tick_s, friction_N)`` returns a
        `Perception`.

        A name such as ``share:NUMBER`` stands for all texts with something behind the colon, which
        is the argument.
        """

        return _added("perception", name, make, PERCEPTIONS, methods=("step", "pause"))

    @staticmethod
    def offered(kind: str, name: str, load: Callable[[], Any]) -> None:
        """Register what an entry point of an installed package names, unless importing it does, as
        a decorator would.

        A name that a call has registered stays with that.

        Raises
        ------
        InputError
            If the name is built in, or the part cannot be registered.
        """
        tables = TABLES[kind]
        if any(name in table.built_in for table in tables):
            raise InputError(f"{name} is the name of a built-in {kind}")
        part = load()
        if kind in ("material", "scene"):
            getattr(register, kind)(part)
            return
        if not any(name in table.known for table in tables):
            getattr(register, kind)(name, part)
        if not any(name in table.known for table in tables):
            raise InputError(
                f"it registers nothing by that name: decorate it by @tissue.register.{kind}"
            )

    @staticmethod
    def material(file: str | Path) -> tuple[str, ...]:
        """Register the materials of a TOML file: ``[cutting.NAME.CONSTANT]`` for cutting,
        ``[soft...]`` for organs.

        Each constant has value, range, source and confidence, as in `tissue/materials`. Returns the
        names.
        """
        return check.add_materials(Path(file))

    @staticmethod
    def scene(file: str | Path) -> str:
        """Register the scene of a TOML file by its name, for `load_scene`, ``tissue scenes`` and
        ``tissue run``.
        """
        path = Path(file).resolve()
        name = check.scene_name(path)
        SCENES.add(name, path)
        return name


def _same(part: Any) -> Any:
    """Return the part itself, as the entry of a table without details."""
    return part


def _added(
    kind: str,
    name: str,
    part: Any,
    table: Any,
    entry: Callable[[Any], Any] = _same,
    methods: tuple[str, ...] = (),
) -> Any:
    """Check a part and add its entry to a table; return a decorator that does so where no part
    is given.
    """

    def add(each: Any) -> Any:
        check.name(kind, name, argument=kind == "perception")
        check.callable_part(kind, name, each, methods)
        table.add(name, entry(each))
        return each

    return add if part is None else add(part)
