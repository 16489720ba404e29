"""Numerical settings of a scene, grids for a convergence study, and test positions."""

import os
import platform
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from hashlib import blake2b, sha256
from importlib.metadata import version
from importlib.resources import files
from itertools import product
from pathlib import Path
from time import time_ns
from typing import Any

import numpy as np

from tissue.materials.constants import constants
from tissue.prediction.guard import GuardedMaker
from tissue.prediction.trained import is_trained
from tissue.scene.anatomy import Tooth
from tissue.scene.load import changed
from tissue.scene.organ import IncisedAnatomy, LayersAnatomy, SoftAnatomy
from tissue.scene.registry import PREDICTORS, RENDERERS, TABLES
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, Probe, Tool
from tissue.simulation.builders.cutting import cutter_of

LATENCY_MS = 4
"""Latency of the haptic loop [ms] if the scene does not set a latency.

The published study has a mean of 4.3 ms.
"""
VOXEL_SHARES = {True: (1.0, 0.5**0.5, 0.5), False: (1.0, 3.0**-0.5, 1.0 / 3.0)}
"""Voxel edges of three grids, relative to the scene, for a grid-convergence index.

The key is True for a quick chart and False for a full chart.
"""
TET_SHARES = {True: (1.0, 0.8, 0.64), False: (1.0, 0.5**0.5, 0.5)}
"""Edges of tetrahedra in three meshes, relative to the scene; see `VOXEL_SHARES`.

With half the edge, a mesh has seven times as many unknowns: 140,000 for a liver. Meshes with more
similar edges do not show the order of convergence, because the force varies irregularly.
"""
PLACES = ((0.0, 0.0, 1.0), (-0.37, -0.61, 1.07), (0.61, 0.37, 0.93))
"""Shift of the tool path along x and y, and factor on its depth, for three positions.

The unit of the shifts is the edge of the coarsest voxel or of a tetrahedron. The error of a
discretisation depends on the position of the tool relative to the grid or mesh. For example, a path
along the faces of voxels has a smaller error than a path between the faces. No shift is a half, a
third or a quarter of an edge, so the position relative to a finer grid changes too.
"""
COARSEST = 4.0
"""Edge of the coarsest voxel of a quick chart, divided by the edge in the scene; see `_voxels`."""
Changes = Mapping[str, object]


@dataclass(frozen=True)
class Setting:
    """Numerical setting of a scene; its tick time and force error are measured.

    Attributes
    ----------
    name
        Short name for pictures.
    family
        Kind of the varied parameter: "voxels", "shell", "cutting", "elements", "path", "stress" or
        "loop"; "model" if nothing is varied.
    changes
        New values of scene keys, by dotted key. The value None removes the key from the scene.
    finer
        True if the setting is finer than the scene's own setting. Finer settings are measured in
        order, as long as the last one measured was fast enough.
    """

    name: str
    family: str
    changes: Changes = field(default_factory=dict)
    finer: bool = False


def by_hand(scene: Scene) -> Scene:
    """Return a copy of the scene in which a haptic device with latency moves the tool."""
    changes: dict[str, object] = {} if scene.device is not None else {"device": "touch"}
    # without a latency, predictors have nothing to predict
    if scene.device is None or scene.device.coupling.delay_ms == 0:
        changes["coupling.delay_ms"] = LATENCY_MS
    return changed(scene, changes)


def untrained(scene: Scene) -> tuple[str, ...]:
    """Return the predictors that cannot be used because the scene has no trained predictor."""
    if is_trained(scene.name, scene.predictor_file):
        return ()
    return tuple(kind for kind in PREDICTORS if PREDICTORS[kind].trained)


def settings_of(scene: Scene, *, quick: bool) -> list[Setting]:
    """Return the numerical settings of a scene.

    If the scene has a device, these are settings of the haptic loop, otherwise settings of the
    tissue model.

    If `quick` is true, there are fewer settings.
    """
    if scene.device is not None:
        return list(_loops(scene, quick=quick))
    if isinstance(scene.tool, Tool):
        return list(_voxels(scene, scene.tool, quick=quick))
    if isinstance(scene.anatomy, SoftAnatomy):
        return list(_elements(scene, quick=quick))
    plain = force_only(scene)
    return [Setting("force alone" if plain else "as it is", "model", plain)]


def finest(scene: Scene, *, quick: bool) -> Changes:
    """Return the changes that give a scene the finest grid; no changes if the scene has no grid.

    Forces on the finest grid are the reference for haptic loops, and for models without an exact
    geometry.
    """
    return (grids(scene, quick=quick) or [{}])[-1]


