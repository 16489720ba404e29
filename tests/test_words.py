"""Words of names, docstrings, comments, messages and pages, which follow the field's usage.

CONTRIBUTING lists what to write instead.
"""

import io
import os
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PLACES = (
    "meshes",
    "kernels",
    "tissue",
    "tests",
    "examples",
    "docs",
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
)
BUILT = {"_build", "gallery", "names", "__pycache__"}
"""Folders that are made when the site is built, and may come and go."""


def under(folder):
    """Files under a folder, those aside that are made."""
    for where, folders, names in os.walk(folder):
        folders[:] = sorted(set(folders) - BUILT)
        yield from (Path(where, name) for name in names)


FILES = sorted(
    path
    for place in PLACES
    for path in ([ROOT / place] if (ROOT / place).is_file() else under(ROOT / place))
    if path.suffix in (".py", ".md", ".toml", ".rst") and path != Path(__file__).resolve()
)
WORDS = {
    r"told|tells?|telling|said|says?": "reports, states, shows, raises",
    r"believ\w*|vouch\w*": "valid, trusted, assumed; validate_sample, limit_force",
    r"undelayed": "reference, without latency",
    r"(?<!half )(?<!gives )(?<!gave )(?<!under )ways?": "path, path length, direction, method",
    r"rooms?|houses?": "memory, space; package, module",
    r"(?<!\.)(?<!import )(?<!noise )floors?(?!\()": "base, ground; layer",
    r"worth": "fidelity, error; verification",
    r"in its hand": "closed-loop stability",
    r"overdo\w*": "over-compensates",
    r"catch(es)? up": "start_background",
    r"StressBeside|StressHere": "StressSolver, InlineStressSolver",
}
"""Words of text, by what to write instead; an underscore ends a word."""
NAMES = {
    "ahead",
    "believe",
    "beside",
    "catch_up",
    "own",
    "settle",
    "undelayed",
    "vouch",
    "watch",
    "ways_along",
    "of_one_look",
}
"""Names with too little meaning.

Write instead: predict, is_primary, wait_for_background, observer, arc_length, map_estimate_errors.
"""


ANY_WORD = re.compile(rf"(?<![A-Za-z\"])(?:{'|'.join(WORDS)})(?![A-Za-z\"])", re.IGNORECASE)
ANY_NAME = re.compile(rf"\b(?:{'|'.join(sorted(NAMES))})\b")


def hits(text):
    """Line and word of each hit in a text; a word in quotes alone is a key of a file's format."""
    return [(text.count("\n", 0, hit.start()) + 1, hit.group()) for hit in ANY_WORD.finditer(text)]


def named(code):
    """Line and name of each definition or use of a name that is not to be used."""
    if not ANY_NAME.search(code):
        return []
    tokens = tokenize.generate_tokens(io.StringIO(code).readline)
    return [
        (each.start[0], each.string)
        for each in tokens
        if each.type == tokenize.NAME and each.string in NAMES
    ]


@pytest.mark.parametrize("place", PLACES)
def test_files_use_the_words_of_the_field(place):
    found = []
    for path in FILES:
        if path.relative_to(ROOT).parts[0] == place:
            text = path.read_text("utf-8")
            words = hits(text) + (named(text) if path.suffix == ".py" else [])
            found += [f"{path.relative_to(ROOT)}:{line}: {word}" for line, word in sorted(words)]
    assert not found, "\n".join(found)


def test_words_are_found_and_plain_ones_left():
    text = (
        "the tool is told its way\nalways half way, np.floor(x), what it stands for\nway_m, _tell"
    )
    assert sorted(hits(text)) == [(1, "told"), (1, "way"), (3, "tell"), (3, "way")]
    assert named("own = ahead(3)  # its own\n") == [(1, "own"), (1, "ahead")]
