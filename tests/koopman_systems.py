"""Systems to hold lifted operators against: their rates, their flows, and recorded episodes of them."""

import numpy as np

from tissue.prediction.edmd.episodes import Episode

SLOW_RATE, FAST_RATE, SLOW_STEP_S = -0.05, -1.0, 0.1
SLOW_GENERATOR = np.array([[SLOW_RATE, 0, 0], [0, FAST_RATE, -FAST_RATE], [0, 0, 2 * SLOW_RATE]])
"""Of x1, x2 and x1² on the slow manifold (Brunton et al. 2016)."""
SLOW_OPERATOR = np.array([[0.99501248, 0, 0], [0, 0.90483742, 0.09468046], [0, 0, 0.99004983]])
"""Its exponential over 0.1 s, printed to eight digits."""


def slow_manifold(states, inputs=0.0):
    """dx1/dt = μ x1, dx2/dt = λ (x2 - x1²)."""
    first, second = states[..., 0], states[..., 1]
    return np.stack([SLOW_RATE * first, FAST_RATE * (second - first**2)], axis=-1)


def slow_manifold_at(start, times):
    """Exact states, shape (..., times, 2)."""
    first, second = np.asarray(start)[..., :1], np.asarray(start)[..., 1:]
    share = FAST_RATE / (FAST_RATE - 2 * SLOW_RATE)
    slow = share * first**2 * np.exp(2 * SLOW_RATE * times)
    later = (second - share * first**2) * np.exp(FAST_RATE * times) + slow
    return np.stack([first * np.exp(SLOW_RATE * times), later], axis=-1)


def duffing(states, inputs=0.0):
    """A damped spring that hardens: dv/dt = -0.5 v - x - x³ + u."""
    place, speed = states[..., 0], states[..., 1]
    return np.stack([speed, -0.5 * speed - place - place**3 + inputs], axis=-1)


def van_der_pol(states, inputs=0.0):
    """As Korda & Mezić (2018) have it."""
    first, second = states[..., 0], states[..., 1]
    return np.stack([2.0 * second, -0.8 * first + 2.0 * second - 10.0 * first**2 * second + inputs], axis=-1)


def contact(states, inputs=0.0):
    """A mass of 0.1 kg on a spring of 20 N/m, before a wall at 0 of 500 N/m and 1 N s/m that only pushes."""
    place, speed = states[..., 0], states[..., 1]
    wall = np.where(place > 0.0, 500.0 * place + 1.0 * speed, 0.0)
    return np.stack([speed, (-20.0 * (place + 0.002) - 0.2 * speed - wall + inputs) / 0.1], axis=-1)


def advance(field, states, step_s, inputs=0.0, substeps=1):
    """The classical Runge-Kutta method, inputs held."""
    h = step_s / substeps
    for _ in range(substeps):
        k1 = field(states, inputs)
        k2 = field(states + 0.5 * h * k1, inputs)
        k3 = field(states + 0.5 * h * k2, inputs)
        k4 = field(states + h * k3, inputs)
        states = states + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return states


def record(field, starts, inputs, step_s, substeps=1):
    """Episodes from starts (e, d) under inputs (e, n), each with its rates."""
    states = [np.asarray(starts, dtype=float)]
    for now in inputs.T[:-1]:
        states.append(advance(field, states[-1], step_s, now, substeps))
    table = np.stack(states, axis=1)
    rates = field(table, inputs)
    return [
        Episode(each, given[:, None] if inputs.any() else None, step_s, slope)
        for each, given, slope in zip(table, inputs, rates, strict=True)
    ]
