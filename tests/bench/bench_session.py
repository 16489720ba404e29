"""Throughput and latency of loops that a program moves, and of the environments.

python tests/bench/bench_session.py [--part loops|rates|environments|solves|server] [--seconds S]

``loops``: time of a tick, a snapshot and a restore, and size of the snapshot. ``rates``: force with
steps of 2 to 20 ms against steps of 1 ms, along a circle in bone and under a thrust.
``environments``: steps a second in one process and in two, each with random actions. ``solves``:
error of the loads of `Palpation`, which is not solved in every tick. ``server``: round trip of a
pose over UDP. The times are medians, 99th percentiles and maxima.
"""

import argparse
import pickle
import sys
import threading
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(ROOT / "examples"))
sys.path.insert(0, str(ROOT / "examples/clients"))

import numpy as np  # noqa: E402
from harness import machine  # noqa: E402
from pose_client import PoseClient  # noqa: E402

import tissue  # noqa: E402
from tissue.links.pose_server import serve_network  # noqa: E402
from tissue.scene.coupling import Hardware  # noqa: E402

PATHS = {
    "milling": ([[-3, 0, 1.5], [-3, 0, -1], [2, 0, -1]], 5.0),
    "pedicle": ([[0, 0, 1], [0, 0, -8]], 3.0),
    "molar": ([[0, 0, 0.6], [0, 0, -2.0]], 1.5),
    "needle": ([[0, 0, 5], [0, 0, -45]], 20.0),
    "incision": ([[-20, 0, 4], [-20, 0, -5], [10, 0, -5]], 20.0),
    "palpation": ([[-45, 0, 2], [-45, 0, -3], [20, 0, -3]], 25.0),
    "liver-press": ([[0, 0, 3], [0, 0, -6], [5, 0, -6]], 15.0),
    "wall": ([[0, 0, 1], [0, 0, -1]], 5.0),
}
"""Corners of a path [mm] and the speed along it [mm/s]."""


def tips(points, speed_mm_s):
    """Return a tip each millisecond [mm], shape (n, 3)."""
    points = np.array(points, float)
    lengths = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    along = np.arange(1, int(lengths[-1] / speed_mm_s * 1e3) + 1) * speed_mm_s * 1e-3
    return np.column_stack([np.interp(along, lengths, column) for column in points.T])


def spread(times_s, unit=1e6):
    """Return median, 99th percentile and maximum as text."""
    values = unit * np.percentile(times_s, [50, 99, 100])
    return " ".join(f"{value:9.1f}" for value in values)


def timed(call, count):
    """Return the times of some calls [s]."""
    found = []
    for _ in range(count):
        start = perf_counter()
        call()
        found.append(perf_counter() - start)
    return np.array(found)


def loops():
    """Print times of ticks and snapshots."""
    print(
        "scene        tick / us: median 99 % max     snapshot / ms       restore / ms    size / kB"
    )
    for name, path in PATHS.items():
        loop = tissue.Loop(name)
        loop.reset([*path[0][0]])
        ticks = []
        for tip in tips(*path):
            start = perf_counter()
            loop.step(tip)
            ticks.append(perf_counter() - start)
        copied = timed(loop.snapshot, 50)
        snapshot = loop.snapshot()
        restored = timed(lambda loop=loop, kept=snapshot: loop.restore(kept), 50)
        size = len(pickle.dumps(snapshot)) / 1e3
        print(
            f"{name:11} {spread(ticks)} {spread(copied, 1e3)} {spread(restored, 1e3)} {size:9.0f}"
        )


