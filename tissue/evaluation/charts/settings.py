"""What can be chosen for a scene: its settings from coarse to fine, and the grids that its convergence is shown by."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product

from tissue.builders.cutting import cutter_of
from tissue.prediction.trained import is_trained
from tissue.scene.load import changed
from tissue.scene.organ import LayersAnatomy, SoftAnatomy
from tissue.scene.registry import PREDICTORS, RENDERERS
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe, Tool

__all__ = ["LATENCY_MS", "Setting", "by_hand", "finest", "grids", "refined", "settings_of", "shares", "untrained"]

LATENCY_MS = 4
"""Latency at which loops are compared where a scene has none, the mean that the paper reports being 4.3 ms."""
LOST = "displacement and stress"
VOXEL_SHARES = {True: (1.0, 0.5**0.5, 0.5), False: (1.0, 3.0**-0.5, 1.0 / 3.0)}
"""Lengths of the three grids of a grid-convergence index over those of the scene, quick or not."""
TET_SHARES = {True: (1.0, 0.8, 0.64), False: (1.0, 0.5**0.5, 0.5)}
"""The same of tetrahedra: half the edge takes seven times the unknowns, 140,000 of a liver. Ratios nearer to
1 would show how the force scatters from mesh to mesh, and no order."""
Changes = Mapping[str, object]


@dataclass(frozen=True)
class Setting:
    """One setting to run a scene at.

    Attributes
    ----------
    name
        A few words, for a picture.
    family
        What is varied: voxels, shell, elements, path, stress, loop or cores.
    changes
        Values by dotted key; None takes an entry out.
    leaves_out
        What a scene loses by it, in words; empty for nothing.
    cores
        Processor cores; None for all.
    compute
        Warp device.
    finer
        Whether it is finer than the scene: offered where the finer ones before it took no longer than a tick may.
    """

    name: str
    family: str
    changes: Changes = field(default_factory=dict)
    leaves_out: str = ""
    cores: int | None = None
    compute: str = "cpu"
    finer: bool = False


def by_hand(scene: Scene) -> Scene:
    """The scene on a device, with a latency to be hidden."""
    changes: dict[str, object] = {} if scene.device is not None else {"device": "touch"}
    if scene.device is None or scene.device.coupling.delay_ms == 0:
        changes["coupling.delay_ms"] = LATENCY_MS
    return changed(scene, changes)


def untrained(scene: Scene) -> tuple[str, ...]:
    """Return the predictors that cannot serve a scene because they need training and no file of it is known."""
    if is_trained(scene.name, scene.predictor_file):
        return ()
    return tuple(kind for kind in PREDICTORS if PREDICTORS[kind].trained)


def settings_of(scene: Scene, *, quick: bool) -> list[Setting]:
    """Settings of a scene; without a device those of its model, with one those of its loop.

    The quick ones are those that a scene is chosen from when nothing has been measured yet.
    """
    if scene.device is not None:
        return list(_loops(scene, quick=quick))
    if isinstance(scene.tool, Tool):
        return list(_voxels(scene, scene.tool, quick=quick))
    if isinstance(scene.anatomy, SoftAnatomy):
        return list(_elements(scene, scene.anatomy, quick=quick))
    plain, lost = _force_only(scene)
    return [Setting("force alone" if plain else "as it is", "model", plain, lost)]


def finest(scene: Scene, *, quick: bool) -> Changes:
    """The finest of the grids: what loops are held to, and models where no exact geometry is known."""
    return (grids(scene, quick=quick) or [{}])[-1]


def shares(scene: Scene, *, quick: bool) -> tuple[float, ...]:
    """Lengths of three grids over those of a scene, coarse to fine; none where there is no grid."""
    if isinstance(scene.tool, Tool):
        return VOXEL_SHARES[quick]
    return TET_SHARES[quick] if isinstance(scene.anatomy, SoftAnatomy) else ()


def grids(scene: Scene, *, quick: bool) -> list[Changes]:
    """Those grids, by the most accurate method."""
    best: dict[str, object] = {"organ.order": 2, "organ.path": "condensed"}
    if isinstance(scene.tool, Tool):
        best = {"voxels.removal": "subvoxel"}
    return [refined(scene, share) | best for share in shares(scene, quick=quick)]


def refined(scene: Scene, share: float) -> dict[str, object]:
    """All lengths of the scene's grid times a share, and no field that no force depends on."""
    lengths: dict[str, float] = {}
    if isinstance(scene.tool, Tool):
        lengths = {"voxels.spacing_mm": scene.voxels.spacing_mm, "tool.shell_spacing_mm": _shell_mm(scene.tool)}
    elif isinstance(scene.anatomy, SoftAnatomy):
        organ = scene.anatomy
        lengths = {"anatomy.touch_edge_mm": _edge_mm(scene, organ), "anatomy.edge_mm": organ.edge_mm}
        lengths["anatomy.edge_growth"] = organ.edge_growth  # else edges away from the tool would hardly shrink
    return _force_only(scene)[0] | {key: share * value for key, value in lengths.items()}


