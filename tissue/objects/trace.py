"""Trace of a run: columns that convert to pandas, xarray and HTML."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, counted
from meshes.base.extras import install_command
from tissue.objects.html import scrolled, table_html
from tissue.simulation.saved_fields import field_label
from tissue.simulation.trace import NO_LAYER, Table

if TYPE_CHECKING:
    import pandas
    import xarray

SHOWN_ROWS = 5
"""Number of rows that a notebook shows at the start and at the end of a trace."""


class Trace(dict[str, NDArray[Any]], Table):
    """Columns of a run, keyed by name, with one row per tick: ``run.trace["force_z_N"]``.

    The name of a column ends with its unit. A trace is a ``dict``, so
    ``pandas.DataFrame(run.trace)`` returns a table. The column ``layer`` contains names.

    Parameters
    ----------
    table
        Table from the simulation engine.

    Attributes
    ----------
    columns
        Names of the columns.
    rows
        Values, shape (ticks, columns). Here the column ``layer`` contains indices into
        ``layer_names``, or -1 for no layer.
    layer_names
        Names of the layers.
    """

    def __init__(self, table: Table) -> None:
        Table.__init__(self, table.columns, table.rows, table.layer_names)
        dict.__init__(self, {name: table[name] for name in table.columns})

    def __missing__(self, name: str) -> NDArray[Any]:
        return Table.__getitem__(self, name)  # raises an error that lists the known columns

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a table with one row per tick; layers are categories, column names contain units.

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
        """Return an xarray data set with one variable per column, along the dimension ``time_s``.

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
        size = f"{counted(len(self.rows), 'tick')} of {counted(len(self), 'column')}"
        return f"<{size}: {', '.join(self)}>"

    def _repr_html_(self) -> str:
        count = len(self.rows)
        # A single hidden row is shown instead of dots.
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
            + f"<p>{counted(count, 'tick')}, {counted(len(self), 'column')}</p>"
        )


def needed(name: str, *, extra: str) -> Any:
    """Import and return a module of an optional dependency.

    Raises
    ------
    InputError
        If the module is not installed. The message shows the command that installs it.
    """
    from importlib import import_module

    try:
        return import_module(name)
    except ModuleNotFoundError as missing:
        # The module is installed, but a package that it imports is missing. This error is shown
        # unchanged.
        if missing.name is None or missing.name.split(".")[0] != name.split(".")[0]:
            raise
        raise InputError(
            name,
            "be installed for this conversion",
            "a Python environment without it",
            f"run {install_command(extra)}",
        ) from None


def _attributes(column: str) -> dict[str, str]:
    """Return the name and the unit of a column as attributes for xarray."""
    words, unit = field_label(column)
    return {"long_name": words, **({"units": unit} if unit else {})}


def _cell(value: object) -> str:
    return f"{value + 0.0:.5g}" if isinstance(value, float) else str(value)
