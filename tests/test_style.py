"""Style of docstrings and words: summary lines, and the terms that CONTRIBUTING lists."""

import ast
import os
import re
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
    ".ci",
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
)
BUILT = {"_build", "gallery", "names", "__pycache__"}
"""Folders that are made when the site is built, and may come and go."""


def files_under(place):
    """Return the text files under a folder, except generated ones; or the file itself."""
    if place.is_file():
        return [place]
    found = []
    for folder, folders, names in os.walk(place):
        folders[:] = sorted(set(folders) - BUILT)
        found += [Path(folder, name) for name in sorted(names)]
    return [path for path in found if path.suffix in (".py", ".md", ".toml", ".rst")]


FILES = {place: files_under(ROOT / place) for place in PLACES}
MODULES = [path for paths in FILES.values() for path in paths if path.suffix == ".py"]

OPENERS = re.compile(r"(What|Where|How|Whether|Who|Why|Those|That|Which|The same)\b")
"""Words that a summary line does not open with: it has a verb, or is a noun phrase."""
OTHER_VERBS = re.compile(r"(Returns|Computes|Gives|Makes|Raises|Writes|Reads|Is|Has)\b")
"""Verbs that are not in the imperative."""

WORDS = {
    r"beside": "next to, alongside, in addition to",
    r"mend(s|ed|ing)?": "fix, correct",
    r"greatest": "largest, best",
    r"foretold|foreseen": "predicted",
    r"nothing beats": "Pareto-optimal",
    r"struck off|laid to|goes on|lest": "removed, assigned, continues, so that ... not",
    r"told|tells?|telling|said|says?": "reports, states, shows, raises",
    r"believ\w*|vouch\w*": "valid, trusted, assumed",
    r"undelayed": "reference, without latency",
    r"(?<!half )(?<!gives )(?<!gave )(?<!under )ways?": "path, direction, method",
    r"rooms?|houses?": "memory, space; package, module",
    r"(?<!\.)(?<!import )(?<!noise )floors?(?!\()": "base, ground; layer",
    r"overdo\w*": "over-compensates",
}
"""Words of prose, with the words to write instead."""
ANY_WORD = re.compile(rf"(?<![\w\"-])(?:{'|'.join(WORDS)})(?![\w\"-])", re.IGNORECASE)


def summaries(code):
    """Return the line and the summary of every docstring of a module."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    found = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, documented):
            text = ast.get_docstring(node)
            if text:
                found.append((getattr(node, "lineno", 1), " ".join(text.split("\n\n")[0].split())))
    return found


def bad_summaries(code):
    """Return the line and the summary of docstrings with a wrong opening or no sentence."""
    return [
        (line, summary)
        for line, summary in summaries(code)
        if OPENERS.match(summary) or OTHER_VERBS.match(summary)
    ]


def bad_words(text):
    """Return the line and word of each hit; a word alone in quotes is a key of a file's format."""
    return [(text.count("\n", 0, hit.start()) + 1, hit.group()) for hit in ANY_WORD.finditer(text)]


def test_summary_lines_open_with_a_verb_or_a_noun():
    found = [
        f"{path.relative_to(ROOT)}:{line}: {summary}"
        for path in MODULES
        for line, summary in bad_summaries(path.read_text("utf-8"))
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("place", PLACES)
def test_texts_use_the_terms_of_the_field(place):
    found = [
        f"{path.relative_to(ROOT)}:{line}: {word}"
        for path in FILES[place]
        if path != Path(__file__).resolve()
        for line, word in bad_words(path.read_text("utf-8"))
    ]
    assert not found, "\n".join(found)


def test_bad_summaries_and_words_are_found_and_good_ones_left():
    code = (
        '"""Kernels."""\ndef f():\n    """How it is done."""\ndef g():\n    """Return the force."""'
    )
    assert bad_summaries(code) == [(2, "How it is done.")]
    text = 'the tool is told its way\nalways half way, np.floor(x), far_way_m "says"\nBeside it'
    assert bad_words(text) == [(1, "told"), (1, "way"), (3, "Beside")]