def rates():
    """Print the error of steps of several ticks."""
    burr = tissue.cutters.ball_burr(diameter_mm=4, flutes=6, spin_rpm=20_000)
    turn = 2.0 * np.pi * np.arange(1, 1001) / 1000
    circle = np.column_stack([2 - 2 * np.cos(turn), 2 * np.sin(turn), np.full(1000, -0.5)])
    found = {}
    for step in (1, 2, 5, 10, 20):
        bone = tissue.Bone.block((16, 16, 6), spacing_mm=0.2)
        loop = tissue.Loop(bone, burr, start_mm=(0, 0, 0.5), step_ms=step)
        for height in np.linspace(0.5, -0.5, 201 if step == 1 else 100 // step * 2 + 1):
            loop.step([0, 0, height])
        found[step] = np.array([loop.step(tip)[:3] for tip in circle[step - 1 :: step]])
    print("circle of 2 mm radius at 12.6 mm/s, 0.5 mm deep: RMS error of the force")
    for step, forces in found.items():
        wanted = found[1][step - 1 :: step]
        error = np.linalg.norm(forces - wanted) / np.linalg.norm(wanted)
        print(f"  {step:2d} ms: {100 * error:.3f} %")
    print("pedicle under 30 N with M = 40 kg and D = 8 kN s/m, by the caller: 1.5 s")
    base = None
    for step in (1, 2, 5, 10, 20):
        loop = tissue.Loop("pedicle", step_ms=step)
        depth = thrust = feed = 0.0
        depths = []
        for _ in range(1500 // step):
            thrust = loop.step([0, 0, 1.0 - 1e3 * depth])[2]
            feed += 1e-3 * step * (30.0 - thrust - 8e3 * feed) / 40.0
            feed = min(max(feed, 0.0), 3e-3)
            depth += feed * 1e-3 * step
            depths.append(depth)
        if base is None:
            base = np.array(depths)
        error = np.abs(np.array(depths) - base[step - 1 :: step]).max()
        print(f"  {step:2d} ms: depth {1e3 * depth:.3f} mm, off by up to {1e6 * error:.1f} um")


def environments(seconds):
    """Print steps a second."""
    import gymnasium

    print(
        "environment     one process      two processes, all steps   (steps of 20 ticks a second)"
    )
    for name in ("Palpation", "Milling", "Drilling"):
        found = []
        for count in (1, 2):
            make = f"tissue.environments:tissue/{name}-v0"
            if count == 1:
                envs = gymnasium.vector.SyncVectorEnv([lambda make=make: gymnasium.make(make)])
            else:
                kind = gymnasium.vector.AsyncVectorEnv
                envs = kind([lambda make=make: gymnasium.make(make)] * 2)
            rng = np.random.default_rng(0)
            envs.reset(seed=0)
            action = np.zeros(envs.action_space.shape)
            steps, start = 0, perf_counter()
            while perf_counter() - start < seconds:
                action = np.clip(0.9 * action + 0.5 * rng.normal(size=action.shape), -1.0, 1.0)
                envs.step(action.astype(np.float32))
                steps += count
            found.append(steps / (perf_counter() - start))
            envs.close()
        print(f"{name:12} {found[0]:12.0f} {found[1]:18.0f}")


def solves():
    """Print the error of the mean loads of `Palpation` against a solve in every tick."""
    from learning.experts import PalpationExpert

    from tissue.environments.palpation import Palpation

    class EveryTick(Palpation):
        solve_ticks = 1

    usual = Palpation()
    exact = EveryTick()
    print("palpation: RMS error of the mean loads, four episodes, and largest error of a score")
    for name in ("expert", "random actions"):
        loads = {usual: [], exact: []}
        scores = []
        rng = np.random.default_rng(0)
        for seed in range(4):
            observation, _ = usual.reset(seed=seed)
            exact.reset(seed=seed)
            expert = PalpationExpert(usual)
            action = np.zeros(usual.action_count)
            ended = False
            while not ended:
                if name == "expert":
                    action = expert(observation)
                else:
                    action = np.clip(0.9 * action + 0.5 * rng.normal(size=action.shape), -1.0, 1.0)
                exact.step(action)
                observation, _, terminated, truncated, _ = usual.step(action)
                ended = terminated or truncated
                for env, found in loads.items():
                    found.append(env._loads[:3].copy())
            scores.append(abs(usual.score - exact.score))
        wanted = np.array(loads[exact])
        error = np.linalg.norm(np.array(loads[usual]) - wanted) / np.linalg.norm(wanted)
        print(f"  {name}: {100 * error:.2f} % of the force, score {max(scores):.5f}")


def server():
    """Print the round trip of a pose."""
    print("scene       round trip / us: median 99 % max   (UDP on this machine, with its tick)")
    for name in ("wall", "needle", "palpation", "pedicle"):
        loop = tissue.Loop(name)
        stop, ports, ready = threading.Event(), [], threading.Event()

        def opened(address, ports=ports, ready=ready):
            ports.append(int(address.rpartition(":")[2]))
            ready.set()

        thread = threading.Thread(
            target=serve_network,
            args=(loop, Hardware(address="udp://127.0.0.1:0")),
            kwargs={"opened": opened, "ends": stop.is_set},
        )
        thread.start()
        ready.wait()
        client = PoseClient(ports[0])
        times = []
        for tip in tips(*PATHS[name])[:2000]:
            start = perf_counter()
            client.move(tuple(1e-3 * tip))
            times.append(perf_counter() - start)
        client.close()
        stop.set()
        thread.join()
        print(f"{name:10} {spread(times)}")


def main():
    """Run the parts that are asked for."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--part", choices=("loops", "rates", "environments", "solves", "server"))
    parser.add_argument("--seconds", type=float, default=10.0)
    asked = parser.parse_args()
    print(machine())
    for part in (loops, rates, solves, server):
        if asked.part in (None, part.__name__):
            part()
    if asked.part in (None, "environments"):
        environments(asked.seconds)


if __name__ == "__main__":
    main()
