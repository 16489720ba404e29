"""Theoretical bounds on the stiffness of a virtual wall, drawn as lines in a stability map.

The bounds do not judge a run. The eigenvalues in `tissue.haptics.loop.critical_stiffness` do. Each
bound takes the same `WallLoop`. A hand adds its damping to the damping of the device if the bound
contains damping.
"""

from math import ceil, inf, pi

import numpy as np

from meshes.base.errors import require_positive, require_range
from tissue.haptics.loop.filters import low_pass_gain
from tissue.haptics.loop.sampled_loop import WallLoop

__all__ = ["delay_bound_N_m", "pade_bound_N_m", "passive_bound_N_m", "quantised_bound_N_m"]


def passive_bound_N_m(loop: WallLoop) -> float:
    """Return the stiffness up to which the wall is passive (Colgate and Schenkel, 1997) [N/m].

    A passive wall is stable in any passive hand. The condition b > T / 2 Re{(1 - exp(-j w T)) H} /
    (1 - cos w T) is solved for K on a grid of w. H contains wall, filter and a delay of whole
    steps. A fraction of a step counts as a whole step, and the lag of the amplifier as delay. Only
    the device's own damping counts. Without delay and filter, the bound is 2 (b - |B|) / T for
    either sign of B. T is the time for which a force is held, so that a slow model counts with its
    own step. One more step of delay is added if a filter changes the held force within the step.
    The result is 0 if B, delay and filter leave no passive stiffness.
    """
    step = loop.tick_s * loop.model_ticks
    lag = loop.delay_s + 1.0 / (2.0 * pi * loop.amplifier_Hz)
    turn = np.concatenate([np.geomspace(1e-3, 1e-2, 100), np.linspace(1e-2, np.pi, 4000)])
    back = np.exp(-1j * turn)
    gain = low_pass_gain(loop.filter_s, step)
    passed = (
        gain
        / (1.0 - (1.0 - gain) * back)
        * back ** (ceil(lag / step - 1e-9) + (gain < 1.0 and loop.model_ticks > 1))
    )
    paid = 2.0 * loop.damping_N_s_m / step * (1.0 - np.cos(turn))
    owed_to_damping = ((1.0 - back) ** 2 * passed).real * loop.wall_damping_N_s_m / step
    owed_to_stiffness = ((1.0 - back) * passed).real
    left = paid - owed_to_damping
    if (left < 0.0).any():
        return 0.0
    owing = owed_to_stiffness > 0.0
    return float((left[owing] / owed_to_stiffness[owing]).min())


def delay_bound_N_m(loop: WallLoop) -> float:
    """Return K = (b + B) / (T / 2 + t_d) (Gil et al., 2009) [N/m].

    It is a first-order guide with delay and can be unsafe.
    """
    damping = loop.damping_N_s_m + loop.hand_damping_N_s_m + loop.wall_damping_N_s_m
    return max(damping / (0.5 * loop.tick_s * loop.model_ticks + loop.delay_s), 0.0)


def quantised_bound_N_m(loop: WallLoop, *, friction_N: float, encoder_m: float) -> float:
    """Return K = min(2 b / T, 2 f_c / D) (Abbott and Okamura, 2005) [N/m].

    f_c is the Coulomb friction and D the encoder step.
    """
    require_range(
        "friction_N", friction_N, 0.0, 1e3, "give the device's Coulomb friction, 0 for none"
    )
    require_positive("encoder_m", encoder_m, "give the device's encoder step, such as 5.5e-5")
    return min(
        2.0 * loop.damping_N_s_m / (loop.tick_s * loop.model_ticks), 2.0 * friction_N / encoder_m
    )


def pade_bound_N_m(loop: WallLoop, *, hold: bool = True) -> float:
    """Return the critical stiffness with a first-order Padé approximation of the delay [N/m].

    Hold and delay are combined into one delay t, approximated as (1 - t s / 2) / (1 + t s / 2). The
    bound follows from Routh's criterion for the third-order polynomial. With ``hold`` the delay is
    t_d + T / 2, without it t_d alone, as in a continuous model of the loop. The result is infinite
    if the delay is zero. Hand stiffness is ignored.
    """
    delay = loop.delay_s + (0.5 * loop.tick_s * loop.model_ticks if hold else 0.0)
    if delay == 0.0:
        return inf
    mass = loop.mass_kg + loop.hand_mass_kg
    damping = loop.damping_N_s_m + loop.hand_damping_N_s_m
    cubic = 0.5 * mass * delay
    constant = damping + loop.wall_damping_N_s_m
    square = mass + 0.5 * delay * (damping - loop.wall_damping_N_s_m)
    return max(square * constant / (cubic + 0.5 * delay * square), 0.0)
