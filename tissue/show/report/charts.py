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

__all__ = [
    "Record",
    "charts",
    "columns",
    "packed",
    "packed_mesh",
    "packed_shares",
    "packed_vectors",
]

Record = dict[str, Any]
"""Values that JSON can contain."""
LARGEST = 32767
"""Largest absolute value of a number that is encoded with 16 bits."""
STEPS = 255
"""Number of steps of a colour: one byte, as many as a screen shows."""


def packed(values: NDArray[np.integer[Any]], *, differences: bool = True) -> Record:
    """Encode an array of integers, shape (rows,) or (rows, columns), as compressed text.

    Integers of 8 bits are unsigned. Integers of 16 and 32 bits are signed.

    By default, the differences between consecutive rows are encoded. A difference that does not fit
    into the bytes of an integer is wrapped around. Negative differences become odd numbers and the
    others even numbers (zigzag code). The high bytes of small differences are therefore 0. Before
    the compression, bytes are ordered by significance: the lowest bytes of all integers come first,
    column by column.
    """
    rows = values if values.ndim == 2 else values[:, None]
    size = rows.dtype.itemsize
    whole = rows.astype(f"i{size}").astype(np.int64)
    if differences:
        step = np.diff(whole, axis=0, prepend=0).astype(f"i{size}").astype(np.int64)
        # the sign moves to the lowest bit (zigzag)
        whole = (step << 1) ^ (step >> 63)
    planes = (
        np.ascontiguousarray(whole.astype(f"<u{size}").T)
        .reshape(-1)
        .view(np.uint8)
        .reshape(-1, size)
        .T
    )
    return {
        "rows": rows.shape[0],
        "columns": rows.shape[1],
        "kind": f"{rows.dtype.kind}{size}",
        "differences": differences,
        # 9 is the smallest output; a report is written once and sent on
        "data": b64encode(zlib.compress(np.ascontiguousarray(planes).tobytes(), 9)).decode("ascii"),
    }


def packed_vectors(values: ArrayLike) -> Record:
    """Encode an array of numbers as integers of 16 bits, with one step size for all columns.

    The step size is the range of the widest column divided by 65,532.

    A number is decoded as ``low`` + ``step`` * (whole + 32767), where ``whole`` is the integer and
    ``low`` belongs to the column.

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


def packed_mesh(points_mm: ArrayLike, triangles: ArrayLike) -> tuple[Record, NDArray[np.intp]]:
    """Encode a surface; also return the indices of its points in the order of encoding.

    Unused points are left out. Points are in the order in which triangles first use them. A corner
    of a triangle is encoded as the number of points that earlier corners use, minus the index of
    its point. A point that is used for the first time therefore has the code 0.
    """
    corners = np.asarray(triangles, dtype=np.intp).reshape(-1, 3).ravel()
    used, first, at = np.unique(corners, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    named = place[at.reshape(-1)]
    unnamed = np.maximum.accumulate(np.concatenate([[-1], named]))[:-1] + 1
    record = {
        "points": packed_vectors(np.asarray(points_mm, dtype=np.float64)[used[order]]),
        "corners": packed((unnamed - named).astype(np.int32)[:, None], differences=False),
    }
    return record, used[order]


PLAYED = {"raw_force": "renderer's", "device_force": "played by the device"}
FIRST = ("indentation_mm", "insertion_mm", "depth_mm")
"""Columns that the last chart shows at the start, if a run has one of them."""
HIDDEN = ("tool_q", "device_q")


def columns(trace: Table) -> Record:
    """Return the encoded columns of a trace that vary.

    The layer of largest contact in each row is returned too.
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
