"""Refusals of teeth that cannot be: layers unknown, missing, apart, of no tooth's size, or one outside another."""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.surfaces.repair import Triangles
from meshes.tooth.layer_contact import inside_surface
from meshes.tooth.layers import TOOTH_LAYERS

__all__ = ["require_known", "require_pulp_within", "require_tooth_size", "require_touching"]

_SMALLEST_MM, _LARGEST_MM, _TYPICAL_MM = 5.0, 40.0, 18.0
_TOUCH_M = 0.5e-3
_POINTS_TESTED = 4000
_NEAR_M, _LEAST_WITHIN = 0.2e-3, 0.6


def require_known(names: Iterable[str], argument: str) -> None:
    """Refuse names that are not a tooth's layers, and layers without both enamel and dentin."""
    given = list(names)
    for name in given:
        if name not in TOOTH_LAYERS:
            raise InputError(argument, f"name layers of {', '.join(TOOTH_LAYERS)}", name, "rename it")
    for name in ("enamel", "dentin"):
        if name not in given:
            raise InputError(argument, "give enamel and dentin", ", ".join(given) or "none", f"add the {name}")


def require_tooth_size(size_mm: float, argument: str, given: str, per_unit: float) -> None:
    """Refuse a longest side [mm] that no tooth has, and suggest what `argument` would make one.

    Parameters
    ----------
    argument, given
        What sets the size, and the value that it has.
    per_unit
        Size over that value: voxels along the side, or file units.
    """
    if _SMALLEST_MM <= size_mm <= _LARGEST_MM:
        return
    raise InputError(
        argument,
        f"make the tooth {_SMALLEST_MM:g} to {_LARGEST_MM:g} mm long",
        f"{given}, which makes it {size_mm:.3g} mm",
        f"use the scanner's value, about {_TYPICAL_MM / per_unit:.1g}",
    )


def require_touching(points_m: Mapping[str, NDArray[np.float64]], solids: Mapping[str, Triangles]) -> None:
    """Refuse layers that lie in no other layer and farther than 0.5 mm from every one.

    Parameters
    ----------
    points_m, solids
        Points on the surface of each layer [m], shape (n, 3), and its vertices [m] and triangles.
    """
    from scipy.spatial import cKDTree

    trees = {name: cKDTree(points) for name, points in points_m.items()}
    for name, points in points_m.items():
        tested = points[:: max(len(points) // _POINTS_TESTED, 1)]
        apart = {other: float(tree.query(tested)[0].min()) for other, tree in trees.items() if other != name}
        nearest = min(apart, key=lambda other: apart[other])
        if apart[nearest] <= _TOUCH_M:
            continue
        few = tested[:: max(len(tested) // 100, 1)]
        if not any(inside_surface(*solid, few).any() for other, solid in solids.items() if other != name):
            raise InputError(
                f"{name} surface",
                "touch the others in one common frame and unit",
                f"one {1e3 * apart[nearest]:.3g} mm from {nearest}, the nearest",
                "check its unit and its origin",
            )


def require_pulp_within(pulp_m: NDArray[np.float64], dentin: Triangles, dentin_samples_m: NDArray[np.float64]) -> None:
    """Refuse a pulp of whose surface less than 60 % lies within the dentin or 0.2 mm from its surface.

    Parameters
    ----------
    pulp_m, dentin_samples_m
        Points on both surfaces [m], shape (n, 3).
    dentin
        Vertices of the dentin [m] and its triangles.
    """
    from scipy.spatial import cKDTree

    tested = pulp_m[:: max(len(pulp_m) // 2000, 1)]
    far = tested[cKDTree(dentin_samples_m).query(tested)[0] >= _NEAR_M]
    within = 1.0 - float(np.count_nonzero(~inside_surface(*dentin, far))) / len(tested)
    if within < _LEAST_WITHIN:
        raise InputError(
            "pulp",
            "lie within the dentin",
            f"{100.0 * within:.0f} % of its surface there",
            "check which layer is which, and the frame of the pulp surface",
        )
