"""Benchmarks of the same work by other packages, each in its own environment, and by this project.

`python tests/bench/peers/run.py [NAME ...] [--venvs DIR] [--rounds N]` makes the environments that
are missing. It runs our version and the peer in turn, N times each, and prints the fastest round of
each with its result, so that a reader can check that both did the same work.
"""

import argparse
import json
import os
import subprocess
import sys
import venv
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[2])]
from harness import machine, table  # noqa: E402

from meshes.base.cache import cache_folder  # noqa: E402

PEERS = {
    "scikit-fem": ("scikit-fem",),
    "mujoco": ("mujoco", "numpy"),
    "pykoop": ("pykoop",),
    "manifold": ("manifold3d", "numpy"),
}
"""Packages of each environment."""
DIFFERS = {
    "scikit-fem": "its solver is SuperLU, ours a multifrontal Cholesky factor",
    "mujoco": "it steps masses and makes the whole body anew in each step; ours is quasi-static on a "
    "compliance that is prepared beforehand. Its press is half of ours (a static frictionless "
    "scikit-fem solve on the same meshes presses 1.11 and 0.53 N, ours 1.08 and 0.51)",
    "pykoop": "ours also caps the spectrum and fits an offset, and has the ten steps as one matrix",
    "manifold": "it keeps exact triangles and has no force; each cut leaves more of them",
}
"""Differences between the work of a peer and ours."""
ALONE = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""One thread of BLAS for all: on a machine that is not idle more of them wait for each other."""


def environment(name: str, folder: Path) -> Path:
    """Return the interpreter of a peer's environment, with the packages installed."""
    home = folder / name
    python = home / ("Scripts" if os.name == "nt" else "bin") / "python"
    if not python.is_file():
        venv.create(home, with_pip=True)
        install = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        subprocess.run([*install, *PEERS[name]], check=True)
    return python


def lines(python: Path | str, script: str, *arguments: str) -> list[dict[str, Any]]:
    """Return the output of a script, one JSON object per line."""
    done = subprocess.run(
        [python, HERE / script, *arguments],
        check=True,
        capture_output=True,
        text=True,
        timeout=600,
        env=os.environ | ALONE,
    )
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def fastest(rounds: list[list[dict[str, Any]]]) -> dict[tuple[str, str], dict[str, Any]]:
    """Return for each work the round with the smallest median: other work only adds time."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for line in (line for each in rounds for line in each):
        key = line["name"], line["work"]
        if key not in found or line["median_us"] < found[key]["median_us"]:
            found[key] = line
    return found


def compared(name: str, folder: Path, rounds: int) -> list[tuple[str, ...]]:
    """Return rows that compare one peer with this project, measured in turn."""
    python = environment(name, folder)
    script = f"peer_{name.replace('-', '_')}.py"
    both = [(lines(sys.executable, "ours.py", name), lines(python, script)) for _ in range(rounds)]
    ours = {work: line for (_, work), line in fastest([each for each, _ in both]).items()}
    rows = []
    for (peer, work), line in fastest([each for _, each in both]).items():
        if work in ours:
            here = ours[work]
            timed = [f"{each['median_us']:.3g} ({each['p99_us']:.3g})" for each in (line, here)]
            came = [f"{each['value']:.4g} {each['unit']}" for each in (line, here)]
            rows.append((work, line["size"], peer, *timed, *came))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*PEERS, []], help="peers; default all")
    parser.add_argument("--venvs", type=Path, default=cache_folder() / "peers")
    parser.add_argument("--rounds", type=int, default=2)
    given = parser.parse_args()
    print(machine())
    for name in given.names or PEERS:
        rows = compared(name, given.venvs, given.rounds)
        head = ("work", "size", "peer", "its median (99 %) us", "ours us", "its result", "ours")
        print(f"\n{name}: {DIFFERS[name]}\n{table(rows, head)}", flush=True)


if __name__ == "__main__":
    main()
