"""Performance and accuracy of perception.

Run: `python tests/bench/bench_perception.py [--quick]`.

The first table shows a tick of the run-time mapping (5 us is the aim). It covers forces that are
held back, like nearly all of a contact's forces, and forces that all are changes, for the
population and an observer. Further figures are the time to build the mapping and the deadband on
recorded runs by hand.
"""

import argparse

import numpy as np
from harness import Cost, cost_of, machine, table
from held_back import held_back

import tissue
from tissue.perception.laws import weber_of
from tissue.perception.observer import Observer, population_observer
from tissue.simulation.builders.prediction import perception

LIMIT_N, TICK_S = 3.3, 1e-3
WEAK = Observer.known("weak", alpha=0.7, beta=1.4, kappa=0.09, offset_N=0.25, lapse=0.02, sigma=0.2)
RECORDED = {
    "wall": {},
    "milling": {},
    "palpation": {},
    "molar": {"voxels.spacing_mm": 0.1, "stress": None},
}


def built(observer: Observer):
    """Perception on a Touch."""
    return perception(observer, rng=np.random.default_rng(0), force_limit_N=LIMIT_N, tick_s=TICK_S)


def ticks(count: int) -> list[tuple[str, ...]]:
    """Cost of a tick."""
    rng = np.random.default_rng(1)
    held = np.array([0.0, 0.3, 1.0]) + 1e-3 * rng.standard_normal((count, 3))
    jumps = np.abs(rng.normal(1.0, 0.5, (count, 3)))
    rows = []
    for observer in (population_observer(), WEAK):
        for kind, forces in (("held back", held), ("every one a change", jumps)):
            person = built(observer)
            cost = cost_of(
                lambda k, person=person, forces=forces: person.step(forces[k]), count=count
            )
            rows.append(
                (observer.name, kind, f"{cost.median:.2f}", f"{cost.p99:.2f}", f"{cost.worst:.0f}")
            )
    return rows


def traces(quick: bool) -> list[tuple[str, ...]]:
    """Return a table row for each recorded scene: effect of the deadband on its forces."""
    law, rows = weber_of(population_observer()), []
    for name, changes in list(RECORDED.items())[: 2 if quick else None]:
        run = tissue.simulate(
            tissue.load_scene(name, {"device": "touch", "hand": "novice", "seed": 3, **changes})
        )
        wanted = run.trace.vectors("filtered_force", "N")
        played, changed = held_back(wanted, law)
        felt = np.linalg.norm(wanted, axis=1) > law.kappa * law.offset
        off = np.linalg.norm(wanted - played, axis=1)
        rows.append(
            (
                name,
                f"{felt.sum()}",
                f"{100 * (1 - changed[felt].mean()):.1f}",
                f"{(off / law.threshold(np.linalg.norm(played, axis=1))).max():.3f}",
                f"{100 * np.linalg.norm(off) / np.linalg.norm(wanted):.1f}",
            )
        )
    return rows


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    print(machine(), "\n")
    print(
        table(
            ticks(2_000 if quick else 50_000),
            ("observer", "forces", "median us", "99 % us", "worst us"),
        ),
        "\n",
    )
    building: Cost = cost_of(lambda k: built(WEAK), count=20 if quick else 200, warm_up=5)
    print(f"build {building.median / 1e3:.2f} ms\n")
    head = (
        "scene, novice on touch",
        "ticks felt",
        "not needed %",
        "error / threshold",
        "force error %",
    )
    print(table(traces(quick), head))


if __name__ == "__main__":
    main()
