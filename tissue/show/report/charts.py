"""Charts of a report, and encoding of arrays as compact text in JSON, which `decode.js` reads."""

import zlib
from base64 import b64encode
from typing import Any

import numpy as np
from matplotlib.colors import to_hex
from numpy.typing import ArrayLike, NDArray

from tissue.models.tissue_model import TICK_S
from tissue.scene.scene import Scene
from tissue.show.figures.figure import COMPONENTS, field_words, layer_colours, torque_unit
from tissue.simulation.trace import Table

Record = dict[str, Any]
"""Values that JSON can contain."""
LARGEST = 32767
"""Largest absolute value of a number that is encoded with 16 bits."""
STEPS = 255
"""Number of steps of an encoded colour scale: one byte per value, as on a screen."""


def packed(values: NDArray[np.integer[Any]]) -> Record:
    """Encode an array of integers, shape (rows,) or (rows, columns), as compressed text.

    Integers of 8 bits are unsigned. Integers of 16 and 32 bits are signed. The differences between
    consecutive rows are encoded, column by column. A difference that exceeds the range of the
    integer type is wrapped around.
    """
    rows = values if values.ndim == 2 else values[:, None]
    steps = np.diff(rows, axis=0, prepend=np.zeros((1, rows.shape[1]), rows.dtype)).T
    little = np.ascontiguousarray(steps, dtype=rows.dtype.newbyteorder("<"))
    return {
        "rows": rows.shape[0],
        "columns": rows.shape[1],
        "kind": f"{rows.dtype.kind}{rows.dtype.itemsize}",
        # 9 is the smallest output; a report is written once and sent on
        "data": b64encode(zlib.compress(little.tobytes(), 9)).decode("ascii"),
    }


def packed_vectors(values: ArrayLike) -> Record:
    """Encode an array of numbers as integers of 16 bits, with one step size for all columns.

    The step size is the range of the widest column divided by 65,532.

    A number is decoded as ``low`` + ``step`` * (whole + 32767). ``whole`` is the integer, and
    ``low`` is the smallest value of the column, rounded down to a multiple of ``step``.

    A value of 0 stays exactly 0.
    """
    rows = np.asarray(values, dtype=np.float64)
    low, high = (
        (rows.min(axis=0), rows.max(axis=0)) if len(rows) else (np.zeros(rows.shape[1:]),) * 2
    )
    widest = float(np.max(high - low, initial=0.0)) or float(np.abs(rows).max(initial=0.0))
    # two steps are kept for the rounding of the lowest value; constant columns have any step
    step = widest / (2 * LARGEST - 2) or 1.0
    low = step * np.floor(low / step)
    whole = np.rint((rows - low) / step) - LARGEST
    return {"low": low.tolist(), "step": step, **packed(whole.astype(np.int16))}


def packed_shares(values: ArrayLike) -> Record:
    """Encode positions on a colour scale, 0 to 1, in steps of 1/255."""
    return packed(
        np.rint(STEPS * np.clip(np.nan_to_num(np.asarray(values)), 0.0, 1.0)).astype(np.uint8)
    )


def packed_mesh(points_mm: ArrayLike, triangles: ArrayLike) -> Record:
    """Encode a surface with points, shape (n, 3), and indices of its triangles, shape (m, 3)."""
    corners = np.asarray(triangles, dtype=np.int32).reshape(-1, 3)
    return {"points": packed_vectors(np.asarray(points_mm)), "corners": packed(corners)}


PLAYED = {"raw_force": "renderer's", "device_force": "played by the device"}
FIRST = ("indentation_mm", "insertion_mm", "depth_mm")
"""Columns that the last chart shows at the start, if a run has one of them."""
HIDDEN = ("tool_q", "device_q")


def encoded_columns(trace: Table) -> Record:
    """Encode those columns of a trace that vary and contain only finite values.

    For each row, the index of the layer with the largest contact area is also encoded.
    """
    varying = [
        name
        for name in trace.columns
        if name not in ("time_s", "layer") and np.ptp(trace[name]) > 0.0
    ]
    kept = [name for name in varying if np.isfinite(trace[name]).all()]
    layers = trace.rows[:, trace.columns.index("layer")].astype(np.int16)
    colours = layer_colours(trace.layer_names)
    return {
        "rows": len(trace.rows),
        "start_s": float(trace["time_s"][0]),
        "step_s": TICK_S,
        "columns": {name: packed_vectors(trace[name][:, None]) for name in kept},
        "labels": {name: field_words(name) for name in kept if not name.startswith(HIDDEN)},
        "layer": packed(layers),
        "layers": [[name, to_hex(colours[name])] for name in trace.layer_names],
    }


def charts(trace: Table, scene: Scene | None) -> list[Record]:
    """Return the charts of a report.

    The charts show force, torque, force at a device, removal rate or contact area, depth, and one
    column that the user of the report can choose.
    """
    shown, factor = torque_unit(np.abs(trace.vectors("model_torque", "Nm")).max(initial=0.0))
    torque = ("torque", "Nm", f"torque / {shown}", factor)
    drawn = []
    for name, unit, label, scale in (("force", "N", "force / N", 1.0), torque):
        # an axial load without friction has no torque
        if not trace.vectors(f"model_{name}", unit).any() and name == "torque":
            continue
        model, commanded = (
            [_line(f"{of}{name}_{c}_{unit}", c, COMPONENTS[i], scale) for i, c in enumerate("xyz")]
            for of in ("model_", "")
        )
        pale = [line | {"label": "", "pale": True} for line in commanded]
        magnitude = [line["of"][0] for line in model]
        size = {"of": magnitude, "label": "magnitude", "scale": scale, "fill": True}
        drawn.append({"label": label, "tall": name == "force", "lines": [size, *pale, *model]})
    if scene is not None and scene.device is not None:
        drawn.append(_device(trace))
    cuts = bool((trace["removed_mm3"] > 0.0).any())
    drawn.append(_one("removal_rate_mm3_s" if cuts else "contact_mm2"))
    drawn.append(_one("tool_z_mm") | {"label": "tip, z / mm", "layers": True})
    usual = "removed_mm3" if cuts else "contact_mm2"
    first = next((name for name in trace.columns if name.startswith(FIRST)), usual)
    return [*drawn, _one(first) | {"choose": first}]


def _device(trace: Table) -> Record:
    """Return the chart of the forces at the device."""
    lines = [
        _line("", label, colour, 1.0) | {"of": [f"{name}_{c}_N" for c in "xyz"]}
        for (name, label), colour in zip(PLAYED.items(), COMPONENTS, strict=False)
        if f"{name}_x_N" in trace
    ]
    return {"label": "at the device / N", "lines": lines}


def _one(name: str) -> Record:
    return {"label": field_words(name), "lines": [_line(name, "", "", 1.0)]}


def _line(column: str, label: str, colour: str, scale: float) -> dict[str, Any]:
    return {"of": [column], "label": label, "colour": colour, "scale": scale}
