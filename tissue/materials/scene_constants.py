"""Constants of a scene: constants of this package, or constants from a user's file.

Constants of this package are called cited, because each has a source.
"""

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Annotated, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, StringConstraints, ValidationError

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.file_limits import require_regular
from meshes.base.hints import nearest
from meshes.base.text_tables import read_text, read_toml
from tissue.materials.constants import (
    CUT_AS,
    Constant,
    CuttingCoefficients,
    changed_coefficients,
    constants,
    listed,
)

TABLES = ("cutting", "tooth", "soft", "needle", "devices", "hands")
"""Names of the tables whose constants a file may replace."""
ENERGY = "tangential_chip_N_mm2"
"""Name of the constant that is the specific cutting energy."""
HARD_LIMITS = {"poisson_ratio": 0.5, "heat_share": 1.0}
"""Upper limits of constants, keyed by the name of the constant.

The equations cannot be solved for a Poisson's ratio of 0.5.
"""


@dataclass(frozen=True)
class Materials:
    """Constants used by a scene.

    Attributes
    ----------
    given
        Constants of a user's file, keyed by their names ``TABLE.MATERIAL.NAME``. In the table
        ``cutting``, MATERIAL may also be the name of a layer. Constants of the layer take
        precedence over constants of the material.
    names, matrix
        Names of the correlated constants in the file, and the correlation matrix of these
        constants. The correlation is that of the numbers z in `tissue.materials.constants.Prior`.
    file
        Path of the file; empty if all constants are cited.
    """

    given: Mapping[str, Constant] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    matrix: tuple[tuple[float, ...], ...] = ()
    file: str = ""

    cited: ClassVar["Materials"]

    @classmethod
    def read(cls, file: str | PathLike[str]) -> "Materials":
        """Read constants from a TOML file, to replace cited constants.

        Raises
        ------
        InputError
            If the file cannot be read, or contains an invalid table, material, constant or number.
        """
        path = require_regular(Path(file))
        try:
            text = read_text(path)
        except (OSError, ValueError):
            raise InputError(
                "materials", "be an existing TOML file", path, "check the path"
            ) from None
        return _parsed(text, str(path))

    @classmethod
    def of(cls, given: "str | PathLike[str] | Materials | None") -> "Materials":
        """Return the constants of a file or `Materials` object, or the cited constants for None.

        Raises
        ------
        InputError
            As in `read`, or if the argument has another type.
        """
        if given is None:
            return cls.cited
        if isinstance(given, Materials):
            return given
        if not isinstance(given, str | PathLike):
            raise InputError(
                "materials",
                "be the path of a TOML file",
                type(given).__name__,
                "give the file that `tissue fit` wrote",
            )
        return cls.read(given)

    def constants(self, table: str, material: str) -> dict[str, Constant]:
        """Return the constants of a material, keyed by name.

        Constants in the user's file replace cited constants. The result contains all names of the
        cited constants. For a layer in the table ``cutting``, use `coefficients`, because a layer
        is not a material. This method raises the same errors as
        `tissue.materials.constants.constants`.
        """
        found = constants(table, material)
        if not self.given:
            return found
        start = f"{table}.{material}."
        return {name: self.given.get(start + name, one) for name, one in found.items()}

    def values(self, table: str, material: str) -> dict[str, float]:
        """Return the values of a material's constants; see `constants`."""
        return {name: one.value for name, one in self.constants(table, material).items()}

    def layer_constants(self, layer: str, *, bone: str = "bone") -> dict[str, Constant]:
        """Return the cutting constants of a layer.

        If the user's file has constants for the layer, they replace the constants of the layer's
        material. A bone layer has the material `bone`.
        """
        found = self.constants("cutting", CUT_AS.get(layer, bone))
        return {name: self.given.get(f"cutting.{layer}.{name}", one) for name, one in found.items()}

    def coefficients(
        self, layer_names: Sequence[str], changes: Mapping[str, float | None], *, bone: str = "bone"
    ) -> tuple[CuttingCoefficients, ...]:
        """Return the cutting coefficients of layers in SI units.

        Parameters
        ----------
        layer_names
            Names of the layers. Enamel, dentin, caries, pulp and ligament have their own materials.
            Any other layer has the material `bone`.
        changes
            Constants, keyed by name, that replace those of the materials in all layers.
        bone
            Material of bone.

        Raises
        ------
        InputError
            If a material is not listed, or `changes` contains a name that is not a constant.
        """
        layers = (self.layer_constants(layer, bone=bone) for layer in layer_names)
        return tuple(changed_coefficients(layer, changes) for layer in layers)

    def numbers(
        self, table: str, numbers: Mapping[str, float], *materials: str
    ) -> dict[str, float]:
        """Return the parameters of a device or a simulated hand, updated with the user's file.

        If the file gives the same parameter for several of the `materials`, the last of these is
        used.
        """
        found = dict(numbers)
        for material in materials:
            start = f"{table}.{material}."
            found |= {
                name[len(start) :]: one.value
                for name, one in self.given.items()
                if name.startswith(start)
            }
        return found

    def origin(self, table: str, material: str, name: str) -> str:
        """Return the origin of a constant, as text for a note: "of FILE", or "cited"."""
        return (
            f"of {Path(self.file).name}" if f"{table}.{material}.{name}" in self.given else "cited"
        )

    def correlation(self, names: Sequence[str]) -> Array:
        """Return the correlation matrix, shape (n, n), of the constants with the given names.

        The diagonal is one. Pairs of constants that the file does not list have zero correlation.
        """
        found = np.eye(len(names))
        place = {name: at for at, name in enumerate(self.names)}
        for i, first in enumerate(names):
            for j, second in enumerate(names):
                if i != j and first in place and second in place:
                    found[i, j] = self.matrix[place[first]][place[second]]
        return found

    @property
    def key(self) -> str:
        """Text that identifies the constants, used as a cache key.

        The text is empty if all constants are cited, which means that no file replaces constants.
        """
        return repr((sorted(self.given.items()), self.names, self.matrix)) if self.given else ""


