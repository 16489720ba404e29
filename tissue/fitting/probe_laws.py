"""Force of a ball on a layer over a bed, as a function of the constants of an elastic law.

The force is proportional to Young's modulus. The logarithm of the force is interpolated between
solutions on an axisymmetric mesh (`tissue.fem.axisymmetric`). The coordinates of the interpolation
are the logarithms of the shape constants of the law. A fit then needs no further solution, so
thousands of resampled presses can be fitted.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.base.text_tables import shown
from tissue.fem.axisymmetric import FIRST, LayerMesh, LinearLaw, layer_mesh, press_forces
from tissue.materials.elasticity import lame
from tissue.scene.organ import LAW_SHAPES, Organ, SlabAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe
from tissue.simulation.builders.organ import hindrance, law_of, with_cited_shape

SHAPES = {
    "second_share": (0.05, 0.95),
    "square_ratio": (0.1, 100.0),
    "cube_ratio": (0.1, 100.0),
    "exponent": (2.0, 30.0),
    "exponential_rate": (0.1, 50.0),
}
"""Range of each shape constant in which a fit searches.

Each end is the limit of the scene key, or lies factors of ten beyond published fits.
"""
NODES = {1: 9, 2: 7}
"""Number of values of a shape constant at which forces are solved, keyed by number of constants.

With one constant and 9 nodes, interpolated forces have an error below 0.3 %
(`tests/tissue/fitting/test_probes.py`).
"""
DENSE = {1: 400, 2: 60}
"""Number of values per shape constant that a fit compares, keyed by the number of constants.

Two neighbouring values of a rate differ by 1.6 % with one shape constant, and by 12 % with two
shape constants.
"""
SHARES = np.array([0.04, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
"""Depths of the solutions divided by the largest depth.

