"""Material constants with their sources: `tissue.material` and `tissue.material_names`."""

from typing import TYPE_CHECKING

from meshes.base.errors import InputError
from meshes.base.hints import nearest, suggests_arguments
from tissue.materials.constants import Constant, constants, listed
from tissue.objects.html import table_html
from tissue.objects.trace import needed

if TYPE_CHECKING:
    import pandas

TABLES = ("cutting", "tooth", "soft", "needle")
"""Data files whose tables are materials."""
CONFIDENCE = {"H": "high", "M": "medium", "L": "low"}
TITLES = ("constant", "value", "lowest", "highest", "confidence", "source")


class Material(dict[str, Constant]):
    """Constants of a material, keyed by names with units.

    An example is ``tissue.material("enamel")["modulus_GPa"].value``.

    Parameters
    ----------
    name
        Name of the material.
    """

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        for table in TABLES:
            if name in listed(table):
                self.update(constants(table, name))

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a table with value, range, confidence and source of each constant.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        table = needed("pandas", extra="pandas").DataFrame(self._rows(), columns=TITLES)
        return table.set_index("constant").rename_axis(columns=self.name)

    def _rows(self) -> list[tuple[str, float, float, float, str, str]]:
        return [
            (
                name,
                one.value,
                one.low,
                one.high,
                CONFIDENCE.get(one.confidence, one.confidence),
                one.source,
            )
            for name, one in self.items()
        ]

    def __repr__(self) -> str:
        return f"<{self.name}: {', '.join(f'{name} {one.value:g}' for name, one in self.items())}>"

    def _repr_html_(self) -> str:
        rows = [
            [f"{each:g}" if isinstance(each, float) else each for each in row]
            for row in self._rows()
        ]
        return table_html(rows, titles=TITLES, caption=self.name)


@suggests_arguments
def material(name: str) -> Material:
    """Return the constants of a built-in or registered material.

    Parameters
    ----------
    name
        Name from the list that `material_names` returns.

    Raises
    ------
    InputError
        If the material is unknown.
    """
    known = material_names()
    if name not in known:
        raise InputError(
            "material",
            f"be one of {', '.join(known)}",
            f"{name}{nearest(name, known)}",
            "choose a listed name",
        )
    return Material(name)


@suggests_arguments
def material_names() -> list[str]:
    """Return the names of all materials, including registered materials."""
    return list(dict.fromkeys(name for table in TABLES for name in listed(table)))
