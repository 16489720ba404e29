"""Page on hand-held cutting tools: change of the tool path caused by a shift of the device path."""

from collections.abc import Iterator
from functools import cache

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.conditioning import (
    OBLIQUE,
    DevicePath,
    amplification,
    force_error,
    in_a_hand,
    recorded_path,
    replayed,
)
from tissue.evaluation.atlas.page import (
    GREEN,
    GREY,
    ORANGE,
    THEORY,
    Answer,
    Conduct,
    Data,
    Page,
    Table,
    Verdict,
    panel,
    shown,
)
from tissue.scene.load import load_scene
from tissue.scene.scene import Scene

__all__ = ["HeldTool"]

LIGHT = 1e-4
"""Factor on the mass of the tool in runs that approximate a massless, quasi-static tool.

The value is a choice. The damping between tool and device is proportional to the square root of the
mass, so this factor reduces the damping to a hundredth.
"""
SECONDS = {"milling": 1.4, "glenoid": 2.4, "pedicle": 1.1, "molar": 1.7, "caries": 1.6}
"""Duration of the run of each cutting scene [s]. The run includes one second of contact."""
SHIFTS_M = np.array([1e-9, 1e-6, 1e-5])
SEED = 1
MOST = 10.0
"""Amplification above which a tool counts as ill-conditioned.

The value is a choice. At commit c4a1af96, the amplification is at most 2.6 with the mass that the
engine uses. With an almost massless tool, the amplification is 23 for a shift of 1 nm in ``molar``,
and at most 3.7 in the other scenes.
"""
STYLES = (("o-", "#0072B2"), ("s-", ORANGE), ("^-", GREEN), ("D-", "#56B4E9"), ("v-", "#CC79A7"))
RULES = {"engine": "tool of the engine", "massless": "massless quasi-static limit"}


def _columns(scene: Scene, path: DevicePath, rule: str, *, mass_share: float) -> Table:
    """Measure amplification and force error for each shift of the device path."""
    reference = replayed(scene, path, mass_share=mass_share)
    rows = []
    for shift_m in SHIFTS_M.tolist():
        course = replayed(scene, path.shifted(shift_m * OBLIQUE), mass_share=mass_share)
        rows.append((amplification(course, reference, shift_m)[0], force_error(course, reference)))
    amplified, error = np.array(rows).T
    return {rule: amplified, f"{rule}_force": error}


@cache
def _measured() -> Data:
    """Replay the path of one hand in every scene, with the tool's mass and almost without mass."""
    data: Data = {}
    for name, seconds in SECONDS.items():
        scene = in_a_hand(load_scene(name), seed=SEED, seconds=seconds)
        path = recorded_path(scene)
        engine = _columns(scene, path, "engine", mass_share=1.0)
        light = _columns(scene, path, "massless", mass_share=LIGHT)
        data[name] = {"shift_m": SHIFTS_M} | engine | light
    return data


class HeldTool(Page):
    """Amplification of a shift of the device path by a cutting tool.

    The tool has either the mass that the engine uses, or almost no mass.
    """

    name = "held_tool"
    title = "Cutting tool in a hand: amplification of a small shift"
    question = (
        "The path of a device is replayed with a shift of 1 nm, 1 µm and 10 µm. How far is the "
        "cutting tool from its path without the shift one second after the first contact, relative "
        "to the shift?"
    )
    source = (
        "Touch in the hand of an expert, one second of contact, replayed without feedback; "
        "massless limit: a ten-thousandth of the tool's mass"
    )

    def measure(self) -> Data:
        """Replay the shifted paths. The tables are cached for further calls."""
        return dict(_measured())

    def judge(self, data: Data) -> Verdict:
        """Check the largest amplifications, with and almost without mass, against the bound."""
        largest = {
            rule: {name: table[rule].max() for name, table in data.items()} for rule in RULES
        }
        worst = {rule: max(each, key=each.__getitem__) for rule, each in largest.items()}
        grown = {rule: largest[rule][worst[rule]] for rule in RULES}
        error = {
            rule: 100.0 * max(table[f"{rule}_force"].max() for table in data.values())
            for rule in RULES
        }
        return Verdict(
            grown["massless"] > MOST,
            grown["engine"] <= MOST,
            "In the massless quasi-static limit the tool path changes by up to "
            f"{grown['massless']:.3g} times the shift ({worst['massless']}), and the force by up "
            f"to {error['massless']:.2g} %. With the tool of the engine the path changes by at "
            f"most {grown['engine']:.3g} times the shift ({worst['engine']}), and the force by at "
            f"most {error['engine']:.2g} %. The bound is {MOST:g} times.",
        )

    def ask(self) -> list[Answer]:
        """List the amplifications; replay an unchanged path, and a shifted path on a wall."""
        return [*_rows(_measured()), *_replays()]

    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the amplification against the shift, with and almost without mass of the tool."""
        holds = self.judge(data).holds
        panels = chart.subplots(1, 2, sharey=True)
        for axes, (rule, title) in zip(panels, RULES.items(), strict=True):
            engine = rule == "engine"
            curves = [
                (name, table[rule], style)
                for (name, table), style in zip(data.items(), STYLES, strict=True)
            ]
            panel(
                axes,
                SHIFTS_M,
                ("shift of the device / m", "change of the tool path / shift" if engine else ""),
                [("free tool", 1.0, THEORY), ("bound", MOST, (":", GREY)), *curves],
                conduct=[(Conduct.HOLDS, SHIFTS_M[0], SHIFTS_M[-1])] if engine and holds else (),
                legend="best" if engine else "",
                title=title,
            )


def _rows(data: Data) -> Iterator[Answer]:
    """Yield the amplifications of each scene."""
    for name, table in data.items():
        engine, massless = (
            ", ".join(f"{value:.3g}" for value in table[rule].tolist()) for rule in RULES
        )
        yield shown(
            f"{name}, shifted by 1 nm, 1 µm and 10 µm",
            (table["engine"] <= MOST).all(),
            f"{engine} times the shift; in the massless limit {massless} times",
        )


def _replays() -> Iterator[Answer]:
    """Yield the answers for a path that is replayed twice, and for a shifted path on a wall."""
    # The burr touches after 0.4 s, the ball after 0.5 s.
    scene = in_a_hand(load_scene("milling"), seed=SEED, seconds=0.6)
    path = recorded_path(scene)
    first = replayed(scene, path)
    second = replayed(scene, path)
    same = np.array_equal(first.tips_m, second.tips_m)
    same = same and np.array_equal(first.forces_N, second.forces_N)
    yield shown(
        "milling, the same path twice", same, "equal tool paths and forces, to the last bit"
    )
    wall = in_a_hand(load_scene("wall"), seed=SEED, seconds=1.5)
    path = recorded_path(wall)
    shift_m = 1e-6
    moved = replayed(wall, path.shifted(shift_m * OBLIQUE))
    grown, _ = amplification(moved, replayed(wall, path), shift_m)
    # measured: 1.000, because a wall only holds back a part of the shift
    yield shown("a ball on a wall, shifted by 1 µm", grown < 1.1, f"{grown:.4g} times the shift")