Between these depths, force / depth^1.5 is interpolated.
"""
UNIT_PA = 1e3
"""Modulus of the solutions [Pa]."""
DEEPEST = 0.8
"""Largest ratio of depth to ball radius for which the solver is verified."""
THICKNESSES = 0.7
"""Largest accepted ratio of depth to layer thickness (judgement)."""


@dataclass(frozen=True)
class LayerScene:
    """Geometry and elastic law of a scene whose constants can be fitted to a table of presses."""

    organ: Organ
    radius_m: float
    thickness_m: float
    poisson_ratio: float


@dataclass(frozen=True, eq=False)
class ProbeCurves:
    """Force per modulus [N/Pa] at d depths, for s sets of shape constants of an elastic law.

    Attributes
    ----------
    keys
        Keys of the k shape constants in the table `organ` of a scene.
    shapes
        Values of the shape constants, shape (s, k). For a law without shape constants, the array
        has one empty row.
    unit_N_Pa
        Force for a Young's modulus of 1 Pa, shape (s, d).
    """

    keys: tuple[str, ...]
    shapes: Array
    unit_N_Pa: Array


def layer_scene(scene: Scene) -> LayerScene:
    """Return the ball's radius, the layer's thickness and the layer's elastic law of a scene.

    Raises
    ------
    InputError
        If the organ is not a slab of one isotropic material, or the probe is not a ball.
    """
    anatomy = scene.anatomy
    organ = with_cited_shape(scene.organ, scene.constants)
    tool = scene.tool
    with_table = "for a table of presses"
    if not isinstance(anatomy, SlabAnatomy):
        raise InputError(
            "anatomy.kind",
            f"be slab {with_table}",
            anatomy.kind,
            "use a slab of the tissue's thickness on its bed",
        )
    if not isinstance(tool, Probe) or tool.kind != "sphere-probe":
        raise InputError(
            "tool.kind", f"be sphere-probe {with_table}", tool.kind, "use tool.kind=sphere-probe"
        )
    others = (name for name in ("capsule", "viscous", "young_end_kPa") if getattr(organ, name))
    found = hindrance(organ) or next(others, None)
    if found is not None:
        raise InputError(
            f"organ.{found}",
            f"be left out {with_table}, which determines one isotropic material",
            shown(getattr(organ, found)),
            "use a scene without it",
        )
    if anatomy.nodule_mm > 0.0:
        raise InputError(
            "anatomy.nodule_diameter_mm",
            f"be 0 {with_table}",
            f"{anatomy.nodule_mm:g}",
            "use --set anatomy.nodule_diameter_mm=0 --set organ.parts={}",
        )
    ratio = organ.poisson_ratio
    if ratio is None:
        ratio = scene.constants.values("soft", organ.material)["poisson_ratio"]
    return LayerScene(organ, 0.5e-3 * tool.size_mm, 1e-3 * anatomy.size_mm[2], ratio)


def require_shallow(layer: LayerScene, deepest_m: float) -> None:
    """Refuse a depth [m] for which the solver is not verified.

    Raises
    ------
    InputError
        If the depth is too large relative to the ball's radius or the layer's thickness.
    """
    largest_m = min(DEEPEST * layer.radius_m, THICKNESSES * layer.thickness_m)
    if deepest_m > largest_m:
        raise InputError(
            "measured",
            f"have depths of at most {1e3 * largest_m:.3g} mm, the smaller of {DEEPEST:g} radii of "
            f"the ball and {THICKNESSES:g} thicknesses of the slab",
            f"a depth of {1e3 * deepest_m:.3g} mm",
            "check tool.diameter_mm and anatomy.size_mm, or remove the deeper rows",
        )


def probe_curves(
    layer: LayerScene,
    depths_m: Array,
    keys: tuple[str, ...],
    *,
    first: float = FIRST,
    progress: Progress = silent,
) -> ProbeCurves:
    """Compute the forces at given depths over the ranges of the given shape constants.

    Parameters
    ----------
    layer
        Geometry and elastic law of the scene. Shape constants of the law that are not in `keys`
        keep their values.
    depths_m
        Depths [m], not all of them zero, shape (d,).
    keys
        Names of the shape constants that vary, at most two.
    first
        Edge length of the mesh cells under the ball, divided by the ball's radius.
    progress
        Called with the completed share.

    Raises
    ------
    InputError
        If a depth is too large relative to the ball's radius or the layer's thickness.
    """
    deepest_m = float(depths_m.max())
    require_shallow(layer, deepest_m)
    mesh = layer_mesh(layer.radius_m, layer.thickness_m, first=first)
    if not keys:
        curve = _curve(mesh, layer, {}, deepest_m)
        _require(curve)
        return ProbeCurves((), np.zeros((1, 0)), _between(curve, deepest_m, depths_m)[None])
    axes = [_axis(key, NODES[len(keys)]) for key in keys]
    places = list(product(*axes))
    solved = []
    for number, values in enumerate(places):
        progress(f"solution {number + 1} of {len(places)}", number / len(places))
        solved.append(_curve(mesh, layer, dict(zip(keys, values, strict=True)), deepest_m))
    grid = np.log(np.reshape(solved, (*map(len, axes), -1)))
    axes, grid = _solved_part(axes, grid)
    logs = [_scale(key, axis) for key, axis in zip(keys, axes, strict=True)]
    dense = [np.linspace(each[0], each[-1], DENSE[len(keys)]) for each in logs]
    wanted = np.stack(np.meshgrid(*dense, indexing="ij"), axis=-1).reshape(-1, len(keys))
    curves = np.exp(RegularGridInterpolator(logs, grid, method="cubic")(wanted))
    shapes = np.column_stack([_unscaled(key, wanted[:, at]) for at, key in enumerate(keys)])
    unit = np.stack([_between(curve, deepest_m, depths_m) for curve in curves])
    return ProbeCurves(keys, shapes, unit)


def _curve(mesh: LayerMesh, layer: LayerScene, shape: dict[str, float], deepest_m: float) -> Array:
    """Return the force per modulus [N/Pa] at the depths `SHARES`; NaN without a solution."""
    table = lame(np.array([UNIT_PA]), layer.poisson_ratio)
    found = law_of(layer.organ.model_copy(update=shape), table)
    first, shear = table[0].tolist()
    law = LinearLaw(first, shear) if found is None else found[0]
    return press_forces(mesh, law, SHARES * deepest_m) / UNIT_PA


def _require(curves: Array) -> None:
    if not np.isfinite(curves).all():
        raise InputError(
            "organ.law",
            "have an equilibrium at the measured depths",
            "none",
            "remove the deeper rows, use another law, or use another thickness",
        )


def _solved_part(axes: list[Array], grid: Array) -> tuple[list[Array], Array]:
    """Remove large values of the shape constants for which no equilibrium was found."""
    for at in range(len(axes)):
        others = tuple(each for each in range(grid.ndim) if each != at)
        # With two constants, the corner of both large values may fail alone.
        failed = np.flatnonzero(~np.isfinite(grid).all(axis=others))
        count = int(failed[0]) if len(failed) else grid.shape[at]
        keep = slice(0, max(count, 4))
        axes[at] = axes[at][keep]
        grid = grid[(slice(None),) * at + (keep,)]
    _require(grid)
    return axes, grid


def _axis(key: str, count: int) -> Array:
    low, high = SHAPES[key]
    start, end = _scale(key, np.array([low, high])).tolist()
    return _unscaled(key, np.linspace(start, end, count))


def _scale(key: str, values: Array) -> Array:
    """Return the coordinate of a constant for the interpolation.

    The coordinate is the logarithm of the constant, or the value itself for `second_share`.
    """
    return values if key == "second_share" else np.log(values)


def _unscaled(key: str, places: Array) -> Array:
    return places if key == "second_share" else np.exp(places)


def _between(curve: Array, deepest_m: float, depths_m: Array) -> Array:
    """Interpolate a force curve over depth through force / depth^1.5, which changes slowly."""
    solved = SHARES * deepest_m
    ratio = curve / solved**1.5
    # Towards a vanishing depth the force is Hertz's, so the ratio is constant.
    smooth = PchipInterpolator(np.concatenate([[0.0], solved]), np.concatenate([ratio[:1], ratio]))
    depth = np.maximum(depths_m, 0.0)
    return smooth(depth) * depth**1.5


def shape_keys(organ: Organ) -> tuple[str, ...]:
    """Return the shape constants of an organ's law that have a value above zero."""
    return tuple(key for key in LAW_SHAPES.get(organ.law, ()) if (getattr(organ, key) or 0.0) > 0.0)
