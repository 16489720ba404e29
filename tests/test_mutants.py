"""Planted errors: their places, finding them again, and the tests that detect them."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).parent / "bench"
SOURCE = """
WIDTH_M = 2.0

class Tool:
    def force(self, depth, rate):
        \"\"\"Force, 3 * depth.\"\"\"
        if depth < 0.0:
            raise ValueError(f"depth must be positive, got {depth + 1}")
        total = 3.0 * depth + rate[0]
        total += WIDTH_M
        return total if depth > 0 else -total
"""
PLANTED = {
    "WIDTH_M = 2.0  ->  WIDTH_M = 2.2",
    "3.0 * depth + rate[0]  ->  3.0 * depth - rate[0]",
    "3.0 * depth + rate[0]  ->  3.0 * depth",
    "3.0 * depth + rate[0]  ->  rate[0]",
    "3.0 * depth  ->  3.0",
    "3.0 * depth  ->  depth",
    "3.0 * depth  ->  3.3000000000000003 * depth",
    "rate[0]  ->  rate[1]",
    "total += WIDTH_M  ->  pass",
    "total += WIDTH_M  ->  total -= WIDTH_M",
    "depth > 0  ->  depth <= 0",
    "depth > 0  ->  depth >= 0",
    "-total  ->  total",
}


@pytest.fixture
def mutants_of(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCH))
    from mutant_operators import mutants_of

    return mutants_of


def test_errors_are_planted_in_what_computes_and_nowhere_else(mutants_of):
    """Not in texts, checks and messages; each is one change of the source that still parses."""
    found = mutants_of("tool", SOURCE)
    assert {each.change for each in found} == PLANTED and len(found) == len(PLANTED)
    for each in found:
        changed = each.applied(SOURCE)
        ast.parse(changed)
        assert changed != SOURCE and changed.count("\n") == SOURCE.count("\n")
    signed = next(each for each in found if each.operator == "sign" and "rate" in each.change)
    assert "total = (3.0 * depth - rate[0])\n" in signed.applied(SOURCE)


def test_an_address_survives_changes_around_it(mutants_of):
    """An address survives changes around it.

    Other lines, another module and another layout of the same expression leave the address within a
    module unchanged.
    """
    places = {each.place for each in mutants_of("tool", SOURCE)}
    moved = "import numpy\n\n\ndef other():\n    return 1 + 2\n" + SOURCE.replace(
        "3.0 * depth + rate", "(3.0*depth) + rate"
    )
    assert places <= {each.place for each in mutants_of("elsewhere.tool", moved)}
    renamed = {each.place for each in mutants_of("tool", SOURCE.replace("def force", "def push"))}
    assert all(place.startswith("<module>") for place in places & renamed)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="runs tests in forked processes")
def test_a_planted_error_is_caught():
    """One of the recorded mutants is caught."""
    command = [sys.executable, str(BENCH / "mutants.py"), "--count", "1", "--seed", "1"]
    done = subprocess.run(command, capture_output=True, text=True)
    print(done.stdout)
    assert done.returncode == 0, done.stderr
    caught, count = re.search(r"mutation score: (\d+) of (\d+)", done.stdout).groups()
    assert int(count) == int(caught) == 1
