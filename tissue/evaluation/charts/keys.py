"""What a measurement belongs to: a scene at a setting, a machine, and the code that ran."""

import platform
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from tissue.evaluation.charts.settings import Setting
from tissue.scene.load import changed
from tissue.scene.scene import Scene

__all__ = ["machine", "scene_text", "setting_key", "sources"]

PACKAGES = ("meshes", "kernels", "tissue")


def scene_text(scene: Scene) -> str:
    """A scene without its words and its wishes, as text: what its numbers depend on."""
    return scene.model_copy(update={"description": "", "fidelity": None}).to_toml()


def machine() -> str:
    """What a time belongs to: processor, cores, and the versions that compute."""
    import psutil

    return (
        f"{platform.machine()} {psutil.cpu_count()} cores {platform.system()}; tissue {version('tissue-sim')}, "
        f"warp {version('warp-lang')}, numpy {version('numpy')}, Python {platform.python_version()}"
    )


@cache
def sources() -> str:
    """Checksum of all code and constants: both the time of a tick and its error may change with any of them."""
    digest = blake2b(digest_size=8)
    for package in PACKAGES:
        for path in sorted(Path(str(files(package))).rglob("*")):
            if path.is_file() and path.parent.name != "__pycache__":
                digest.update(path.read_bytes())
    return digest.hexdigest()


def setting_key(scene: Scene, setting: Setting, *, quick: bool) -> str:
    """Hash of a scene at a setting, of the machine and of the code."""
    at = scene_text(changed(scene, setting.changes))
    text = f"{at}|{setting.cores}|{setting.compute}|{quick}|{machine()}|{sources()}"
    return blake2b(text.encode(), digest_size=12).hexdigest()
