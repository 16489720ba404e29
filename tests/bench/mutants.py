"""Share of planted errors that the quick tests find.

Run: `python tests/bench/mutants.py` (see README.md here).

Each mutant is one small error in a numerically important module: a sign, a comparator, a constant
times 1.1, a dropped term, or an integer off by one. `mutants.toml` lists the modules with the tests
that guard them, and the mutants that change no result, each with its reason. `mutants_recorded.txt`
holds mutants by address, so that the same errors can be planted after files have moved.
"""

import argparse
import os
import shutil
import sys
import tempfile
import time
import tomllib
from collections import Counter, defaultdict, deque
from collections.abc import Iterator
from hashlib import blake2b
from pathlib import Path

from mutant_operators import OPERATORS, Mutant, mutants_of
from mutant_runs import PACKAGES, Runs, Verdict, file_of, preload

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
RECORDED = HERE / "mutants_recorded.txt"
KILLERS = 6
"""Recent tests of a module that run first."""
CAUGHT = ("failed", "timeout", "crashed")


class Table:
    """Guarded modules of `mutants.toml`, with their mutants.

    Attributes
    ----------
    guards
        Test files of each module, below the root.
    equivalent
        Reason why a mutant changes no result, by its place in the module.
    """

    def __init__(self, path: Path = HERE / "mutants.toml") -> None:
        table = tomllib.loads(path.read_text())
        self.guards = {module: _test_files(names) for module, names in table["guards"].items()}
        self.equivalent = {
            entry["mutant"]: entry["reason"] for entry in table.get("equivalent", [])
        }
        split = [address.split(" | ", 1) for address in self.equivalent]
        self._moved = {place for module, place in split if file_of(module, ROOT) is None}
        self._all: list[Mutant] | None = None

    def of(self, module: str) -> list[Mutant]:
        """Mutants of a module that are not equivalent; none if the module is not there."""
        path = file_of(module, ROOT)
        if path is None:
            return []
        found = mutants_of(module, path.read_text())
        return [
            each
            for each in found
            if each.address not in self.equivalent and each.place not in self._moved
        ]

    def placed(self, address: str) -> Mutant | None:
        """Return the mutant of an address, or None if it does not exist.

        It is in another module if its function has moved.
        """
        module, place = address.split(" | ", 1)
        for each in self.of(module):
            if each.place == place:
                return each
        if self._all is None:
            paths = [
                path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))
            ]
            names = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths]
            self._all = [
                each
                for name, path in zip(names, paths, strict=True)
                for each in mutants_of(name, path.read_text())
            ]
        found = [each for each in self._all if each.place == place]
        return found[0] if len(found) == 1 else None


def _test_files(names: list[str]) -> list[str]:
    """Paths of test files below the root; one that has moved is found by its name."""
    found = []
    for name in names:
        path = ROOT / "tests" / name
        others = [path] if path.is_file() else sorted((ROOT / "tests").rglob(path.name))
        if not others:
            print(f"mutants.toml names a test file that is not there: {name}", file=sys.stderr)
        found += [str(each.relative_to(ROOT)) for each in others[:1]]
    return found


def _rank(seed: int, text: str) -> bytes:
    """Return the rank of a text in a random order.

    The order depends on the seed and the text alone, so that edits elsewhere do not reshuffle a
    draw.
    """
    return blake2b(f"{seed} {text}".encode()).digest()


def fresh(table: Table, seed: int, only: str) -> Iterator[Mutant]:
    """Yield mutants until the supply ends.

    They are drawn module after module, and within a module operator after operator.
    """
    stocks: dict[str, dict[str, deque[Mutant]]] = {}
    for module in sorted(
        (name for name in table.guards if only in name), key=lambda name: _rank(seed, name)
    ):
        stock: dict[str, deque[Mutant]] = defaultdict(deque)
        for each in sorted(table.of(module), key=lambda each: _rank(seed, each.address)):
            stock[each.operator].append(each)
        order = sorted(OPERATORS, key=lambda operator: _rank(seed, module + operator))
        stocks[module] = {operator: stock[operator] for operator in order if stock[operator]}
    turn = 0
    while any(stocks.values()):
        for stock in stocks.values():
            operators = [operator for operator in stock if stock[operator]]
            if operators:
                yield stock[operators[turn % len(operators)]].popleft()
        stocks = {
            name: {key: left for key, left in stock.items() if left}
            for name, stock in stocks.items()
        }
        turn += 1


class Score:
    """Verdicts so far, and which tests caught the errors of each module."""

    def __init__(self, table: Table) -> None:
        self.table = table
        self.verdicts: dict[str, tuple[Mutant | None, Verdict]] = {}
        self.killers: dict[str, deque[str]] = defaultdict(lambda: deque(maxlen=KILLERS))
        self._started = time.monotonic()

    def add(self, address: str, mutant: Mutant | None, guard: str, verdict: Verdict) -> None:
        """Book one verdict and print it."""
        self.verdicts[address] = mutant, verdict
        if verdict.outcome == "failed":
            if verdict.test in self.killers[guard]:
                self.killers[guard].remove(verdict.test)
            self.killers[guard].appendleft(verdict.test)
        word = (
            "caught" if verdict.outcome in CAUGHT else verdict.outcome.replace("passed", "SURVIVED")
        )
        test = verdict.test or (verdict.outcome if word == "caught" else "")
        print(
            f"{time.monotonic() - self._started:7.1f} s  {word:9} {address}  [{test}]", flush=True
        )

    @property
    def counted(self) -> int:
        """Number of mutants in the score: all but those whose code does not compile."""
        return sum(verdict.outcome != "void" for _, verdict in self.verdicts.values())

    @property
    def caught(self) -> int:
        """Number of mutants that the tests caught."""
        return sum(verdict.outcome in CAUGHT for _, verdict in self.verdicts.values())

    def report(self) -> None:
        """Print survivors with their location, the share of each operator, and the score."""
        print("\nsurvivors:")
        shares: dict[str, Counter[bool]] = defaultdict(Counter)
        for address, (mutant, verdict) in sorted(self.verdicts.items()):
            if verdict.outcome == "void":
                continue
            shares[address.split(" | ")[2]][verdict.outcome in CAUGHT] += 1
            if verdict.outcome in CAUGHT:
                continue
            print(
                f"  {_location(mutant) if mutant else 'not placed'}  {verdict.outcome}\n    "
                f"{address}"
            )
        for operator, share in sorted(shares.items()):
            print(f"{operator}: {share[True]} of {sum(share.values())} caught")
        percent = 100.0 * self.caught / max(self.counted, 1)
        print(f"mutation score: {self.caught} of {self.counted} caught, {percent:.1f} %")
        print(
            f"left out: {len(self.table.equivalent)} listed as equivalent, "
            f"{len(self.verdicts) - self.counted} do not compile"
        )