def relative_edges(scene: Scene, *, quick: bool) -> tuple[float, ...]:
    """Return the edge lengths of three grids divided by the scene's edge length, coarsest first.

    The result is empty for a scene without a grid.
    """
    if isinstance(scene.tool, Tool):
        return VOXEL_SHARES[quick]
    return TET_SHARES[quick] if isinstance(scene.anatomy, SoftAnatomy) else ()


def grids(scene: Scene, *, quick: bool) -> list[Changes]:
    """Return the changes that give a scene a coarse, a medium and a fine grid, coarsest first.

    The changes also select the most accurate numerical method.
    """
    best: dict[str, object] = {"organ.order": 2, "organ.path": "condensed"}
    if isinstance(scene.tool, Tool):
        best = {"voxels.removal": "subvoxel"}
    return [refined(scene, share) | best for share in relative_edges(scene, quick=quick)]


def refined(scene: Scene, share: float) -> dict[str, object]:
    """Return the changes that multiply all edge lengths of the scene's grid by `share`.

    The changes also switch off computed fields that do not influence the force, such as stress.
    """
    lengths: dict[str, float] = {}
    if isinstance(scene.tool, Tool):
        lengths = {
            "voxels.spacing_mm": scene.voxels.spacing_mm,
            "tool.shell_spacing_mm": _shell_mm(scene.tool),
        }
    elif isinstance(scene.anatomy, SoftAnatomy):
        lengths = {
            "anatomy.touch_edge_mm": edge_mm(scene),
            "anatomy.edge_mm": scene.anatomy.edge_mm,
        }
        # Without this key, edges away from the tool would hardly shrink.
        lengths["anatomy.edge_growth"] = scene.anatomy.edge_growth
    return force_only(scene) | {key: share * value for key, value in lengths.items()}


def placed(scene: Scene) -> list[Scene]:
    """Return copies of the scene with its tool path at the three positions in `PLACES`.

    For a scene without a grid, with a device or without a path, the list contains only the
    unchanged scene.
    """
    if scene.device is not None or not isinstance(scene.motion, PathMotion):
        return [scene]
    if isinstance(scene.tool, Tool):
        # A peg in its hole leaves the tool half a voxel.
        step_mm = scene.voxels.spacing_mm * (0.5 if scene.tool.peg_mm[0] else COARSEST)
    elif isinstance(scene.anatomy, SoftAnatomy):
        step_mm = edge_mm(scene)
    else:
        return [scene]
    return [
        scene,
        *(moved(scene, x * step_mm, y * step_mm, depth=depth) for x, y, depth in PLACES[1:]),
    ]


def moved(scene: Scene, x_mm: float, y_mm: float, *, depth: float = 1.0) -> Scene:
    """Return the scene with a path that is shifted along x and y.

    The depth of the path below z = 0 is multiplied by `depth`.
    """
    assert isinstance(scene.motion, PathMotion)
    points = np.array(scene.motion.points_mm)
    points[:, 2] = np.where(points[:, 2] < 0.0, depth * points[:, 2], points[:, 2])
    points[:, :2] += x_mm, y_mm
    # 10 nm is far below a voxel and keeps the text of the scene short
    path = tuple((x, y, z) for x, y, z in points.round(5).tolist())
    return scene.model_copy(update={"motion": scene.motion.model_copy(update={"points_mm": path})})


def edge_mm(scene: Scene) -> float:
    """Return the edge length [mm] of an organ's tetrahedra under the probe."""
    assert isinstance(scene.anatomy, SoftAnatomy)
    assert isinstance(scene.tool, Probe)
    # a quarter of the probe's size is the default of a scene
    return scene.anatomy.touch_edge_mm or 0.25 * scene.tool.size_mm


def force_only(scene: Scene) -> dict[str, object]:
    """Return the changes that switch off computed fields, which do not influence the force."""
    if isinstance(scene.anatomy, SoftAnatomy):
        return {"organ.interval_ms": 0.0} if scene.organ.interval_ms else {}
    if isinstance(scene.anatomy, LayersAnatomy | IncisedAnatomy):
        return {"anatomy.interval_ms": 0.0} if scene.anatomy.interval_ms else {}
    return {} if scene.stress is None else {"stress": None}


def _shell_mm(tool: Tool) -> float:
    """Return the distance between neighbouring cutting elements of a cutter [mm]."""
    from tissue.models.bone.model import SHELL_ELEMENTS

    return tool.shell_spacing_mm or 1e3 * float(
        (cutter_of(tool).cutting_area_m2 / SHELL_ELEMENTS) ** 0.5
    )