Materials.cited = Materials()


@lru_cache(maxsize=64)
def _parsed(text: str, path: str) -> Materials:
    try:
        tables = read_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            "materials",
            "be a valid TOML file",
            f"{path} with the error: {str(error)[:200].lower()}",
            "fix the file",
        ) from None
    correlation = tables.pop("correlation", None)
    given: dict[str, Constant] = {}
    for table, materials in tables.items():
        _require_known("a table", table, TABLES, path)
        for material, entries in _table(materials, table, path).items():
            # In the table `cutting`, the name may be the name of a layer. Its constants have the
            # names of the constants of bone.
            if table != "cutting":
                _require_known(f"a material of {table}", material, listed(table), path)
            known = constants(table, material if material in listed(table) else "bone")
            for name, entry in _table(entries, f"{table}.{material}", path).items():
                _require_known(f"a constant of {table}.{material}", name, known, path)
                full = f"{table}.{material}.{name}"
                given[full] = checked_constant(full, entry, path)
    if not given:
        raise InputError(f"materials: {path} contains no constant. {_instead_of(text)}.")
    if correlation is None:
        return Materials(given, file=path)
    names, matrix = _correlation(correlation, given, path)
    return Materials(given, names, matrix, path)


FITTED_KEYS = "# keys of the scene: --set "
"""Start of a comment in a file of `tissue fit`, before the options that set the fitted keys."""


def _instead_of(text: str) -> str:
    """Return advice for a file without constants, such as the scene keys to set instead."""
    for line in text.splitlines():
        if line.startswith(FITTED_KEYS):
            keys = line.removeprefix(FITTED_KEYS).replace(" --set ", " and ")
            return f"Leave materials out and set {keys} instead"
    return (
        "Leave materials out, or add a constant to the file, such as "
        "[cutting.bone.radial_chip_N_mm2]"
    )


def _table(found: object, name: str, path: str) -> dict[str, object]:
    if not isinstance(found, dict):
        raise InputError(
            name,
            "be a table in materials",
            f"{found} in {path}",
            "write [TABLE.MATERIAL.NAME] with value, range, source and confidence",
        )
    return found


def _require_known(what: str, name: str, known: Iterable[str], path: str) -> None:
    if name not in known:
        names = list(known)
        raise InputError(
            "materials",
            f"name {what}, one of {', '.join(names)}",
            f"{name}{nearest(name, names)} in {path}",
            "use the listed name that the scene uses, because the file replaces its constants",
        )


class _Entry(BaseModel, strict=True, extra="forbid"):
    """Constant as it is written in a user's file."""

    value: FiniteFloat
    range: Annotated[list[Annotated[FiniteFloat, Field(ge=0.0)]], Field(min_length=2, max_length=2)]
    source: Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
    confidence: Literal["H", "M", "L"]


class _Correlation(BaseModel, strict=True, extra="forbid"):
    """Correlation of constants as it is written in a user's file."""

    names: list[str]
    matrix: list[list[FiniteFloat]]


