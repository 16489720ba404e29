"""E2: powers of a fitted operator blow up once its spectral radius passes 1; a cap stops that."""

import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

from meshes.base.arrays import Array
from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.episodes import Episode
from tissue.prediction.edmd.lifted import Operator
from tissue.prediction.edmd.polynomials import Polynomials
from tissue.prediction.edmd.spectrum import cap_spectrum, spectral_radius
from tissue.prediction.edmd.validation import horizon_errors

__all__ = ["PAGE"]

STEP_S, ORDER, HORIZON = 0.02, 3, 1000


def van_der_pol(start: Array, count: int) -> Array:
    """A path of Van der Pol's oscillator in steps of 20 ms, shape (count, 2)."""

    def rate(_: float, state: Array) -> Array:
        return np.array([state[1], (1.0 - state[0] ** 2) * state[1] - state[0]])

    times = STEP_S * np.arange(count)
    found = solve_ivp(rate, times[[0, -1]], start, method="DOP853", t_eval=times, rtol=1e-9, atol=1e-9)
    return np.asarray(found.y.T)


def operators() -> dict[str, Operator]:
    """The same fit with its eigenvalues left and capped at 1, to noisy paths."""
    rng = np.random.default_rng(11)
    paths = [van_der_pol(rng.uniform(-1.0, 1.0, 2), 60) for _ in range(10)]
    episodes = [Episode(path + 0.02 * rng.normal(size=path.shape), None, STEP_S) for path in paths]
    dictionary = Polynomials(ORDER)
    return {"free": Edmd(dictionary, cap=None).fit(episodes), "capped": Edmd(dictionary, cap=1.0).fit(episodes)}


def measure(quick: bool) -> Data:
    """Errors over the horizon of both, and of staying where one is, on paths that were not learnt from."""
    rng = np.random.default_rng(12)
    tests = [van_der_pol(rng.uniform(-1.5, 1.5, 2), HORIZON + (6 if quick else 30)) for _ in range(2 if quick else 4)]
    steps = np.unique(np.geomspace(1, HORIZON, 12 if quick else 40).astype(int))
    episodes = [Episode(path, None, STEP_S) for path in tests]
    fits = operators()
    found = {name: horizon_errors(each, episodes, HORIZON) for name, each in fits.items()}
    radius = spectral_radius(fits["free"].A / fits["free"].scale[:, None] * fits["free"].scale)
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
            **errors,
            "stay": np.array(stay),
            "theory": np.exp(np.log(last) + (steps - steps[-1]) * np.log(radius)),
            "radius": np.full(len(steps), radius),
        }
    }


def judge(data: Data) -> Verdict:
    """Growth of the free powers against the spectral radius, and the bound of the capped ones."""
    table = data["horizon"]
    radius, steps, free = float(table["radius"][0]), table["steps"], table["free"]
    finite = (steps > 0.5 * steps[-1]) & np.isfinite(free)
    rate = float(np.exp(np.polyfit(steps[finite], np.log(free[finite]), 1)[0])) if finite.sum() > 1 else np.inf
    worst, size = float(table["capped"].max()), float(table["stay"].max())
    better = float((table["capped"] / table["stay"])[steps <= 10].max())
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


def draw(data: Data, chart: Figure) -> None:
    """Error over the horizon."""
    table, high = data["horizon"], 1e12
    free = np.minimum(table["free"], high)
    x_label = f"steps of {1e3 * STEP_S:.0f} ms ahead"
    panel(chart.subplots(), table["steps"], x_label, "root mean square error of the state", [
        (f"theory: ρⁿ with ρ = {table['radius'][0]:.4f}", np.minimum(table["theory"], high), "-", GREY),
        ("powers as fitted (printed)", free, "s", RED),
        ("eigenvalues capped at 1 (ours)", table["capped"], "o", BLUE),
        ("staying where one is", table["stay"], "^", ORANGE),
    ], conduct=[(Conduct.FALLS_BACK, 1.0, HORIZON)], ylim=(1e-3, min(10.0 * np.nanmax(free), high)))  # fmt: skip


PAGE = Page(
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