def _voxels(scene: Scene, tool: Tool, *, quick: bool) -> Iterator[Setting]:
    """Yield numerical settings of a scene in which a tool cuts voxels.

    The settings vary voxel spacing, removal method, cutting elements, cutting law and stress field.
    """
    plain = force_only(scene)
    base = scene.voxels.spacing_mm
    shell = _shell_mm(tool)
    coarsest: Changes | None = None
    # coarse to fine, evenly on a logarithmic axis of cost
    for factor in (4.0, 3.0, 2.0, 1.0) if quick else (5.0, 4.0, 3.0, 2.0, 1.5, 1.0):
        # to 0.1 um, which keeps names and texts of scenes short
        spacing = round(factor * base, 4)
        # a scene refuses tools narrower than four voxels
        if spacing > 0.25 * tool.diameter_mm:
            continue
        coarse: Changes = (
            {"tool.shell_spacing_mm": round(factor * shell, 4)} if factor > 1.0 else {}
        )
        for removal in ("subvoxel",) if quick else ("subvoxel", "binary"):
            name = f"{spacing:g} mm" + (" binary" if removal == "binary" else "")
            grid = {"voxels.spacing_mm": spacing, "voxels.removal": removal}
            coarsest = coarsest or {**plain, **grid, **coarse}
            yield Setting(name, "voxels", {**plain, **grid, **coarse})
    # only elements coarser than those of the scene: finer elements follow with finer voxels below
    for factor in (2.0,) if quick else (4.0, 3.0, 2.0, 1.5):
        wide = {"tool.shell_spacing_mm": round(factor * shell, 4)}
        yield Setting(f"{base:g} mm, shell {factor * shell:.2g} mm", "shell", plain | wide)
    simplest: dict[str, object] = {}
    for name, changes in simpler(scene, tool).items():
        yield Setting(f"{base:g} mm, {name}", "cutting", {**plain, **changes})
        simplest |= changes
    if simplest and coarsest:
        name = f"{coarsest['voxels.spacing_mm']:g} mm, simplest"
        yield Setting(name, "cutting", {**coarsest, **simplest})
    # finer than the scene; 0.6 has 4.6 times as many voxels
    for share in (0.7,) if quick else (0.8, 0.6):
        name = f"{share * base:.3g} mm, shell {share * shell:.2g} mm"
        yield Setting(name, "voxels", refined(scene, share), finer=True)
    if quick:
        return
    if scene.stress is not None:
        # 0.7 to 0.4 mm in the molar, the cells whose solves `docs/verification.md` reports
        for cell in (14.0, 10.0, 8.0):
            edge = round(cell * base, 4)
            yield Setting(f"{base:g} mm, stress {edge:g} mm", "stress", {"stress.cell_mm": edge})


def simpler(scene: Scene, tool: Tool) -> dict[str, Changes]:
    """Return the scene changes, keyed by name, for simpler cutting laws and a simpler drill.

    Each entry omits one part of the model: the size effect, the minimum chip thickness ("linear
    law"), or the web of the drill. The linear law omits the size effect too. The reason is that,
    without a minimum chip thickness, the size effect would grow without bound.
    """
    found: dict[str, Changes] = {}
    if _of_law(scene, "minimum_chip_um") > 0.0:
        no_size: Changes = {"cutting.size_exponent": 0.0}
        if _of_law(scene, "size_exponent") > 0.0:
            found["no size effect"] = no_size
        found["linear law"] = {**no_size, "cutting.minimum_chip_um": 0.0}
    if getattr(tool, "web_mm", 0.0) != 0.0:
        found["simple drill"] = {"tool.web_mm": 0.0}
    return found


def _of_law(scene: Scene, name: str) -> float:
    """Return the largest value, over the layers of a scene, of a constant of the cutting law."""
    stated = getattr(scene.cutting, name)
    if stated is not None:
        return float(stated)
    layers = ("enamel", "dentin") if isinstance(scene.anatomy, Tooth) else ("bone",)
    known = [
        scene.constants.layer_constants(layer, bone=scene.cutting.material) for layer in layers
    ]
    return max(each[name].value if name in each else 0.0 for each in known)


def _elements(scene: Scene, *, quick: bool) -> Iterator[Setting]:
    """Yield numerical settings of an organ: order and edge of tetrahedra, compliance method."""
    plain = force_only(scene)
    base = edge_mm(scene)
    # coarse to fine; linear tetrahedra have fewer nodes at the same edge, so finer ones are tried
    linear, quadratic = (
        ((1.0,), (2.0, 1.4, 1.0)) if quick else ((2.0, 1.4, 1.0, 0.8), (2.0, 1.7, 1.4, 1.2, 1.0))
    )
    for order, factor in (*product((1,), linear), *product((2,), quadratic)):
        edge = round(factor * base, 3)
        changes = plain | {"organ.order": order, "anatomy.touch_edge_mm": edge}
        yield Setting(f"P{order} {edge:g} mm", "elements", changes)
    if quick:
        return
    # nearly twice as many tetrahedra as at 1
    fine = refined(scene, 0.8) | {"organ.order": 2}
    yield Setting(f"P2 {0.8 * base:.3g} mm", "elements", fine, finer=True)
    if scene.organ.law == "linear":
        # numbers of basis vectors, evenly on a logarithmic axis of cost
        for size in (100, 300, 1000):
            yield Setting(
                f"reduced {size}",
                "path",
                plain | {"organ.path": "reduced", "organ.basis_size": size},
            )


