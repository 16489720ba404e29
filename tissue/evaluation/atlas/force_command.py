"""E5: an expected intensity is no force; the command must be the force that evokes the wanted intensity."""

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.builders.perception import perception
from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, Curve, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.haptics.device.device import device_parameters
from tissue.haptics.loop.filters import ForceRange
from tissue.perception.laws import Intensity, intensity_of
from tissue.perception.mapping import ForceMap
from tissue.perception.observer import Observer, population_observer, reference_observer

__all__ = ["PAGE"]

LIMIT_N = device_parameters("touch").force_limit_N
KNEE_N = ForceRange(limit_N=LIMIT_N).knee_share * LIMIT_N
LOWEST_N = population_observer().offset_N
PEOPLE = {"dull": (0.6, 1.4), "keen": (1.6, 1.9)}
"""Stevens' factor and exponent of two people; the reference has 1 and 1.7."""


def known(alpha: float, beta: float) -> Observer:
    """A person known exactly."""
    return Observer.known("someone", alpha=alpha, beta=beta, kappa=0.07, offset_N=0.2, lapse=0.02, sigma=0.2)


def measure(quick: bool) -> Data:
    """Commands, and intensities felt over those wanted, for both people and both laws."""
    forces = np.geomspace(0.02, LIMIT_N, 12 if quick else 30)
    reference = intensity_of(reference_observer())
    data: Data = {}
    for name, (alpha, beta) in PEOPLE.items():
        person = intensity_of(known(alpha, beta))
        law = ForceMap(reference, person, lowest_N=LOWEST_N, knee_N=KNEE_N)
        ours = np.array([law.table.at(force) for force in forces.tolist()])
        printed = person.expected(forces)
        # An intensity has no unit of force: given in tenths of the unit, the printed command is ten times as large.
        tenths = Intensity(log_alpha=float(np.log(10.0 * alpha)), beta=beta)
        data[name] = {
            "force_N": forces,
            "ours_N": ours,
            "printed_N": printed,
            "printed_in_tenths_N": tenths.expected(forces),
            "felt_ours": person.expected(ours) / reference.expected(law.gain * forces),
            "felt_printed": person.expected(printed) / reference.expected(forces),
            "theory_N": (law.gain**1.7 * forces**1.7 / alpha) ** (1.0 / beta),
        }
    return data


def within(table: dict[str, Array]) -> Array:
    """Forces between the straight line at the low end and the knee of the device."""
    return np.asarray((table["force_N"] >= LOWEST_N) & (table["force_N"] <= KNEE_N))


def judge(data: Data) -> Verdict:
    """How far intensities are off what is wanted, by either law; what a change of the unit does."""
    ours = max(float(np.abs(t["felt_ours"][within(t)] - 1.0).max()) for t in data.values())
    off = [t["felt_printed"][within(t)] for t in data.values()]
    worst = max(float(each.max()) for each in off), min(float(each.min()) for each in off)
    theory = max(float(np.abs(t["ours_N"] / t["theory_N"] - 1.0)[within(t)].max()) for t in data.values())
    scaled = float((data["dull"]["printed_in_tenths_N"] / data["dull"]["printed_N"]).min())
    return Verdict(
        worst[0] > 1.5 and worst[1] < 0.67 and scaled > 5.0,
        ours < 1e-6 and theory < 1e-6,
        f"Commanding E[S] as newtons makes people feel {worst[1]:.2g} to {worst[0]:.2g} times what is wanted, and "
        f"{scaled:.0f} times the force if intensity is given in tenths. The inverted law is off by {ours:.0e} at most "
        f"between {LOWEST_N:g} and {KNEE_N:.2f} N.",
    )


def ask() -> list[Answer]:
    """Observers that cannot be inverted, forces that are none, and commands beyond the device."""
    reference = intensity_of(reference_observer())
    vague = Intensity(log_alpha=0.0, beta=0.1, variances=(0.0, 0.0, 0.5))
    rng = np.random.default_rng(0)
    felt = perception("population", rng=rng, force_limit_N=LIMIT_N, tick_s=1e-3)
    assert felt is not None
    commands = [
        float(np.linalg.norm(felt.step(np.array([0.0, 0.0, f])))) for f in np.linspace(0.0, KNEE_N, 400).tolist()
    ]
    return [
        refused("a person whose exponent is hardly known",
                lambda: ForceMap(reference, vague, lowest_N=LOWEST_N, knee_N=KNEE_N)),
        refused("a force that is not a number", lambda: felt.step(np.array([0.0, np.nan, 0.0]))),
        refused("an intensity below zero", lambda: reference.force_N(-1.0)),
        refused("an observer nobody knows", lambda: perception("nobody", rng=rng, force_limit_N=1.0, tick_s=1e-3)),
        shown("forces up to what the device plays uncompressed", max(commands) <= KNEE_N * (1.0 + 1e-9),
              f"commands of {max(commands):.2f} N at most where the device compresses from {KNEE_N:.2f} N on"),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """Command and what is felt over force."""
    left, right = chart.subplots(1, 2)
    conduct = [
        (Conduct.FALLS_BACK, 0.02, LOWEST_N),
        (Conduct.HOLDS, LOWEST_N, KNEE_N),
        (Conduct.FALLS_BACK, KNEE_N, LIMIT_N),
    ]
    commands: list[Curve] = []
    felt: list[Curve] = [("theory: as wanted", 1.0, "-", GREY)]
    for (name, table), marker, colour in zip(data.items(), "os", (BLUE, ORANGE), strict=True):
        ours, once = "ours, α = {}, β = {}".format(*PEOPLE[name]), "" if marker == "o" else "_"
        commands += [
            (f"{once}theory: (F^1.7/α)^(1/β)", table["theory_N"], "-", GREY),
            (ours, table["ours_N"], marker, colour),
            (f"{once}printed: E[S]", table["printed_N"], "--", RED),
        ]
        felt += [(ours, table["felt_ours"], marker, colour), (f"{once}printed", table["felt_printed"], "--", RED)]
    force = data["dull"]["force_N"]
    panel(left, force, "force to be felt / N", "command / N", commands, conduct=conduct, legend="upper left")
    panel(right, force, "force to be felt / N", "intensity felt / wanted", felt, conduct=conduct)


PAGE = Page(
    "force_command",
    "E5 · Is the force to command the expected intensity E[S | F]?",
    "A published framework commands F_perc = E[S | F]. What does a person feel of it, beside what the reference "
    "observer would, and what if the intensity is given in other units?",
    "Statement E5; Stevens' law with exponents of 1.4 to 1.9 about 1.7 for muscle force; device: Touch",
    measure,
    judge,
    ask,
    draw,
)
