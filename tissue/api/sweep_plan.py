"""The runs of a sweep: all combinations of values, each with its scene and a readable folder."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, product
from math import prod
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError
from tissue.scene.load import changed, load_scene, parse_override
from tissue.scene.scene import Scene

__all__ = ["Planned", "parse_values", "planned"]

LONGEST_NAME = 24
"""Letters of a value in the name of a folder; longer ones, and lists, are numbered."""
MOST_RUNS = 10_000
"""Most runs of one sweep: of a second each they take three hours, and their scenes are checked in a minute."""
BRACKETS = {"]": "[", "}": "{"}


@dataclass(frozen=True)
class Planned:
    """A run of a sweep.

    Attributes
    ----------
    name
        Name of its folder, by the keys that are swept.
    values
        Values of the swept keys.
    scene
        What is simulated; None where the values make none.
    problem
        Why they make none.
    """

    name: str
    values: dict[str, object]
    scene: Scene | None
    problem: str = ""


def planned(scene: Scene | str | Path, changes: Mapping[str, Iterable[object]]) -> list[Planned]:
    """All combinations of values, the last key's changing first.

    Raises
    ------
    InputError
        If a key has no values, there are more than `MOST_RUNS` combinations, or no combination makes a scene.
    """
    listed = {key: _listed(key, values) for key, values in changes.items()}
    count = prod(len(values) for values in listed.values())
    if count > MOST_RUNS:
        raise InputError(f"a sweep must have at most {MOST_RUNS} runs, got {count} combinations: give fewer values")
    fixed = {key: values[0] for key, values in listed.items() if len(values) == 1}
    swept = {key: values for key, values in listed.items() if len(values) > 1}
    base = scene if isinstance(scene, Scene) else load_scene(scene)
    words = {key: _words(key, values, swept) for key, values in swept.items()}
    found: dict[str, Planned] = {}
    for places in product(*(range(len(values)) for values in swept.values())):
        chosen = {key: swept[key][place] for key, place in zip(swept, places, strict=True)}
        name = ",".join(words[key][place] for key, place in zip(swept, places, strict=True)) or base.name
        made, problem = None, ""
        try:
            made = changed(base, fixed | chosen)
        except InputError as refused:
            made, problem = None, str(refused)
        found[name] = Planned(name, chosen, made, problem)
    if not any(each.scene is not None for each in found.values()):
        raise InputError(next(iter(found.values())).problem)
    return list(found.values())


def _listed(key: str, values: Iterable[object]) -> list[object]:
    """Values of a key as Python has them, of NumPy's arrays too."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if isinstance(values, str | Mapping) or not isinstance(values, Iterable):
        raise InputError(f"{key} must be given as a list of values, got {values}: use for example [1.0, 2.0]")
    found = list(islice(values, MOST_RUNS + 1))
    if not found:
        raise InputError(f"{key} must be given as a list of values, got {values}: use for example [1.0, 2.0]")
    return [each.item() if isinstance(each, np.generic) else each for each in found]


def parse_values(texts: Sequence[str]) -> dict[str, list[object]]:
    """Values by key of ``key=value,value``; a comma within brackets or quotes belongs to a value.

    Raises
    ------
    InputError
        If there is no ``=``, a value is empty, or a key comes twice.
    """
    found: dict[str, list[object]] = {}
    for text in texts:
        key, sign, values = text.partition("=")
        pieces = _split(values)
        if not sign or not all(pieces):
            raise InputError(f"--set must be key=value,value, got {text}: use for example voxels.spacing_mm=0.2,0.4")
        pairs = [parse_override(f"{key}={piece}") for piece in pieces]
        if pairs[0][0] in found:
            raise InputError(f"--set must name a key once, got {pairs[0][0]} twice: give its values in one, by commas")
        found[pairs[0][0]] = [value for _, value in pairs]
    return found


def _split(text: str) -> list[str]:
    """Text between commas that stand in no brackets and no quotes."""
    pieces, opened, quote = [""], list[str](), ""
    for letter in text:
        if letter == "," and not opened and not quote:
            pieces.append("")
            continue
        pieces[-1] += letter
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter in BRACKETS.values():
            opened.append(letter)
        elif opened and BRACKETS.get(letter) == opened[-1]:
            opened.pop()
    return [piece.strip() for piece in pieces]


def _words(key: str, values: Sequence[object], swept: Mapping[str, object]) -> list[str]:
    """Parts of folders' names for the values of a key: its last word where that names it, and the value."""
    last = key.rpartition(".")[2]
    short = last if sum(other.rpartition(".")[2] == last for other in swept) == 1 else key
    plain = [re.sub(r"[^\w.+-]+", "-", f"{value:g}" if isinstance(value, float) else str(value)) for value in values]
    named = not any(isinstance(value, list | tuple | dict) for value in values)
    named = named and all(plain) and len(set(plain)) == len(plain) and max(map(len, plain)) <= LONGEST_NAME
    return [f"{short}={word if named else f'no{number}'}" for number, word in enumerate(plain, 1)]
