"""Check that traces are bit for bit the recorded ones: `python tests/bench/golden.py FILE [--record]`.

Runs the built-in scenes as shipped, and two of them by hand, and compares a hash of each trace
column with those in the file. The compliance of an organ is computed anew, because a cached one of an
earlier run can differ in its last bit. Hashes hold for one machine, because libraries round differently on
others: record them there before a change, then compare after it.
"""

import argparse
import csv
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from harness import machine

from tissue.scene.load import library_names

CASES = {name: [name] for name in library_names()} | {
    "milling by hand": ["milling", "--set", "device=touch", "--duration-s", "2"],
    "palpation by hand": ["palpation", "--set", "device=touch", "--duration-s", "2"],
}


def column_hashes(arguments: list[str]) -> dict[str, str]:
    """Run a scene and return a hash of each trace column."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        command = [sys.executable, "-m", "tissue", "run", *arguments, "--no-pictures"]
        subprocess.run(
            [*command, "--out", str(out)],
            check=True,
            capture_output=True,
            cwd=Path(__file__).parents[2],
            env=os.environ | {"TISSUE_CACHE": folder},
        )
        with (out / "trace.csv").open(newline="", encoding="utf-8") as file:
            header, *rows = csv.reader(file)
    columns = dict(zip(header, zip(*rows, strict=True), strict=True))
    return {
        name: hashlib.sha256("\n".join(cells).encode()).hexdigest()[:16]
        for name, cells in columns.items()
    }


def main() -> None:
    """Record the hashes, or report the columns that differ from the recorded ones."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="file of the recorded hashes, .json")
    parser.add_argument("--record", action="store_true", help="write the file anew")
    parser.add_argument("--only", nargs="+", default=list(CASES), choices=list(CASES))
    chosen = parser.parse_args()
    found = {case: column_hashes(CASES[case]) for case in chosen.only}
    if chosen.record:
        recorded = {"machine": machine(), "hashes": found}
        chosen.file.write_text(json.dumps(recorded, indent=1) + "\n", encoding="utf-8")
        return
    recorded = json.loads(chosen.file.read_text("utf-8"))
    print(f"recorded on {recorded['machine']}")
    differing = 0
    for case, hashes in found.items():
        before = recorded["hashes"][case]
        names = sorted(
            name for name in before.keys() | hashes.keys() if before.get(name) != hashes.get(name)
        )
        differing += bool(names)
        print(f"{case}: {'the same' if not names else 'differs in ' + ', '.join(names)}")
    sys.exit(1 if differing else 0)


if __name__ == "__main__":
    main()
