"""Simulate bone cutting, tooth drilling and soft-organ pressing, and the forces that a hand feels.

>>> import tissue
>>> run = tissue.simulate(tissue.load_scene("glenoid"))  # doctest: +SKIP
>>> run.trace["force_z_N"]  # doctest: +SKIP
"""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

__all__ = [
    "Assessment",
    "Bone",
    "Cut",
    "DeviceParameters",
    "Fit",
    "Imported",
    "InputError",
    "Loop",
    "Organ",
    "Press",
    "Ranking",
    "Run",
    "Sample",
    "Scene",
    "assess",
    "ball",
    "calibration",
    "compare",
    "cutters",
    "devices",
    "feed_along",
    "fit",
    "flat_punch",
    "import_ct",
    "load_scene",
    "material",
    "material_names",
    "motor_forces",
    "open_run",
    "probe_from_file",
    "rank",
    "register",
    "report",
    "scene_names",
    "scene_text",
    "simulate",
    "stability",
    "study",
    "sweep",
]


if TYPE_CHECKING:
    from meshes.base.errors import InputError
    from tissue import cutters
    from tissue.ct.importing import Imported, import_ct
    from tissue.haptics.device.device import DeviceParameters, Sample
    from tissue.haptics.real.adapter import devices
    from tissue.objects import calibration, stability, study
    from tissue.objects.assess import Assessment, Ranking, assess, rank
    from tissue.objects.bone import Bone
    from tissue.objects.comparison import compare
    from tissue.objects.cutting import Cut, feed_along
    from tissue.objects.fit import Fit, fit
    from tissue.objects.loop import Loop
    from tissue.objects.materials import material, material_names
    from tissue.objects.organ import Organ
    from tissue.objects.press import Press
    from tissue.objects.register import register
    from tissue.objects.run import Run, open_run, report
    from tissue.objects.simulate import simulate
    from tissue.objects.sweep import sweep
    from tissue.objects.tools import ball, flat_punch, probe_from_file
    from tissue.scene.load import load_scene, scene_names, scene_text
    from tissue.scene.scene import Scene
    from tissue.simulation.reference_force import motor_forces

    __version__: str


_HOMES = {
    "Assessment": "tissue.objects.assess",
    "Bone": "tissue.objects.bone",
    "Cut": "tissue.objects.cutting",
    "DeviceParameters": "tissue.haptics.device.device",
    "Fit": "tissue.objects.fit",
    "Imported": "tissue.ct.importing",
    "InputError": "meshes.base.errors",
    "Loop": "tissue.objects.loop",
    "Organ": "tissue.objects.organ",
    "Press": "tissue.objects.press",
    "Ranking": "tissue.objects.assess",
    "Run": "tissue.objects.run",
    "Sample": "tissue.haptics.device.device",
    "Scene": "tissue.scene.scene",
    "assess": "tissue.objects.assess",
    "ball": "tissue.objects.tools",
    "compare": "tissue.objects.comparison",
    "devices": "tissue.haptics.real.adapter",
    "feed_along": "tissue.objects.cutting",
    "fit": "tissue.objects.fit",
    "flat_punch": "tissue.objects.tools",
    "import_ct": "tissue.ct.importing",
    "load_scene": "tissue.scene.load",
    "material": "tissue.objects.materials",
    "material_names": "tissue.objects.materials",
    "motor_forces": "tissue.simulation.reference_force",
    "open_run": "tissue.objects.run",
    "probe_from_file": "tissue.objects.tools",
    "rank": "tissue.objects.assess",
    "register": "tissue.objects.register",
    "report": "tissue.objects.run",
    "scene_names": "tissue.scene.load",
    "scene_text": "tissue.scene.load",
    "simulate": "tissue.objects.simulate",
    "sweep": "tissue.objects.sweep",
}
_MODULES = {
    "calibration": "tissue.objects.calibration",
    "cutters": "tissue.cutters",
    "stability": "tissue.objects.stability",
    "study": "tissue.objects.study",
}


def _require_siblings() -> None:
    """Raise an error if a foreign package ``meshes`` or ``kernels`` hides the project's package."""
    root = Path(__file__).resolve().parent.parent
    for name in ("meshes", "kernels"):
        spec = find_spec(name)
        found = Path(spec.origin).resolve().parent if spec is not None and spec.origin else None
        if found != root / name:
            raise ImportError(
                f"tissue needs its own package {name} at {root / name}, got {found}. "
                f"Uninstall the other {name} or reinstall tissue-sim in a fresh environment"
            )


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from meshes.base.whole_file import package_version  # reads a file

        return package_version()
    if name in _MODULES:
        return import_module(_MODULES[name])
    if name in _HOMES:
        value = getattr(import_module(_HOMES[name]), name)
        if name == "Scene":
            value.model_rebuild()  # models are built late; without this, help shows no parameters
        return value
    hint = ""
    if not name.startswith("_"):  # Python itself asks for such names
        from meshes.base.hints import nearest

        hint = nearest(name, __all__)
    raise AttributeError(f"module 'tissue' has no attribute {name!r}{hint}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])


_require_siblings()
