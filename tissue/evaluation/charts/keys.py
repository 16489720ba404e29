"""Keys of a measurement: a scene at a setting, a machine, and the code that ran."""

import os
import platform
import sys
from collections.abc import Mapping
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from time import time_ns
from typing import Any

from tissue.evaluation.charts.settings import Setting
from tissue.materials.constants import constants
from tissue.prediction.guard import GuardedMaker
from tissue.scene.load import changed
from tissue.scene.registry import TABLES
from tissue.scene.scene import Scene

__all__ = ["machine", "scene_text", "setting_key", "sources"]

PACKAGES = ("meshes", "kernels", "tissue")


def scene_text(scene: Scene) -> str:
    """Return the part of a scene that its numbers depend on, as text.

    Description and fidelity are left out.
    """
    words = {"description": "", "fidelity": None, "materials": ""}
    return scene.model_copy(update=words).to_toml() + scene.constants.key


def machine() -> str:
    """Return the key of a measured time: processor, cores, and versions of the libraries."""
    import psutil

    return (
        f"{platform.machine()} {psutil.cpu_count()} cores {platform.system()}; tissue "
        f"{version('tissue-sim')}, "
        f"warp {version('warp-lang')}, numpy {version('numpy')}, Python {platform.python_version()}"
    )


def sources() -> str:
    """Return the checksum of all code and constants.

    Both the time of a tick and its error may change with any of them. External parts count by their
    names and by the code of their packages.
    """
    digest = blake2b(own_sources().encode(), digest_size=8)
    for kind, table in ((kind, table) for kind, tables in TABLES.items() for table in tables):
        for name in table.known:
            if name not in table.built_in:
                digest.update(f"{kind} {name} {_code_of(table[name])}".encode())
    return digest.hexdigest()


def _code_of(part: Any) -> str:
    """Return the numbers of an external part and the checksum of the package that it calls."""
    if isinstance(part, Mapping):
        return " ".join(f"{name} {_code_of(inner)}" for name, inner in part.items())
    if hasattr(part, "__dataclass_fields__") or isinstance(part, GuardedMaker):
        return _code_of(vars(part))
    if isinstance(part, Path):
        return part.read_text("utf-8") if part.is_file() else ""
    if isinstance(part, tuple) and part[:1] in (("cutting",), ("soft",)):
        return repr(constants(*part))
    return _package_sum(part.__module__.partition(".")[0]) if callable(part) else repr(part)


def _package_sum(name: str) -> str:
    """Return the checksum of all Python files of a package, or of a module.

    Without a file, the result is unique to the call.
    """
    file = getattr(sys.modules.get(name), "__file__", None)
    if file is None:
        return f"{os.getpid()} {time_ns()}"
    path = Path(file)
    files = sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]
    return blake2b(b"".join(each.read_bytes() for each in files), digest_size=8).hexdigest()


@cache
def own_sources() -> str:
    """Return the checksum of all files in these packages."""
    digest = blake2b(digest_size=8)
    for package in PACKAGES:
        for path in sorted(Path(str(files(package))).rglob("*")):
            if path.is_file() and path.parent.name != "__pycache__":
                digest.update(path.read_bytes())
    return digest.hexdigest()


def setting_key(scene: Scene, setting: Setting, *, quick: bool) -> str:
    """Return the hash of a scene at a setting, of the machine and of the code."""
    at = scene_text(changed(scene, setting.changes))
    text = f"{at}|{setting.cores}|{setting.compute}|{quick}|{machine()}|{sources()}"
    return blake2b(text.encode(), digest_size=12).hexdigest()