def _location(mutant: Mutant) -> str:
    path = file_of(mutant.module, ROOT)
    assert path is not None
    line = path.read_bytes()[: mutant.span[0]].count(b"\n") + 1
    return f"{path.relative_to(ROOT)}:{line}"


def measure(
    table: Table, draw: Iterator[str], count: int, *, workers: int, limit_s: float, folder: Path
) -> Score:
    """Plant mutants one after the other until enough of them count."""
    score = Score(table)
    runs = Runs(ROOT, folder, workers=workers, limit_s=limit_s)
    started = 0
    for address in draw:
        if score.counted >= count:
            break
        if started - (len(score.verdicts) - score.counted) >= count:
            runs.wait()  # the last of them may not compile, and then others take their place
            if score.counted >= count:
                break
        started += 1
        module = address.split(" | ")[0]
        mutant = table.placed(address)
        moved = mutant.module if mutant else module
        tests = table.guards.get(moved) or table.guards.get(module, [])
        if mutant is None or not tests:
            score.add(
                address, mutant, module, Verdict("no place" if mutant is None else "no tests")
            )
            continue

        def done(
            verdict: Verdict, address: str = address, mutant: Mutant = mutant, module: str = module
        ) -> None:
            score.add(address, mutant, module, verdict)

        runs.start(mutant, tests, list(score.killers[module]), done)
    runs.wait()
    _require_sound(runs, score, table)
    return score


def _require_sound(runs: Runs, score: Score, table: Table) -> None:
    """Stop if a test that caught an error also fails without one."""
    killers = sorted(
        {verdict.test for _, verdict in score.verdicts.values() if verdict.outcome == "failed"}
    )
    slow = {
        each.split(" | ")[0]
        for each, (_, verdict) in score.verdicts.items()
        if verdict.outcome in ("timeout", "crashed")
    }
    failing = runs.failing(killers, limit_s=20 * runs.limit_s) if killers else []
    for module in sorted(slow):
        failing += runs.failing(table.guards[module], limit_s=runs.limit_s)
    if failing:
        sys.exit(
            "the score means nothing, tests fail without a planted error:\n  "
            + "\n  ".join(failing)
        )


def _take_kernels(folder: Path) -> None:
    """Use a kernel cache of this run alone, which starts with what the user's cache holds."""
    held = Path(os.environ.get("WARP_CACHE_PATH") or Path.home() / ".cache" / "warp")
    if held.is_dir():
        shutil.copytree(held, folder, dirs_exist_ok=True)
    os.environ["WARP_CACHE_PATH"] = str(folder)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        description="Plant errors, run the tests that guard them, print the score."
    )
    parser.add_argument("--count", type=int, default=200, help="mutants to count (default: 200)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the draw (default: 1)")
    parser.add_argument(
        "--fresh", action="store_true", help="draw from the code instead of a file of addresses"
    )
    parser.add_argument(
        "--recorded",
        type=Path,
        default=RECORDED,
        help="addresses to draw from (default: %(default)s)",
    )
    parser.add_argument("--only", default="", help="part of the names of the modules to draw from")
    parser.add_argument("--like", default="", help="part of the addresses to draw")
    parser.add_argument("--workers", type=int, default=2, help="processes at once (default: 2)")
    parser.add_argument(
        "--limit-s", type=float, default=90.0, help="processor time of one mutant (default: 90 s)"
    )
    parser.add_argument("--record", type=Path, help="file to write the counted addresses to")
    options = parser.parse_args()

    table = Table()
    if options.fresh:
        draw = (each.address for each in fresh(table, options.seed, options.only))
    else:
        recorded = [
            line
            for line in options.recorded.read_text().splitlines()
            if line not in table.equivalent
        ]
        draw = (
            each
            for each in sorted(recorded, key=lambda line: _rank(options.seed, line))
            if options.only in each
        )
    with tempfile.TemporaryDirectory(prefix="tissue-mutants-") as name:
        folder = Path(name)
        _take_kernels(folder / "warp")
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        preload()
        print(
            f"{options.count} mutants, seed {options.seed}, {options.workers} processes", flush=True
        )
        drawn = (each for each in draw if options.like in each)
        score = measure(
            table,
            drawn,
            options.count,
            workers=options.workers,
            limit_s=options.limit_s,
            folder=folder,
        )
        score.report()
        if options.record:
            counted = [
                address
                for address, (_, verdict) in score.verdicts.items()
                if verdict.outcome != "void"
            ]
            options.record.write_text("".join(f"{each}\n" for each in sorted(counted)))


if __name__ == "__main__":
    main()