def _loops(scene: Scene, *, quick: bool) -> Iterator[Setting]:
    """Yield settings of a haptic loop: renderer, predictor and update rate of the tissue."""
    plain = force_only(scene)
    missing = untrained(scene)
    for law in RENDERERS:
        if not quick or law == "proxy":
            yield Setting(law, "loop", plain | {"renderer": law, "prediction": "none"})
    for kind in PREDICTORS.names[1:]:
        if kind not in missing and (not quick or kind in ("kalman", "koopman-look-ahead")):
            yield Setting(kind, "loop", plain | {"prediction": kind})
    # a tool that cuts needs a response in every tick: at 100 Hz its error in milling is 34 to 51 %,
    # and its motion can grow without bound
    if isinstance(scene.tool, Tool):
        return
    for kind in PREDICTORS:
        if kind not in missing and (not quick or kind in ("hold", "koopman-look-ahead")):
            yield Setting(
                f"100 Hz, {kind}",
                "loop",
                # ten ticks of 1 ms
                plain | {"prediction": kind, "coupling.model_ms": 10},
            )


PACKAGES = ("meshes", "kernels", "tissue")


def scene_text(scene: Scene) -> str:
    """Return a text with the values of a scene that determine its results.

    The keys `description` and `fidelity` are left out.
    """
    words = {"description": "", "fidelity": None, "materials": ""}
    return scene.model_copy(update=words).to_toml() + scene.constants.key


def machine() -> str:
    """Return a text that identifies this machine: processor, cores and library versions."""
    import psutil

    return (
        f"{platform.machine()} {psutil.cpu_count()} cores {platform.system()}; tissue "
        f"{version('tissue-sim')}, "
        f"warp {version('warp-lang')}, numpy {version('numpy')}, Python {platform.python_version()}"
    )


def sources() -> str:
    """Return a checksum of all code and constants.

    Stored measurements are identified by the checksum, because any change of code or constants may
    change a measurement. Plug-ins that other packages register are included.
    """
    # 8 bytes: only compared with checksums of other versions of the code
    digest = blake2b(code_sha256().encode(), digest_size=8)
    for kind, table in ((kind, table) for kind, tables in TABLES.items() for table in tables):
        for name in table.known:
            if name not in table.built_in:
                digest.update(f"{kind} {name} {_code_of(table[name])}".encode())
    return digest.hexdigest()


def _code_of(part: Any) -> str:
    """Return a text that changes if the constants or the code of a plug-in change."""
    if isinstance(part, Mapping):
        return " ".join(f"{name} {_code_of(inner)}" for name, inner in part.items())
    if hasattr(part, "__dataclass_fields__") or isinstance(part, GuardedMaker):
        return _code_of(vars(part))
    if isinstance(part, Path):
        return part.read_text("utf-8") if part.is_file() else ""
    # a tuple names a table and material of constants
    if isinstance(part, tuple) and part[:1] in (("cutting",), ("soft",)):
        return repr(constants(*part))
    return _package_sum(part.__module__.partition(".")[0]) if callable(part) else repr(part)


def _package_sum(name: str) -> str:
    """Return a checksum of all Python files of a package, or of the file of a module.

    If the code has no file, as in an interactive session, every call returns a different checksum.
    """
    file = getattr(sys.modules.get(name), "__file__", None)
    # code from an interactive session cannot be compared: its results are never reused
    if file is None:
        return f"{os.getpid()} {time_ns()}"
    path = Path(file)
    files = sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]
    # 8 bytes: only compared with checksums of other versions of the package
    return blake2b(b"".join(each.read_bytes() for each in files), digest_size=8).hexdigest()


@cache
def code_sha256() -> str:
    """Return the SHA-256 of all files of this installation: code, constants and data."""
    digest = sha256()
    for package in PACKAGES:
        for path in sorted(Path(str(files(package))).rglob("*")):
            # compiled files follow from the sources and change when they are first imported
            if path.is_file() and path.parent.name != "__pycache__":
                digest.update(path.read_bytes())
    return digest.hexdigest()
