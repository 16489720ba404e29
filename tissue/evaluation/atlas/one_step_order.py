"""E1: the one-step error of a lifted generator is of second order only where its dictionary is closed."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, finish, region
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.prediction.edmd.closure import step_errors
from tissue.prediction.edmd.dictionary import Delays, Dictionary, Identity
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.episodes import Episode
from tissue.prediction.edmd.lifted import Generator
from tissue.prediction.edmd.polynomials import Polynomials

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ONE_STEP_ORDER", "slow_manifold", "slow_rates"]

Array = NDArray[np.float64]
SLOW, FAST = -0.05, -1.0
"""dx1/dt = slow x1, dx2/dt = fast (x2 - x1^2) (Brunton et al. 2016): closed by x1^2, and by no other square."""
DICTIONARIES: dict[str, Dictionary] = {
    "closed": Polynomials(2, columns=(0,)),
    "open": Polynomials(2, columns=(1,)),
    "linear": Identity(),
}
LABELS = {"closed": "x1, x2, x1²: closed", "open": "x1, x2, x2²: not closed", "linear": "x1, x2: not closed"}


def slow_rates(states: Array) -> Array:
    """Time derivatives of states, shape (n, 2)."""
    x, y = states.T
    return np.column_stack([SLOW * x, FAST * (y - x * x)])


def slow_manifold(states: Array, time_s: float) -> Array:
    """States so much later, exactly, shape (n, 2)."""
    x, y = states.T
    bend = FAST / (FAST - 2.0 * SLOW)
    fast_after = (y - bend * x * x) * np.exp(FAST * time_s) + bend * x * x * np.exp(2.0 * SLOW * time_s)
    return np.column_stack([x * np.exp(SLOW * time_s), fast_after])


def fitted(name: str) -> tuple[Generator, Array]:
    """A generator fitted to random states of [-1, 1]^2, and those."""
    states = np.random.default_rng(5).uniform(-1.0, 1.0, (400, 2))
    return Edmd(DICTIONARIES[name]).fit_generator([Episode(states, None, 0.1, slow_rates(states))]), states


def measure(quick: bool) -> Data:
    """One-step errors over the step for three dictionaries, by Euler's step as printed and by the exact exponential."""
    steps = np.geomspace(1e-4, 1e-1, 4 if quick else 10)
    data: Data = {}
    for name in DICTIONARIES:
        generator, states = fitted(name)

        def flow(step: float, states: Array = states) -> Array:
            return slow_manifold(states, step)

        found = step_errors(generator, states, slow_rates(states), flow, steps.tolist())
        data[name] = {
            "step_s": steps,
            "printed": found.euler,
            "exact": found.exact,
            "theory": steps * found.defect,
            "quadratic": found.euler[-1] * (steps / steps[-1]) ** 2,
        }
    return data


def slope(table: dict[str, Array], name: str) -> float:
    """Order of an error."""
    return float(np.polyfit(np.log(table["step_s"]), np.log(np.maximum(table[name], 1e-300)), 1)[0])


def judge(data: Data) -> Verdict:
    """Orders of all dictionaries, and the closed one's exact step."""
    orders = {name: slope(table, "printed") for name, table in data.items()}
    exact = float(data["closed"]["exact"].max())
    small = data["linear"]["step_s"] < 2e-3
    off = max(
        float(np.abs(data[name]["printed"] / data[name]["theory"] - 1.0)[small].max()) for name in ("open", "linear")
    )
    return Verdict(
        abs(orders["open"] - 1.0) < 0.15 and abs(orders["linear"] - 1.0) < 0.15 and off < 0.05,
        abs(orders["closed"] - 2.0) < 0.1 and exact < 1e-12,
        f"The printed update has order {orders['closed']:.2f} with the closed dictionary and {orders['open']:.2f} and "
        f"{orders['linear']:.2f} with the others, where the error is the step times |Lφ − Kφ| (to {100 * off:.1g} %). "
        f"With the exact exponential the closed one is right to {exact:.0e} at any step.",
    )


def ask() -> list[Answer]:
    """Data that cannot be learnt from, a dictionary without a generator's order, and inputs over a held step."""
    generator, states = fitted("closed")
    still = np.ones((50, 2))
    torn = np.where(np.arange(50)[:, None] == 7, np.nan, np.random.default_rng(0).normal(size=(50, 2)))
    times = 0.1 * np.arange(60)
    driven = np.sin(times)[:, None] + 0.1 * np.random.default_rng(1).normal(size=(60, 1))
    path = np.zeros((60, 1))
    for tick in range(59):  # dx/dt = -x + u with u held
        path[tick + 1] = path[tick] * np.exp(-0.1) + (1.0 - np.exp(-0.1)) * driven[tick]
    held = Edmd(Identity(), offset=False).fit([Episode(path, driven, 0.1)])
    off = abs(float(held.A[0, 0]) - np.exp(-0.1)) + abs(float(held.B[0, 0]) - (1.0 - np.exp(-0.1)))
    fast_after = generator.discrete(10.0).predict(states[0], None, 1)
    far = float(np.abs(fast_after - slow_manifold(states[:1], 10.0)).max())
    return [
        refused("a fit to a system at rest", lambda: Edmd(Identity()).fit([Episode(still, None, 0.1)])),
        refused("a fit to samples with a gap", lambda: Edmd(Identity()).fit([Episode(torn, None, 0.1)])),
        refused("the order of a dictionary with delays",
                lambda: step_errors(Edmd(Delays(1)).fit_generator([Episode(states, None, 0.1, slow_rates(states))]),
                                    states, slow_rates(states), lambda step: states, [0.1])),
        shown("an operator with inputs", off < 1e-9, f"the exact zero-order hold to {off:.0e}: none is left out"),
        shown("the step of 10 s of the closed generator", far < 1e-9, f"right to {far:.0e}"),
    ]  # fmt: skip


def draw(data: Data, chart: "Figure") -> None:
    """Errors over the step."""
    left, right = chart.subplots(1, 2, sharey=True)
    for axes, kind in ((left, "printed"), (right, "exact")):
        steps = data["closed"]["step_s"]
        region(axes, Conduct.HOLDS, steps[0], steps[-1]) if kind == "exact" else None
        for (name, table), colour, marker in zip(data.items(), (BLUE, RED, ORANGE), "os^", strict=True):
            axes.loglog(steps, np.maximum(table[kind], 1e-17), marker, color=colour, label=LABELS[name])
            if name != "closed":
                axes.loglog(steps, table["theory"], color=GREY,
                            label="theory: step × |Lφ − Kφ|" if name == "open" else None)  # fmt: skip
            elif kind == "printed":
                axes.loglog(steps, table["quadratic"], "--", color=GREY, label="slope 2")
    finish(left, "step / s", "one-step error / deviations", title="printed: φ + ΔtKφ", ylim=(1e-18, 1.0))
    finish(right, "step / s", "", title="exact exponential (ours)", legend="center left")


ONE_STEP_ORDER = Page(
    "one_step_order",
    "E1 · Is the one-step error of a lifted model O(Δt²)?",
    "A published theorem claims it for any dictionary. What order do dictionaries have that are closed under the "
    "dynamics, and others?",
    "Statement E1; slow manifold of Brunton et al. (2016), generator EDMD of Klus et al. (2020)",
    measure,
    judge,
    ask,
    draw,
)
