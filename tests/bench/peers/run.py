"""Benchmarks of the same work by other packages, each in its own environment, and by this project.

`python tests/bench/peers/run.py [NAME ...] [--venvs DIR] [--out DIR] [--rounds N]` makes the
environments that are missing. It runs our version and the peer in turn, N times each, and keeps the
fastest round of each. `peers.csv` and `peers.md` under --out hold times, ratios and results, so
that a reader can check that both did the same work.
"""

import argparse
import csv
import json
import os
import subprocess
import sys
import venv
from datetime import date
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[2])]
from harness import machine  # noqa: E402

from meshes.base.cache import cache_folder  # noqa: E402

PEERS = {
    "scikit-fem": ("scikit-fem",),
    "mujoco": ("mujoco", "numpy"),
    "newton": ("newton",),
    "pykoop": ("pykoop",),
    "questplus": ("questplus",),
    "manifold": ("manifold3d", "numpy"),
    "trimesh": ("trimesh", "manifold3d", "numpy"),
    "warp": ("warp-lang", "numpy"),
    "numpy": ("numpy",),
}
"""Packages of each environment.

The package questplus is under the GPL: it stays in its environment and is never imported by ours.
"""
ALONE = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""One thread of BLAS for all: on a machine that is not idle more of them wait for each other."""
DIFFERS = {
    "scikit-fem": (
        "same matrix, same solution; its solver is SuperLU as scipy has it, ours a multifrontal "
        "Cholesky factor"
    ),
    "mujoco": "it steps masses and rings or is damped, its press is half of ours (why is not known; a "
    "static frictionless scikit-fem solve on the same meshes presses 1.11 and 0.53 N, ours "
    "without friction 1.08 and 0.51), and it makes the whole body anew each step; ours is "
    "quasi-static on the compliance of the top, prepared beforehand",
    "newton": (
        "it steps masses by penalties and gives no press; the step ends after its iterations, "
        "converged or not; cells of five tetrahedra instead of six"
    ),
    "pykoop": "same delays, same data, same ridge; ours also caps the spectrum and fits an offset, and "
    "has the ten steps as "
    "one matrix ready",
    "questplus": (
        "same size of grid and the same people; its psychometric function is a Weibull, ours "
        "follows Weber's law"
    ),
    "manifold": "it keeps exact triangles and has no force; each cut leaves more of them",
    "trimesh": "as manifold3d, which it calls",
    "warp": "no force, no layers, no accounting but the sum",
    "numpy": "no force, no layers, no accounting but the sum",
}
"""Differences between the work of a peer and ours."""


def environment(name: str, folder: Path) -> Path:
    """Its interpreter, with the packages in."""
    home = folder / name
    python = home / ("Scripts" if os.name == "nt" else "bin") / "python"
    done = home / "installed.txt"
    wanted = "\n".join(PEERS[name])
    if not done.is_file() or done.read_text("utf-8") != wanted:
        venv.create(home, with_pip=True)
        subprocess.run(
            [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", *PEERS[name]],
            check=True,
        )
        done.write_text(wanted, "utf-8")
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


def fastest(rounds: list[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Return for each work the round with the smallest median.

    Other work on the machine only adds time.
    """
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for line in (line for each in rounds for line in each):
        key = (line["name"], line["work"])
        if key not in found or line["median_us"] < found[key]["median_us"]:
            found[key] = line
    return list(found.values())


def compared(name: str, folder: Path, rounds: int) -> list[dict[str, Any]]:
    """Return rows that compare one peer with this project, measured in turn."""
    python = environment(name, folder)
    script = f"peer_{name.replace('-', '_')}.py"
    both = [(lines(sys.executable, "ours.py", name), lines(python, script)) for _ in range(rounds)]
    ours = {line["work"]: line for line in fastest([each for each, _ in both])}
    rows = []
    for peer in fastest([each for _, each in both]):
        here = ours.get(peer["work"])
        if here is None:
            continue
        ratio = peer["median_us"] / here["median_us"]
        rows.append(
            {
                "peer": peer["name"],
                "work": peer["work"],
                "size": peer["size"],
                "our_size": here["size"],
                "peer_us": peer["median_us"],
                "peer_p99_us": peer["p99_us"],
                "our_us": here["median_us"],
                "our_p99_us": here["p99_us"],
                "ratio": ratio,
                "faster": "ours" if ratio > 1.0 else peer["name"],
                "peer_value": peer["value"],
                "our_value": here["value"],
                "unit": peer["unit"],
                "our_unit": here["unit"],
                "differs": DIFFERS[name],
                "versions": json.dumps(peer["versions"]),
            }
        )
    return rows


def in_words(us: float) -> str:
    """A time, three digits."""
    return f"{us:.3g} us" if us < 1e3 else f"{us / 1e3:.3g} ms" if us < 1e6 else f"{us / 1e6:.3g} s"


def markdown(rows: list[dict[str, Any]], missing: dict[str, str], rounds: int) -> str:
    """The table for people."""
    text = [
        (
            f"{date.today().isoformat()}, {machine()}; the faster of {rounds} rounds each, ours "
            "and theirs in turn, one thread of BLAS, processor time."
        ),
        "",
        (
            "| work | peer | its median (99 %) | ours (99 %) | ours is faster by | came out: "
            "theirs, ours |"
        ),
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        ratio = (
            f"{row['ratio']:.2g}"
            if row["ratio"] > 1.0
            else f"**{row['ratio']:.2g}: {row['peer']} wins**"
        )
        same = row["unit"] == row["our_unit"]
        came = (
            f"{row['peer_value']:.4g}{'' if same else ' ' + row['unit']}, {row['our_value']:.4g} "
            f"{row['our_unit']}"
        )
        text.append(
            f"| {row['work']}, {row['size']} | {row['peer']} | {in_words(row['peer_us'])} "
            f"({in_words(row['peer_p99_us'])}) "
            f"| {in_words(row['our_us'])} ({in_words(row['our_p99_us'])}) | {ratio} "
            f"| {came} |"
        )
    text += ["", "Where the work is not the same:"]
    for differs in dict.fromkeys(row["differs"] for row in rows):
        peers = dict.fromkeys(
            row["peer"].split(",")[0] for row in rows if row["differs"] == differs
        )
        text.append(f"- {', '.join(peers)}: {differs}.")
    text += [f"- {name} is missing: {why}" for name, why in missing.items()]
    return "\n".join(text) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", choices=[*PEERS, []], help="peers; default all")
    parser.add_argument(
        "--venvs", type=Path, default=cache_folder() / "peers", help="folder of their environments"
    )
    parser.add_argument("--out", type=Path, default=Path("peers"), help="folder of the tables")
    parser.add_argument("--rounds", type=int, default=2)
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    missing: dict[str, str] = {}
    for name in given.names or PEERS:
        print(name, flush=True, file=sys.stderr)
        try:
            rows += compared(name, given.venvs, given.rounds)
        except (OSError, subprocess.SubprocessError) as problem:
            detail = getattr(problem, "stderr", None) or str(problem)
            missing[name] = str(detail).strip().splitlines()[-1]
    given.out.mkdir(parents=True, exist_ok=True)
    text = markdown(rows, missing, given.rounds)
    (given.out / "peers.md").write_text(text, "utf-8")
    if rows:
        with (given.out / "peers.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, fieldnames=list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
    print(text)


if __name__ == "__main__":
    main()
