"""Scenes broken at random.

Each loads, or is refused in one sentence; some of the scenes that load are built and run.
"""

import os
import random
import tomllib
from copy import deepcopy

import numpy as np
import pytest
import tomli_w
from scene_kinds import kinds, write_files

from tissue import InputError, load_scene, scene_names, scene_text, simulate
from tissue.scene.load import saved_text

SEED = os.environ.get("TISSUE_FUZZ_SEED", "")
"""Seed of mutations that differ from the daily ones; without it a scene's number is its seed."""
WILD = (
    0,
    -1,
    1,
    1e300,
    -1e300,
    1e-300,
    float("nan"),
    float("inf"),
    -float("inf"),
    2**63,
    -(2**63),
    True,
    False,
    "",
    "0.1",
    "none",
    "ä\u202e\x07",
    "a" * 5000,
    [],
    [0.0],
    [0, 0, 0],
    [[0, 0, 0]],
    [1, "x", None],
    {},
    {"kind": "path"},
    {"kind": 3},
    {"a": {"b": {"c": 1}}},
    [[float("nan")] * 3] * 2,
    "../..",
    "/",
    "\\",
    "novice",
    "touch",
)
CHARACTERS = "=[]{}\",.#\n\t -+eE0159abz_'\\ä\x00\ufeff"


def leaves(table, above=()):
    """Every entry of nested tables, by its keys."""
    for key, value in table.items():
        yield (*above, key)
        if isinstance(value, dict):
            yield from leaves(value, (*above, key))


def of(table, path):
    """The table that holds the last key of a path."""
    for key in path[:-1]:
        table = table[key]
    return table


def mutated_table(table, chance):
    """A copy of a scene's table with one to four entries broken."""
    table = tomllib.loads(tomli_w.dumps(table))
    for _ in range(chance.randint(1, 4)):
        path = chance.choice(list(leaves(table)))
        inner, key = of(table, path), path[-1]
        value = inner[key]
        match chance.randrange(9):
            case 0:
                del inner[key]
            case 1:
                inner[key + chance.choice(["", "s", "_m", "_mm", "."])] = chance.choice(WILD)
            case 2:
                inner[key.replace("_mm", "_m")] = inner.pop(key)
            case 3 if isinstance(value, int | float):
                inner[key] = value * chance.choice([-1, 0, 1e3, 1e-3, 1e9])
            case 4 if isinstance(value, list):
                inner[key] = value[: chance.randrange(len(value) + 1)] * chance.randrange(3)
            case 5:
                inner[key] = {key: value}
            case 6:
                other = of(table, chance.choice(list(leaves(table))))
                inner[key] = deepcopy(chance.choice(list(other.values()) or [0]))
            case 7:
                table[chance.choice(["stress", "heat", "organ", "coupling", "cutting", "x"])] = (
                    chance.choice(WILD)
                )
            case _:
                inner[key] = chance.choice(WILD)
    return table


def mutated_text(text, chance):
    """A scene's text with some characters, words or lines broken."""
    for _ in range(chance.randint(1, 6)):
        at = chance.randrange(len(text) + 1)
        match chance.randrange(5):
            case 0:
                text = text[:at] + chance.choice(CHARACTERS) + text[at:]
            case 1:
                text = text[:at] + text[at + chance.randint(1, 12) :]
            case 2:
                lines = text.splitlines(keepends=True)
                chance.shuffle(lines)
                text = "".join(lines)
            case 3:
                end = at + chance.randint(1, 60)
                text = text[:end] + text[at:end] + text[end:]
            case _:
                text = (
                    text[:at]
                    + chance.choice(
                        ["nan", "-inf", "1e999", "0x7f", "''", "[[", "true", "1979-05-27"]
                    )
                    + text[at:]
                )
    return text


def written(number, tables, folder):
    """The file of the mutated scene of a number."""
    chance = random.Random(f"{SEED} {number}" if SEED else number)
    name = chance.choice(sorted(tables))
    text = tables[name] if isinstance(tables[name], str) else tomli_w.dumps(tables[name])
    if chance.random() < 0.6:
        try:
            text = tomli_w.dumps(mutated_table(tomllib.loads(text), chance))
        except (
            TypeError,
            ValueError,
            RecursionError,
        ):  # what TOML cannot hold, or nested too deeply
            text = mutated_text(text, chance)
    else:
        text = mutated_text(text, chance)
    path = folder / "scene.toml"
    path.write_bytes(
        text.encode("utf-8", "surrogatepass") if chance.random() < 0.98 else text.encode("utf-16")
    )
    return path


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    files = write_files(tmp_path_factory.mktemp("files"))
    return kinds(files) | {f"built-in {name}": scene_text(name) for name in scene_names()}


def outcome(path):
    """The scene, or the sentence that refuses it."""
    try:
        return load_scene(path)
    except InputError as refusal:
        return str(refusal)
    except Exception as problem:
        raise AssertionError(f"a fault of its own: {path.read_bytes()[:2000]!r}") from problem


def is_sentence(message):
    """Return whether a refusal is one line that holds the given value, or the key to change."""
    has_given = any(
        part in message
        for part in (", got ", " is not a known key", " must be given", " must be left out")
    )
    return "\n" not in message and has_given and 20 < len(message) < 2000


def share_refused(numbers, tables, folder):
    """Return the share of mutated scenes that are refused.

    Scenes that load are kept unchanged by a run.
    """
    refused = 0
    for number in numbers:
        found = outcome(written(number, tables, folder))
        if isinstance(found, str):
            assert is_sentence(found), f"scene {number}: {found[:500]}"
            refused += 1
            continue
        kept = folder / "kept.toml"
        kept.write_text(saved_text(found), "utf-8")
        assert load_scene(kept) == found, f"scene {number}: another one is kept"
    return refused / len(numbers)


def test_some_hundred_broken_scenes_load_or_are_refused_in_a_sentence(tables, tmp_path):
    assert 0.3 < share_refused(range(300), tables, tmp_path) < 1.0, (
        "mutations that break some and not all"
    )


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_thousand_broken_scenes_load_or_are_refused_in_a_sentence(tables, tmp_path):
    assert 0.3 < share_refused(range(1_000), tables, tmp_path) < 1.0, (
        "mutations that break some and not all"
    )


@pytest.mark.parametrize("count", [4, pytest.param(15, marks=pytest.mark.slow)])
@pytest.mark.timeout(1800)
def test_broken_scenes_that_load_are_built_or_refused_in_a_sentence(count, tables, tmp_path):
    cheap = count < 10
    small = (
        {name: each for name, each in tables.items() if name in ("block", "slab", "wall")}
        if cheap
        else {name: each for name, each in tables.items() if not isinstance(each, str)}
    )
    built = 0
    for number in range(20_000, 30_000):
        found = outcome(written(number, small, tmp_path))
        if isinstance(found, str):
            continue
        try:
            run = simulate(found.model_copy(update={"duration_s": 0.01}))
            assert np.isfinite(run.trace.rows).all(), f"scene {number}"
        except InputError as refusal:
            assert is_sentence(str(refusal)), f"scene {number}: {refusal}"
        except Exception as problem:
            raise AssertionError(
                f"scene {number}: {(tmp_path / 'scene.toml').read_text('utf-8')[:2000]}"
            ) from problem
        built += 1
        if built == count:
            return
    raise AssertionError("too few scenes loaded")
