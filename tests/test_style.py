"""Style of docstrings and words: summary lines, and the terms that CONTRIBUTING lists."""

import ast
import inspect
import itertools
import os
import re
from pathlib import Path

import pytest
from own_imports import statements

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
SUSPECT = re.compile(rf"[\"']\s*(?:{OPENERS.pattern}|{OTHER_VERBS.pattern})")
"""A string with such a first word, which may be a summary line."""

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
    r"(?<!operating )rooms?(?! temperature)|houses?": "memory, space; package, module",
    r"(?<!\.)(?<!import )(?<!noise )floors?(?!\()": "base, ground; layer",
    r"overdo\w*": "over-compensates",
}
"""Words of prose, with the words to write instead."""
_ANY = "|".join(WORDS)
ANY_WORD = re.compile(rf'(?<![\w-])(?!(?<=")(?:{_ANY})")(?:{_ANY})(?![\w-])', re.IGNORECASE)
"""Any of the words, except a word that stands alone between double quotes."""


def summaries(code):
    """Return the line and the summary of every docstring of a module, also of its attributes."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    texts = []
    for node in statements(ast.parse(code)):
        if isinstance(node, documented):
            texts.append((getattr(node, "lineno", 1), ast.get_docstring(node)))
            texts += attribute_docstrings(node.body)
    return [(line, " ".join(text.split("\n\n")[0].split())) for line, text in texts if text]


def attribute_docstrings(body):
    """Return the line and the text of each string that follows an assignment."""
    return [
        (after.lineno, inspect.cleandoc(after.value.value))
        for before, after in itertools.pairwise(body)
        if isinstance(before, (ast.Assign, ast.AnnAssign))
        and isinstance(after, ast.Expr)
        and isinstance(after.value, ast.Constant)
        and isinstance(after.value.value, str)
    ]


def bad_summaries(code):
    """Return the line and the summary of each docstring with a wrong first word."""
    if SUSPECT.search(code) is None:
        return []
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
    assert bad_summaries('SIZE_MM = 3.0\n"""What a tool has."""\n') == [(2, "What a tool has.")]
    text = 'the tool is told its way\nalways half way, np.floor(x), far_way_m "says"\nBeside it'
    assert bad_words(text) == [(1, "told"), (1, "way"), (3, "Beside")]
    # a message may begin or end with the word
    assert bad_words('"Beside it"\n"in one way"\n"lest"') == [(1, "Beside"), (2, "way")]
    assert bad_words("at room temperature, in the operating room; room for it") == [(1, "room")]
