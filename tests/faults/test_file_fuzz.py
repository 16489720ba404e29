"""Damaged files of every kind.

They are read or refused in one sentence, without traceback, crash or hang.
"""

import os
import shutil
from pathlib import Path

import fuzz_sources
import pytest
from fuzz_files import Reading, damaged

QUICK = {
    "surface": 3,
    "tets": 12,
    "poses": 6,
    "scene": 6,
    "predictor": 6,
    "observer": 10,
    "trials": 10,
}
QUICK |= {
    "study": 4,
    "assess": 5,
    "surface apart": 0,
    "tets apart": 0,
    "run apart": 0,
    "image": 2,
    "labels": 4,
    "image apart": 0,
}
QUICK |= {"log": 3, "log apart": 0, "toolpath": 3}
"""Number of damaged files from each whole one, by reader.

A file that is parsed in a process of its own takes most of a second, and belongs to the slow set.
"""
FIRST_SEED = int(os.environ.get("TISSUE_FUZZ_SEED", "0"))
"""Of the damage: set the variable for other damage."""
SLOW = {reader: 2 if reader.endswith(" apart") else 0 for reader in QUICK}


@pytest.fixture(scope="session")
def sources(tmp_path_factory):
    """Whole files by reader, and the folder that they lie in."""
    folder = tmp_path_factory.mktemp("whole")
    meshes, native = fuzz_sources.write_meshes(folder), fuzz_sources.write_native(folder)
    return folder, meshes | native | fuzz_sources.write_logs(folder)


def spoilt_file(folder: Path, source: Path, reader: str, seed: int, work: Path) -> Path:
    """Return the input of a reader: a damaged copy of a file, in a copy of its folder if any."""
    content = damaged(source.read_bytes(), seed)
    whole = {"study": "study", "assess": "run", "run apart": "run"}.get(reader)
    if whole is None:
        given = work / source.name
        given.write_bytes(content)
        return given
    given = work / f"{whole} {seed}"
    shutil.rmtree(given, ignore_errors=True)
    shutil.copytree(folder / whole, given)
    (given / source.relative_to(folder / whole)).write_bytes(content)
    if reader == "assess" and not (work / "run").exists():
        shutil.copytree(folder / "run", work / "run")
    return given


def fuzz(sources, work, counts, first_seed):
    """Read damaged files; outcomes by kind, and what is wrong with any."""
    folder, by_reader = sources
    reading, outcomes, wrong = Reading(), {}, []
    for reader, paths in by_reader.items():
        for source in paths:
            for seed in range(first_seed, first_seed + counts[reader]):
                given = spoilt_file(folder, source, reader, seed, work)
                outcome, message = reading.read(reader.removesuffix(" apart"), given)
                outcomes[outcome] = outcomes.get(outcome, 0) + 1
                sentence = outcome != "refused" or (message.count("\n") == 0 and ". " in message)
                if outcome not in ("read", "refused") or not sentence:
                    wrong.append(f"{reader} of {source.name}, seed {seed}: {outcome} {message}")
                if given.is_dir():
                    shutil.rmtree(given)
    reading.close()
    return outcomes, wrong


@pytest.mark.slow
@pytest.mark.parametrize("apart", [False, True])
def test_whole_files_are_read(sources, apart):
    folder, by_reader = sources
    reading = Reading()
    for reader, paths in by_reader.items():
        if reader.endswith(" apart") != apart:
            continue
        for source in paths:
            given = {
                "study": folder / "study",
                "assess": folder / "run",
                "run apart": folder / "run",
            }.get(reader, source)
            assert reading.read(reader.removesuffix(" apart"), given) == ("read", ""), source
    reading.close()


@pytest.mark.slow
def test_damaged_files_are_read_or_refused(sources, tmp_path):
    outcomes, wrong = fuzz(sources, tmp_path, QUICK, FIRST_SEED)
    assert not wrong, "\n".join(wrong)
    assert sum(outcomes.values()) > 100 and outcomes["refused"] > 50


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_damaged_files_that_are_parsed_apart_are_read_or_refused(sources, tmp_path):
    outcomes, wrong = fuzz(sources, tmp_path, SLOW, FIRST_SEED + 1000)
    assert not wrong, "\n".join(wrong)
    assert sum(outcomes.values()) >= 26
