"""The constants of a scene: the cited ones, with those of a person's file in their place."""

import difflib
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from math import isfinite
from os import PathLike
from pathlib import Path
from typing import ClassVar, TypeGuard

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.file_limits import require_regular
from meshes.base.text_tables import read_toml
from tissue.materials.constants import Constant, CuttingCoefficients, changed_coefficients, constants, listed
from tissue.materials.cutting import CUT_AS

__all__ = ["Materials", "checked_constant"]

TABLES = ("cutting", "tooth", "soft", "needle", "devices", "hands")
"""Tables whose constants a file may replace."""
HARD_LIMITS = {"poisson_ratio": 0.5, "heat_share": 1.0}
"""Greatest value of a constant, by its name; a ratio of one half cannot be solved."""


@dataclass(frozen=True)
class Materials:
    """Constants that a scene rests on.

    Attributes
    ----------
    given
        Constants of a person's file by their names ``TABLE.MATERIAL.NAME``; in the table ``cutting`` a layer may stand
        for the material, and its constants come before those of its material.
    names, matrix
        Correlation of constants as the file states it: of the normal numbers of `tissue.materials.prior.Prior`.
    file
        Where they were read; nothing where all are cited.
    """

    given: Mapping[str, Constant] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    matrix: tuple[tuple[float, ...], ...] = ()
    file: str = ""

    cited: ClassVar["Materials"]

    @classmethod
    def read(cls, file: str | PathLike[str]) -> "Materials":
        """Constants of a TOML file, over the cited ones.

        Raises
        ------
        InputError
            If the file cannot be read, or holds a table, a material, a constant or a number that cannot be meant.
        """
        path = require_regular(Path(file))
        try:
            text = path.read_text("utf-8")
        except (OSError, ValueError):
            raise InputError(f"materials must be a TOML file that exists, got {path}: check the path") from None
        return _parsed(text, str(path))

    @classmethod
    def of(cls, given: "str | PathLike[str] | Materials | None") -> "Materials":
        """Constants that a caller gives, by their file or as they are; None for the cited ones; raises as `read`.

        Raises
        ------
        InputError
            If it is neither.
        """
        if given is None:
            return cls.cited
        if isinstance(given, Materials):
            return given
        if not isinstance(given, str | PathLike):
            raise InputError(
                f"materials must be the path of a TOML file, got {type(given).__name__}: name what `tissue fit` wrote"
            )
        return cls.read(given)

    def constants(self, table: str, material: str) -> dict[str, Constant]:
        """Constants of a material by their names, those of the file in place of the cited ones; raises as `constants`.

        The names of the cited ones are all there; a layer of the table ``cutting`` is no material, see `coefficients`.
        """
        start = f"{table}.{material}."
        found = constants(table, material)
        return {name: self.given.get(start + name, one) for name, one in found.items()} if self.given else found

    def layer_constants(self, layer: str, *, bone: str = "bone") -> dict[str, Constant]:
        """Cutting constants of a layer: of its material, or `bone`, and over them its own."""
        found = self.constants("cutting", CUT_AS.get(layer, bone))
        return {name: self.given.get(f"cutting.{layer}.{name}", one) for name, one in found.items()}

    def coefficients(
        self, layer_names: Sequence[str], changes: Mapping[str, float | None], *, bone: str = "bone"
    ) -> tuple[CuttingCoefficients, ...]:
        """Cutting coefficients of layers in SI.

        Parameters
        ----------
        layer_names
            Enamel, dentin, caries, pulp and ligament are cut as such, all others as `bone`.
        changes
            Single constants in place of those of the materials, in all layers.
        bone
            Material of bone.

        Raises
        ------
        InputError
            If there is no such material, or a change names no constant.
        """
        layers = (self.layer_constants(layer, bone=bone) for layer in layer_names)
        return tuple(changed_coefficients(layer, changes) for layer in layers)

    def numbers(self, table: str, numbers: Mapping[str, float], *materials: str) -> dict[str, float]:
        """Numbers of a device or a hand with those of the file in their place, later materials over earlier ones."""
        found = dict(numbers)
        for material in materials:
            start = f"{table}.{material}."
            found |= {name[len(start) :]: one.value for name, one in self.given.items() if name.startswith(start)}
        return found

    def origin(self, table: str, material: str, name: str) -> str:
        """Whether a constant is cited or comes from the file, in a word for a note."""
        return f"of {Path(self.file).name}" if f"{table}.{material}.{name}" in self.given else "cited"

    def correlation(self, names: Sequence[str]) -> Array:
        """Correlation of constants by their names, shape (n, n): ones on the diagonal, zero where the file has none."""
        found = np.eye(len(names))
        place = {name: at for at, name in enumerate(self.names)}
        for i, first in enumerate(names):
            for j, second in enumerate(names):
                if i != j and first in place and second in place:
                    found[i, j] = self.matrix[place[first]][place[second]]
        return found

    @property
    def key(self) -> str:
        """What they hold, as text: what a cache of anything computed with them goes by."""
        return repr((sorted(self.given.items()), self.names, self.matrix)) if self.given else ""


