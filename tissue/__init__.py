"""Simulate cutting bone, drilling teeth and pressing soft organs, and what a hand feels while doing it.

>>> import tissue
>>> run = tissue.simulate(tissue.load_scene("glenoid"))  # doctest: +SKIP
>>> run.trace["force_z_N"]  # doctest: +SKIP
"""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from meshes.base.errors import InputError
    from tissue import cutters
    from tissue.api import calibration, stability, study
    from tissue.api.assess import Assessment, assess
    from tissue.api.bone import Bone
    from tissue.api.comparison import compare
    from tissue.api.cut import Cut
    from tissue.api.fit import Fit, fit
    from tissue.api.loop import Loop
    from tissue.api.materials import material, material_names
    from tissue.api.motor import motor_forces
    from tissue.api.organ import Organ
    from tissue.api.poses import feed_along
    from tissue.api.press import Press
    from tissue.api.register import register
    from tissue.api.report import report
    from tissue.api.run import Run, open_run
    from tissue.api.simulate import simulate
    from tissue.api.sweep import sweep
    from tissue.api.tools import ball, flat_punch, probe_from_file
    from tissue.haptics.device.device import DeviceParameters, Sample
    from tissue.hardware.search import devices
    from tissue.importing.importing import Imported, import_ct
    from tissue.scene.load import load_scene, scene_names, scene_text
    from tissue.scene.scene import Scene

    __version__: str

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
    "register",
    "report",
    "scene_names",
    "scene_text",
    "simulate",
    "stability",
    "study",
    "sweep",
]

_HOMES = {
    "Assessment": "tissue.api.assess",
    "Bone": "tissue.api.bone",
    "Cut": "tissue.api.cut",
    "DeviceParameters": "tissue.haptics.device.device",
    "Fit": "tissue.api.fit",
    "Imported": "tissue.importing.importing",
    "InputError": "meshes.base.errors",
    "Loop": "tissue.api.loop",
    "Organ": "tissue.api.organ",
    "Press": "tissue.api.press",
    "Run": "tissue.api.run",
    "Sample": "tissue.haptics.device.device",
    "Scene": "tissue.scene.scene",
    "assess": "tissue.api.assess",
    "ball": "tissue.api.tools",
    "compare": "tissue.api.comparison",
    "devices": "tissue.hardware.search",
    "feed_along": "tissue.api.poses",
    "fit": "tissue.api.fit",
    "flat_punch": "tissue.api.tools",
    "import_ct": "tissue.importing.importing",
    "load_scene": "tissue.scene.load",
    "material": "tissue.api.materials",
    "material_names": "tissue.api.materials",
    "motor_forces": "tissue.api.motor",
    "open_run": "tissue.api.run",
    "probe_from_file": "tissue.api.tools",
    "register": "tissue.api.register",
    "report": "tissue.api.report",
    "scene_names": "tissue.scene.load",
    "scene_text": "tissue.scene.load",
    "simulate": "tissue.api.simulate",
    "sweep": "tissue.api.sweep",
}
_MODULES = {
    "calibration": "tissue.api.calibration",
    "cutters": "tissue.cutters",
    "stability": "tissue.api.stability",
    "study": "tissue.api.study",
}


def _require_siblings() -> None:
    """Refuse another package named ``meshes`` or ``kernels`` that hides the one next to this package."""
    root = Path(__file__).resolve().parent.parent
    for name in ("meshes", "kernels"):
        spec = find_spec(name)
        found = Path(spec.origin).resolve().parent if spec is not None and spec.origin else None
        if found != root / name:
            raise ImportError(
                f"tissue needs its own package {name} at {root / name}, got {found}: "
                f"uninstall the other {name} or reinstall tissue-sim in a fresh environment"
            )


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from meshes.base.file_version import package_version  # reads a file

        return package_version()
    if name in _MODULES:
        return import_module(_MODULES[name])
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'tissue' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])


_require_siblings()
