"""Parsers in a process of their own.

Their results are returned, and their failures stay in that process.
"""

import numpy as np
import pytest

import meshes.base.isolated_parser
from meshes.base.errors import InputError
from meshes.base.isolated_parser import parse_isolated

PARSERS = """
import ctypes, time
import numpy as np
from meshes.base.errors import DamagedFileError, InputError

def well(path, offset):
    print("a library talks")
    arrays = {"a": np.arange(6.0).reshape(2, 3) + offset, "b": np.zeros((0, 3), np.uint8), "c": np.array([True])[::-1]}
    return {"name": path.name}, arrays

def crashes(path):
    ctypes.string_at(0)

def ends(path):
    raise SystemExit(3)

def raises(path):
    raise KeyError("no such thing")

def names_the_damage(path):
    raise DamagedFileError("cell 3 has no points")

def refuses(path):
    raise InputError("file must be good, got a bad one. Fix it")

def hangs(path):
    while True:
        time.sleep(1.0)

def grows(path):
    held = np.ones(50_000_000)
    time.sleep(60.0)
"""


@pytest.fixture
def parse(tmp_path, monkeypatch):
    """Run one of the parsers above on a file."""
    (tmp_path / "parsers_of_the_test.py").write_text(PARSERS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    file = tmp_path / "bone.abc"
    file.write_text("x")

    def run(parser, **options):
        return parse_isolated(
            f"parsers_of_the_test:{parser}",
            file,
            what="ABC surface",
            remedy="export it again",
            **options,
        )

    return run


def test_what_a_parser_finds_comes_back(parse):
    facts, arrays = parse("well", offset=0.1)
    assert facts == {"name": "bone.abc"}
    np.testing.assert_array_equal(arrays["a"], np.arange(6.0).reshape(2, 3) + 0.1)
    assert arrays["b"].shape == (0, 3) and arrays["b"].dtype == np.uint8
    assert arrays["c"].tolist() == [True]


@pytest.mark.parametrize(
    ("parser", "reason"),
    [
        ("crashes", "its parser crashed with exit code "),
        ("ends", "its parser crashed with exit code 3"),
        ("raises", "it is damaged or cut off"),
        ("names_the_damage", "cell 3 has no points"),
        ("hangs", "its parser took longer than 1 s"),
    ],
)
def test_a_parser_that_fails_is_refused(parse, monkeypatch, parser, reason):
    if parser == "hangs":
        monkeypatch.setattr(meshes.base.isolated_parser, "_LONGEST_S", 1.0)
    with pytest.raises(InputError) as refused:
        parse(parser)
    assert str(refused.value).startswith(
        f"file must be a readable ABC surface, got bone.abc ({reason}"
    )
    assert str(refused.value).endswith("). Export it again")


def test_a_parser_that_takes_too_much_memory_is_ended(parse, monkeypatch):
    monkeypatch.setattr(meshes.base.isolated_parser, "_LEAST_BYTES", 300 << 20)
    with pytest.raises(InputError, match=r"its parser took more than 0.29 GiB of memory"):
        parse("grows")
