"""Push a needle through the capsule of a liver and a vessel wall, draw it out, push it in again along its track.

Expected: the capsule is punctured at 16.9 mm with 2.30 N and the force drops by 0.67 N, not to the cutting force alone:
the edge of the hole still holds 0.65 N, and the organ stays deflected by 13.7 mm. From there the force grows by 11.6 N
per metre of needle in the organ. The vessel wall, 30 mm deep in the organ, breaks at 49.9 mm of travel with 3.00 N.
Drawn back, the shaft sticks over 32.6 mm before it slides, and pulls with up to 1.91 N. The second insertion costs 59 %
of the first one's work: nothing is punctured and nothing cut. The numbers of liver are a published fit to one needle
(Okamura 2004), those of the vessel wall have no source (`tissue/materials/needle.toml`): the curve is fitted, not
predicted.
Run: python examples/06_needle_through_the_capsule.py [--out FILE.png]
"""

import sys
from pathlib import Path

import numpy as np

from tissue.models.needle.model import NeedleModel
from tissue.models.needle.parameters import needle_tissue
from tissue.models.tissue_model import ToolMotion
from tissue.motion.motion import FollowPath

FEED_MM_S, DEEP_MM, OUT_MM, WALL_MM = 5.0, 70.0, -20.0, 30.0
TICK_S = 1e-3


def insert_twice() -> tuple[dict[str, np.ndarray], list[tuple[float, str]]]:
    """In, out and in again at 1 kHz: columns over the ticks, and the events with the travel at which they came."""
    corners = np.zeros((4, 3))
    corners[:, 2] = -1e-3 * np.array([-2.0, DEEP_MM, OUT_MM, DEEP_MM])
    path, motion = FollowPath(corners, feed_m_s=1e-3 * FEED_MM_S, axis=(0.0, 0.0, 1.0)), ToolMotion()
    model = NeedleModel(needle_tissue(vessel_wall_depth_m=1e-3 * WALL_MM), diameter_m=1.27e-3)
    path.begin(motion)
    model.place(motion)
    rows, events = [], []
    response = model.respond(motion)
    for tick in range(int(path.duration_s / TICK_S) + 1):
        path.advance(tick * TICK_S, TICK_S, response, motion)
        model.advance(motion)
        response = model.respond(motion)
        rows.append((-1e3 * motion.tip_m[2], response.wrench[2], *response.measures))
        while model.notices:
            events.append((rows[-1][0], model.notices.pop(0)))
    return dict(zip(("travel_mm", "force_N", *model.measure_names), np.array(rows).T, strict=True)), events


def main(out: Path | None = None) -> None:
    trace, events = insert_twice()
    travel, force = trace["travel_mm"], trace["force_N"]
    for at_mm, event in events:
        print(f"at {at_mm:5.1f} mm: {event}")

    first = int(np.flatnonzero(travel > DEEP_MM - 1e-6)[0])
    last = first + int(np.argmin(travel[first:]))
    puncture = int(np.argmax(force[:first] * (travel[:first] < 20.0)))
    drop = force[puncture] - force[puncture + 1]
    held, deflection = trace["elastic_N"][puncture + 1], trace["deflection_mm"][puncture + 1]
    print(f"capsule: {force[puncture]:.2f} N at {travel[puncture]:.1f} mm, drop {drop:.2f} N")
    print(f"left after it: {held:.2f} N held by the hole's edge, the organ deflected by {deflection:.1f} mm")

    sliding = slice(puncture + 1, int(np.flatnonzero(trace["insertion_mm"] == WALL_MM)[0]))
    slope = np.polyfit(1e-3 * trace["insertion_mm"][sliding], force[sliding], 1)[0]
    wall = int(np.argmax(force[:first]))
    print(f"then {slope:.1f} N/m of needle in the organ; vessel wall: {force[wall]:.2f} N at {travel[wall]:.1f} mm")

    back = slice(first, last)
    stuck = DEEP_MM - travel[back][trace["insertion_mm"][back] == trace["insertion_mm"][first]].min()
    pull = -force[back].min()
    print(f"drawn back: sticks over {stuck:.1f} mm, pulls with up to {pull:.2f} N")

    work = [
        np.sum(0.5e-3 * (force[p][1:] + force[p][:-1]) * np.diff(travel[p])) for p in (slice(first), slice(last, None))
    ]
    print(f"work: {1e3 * work[0]:.0f} mJ at first, {1e3 * work[1]:.0f} mJ along the track, {work[1] / work[0]:.0%}")

    assert abs(force[puncture] - 2.30) < 0.01 and abs(travel[puncture] - 16.9) < 0.05
    assert abs(drop - 0.67) < 0.01 and abs(held - 0.65) < 0.001 and abs(deflection - 13.7) < 0.05
    assert abs(slope - 11.6) < 0.1
    assert abs(force[wall] - 3.00) < 0.01 and abs(travel[wall] - 49.9) < 0.05
    assert abs(stuck - 32.6) < 0.1 and abs(pull - 1.91) < 0.01
    assert abs(work[1] / work[0] - 0.59) < 0.01
    if out is not None:
        draw(trace, first, last, out)
        print("picture in", out)


def draw(trace: dict[str, np.ndarray], first: int, last: int, out: Path) -> None:
    """Force over the tip's travel: in, out and in again, with the parts of the first insertion."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 4.8), layout="constrained")
    travel, force = trace["travel_mm"], trace["force_N"]
    parts = [trace[name][:first] for name in ("elastic_N", "cutting_N", "friction_N")]
    names = ("held by membranes", "cut by the tip", "rubbed along the shaft")
    axes.stackplot(travel[:first], *parts, labels=names, colors=("#56B4E9", "#E69F00", "#009E73"), alpha=0.35)
    for part, colour, label in (
        (slice(first), "0.1", "first insertion"),
        (slice(first, last), "#D55E00", "drawn out"),
        (slice(last, None), "#0072B2", "second insertion"),
    ):
        axes.plot(travel[part], force[part], color=colour, linewidth=1.8, label=label)
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    axes.set(xlabel="travel of the tip from the undeformed surface / mm", ylabel="force against insertion / N")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left")
    axes.set_title(f"Needle into a liver with a vessel wall {WALL_MM:g} mm deep, {FEED_MM_S:g} mm/s")
    figure.savefig(out, dpi=150)
    pyplot.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[2]) if sys.argv[1:2] == ["--out"] else None)