Checked = TypeVar("Checked", bound=BaseModel)


def _checked(model: type[Checked], found: object, name: str, path: str) -> Checked:
    """Validate a table of a file."""
    try:
        return model.model_validate(found)
    except ValidationError as problem:
        first = problem.errors()[0]
        place = ".".join(map(str, (name, *first["loc"])))
        if first["type"] == "missing":
            raise InputError(place, f"be given in {path}", "nothing", "add it") from None
        shown = str(first["input"])[:100]
        raise InputError(
            place, f"be valid in {path}", shown, f"{first['msg'][:1].lower()}{first['msg'][1:]}"
        ) from None


def checked_constant(full: str, found: object, path: str) -> Constant:
    """Validate and return a constant of a file."""
    entry = _checked(_Entry, found, full, path)
    low, high = entry.range
    most = HARD_LIMITS.get(full.rpartition(".")[2], np.inf)
    if not low <= entry.value <= high <= most:
        bound = "" if most == np.inf else f", and its range inside [0, {most:g}]"
        raise InputError(
            full,
            f"have its value inside its range{bound}",
            f"the value {entry.value:g} and the range [{low:g}, {high:g}] in {path}",
            "fix the value or the range",
        )
    return Constant(entry.value, low, high, entry.source, entry.confidence)


def _correlation(
    found: object, given: Mapping[str, Constant], path: str
) -> tuple[tuple[str, ...], tuple[tuple[float, ...], ...]]:
    """Read the names and the matrix of the correlation in a file."""
    table = _checked(_Correlation, found, "correlation", path)
    names = table.names
    for name in names:
        _require_known("constants of the file in correlation", name, given, path)
    count = len(names)
    lengths = [len(table.matrix), *map(len, table.matrix), len(set(names))]
    if lengths.count(count) != len(lengths):
        raise InputError(
            "correlation",
            f"have different names and a matrix of {count} x {count} numbers",
            f"other names or another matrix in {path}",
            "fix the names or the matrix",
        )
    matrix = np.array(table.matrix).reshape(count, count)
    # 1e-9: rounding error of numbers in a file.
    is_correlation = np.allclose(matrix, matrix.T, rtol=0.0, atol=1e-9) and np.allclose(
        np.diag(matrix), 1.0, rtol=0.0, atol=1e-9
    )
    if not is_correlation or (count and np.linalg.eigvalsh(matrix)[0] <= 0.0):
        raise InputError(
            "correlation",
            "be symmetric and positive definite with ones on its diagonal",
            f"another matrix in {path}",
            "fix the matrix",
        )
    return tuple(names), tuple(tuple(row) for row in matrix.tolist())


def energy_note(
    layer_names: tuple[str, ...],
    constants: Materials,
    *,
    bone: str = "bone",
    changes: Mapping[str, float | None],
) -> str:
    """Describe the specific cutting energy of each layer, its range and its origin.

    The tangential chip coefficient is used as the specific cutting energy. The energy holds at the
    density and chip thickness that the text states.

    Parameters
    ----------
    layer_names
        Names of the layers of the bone.
    constants
        Constants of the scene.
    bone
        Material of bone.
    changes
        Constants from the scene that replace the constants of all layers.
    """
    if (stated := changes.get(ENERGY)) is not None:
        return f"{1e-3 * stated:g} J/mm3, as the scene states"
    remarks = []
    for layer in layer_names:
        material = CUT_AS.get(layer, bone)
        found = constants.layer_constants(layer, bone=bone)
        energy = found[ENERGY]
        law = changed_coefficients(found, changes)
        # the energy depends on these two quantities only with an exponent that is not zero
        at = []
        if law.density_exponent:
            at.append(f"{law.reference_density_kg_m3:g} kg/m3")
        if law.size_exponent:
            at.append(f"a chip of {1e6 * law.reference_chip_m:g} µm")
        where = f" at {' and '.join(at)}" if at else ""
        known = [
            name for name in (layer, material) if f"cutting.{name}.{ENERGY}" in constants.given
        ]
        origin = f" of {Path(constants.file).name}" if known else ""
        remarks.append(
            f"{[*known, material][0]} {1e-3 * energy.value:g} "
            f"({1e-3 * energy.low:g}-{1e-3 * energy.high:g}) J/mm3"
            f"{where}{origin}, confidence {energy.confidence}"
        )
    return "; ".join(sorted(set(remarks)))