def _force_only(scene: Scene) -> tuple[dict[str, object], str]:
    """What leaves out all that no force depends on, and what is lost by it, in words."""
    changes: dict[str, object] = {"stress": None} if scene.stress is not None else {}
    if isinstance(scene.anatomy, SoftAnatomy):
        changes = {"organ.interval_ms": 0.0} if scene.organ.interval_ms else {}
    elif isinstance(scene.anatomy, LayersAnatomy):
        changes = {"anatomy.interval_ms": 0.0} if scene.anatomy.interval_ms else {}
    return changes, LOST if changes else ""


def _shell_mm(tool: Tool) -> float:
    """Distance of the cutter's elements."""
    from tissue.models.bone.model import SHELL_ELEMENTS

    return tool.shell_spacing_mm or 1e3 * float((cutter_of(tool).cutting_area_m2 / SHELL_ELEMENTS) ** 0.5)


def _edge_mm(scene: Scene, anatomy: SoftAnatomy) -> float:
    """Edge of a tetrahedron under the tool where a scene sets none."""
    assert isinstance(scene.tool, Probe)
    return anatomy.touch_edge_mm or 0.25 * scene.tool.size_mm


def _voxels(scene: Scene, tool: Tool, *, quick: bool) -> Iterator[Setting]:
    """Spacing, kind of removal, elements of the cutter, stress, cores."""
    (plain, lost), base, shell = _force_only(scene), scene.voxels.spacing_mm, _shell_mm(tool)
    for factor in (4.0, 3.0, 2.0, 1.0) if quick else (5.0, 4.0, 3.0, 2.0, 1.5, 1.0):
        spacing = round(factor * base, 4)
        if spacing > 0.25 * tool.diameter_mm:
            continue
        for removal in ("subvoxel",) if quick else ("subvoxel", "binary"):
            name = f"{spacing:g} mm" + (" binary" if removal == "binary" else "")
            grid = {"voxels.spacing_mm": spacing, "voxels.removal": removal}
            coarse: Changes = {"tool.shell_spacing_mm": round(factor * shell, 4)} if factor > 1.0 else {}
            yield Setting(name, "voxels", {**plain, **grid, **coarse}, lost)
    for factor in (2.0,) if quick else (4.0, 3.0, 2.0, 1.5):
        wide = {"tool.shell_spacing_mm": round(factor * shell, 4)}
        yield Setting(f"{base:g} mm, shell {factor * shell:.2g} mm", "shell", plain | wide, lost)
    for share in (0.7,) if quick else (0.8, 0.6):
        name = f"{share * base:.3g} mm, shell {share * shell:.2g} mm"
        yield Setting(name, "voxels", refined(scene, share), lost, finer=True)
    if quick:
        return
    yield Setting(f"{base:g} mm, one core", "cores", plain, lost, cores=1)
    yield from _accelerated(plain, lost)
    if scene.stress is not None:
        for cell in (14.0, 10.0, 8.0):
            edge = round(cell * base, 4)
            yield Setting(f"{base:g} mm, stress {edge:g} mm", "stress", {"stress.cell_mm": edge})


def _elements(scene: Scene, anatomy: SoftAnatomy, *, quick: bool) -> Iterator[Setting]:
    """Order and edge of tetrahedra, compliance method, cores."""
    base, (plain, lost) = _edge_mm(scene, anatomy), _force_only(scene)
    linear, quadratic = ((1.0,), (2.0, 1.4, 1.0)) if quick else ((2.0, 1.4, 1.0, 0.8), (2.0, 1.7, 1.4, 1.2, 1.0))
    for order, factor in (*product((1,), linear), *product((2,), quadratic)):
        edge = round(factor * base, 3)
        changes = plain | {"organ.order": order, "anatomy.touch_edge_mm": edge}
        yield Setting(f"P{order} {edge:g} mm", "elements", changes, lost)
    if quick:
        return
    fine = refined(scene, 0.8) | {"organ.order": 2}
    yield Setting(f"P2 {0.8 * base:.3g} mm", "elements", fine, lost, finer=True)
    for size in (100, 300, 1000) if scene.organ.law == "linear" else ():
        yield Setting(f"reduced {size}", "path", plain | {"organ.path": "reduced", "organ.basis_size": size}, lost)
    if scene.organ.law == "linear":
        yield Setting("lazy", "path", plain | {"organ.path": "lazy"}, lost)
    yield Setting("one core", "cores", plain, lost, cores=1)
    yield from _accelerated(plain, lost)


def _accelerated(plain: Changes, lost: str) -> Iterator[Setting]:
    """The scene on every accelerator that there is."""
    import warp as wp

    import kernels  # noqa: F401  starts Warp without its greeting

    for device in wp.get_cuda_devices():
        yield Setting(str(device), "cores", plain, lost, compute=str(device))


def _loops(scene: Scene, *, quick: bool) -> Iterator[Setting]:
    """Renderer, predictor and rate of the model."""
    plain, lost = _force_only(scene)
    for law in RENDERERS:
        if not quick or law == "proxy":
            yield Setting(law, "loop", plain | {"renderer": law, "prediction": "none"}, lost)
    missing = untrained(scene)
    for kind in PREDICTORS.names[1:]:
        if kind not in missing and (not quick or kind in ("kalman", "koopman")):
            yield Setting(kind, "loop", plain | {"prediction": kind}, lost)
    for kind in PREDICTORS:
        if kind in missing or (quick and kind not in ("hold", "koopman")):
            continue
        yield Setting(f"100 Hz, {kind}", "loop", plain | {"prediction": kind, "coupling.model_ms": 10}, lost)
