"""Suggestions of known names for an unknown key, option, attribute, column or part name."""

import difflib
import re
from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from inspect import Parameter, signature
from types import FunctionType
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])

UNITS = re.compile(r"deg|[km]?n|[kmg]?pa|[kg]?hz|[munk]?m|[mu]?s|kg|rad|m?w|[jk]|mm[23]")
"""Regular expression for a unit in a name. Units are compared separately from words."""
SAME_MEANING = tuple(
    frozenset(words.split())
    for words in (
        "feed speed velocity",
        "spin rpm speed rotation",
        "thrust force load push",
        "size diameter radius width",
        "size spacing resolution voxel voxels",
        "young youngs modulus stiffness elasticity",
        "delay latency lag",
        "prediction predictor method",
        "hand operator surgeon",
        "duration time seconds",
        "interval period step",
        "out output dir directory folder path",
        "cores threads cpus",
        "workers jobs processes",
        "compute gpu cuda",
        "overwrite force replace",
        "pictures picture figures figure plot plots images",
        "format type filetype",
        "over axis abscissa",
        "run simulate simulation",
        "view show display",
        "scenes list",
    )
)
"""Groups of synonyms that users know from simulators, CAD programs and command lines."""
LEAST_SCORE = 0.62
"""Similarity below which a name is not suggested.

If one letter of a scene key is missing, the similarity to the correct key is at least 0.68.
"""
TIE = 0.07
"""Largest difference between the similarity of the best name and that of another suggested name.

An additional word in a name lowers the similarity by 0.085, which is more than this difference. For
`radius_mm`, `diameter_mm` is therefore suggested and `peg_diameter_mm` is not.
"""
MOST = 3
"""Largest number of suggestions."""
MISSPELT = 0.85
"""Ratio of the similarity of two words to the share of letters that they have in common.

With this ratio, a misspelt word is not more similar than a synonym.
"""
OTHER_UNIT = 0.9
"""Factor by which the similarity is multiplied if the two names have different units."""


def closest(word: str, known: Iterable[str]) -> list[str]:
    """Return at most `MOST` known names that resemble a word, the most similar name first.

    Names are compared word by word. Words are compared by spelling. Words in `SAME_MEANING` are
    also compared by meaning. A different unit in a name lowers the similarity (see `OTHER_UNIT`).
    """
    scores = {name: _score(word, name) for name in known}
    best = max(scores.values(), default=0.0)
    if best < LEAST_SCORE:
        return []
    likely = [name for name, score in scores.items() if score > best - TIE]
    return sorted(likely, key=lambda name: -scores[name])[:MOST]


def nearest(word: str, known: Iterable[str]) -> str:
    """Return a question in brackets that suggests the known names most similar to a word.

    The result is an empty string if no name is similar to the word.
    """
    return did_you_mean(closest(word, known))


def suggests_arguments(of: F) -> F:
    """Make errors for unknown arguments of a function or class suggest a known argument.

    Parameters
    ----------
    of
        Function or class. In a class, the constructor and the public methods are wrapped, except
        inherited methods. Functions with a ``**`` parameter are not changed.
    """
    if not isinstance(of, type):
        return _checked(of)
    for name, member in list(vars(of).items()):
        if name.startswith("_") and name != "__init__":
            continue
        if isinstance(member, FunctionType):
            setattr(of, name, _checked(member))
        elif isinstance(member, classmethod | staticmethod):
            setattr(of, name, type(member)(_checked(member.__func__)))
    return of


def _checked(function: F) -> F:
    """Wrap a function such that each call checks the names of keyword arguments."""
    parameters = signature(function).parameters
    if any(each.kind is Parameter.VAR_KEYWORD for each in parameters.values()):
        return function
    known = [name for name in parameters if name not in ("self", "cls")]

    @wraps(function)
    def checked(*values: Any, **options: Any) -> Any:
        """Raise an error for an unknown keyword argument, otherwise call the function."""
        for name in options:
            if name not in known:
                raise TypeError(
                    f"{function.__qualname__}() got an unexpected keyword argument "
                    f"{name!r}{nearest(name, known)}. It takes {', '.join(known)}."
                )
        return function(*values, **options)

    return cast("F", checked)


def did_you_mean(names: Sequence[str]) -> str:
    """Return a question in brackets that suggests names; an empty string if there are no names."""
    if not names:
        return ""
    *first, last = names
    listed = f"{', '.join(first)} or {last}" if first else last
    return f" (did you mean {listed}?)"


def _score(given: str, name: str) -> float:
    """Return the similarity of two names, which is 1 if they have the same words and units."""
    words = _words(given)
    others = _words(name)
    if not words or not others:
        return 0.0
    by_word = sum(max(_alike(word, other) for other in others) for word in words) / len(words)
    # Further words make the name more specific than the given one.
    by_word *= 1.0 - 0.1 * min(max(len(others) - len(words), 0), 3)
    score = max(by_word, _letters("".join(words), "".join(others)))
    units = _units(given)
    return score * OTHER_UNIT if units and units != _units(name) else score


def _units(name: str) -> list[str]:
    """Return the units in a name."""
    return [word for word in re.findall(r"[^\W_]+", name.lower()) if UNITS.fullmatch(word)]


def _words(name: str) -> list[str]:
    """Return the words of a name in lower case, without units."""
    words = re.findall(r"[^\W_]+", name.lower())
    return [word for word in words if not UNITS.fullmatch(word)] or words


def _alike(word: str, other: str) -> float:
    """Return the similarity of two words.

    Equal words have the highest similarity, then words with the same beginning, words with the same
    meaning, and words with similar spelling.
    """
    if word == other:
        return 1.0
    # Shorter beginnings mean nothing: bur is close to burr, but a is not close to all.
    if min(len(word), len(other)) >= 3 and (word.startswith(other) or other.startswith(word)):
        return 0.9
    if any({word, other} <= group for group in SAME_MEANING):
        return 0.85
    return _letters(word, other)


def _letters(word: str, other: str) -> float:
    """Return the similarity of two words by the letters that they share in the same order."""
    return MISSPELT * difflib.SequenceMatcher(None, word, other).ratio()