Materials.cited = Materials()


@lru_cache(maxsize=64)
def _parsed(text: str, path: str) -> Materials:
    try:
        tables = read_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"materials must be valid TOML, got {str(error)[:200].lower()} in {path}: mend it") from None
    correlation, given = tables.pop("correlation", None), dict[str, Constant]()
    for table, materials in tables.items():
        _require_known("a table", table, TABLES, path)
        for material, entries in _table(materials, table, path).items():
            if table != "cutting":
                _require_known(f"a material of {table}", material, listed(table), path)
            known = constants(table, material if material in listed(table) else "bone")
            for name, entry in _table(entries, f"{table}.{material}", path).items():
                _require_known(f"a constant of {table}.{material}", name, known, path)
                full = f"{table}.{material}.{name}"
                given[full] = checked_constant(full, entry, path)
    if not given:
        raise InputError(f"materials must hold a constant such as [cutting.bone.radial_chip_N_mm2], got none in {path}")
    names, matrix = _correlation(correlation, given, path) if correlation is not None else ((), ())
    return Materials(given, names, matrix, path)


def _table(found: object, name: str, path: str) -> dict[str, object]:
    if not isinstance(found, dict):
        raise InputError(
            f"{name} must be a table in materials, got {found} in {path}: write [TABLE.MATERIAL.NAME] with value, "
            "range, source and confidence"
        )
    return found


def _require_known(what: str, name: str, known: Iterable[str], path: str) -> None:
    if name not in known:
        names = list(known)
        close = difflib.get_close_matches(name, names, n=1)
        meant = f" (did you mean {close[0]}?)" if close else ""
        raise InputError(
            f"materials must name {what}: {', '.join(names)}, got {name}{meant} in {path}: choose a listed one"
        )


def checked_constant(full: str, entry: object, path: str) -> Constant:
    """Return an entry of a file of materials as a constant, and raise an error where it is not one."""
    entries = _table(entry, full, path)
    wanted = {"value", "range", "source", "confidence"}
    if wrong := sorted(wanted ^ entries.keys()):
        raise InputError(f"{full} must hold value, range, source and confidence and nothing else, got a difference in "
                         f"{', '.join(wrong)} in {path}: write all four")  # fmt: skip
    value, ends = entries["value"], entries["range"]
    given: list[object] = [value, *ends] if isinstance(ends, list) else [value]
    numbers = [float(each) for each in given if _is_number(each)]
    if len(given) != 3 or len(numbers) != 3:
        raise InputError(
            f"{full} must hold a value and a range of two finite numbers, got {value} and {ends} in {path}: mend them"
        )
    middle, low, high = numbers
    most = HARD_LIMITS.get(full.rpartition(".")[2], np.inf)
    if not (low <= middle <= high and low >= 0.0 and high <= most):
        bound = "" if most == np.inf else f" and range within [0, {most:g}]"
        raise InputError(
            f"{full} must have its value inside its range{bound or ', none below zero'}, got {middle:g} in "
            f"[{low:g}, {high:g}] in {path}: mend them"
        )
    source, confidence = entries["source"], entries["confidence"]
    if not isinstance(source, str) or not source.strip():
        raise InputError(f"{full} must state its source, got {source!r} in {path}: state where the number comes from")
    if confidence not in ("H", "M", "L"):
        raise InputError(f"{full} must have confidence H, M or L, got {confidence!r} in {path}: choose one")
    return Constant(middle, low, high, source, str(confidence))


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _correlation(
    found: object, given: Mapping[str, Constant], path: str
) -> tuple[tuple[str, ...], tuple[tuple[float, ...], ...]]:
    """Names and matrix of the file's correlation, checked."""
    table = _table(found, "correlation", path)
    names, rows = table.get("names"), table.get("matrix")
    if table.keys() != {"names", "matrix"} or not isinstance(names, list) or not isinstance(rows, list):
        raise InputError(f"correlation must hold names and matrix, got {', '.join(table)} in {path}: write both lists")
    for name in names:
        _require_known("constants of the file in correlation", str(name), given, path)
    good = all(isinstance(row, list) and len(row) == len(names) and all(map(_is_number, row)) for row in rows)
    if not good or len(rows) != len(names) or len(set(names)) != len(names):
        raise InputError(
            f"correlation must have a matrix of {len(names)} rows of as many numbers and names that differ, got "
            f"another in {path}: mend it"
        )
    matrix = np.array(rows, dtype=float)
    if len(names) and (
        np.abs(matrix - matrix.T).max() > 1e-9
        or np.abs(np.diag(matrix) - 1.0).max() > 1e-9
        or np.linalg.eigvalsh(matrix)[0] <= 0.0
    ):
        raise InputError(
            f"correlation must be symmetric and positive definite with ones on its diagonal, got another matrix in "
            f"{path}: mend it"
        )
    return tuple(names), tuple(tuple(row) for row in matrix.tolist())
