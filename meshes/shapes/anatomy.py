"""Class for anatomies (shapes with layers), and a function that builds a block of cortical bone.

In the site frame of every anatomy, the origin is the centre of the working face on the bone
surface, and +z is the outward normal at this point. The tool therefore moves along -z.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from meshes.base.arrays import Array, Bytes, Floats, Singles
from meshes.base.errors import by, require_range, require_vector
from meshes.base.grid import Grid
from meshes.base.placement import Placement
from meshes.shapes.sdf import Shape, box

CORTICAL_KG_M3 = 1800.0
TRABECULAR_KG_M3 = 350.0
"""Apparent densities of cortical and trabecular bone [kg/m3], used if only surfaces are given.

The cortical density is the same as in `meshes.surfaces.glenoid.GlenoidSizes`. The trabecular
density lies between the two densities that `GlenoidSizes` has for trabecular bone.
"""

Classify = Callable[[Floats, Floats], tuple[Bytes, Floats]]
"""Function from positions and depths of points to layer indices and apparent densities.

Input: points [m], shape (n, 3), and depth [m], shape (n,), of each point below the outer surface.
Output: layer index, uint8, shape (n,), and apparent density [kg/m3], shape (n,). Within a layer the
density must vary smoothly over a millimetre.
"""

GridSampler = Callable[[Grid], tuple[Singles, Singles]]
"""Function from a grid to the bone fraction, 0 to 1, and the depth [m] of the grid's voxels.

The two arrays are float32 and have the grid's shape.
"""


@dataclass(frozen=True)
class Anatomy:
    """Solid with named layers, in the site frame.

    Attributes
    ----------
    name
        Name for reports.
    shape
        Signed distance from the outer surface [m].
    layer_names
        Name of each layer index of `classify`.
    classify
        Function that returns the layer and the density at given points (see `Classify`).
    notes
        Assumptions and results for reports, as a dictionary from name to value.
    sample
        Function that returns the bone fraction and the depth of all voxels of a grid. It is given
        for shapes, such as triangle meshes, whose signed distance is too expensive to evaluate at
        each voxel. If None, `shape` is evaluated.
    placement
        Placement of the site frame in the file's frame; None if the anatomy was not read from a
        file.
    caps_m
        Points [m] on the cuts, where the scan ends inside the bone: one array, shape (k, 3), for
        each cut.
    thin_layers
        Whether the anatomy has thin layers, such as a root canal, that may lie between the corners
        of a block of voxels. If true, `classify` is called for every voxel.
    structures
        Dictionary from structure name to the signed distance [m] from the structure, for structures
        that a tool may have to avoid.
    """

    name: str
    shape: Shape
    layer_names: tuple[str, ...]
    classify: Classify
    notes: Mapping[str, str] = field(default_factory=dict)
    sample: GridSampler | None = None
    placement: Placement | None = None
    caps_m: tuple[Array, ...] = ()
    thin_layers: bool = False
    structures: Mapping[str, Shape] = field(default_factory=dict)


def cortical_block(
    *,
    size_mm: tuple[float, float, float] = (20.0, 12.0, 8.0),
    density_kg_m3: float = CORTICAL_KG_M3,
) -> Anatomy:
    """Build a block of cortical bone with one layer `cortical`.

    The top face lies in the plane z = 0. The origin is the centre of the top face.

    Parameters
    ----------
    size_mm
        Edge lengths along x, y and z [mm], each 0.1 to 500.
    density_kg_m3
        Apparent density, 100 to 2500 kg/m3. Cortical bone has 1800 to 2000 kg/m3.

    Raises
    ------
    InputError
        If a parameter is not finite or out of range.
    """
    lengths = require_vector("size_mm", size_mm)
    for k in range(3):
        # The limits are one voxel of 0.1 mm, and more than the longest bone, a femur of about 450
        # mm.
        require_range(f"size_mm[{k}]", size_mm[k], 0.1, 500.0, "use about (20, 12, 8)")
    density = require_range(
        "density_kg_m3", density_kg_m3, 100.0, 2500.0, "use 1800 for cortical bone"
    )
    size = lengths * 1e-3

    def classify(points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        return np.zeros(len(points), dtype=np.uint8), np.full(
            len(points), density, dtype=np.float32
        )

    notes = {"size_mm": by(lengths), "cortical density": f"{density:g} kg/m3, uniform"}
    solid = box(size.tolist(), (0.0, 0.0, -0.5 * float(size[2])))
    return Anatomy("cortical block", solid, ("cortical",), classify, notes)
