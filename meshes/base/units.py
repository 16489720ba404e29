"""Units of measured quantities, and the names and units in the headers of tables."""

import re
from collections.abc import Sequence

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "cm": 1e-2, "in": 0.0254},
    "speed": {
        "m/s": 1.0,
        "mm/s": 1e-3,
        "um/s": 1e-6,
        "m/min": 1.0 / 60.0,
        "mm/min": 1e-3 / 60.0,
        "in/min": 0.0254 / 60.0,
    },
    "force": {
        "N": 1.0,
        "mN": 1e-3,
        "uN": 1e-6,
        "kN": 1e3,
        "gf": 9.80665e-3,
        "kgf": 9.80665,
        "lbf": 4.4482216152605,
    },
    "torque": {"Nm": 1.0, "Ncm": 1e-2, "Nmm": 1e-3, "mNm": 1e-3, "uNm": 1e-6},
    "angle": {"rad": 1.0, "deg": 0.017453292519943295},
    "number": {},
}
"""Factors that convert units to SI units, in a dictionary by quantity and then by unit.

The factors of gf, kgf and lbf are exact values from BIPM and NIST SP 811.
"""
_SPELLINGS = {
    "sec": "s",
    "seconds": "s",
    "msec": "ms",
    "usec": "us",
    "mum": "um",
    "inch": "in",
    "inches": "in",
    "mm_s": "mm/s",
    "mm_min": "mm/min",
    "mms-1": "mm/s",
    "N-m": "Nm",
    "N-mm": "Nmm",
    "°": "deg",
}
"""Dictionary from other spellings of a unit to its spelling in `UNITS`."""
_IN_BRACKETS = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]\s*$")
_AT_END = re.compile(r"(?:_|\s*[/,]\s*|\s+in\s+)(mm_min|mm_s|[A-Za-zµμ]+(?:/[a-z]+)?)\s*$")
"""Patterns of units in headers: "Load (N)", "Load [N]", "load_N", "t/ms", "t, s", "Load in N"."""


def plain_unit(text: str) -> str:
    """Return a unit in the spelling of `UNITS`: N m, N*m and N·m become Nm, µm becomes um."""
    unit = re.sub(r"[\s*·.]", "", text).replace("µ", "u").replace("μ", "u")
    return _SPELLINGS.get(unit, unit)


def _parts(header: str, quantity: str) -> tuple[str, str]:
    """Return the name and the unit in a header.

    The unit is an empty string if the header does not state a unit of the quantity.
    """
    for pattern in (_IN_BRACKETS, _AT_END):
        found = pattern.search(header)
        if found and plain_unit(found[1]) in UNITS[quantity]:
            return header[: found.start()], plain_unit(found[1])
    return header, ""


def unit_of(header: str, quantity: str) -> str:
    """Return the unit of `quantity` in a header, or an empty string if there is none."""
    return _parts(header, quantity)[1]


def name_of(header: str, quantity: str) -> str:
    """Return a header's name in lower case without the unit: "tool_x" for "Tool X [mm]"."""
    return re.sub(r"[^a-z0-9]+", "_", _parts(header, quantity)[0].lower()).strip("_")


def column_of(wanted: str, quantity: str, headers: Sequence[str]) -> str | None:
    """Return the header that equals `wanted` apart from the unit, for example "tool_x [um]".

    Returns
    -------
    The header `wanted` if it is in `headers`. Otherwise, the only header with the same name and a
    unit of the quantity. None if no header or several headers match.
    """
    if wanted in headers:
        return wanted
    name = name_of(wanted, quantity)
    found = [
        each
        for each in headers
        if name_of(each, quantity) == name and (unit_of(each, quantity) or not UNITS[quantity])
    ]
    return found[0] if len(found) == 1 else None
