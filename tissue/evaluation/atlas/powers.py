"""E2: powers of a fitted operator blow up once its spectral radius passes 1; a cap stops that."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, finish, region
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.episodes import Episode
from tissue.prediction.edmd.lifted import Operator
from tissue.prediction.edmd.polynomials import Polynomials
from tissue.prediction.edmd.spectrum import cap_spectrum, spectral_radius
from tissue.prediction.edmd.validation import horizon_errors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["POWERS"]

Array = NDArray[np.float64]
STEP_S, ORDER, HORIZON = 0.02, 3, 1000


def van_der_pol(start: Array, count: int) -> Array:
    """A path of Van der Pol's oscillator, by Runge and Kutta's rule in steps of 20 ms, shape (count, 2)."""

    def rate(state: Array) -> Array:
        return np.array([state[1], (1.0 - state[0] ** 2) * state[1] - state[0]])

    path = np.empty((count, 2))
    path[0] = start
    for tick in range(count - 1):
        now = path[tick]
        one = rate(now)
        two = rate(now + 0.5 * STEP_S * one)
        three = rate(now + 0.5 * STEP_S * two)
        four = rate(now + STEP_S * three)
        path[tick + 1] = now + STEP_S / 6.0 * (one + 2.0 * two + 2.0 * three + four)
    return path


def operators() -> dict[str, Operator]:
    """The same fit with its eigenvalues left and capped at 1, to noisy paths."""
    rng = np.random.default_rng(11)
    paths = [van_der_pol(rng.uniform(-1.0, 1.0, 2), 60) for _ in range(10)]
    episodes = [Episode(path + 0.02 * rng.normal(size=path.shape), None, STEP_S) for path in paths]
    dictionary = Polynomials(ORDER)
    return {"free": Edmd(dictionary, cap=None).fit(episodes), "capped": Edmd(dictionary, cap=1.0).fit(episodes)}


def measure(quick: bool) -> Data:
    """Errors over the horizon of both, and of staying where one is, on paths that were not learnt from."""
    horizon = HORIZON
    rng = np.random.default_rng(12)
    tests = [van_der_pol(rng.uniform(-1.5, 1.5, 2), horizon + (6 if quick else 30)) for _ in range(2 if quick else 4)]
    steps = np.unique(np.geomspace(1, horizon, 12 if quick else 40).astype(int))
    episodes = [Episode(path, None, STEP_S) for path in tests]
    found = {name: horizon_errors(each, episodes, horizon) for name, each in operators().items()}
    radius = spectral_radius(operators()["free"].A / operators()["free"].scale[:, None] * operators()["free"].scale)
    starts = found["free"].starts // len(tests)
    stay = [
        np.sqrt(np.mean([((path[n : n + starts] - path[:starts]) ** 2).sum(axis=1).mean() for path in tests]))
        for n in steps.tolist()
    ]
    errors = {name: np.sqrt((each.rms**2).sum(axis=1))[steps - 1] for name, each in found.items()}
    last = np.minimum(errors["free"][-1], 1e300)
    return {
        "horizon": {
            "steps": steps.astype(float),
            "free": errors["free"],
            "capped": errors["capped"],
            "stay": np.array(stay),
            "theory": np.exp(np.log(last) + (steps - steps[-1]) * np.log(radius)),
            "radius": np.full(len(steps), radius),
        }
    }


def judge(data: Data) -> Verdict:
    """Growth of the free powers against the spectral radius, and the bound of the capped ones."""
    table = data["horizon"]
    radius, steps, free = float(table["radius"][0]), table["steps"], table["free"]
    late = steps > 0.5 * steps[-1]
    finite = late & np.isfinite(free)
    rate = float(np.exp(np.polyfit(steps[finite], np.log(free[finite]), 1)[0])) if finite.sum() > 1 else np.inf
    worst = float(table["capped"].max())
    size = float(table["stay"].max())
    near = steps <= 10
    better = float((table["capped"] / table["stay"])[near].max())
    return Verdict(
        radius > 1.0 and free[-1] > 100.0 * size and abs(np.log(rate) / np.log(radius) - 1.0) < 0.1,
        worst < 3.0 * size and better < 1.0,
        f"The fit has a spectral radius of {radius:.4f}; {steps[-1]:.0f} steps ahead its powers are off by "
        f"{free[-1]:.1e} where the path itself is {size:.1f} wide, growing by {rate:.4f} a step. With eigenvalues "
        f"capped at 1 the error stays below {worst:.1f}; up to ten steps ahead it is at most {better:.2f} times that "
        "of staying.",
    )


def ask() -> list[Answer]:
    """Caps and horizons that are none, and what a cap leaves as it was."""
    random = np.random.default_rng(3).normal(size=(8, 8))
    capped, count = cap_spectrum(random, 1.0)
    calm = 0.9 * random / spectral_radius(random)
    same, untouched = cap_spectrum(calm, 1.0)
    operator = operators()["capped"]
    return [
        refused("a cap of 0", lambda: Edmd(Polynomials(2), cap=0.0)),
        refused("the cap of a matrix with NaN", lambda: cap_spectrum(np.full((2, 2), np.nan))),
        refused("0 steps ahead", lambda: operator.predict(np.zeros(2), None, 0)),
        shown("a random matrix, capped", spectral_radius(capped) <= 1.0 + 1e-6 and count > 0,
              f"radius {spectral_radius(random):.2f} to {spectral_radius(capped):.6f}, {count} eigenvalues shrunk",
              conduct=Conduct.FALLS_BACK),
        shown("a calm one", same is calm and untouched == 0, "left as it is, to the bit"),
    ]  # fmt: skip


def draw(data: Data, chart: "Figure") -> None:
    """Error over the horizon."""
    axes, table = chart.subplots(), data["horizon"]
    steps = table["steps"]
    region(axes, Conduct.FALLS_BACK, steps[0], steps[-1])
    high = 1e12
    axes.loglog(
        steps, np.minimum(table["theory"], high), color=GREY, label=f"theory: ρⁿ with ρ = {table['radius'][0]:.4f}"
    )
    axes.loglog(steps, np.minimum(table["free"], high), "s", color=RED, label="powers as fitted (printed)")
    axes.loglog(steps, table["capped"], "o", color=BLUE, label="eigenvalues capped at 1 (ours)")
    axes.loglog(steps, table["stay"], "^", color=ORANGE, label="staying where one is")
    top = min(10.0 * float(np.nanmax(np.minimum(table["free"], high))), high)
    finish(axes, f"steps of {1e3 * STEP_S:.0f} ms ahead", "root mean square error of the state", xlim=steps[[0, -1]],
           ylim=(1e-3, top))  # fmt: skip


POWERS = Page(
    "powers",
    "E2 · Is g(x after n steps) the n-th power of K on g(x)?",
    "A published theorem assumes what it proves. How does the error of a fitted operator grow with the horizon once "
    "its spectral radius is above 1?",
    f"Statement E2; Van der Pol's oscillator with monomials up to order {ORDER}, noise of 0.02 in training",
    measure,
    judge,
    ask,
    draw,
)
