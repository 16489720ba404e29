"""E1: the one-step error of a lifted generator is of second order only where its dictionary is closed."""

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, Curve, panel
from tissue.evaluation.atlas.page import Answer, Data, Page, Table, Verdict, error_of, log_slope, refused, shown
from tissue.prediction.edmd.closure import step_errors
from tissue.prediction.edmd.dictionary import Delays, Dictionary, Identity
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.episodes import Episode
from tissue.prediction.edmd.lifted import Generator
from tissue.prediction.edmd.polynomials import Polynomials

__all__ = ["PAGE", "slow_manifold", "slow_rates"]

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


def errors(name: str, steps: Array) -> Table:
    """One-step errors of a dictionary over the step, by Euler's step as printed and by the exact exponential."""
    generator, states = fitted(name)
    found = step_errors(generator, states, slow_rates(states), lambda step: slow_manifold(states, step), steps.tolist())
    return {
        "step_s": steps,
        "printed": found.euler,
        "exact": found.exact,
        "theory": steps * found.defect,
        "quadratic": found.euler[-1] * (steps / steps[-1]) ** 2,
    }


def measure(quick: bool) -> Data:
    """One-step errors of three dictionaries."""
    steps = np.geomspace(1e-4, 1e-1, 4 if quick else 10)
    return {name: errors(name, steps) for name in DICTIONARIES}


def judge(data: Data) -> Verdict:
    """Orders of all dictionaries, and the closed one's exact step."""
    orders = {name: log_slope(table["step_s"], np.maximum(table["printed"], 1e-300)) for name, table in data.items()}
    exact = float(data["closed"]["exact"].max())
    small = data["linear"]["step_s"] < 2e-3
    off = max(error_of(data[name]["printed"][small], data[name]["theory"][small]) for name in ("open", "linear"))
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


def draw(data: Data, chart: Figure) -> None:
    """Errors over the step."""
    left, right = chart.subplots(1, 2, sharey=True)
    steps, looks = data["closed"]["step_s"], {"closed": ("o", BLUE), "open": ("s", RED), "linear": ("^", ORANGE)}
    printed, exact = (
        [(LABELS[name], np.maximum(table[kind], 1e-17), *looks[name]) for name, table in data.items()]
        for kind in ("printed", "exact")
    )
    theory: list[Curve] = [
        ("theory: step × |Lφ − Kφ|", data["open"]["theory"], "-", GREY),
        ("_", data["linear"]["theory"], "-", GREY),
    ]
    slope = ("slope 2", data["closed"]["quadratic"], "--", GREY)
    panel(left, steps, "step / s", "one-step error / deviations", [*printed, *theory, slope], conduct=(),
          title="printed: φ + ΔtKφ", ylim=(1e-18, 1.0))  # fmt: skip
    panel(right, steps, "step / s", "", [*exact, *theory], title="exact exponential (ours)", legend="center left",
          ylim=(1e-18, 1.0))  # fmt: skip


PAGE = Page(
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
