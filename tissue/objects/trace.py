"""Trace and timing for notebooks: columns by name, also as pandas, xarray and HTML."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.extras import install_command
from tissue.objects.html import scrolled, table_html
from tissue.simulation.saved_fields import field_label
from tissue.simulation.trace import NO_LAYER, Table

if TYPE_CHECKING:
    import pandas
    import xarray

__all__ = ["Trace", "needed"]

SHOWN_ROWS = 5
"""Number of first and of last rows that a notebook shows."""


class Trace(dict[str, NDArray[Any]], Table):
    """Columns by name over the ticks, one row a tick: ``run.trace["force_z_N"]``.

    The unit ends a column's name. A trace is a ``dict``, so ``pandas.DataFrame(run.trace)`` is the
    table. The column ``layer`` holds names.

    Parameters
    ----------
    table
        Table of the engine.

    Attributes
    ----------
    columns
        Names of the columns.
    rows
        Values, shape (ticks, columns); ``layer`` as an index into ``layer_names``, -1 for none.
    layer_names
        Names of the layers.
    """

    def __init__(self, table: Table) -> None:
        Table.__init__(self, table.columns, table.rows, table.layer_names)
        dict.__init__(self, {name: table[name] for name in table.columns})

    def __missing__(self, name: str) -> NDArray[Any]:
        return Table.__getitem__(self, name)  # raises an error that lists the known columns

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a table with one row a tick, layers as categories, and units in the names.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        pandas = needed("pandas", extra="pandas")
        columns: dict[str, Any] = dict(self)
        if "layer" in columns:
            columns["layer"] = pandas.Categorical(
                columns["layer"], categories=[*self.layer_names, NO_LAYER]
            )
        return pandas.DataFrame(columns).rename_axis(index="tick")

    def to_xarray(self) -> "xarray.Dataset":
        """Return a data set with a variable for each column over the dimension ``time_s``.

        Each variable has its unit as the attribute ``units``.

        Raises
        ------
        InputError
            If xarray is not installed.
        """
        xarray = needed("xarray", extra="pandas")
        over = "time_s" if "time_s" in self else "tick"
        found = xarray.Dataset(
            {
                name: (over, values, _attributes(name))
                for name, values in self.items()
                if name != over
            },
            coords={over: self[over] if over in self else np.arange(len(self.rows))},
        )
        found[over].attrs.update(_attributes(over))
        return found

    def __repr__(self) -> str:
        return f"<{len(self.rows)} ticks of {len(self)} columns: {', '.join(self)}>"

    def _repr_html_(self) -> str:
        count = len(self.rows)
        # A single row is shown, not replaced by dots.
        cut = count > 2 * SHOWN_ROWS + 1
        picked = (
            [*range(SHOWN_ROWS), *range(count - SHOWN_ROWS, count)] if cut else list(range(count))
        )
        rows = [[_cell(values[row]) for values in self.values()] for row in picked]
        if cut:
            rows.insert(SHOWN_ROWS, ["…"] * len(self))
        titles = [" / ".join(filter(None, field_label(name))) for name in self]
        return (
            scrolled(table_html(rows, titles=titles, numbers=True))
            + f"<p>{count} ticks, {len(self)} columns</p>"
        )


def needed(name: str, *, extra: str) -> Any:
    """Import and return a module that an extra installs.

    Raises
    ------
    InputError
        If it is not installed; the message shows the command that installs it.
    """
    from importlib import import_module

    try:
        return import_module(name)
    except ModuleNotFoundError as missing:
        # It is installed, but a package that it imports is missing: another fault, shown as it is.
        if missing.name is None or missing.name.split(".")[0] != name.split(".")[0]:
            raise
        raise InputError(
            name, "be installed for this", "none", f"run {install_command(extra)}"
        ) from None


def _attributes(column: str) -> dict[str, str]:
    """Return name and unit of a column as attributes of xarray."""
    words, unit = field_label(column)
    return {"long_name": words, **({"units": unit} if unit else {})}


def _cell(value: object) -> str:
    return f"{value + 0.0:.5g}" if isinstance(value, float) else str(value)
