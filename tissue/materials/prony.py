"""Prony series: stress relaxation and creep of a soft tissue.

The relaxation modulus, divided by its instantaneous value, is ``s(t) = g_inf + sum g_i exp(-t /
tau_i)``, with ``s(0) = 1``. Stress is the hereditary integral of the strain rate with s. Strain is
the hereditary integral of the stress rate with the creep compliance ``j(t) = 1 + sum j_k (1 -
exp(-t / lambda_k))``. In Laplace space, ``p s~(p) p j~(p) = 1``. With the dashpot strains y as the
state and the stress sigma, creep follows ``y' = -B y + c sigma``. Here ``B = diag(1 / tau) - c
c^T`` and ``c_i = sqrt(g_i / tau_i)``. The retardation times are the reciprocals of the eigenvalues
of the symmetric matrix B. One eigenvalue lies below each relaxation rate (Gross 1953, Mathematical
Structure of the Theories of Viscoelasticity; Tschoegl 1989).

The two integrals need one exponential per term and step. The integrals are exact if the input is
linear within each step, and have second-order accuracy for a smooth input (Taylor, Pister and
Goudreau 1970, Int. J. Numer. Methods Eng. 2:45).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError, counted, require_positive


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Step response ``1 + sum amplitude_k (1 - exp(-t / time_k))``.

    Attributes
    ----------
    amplitude
        Amplitude of each delayed term, shape (k,); negative if the response decreases with time.
    time_s
        Time of each term [s], shape (k,).
    """

    amplitude: Array
    time_s: Array


@dataclass(frozen=True)
class Prony:
    """Prony series of a modulus, relative to the instantaneous modulus.

    Attributes
    ----------
    g
        Share of each relaxing term in the instantaneous modulus. Each share is positive, and their
        sum is below 1.
    tau_s
        Relaxation time of each term [s].

    Raises
    ------
    InputError
        If the lengths of `g` and `tau_s` differ, a share or a time is not positive and finite, or
        the shares sum to 1 or more.
    """

    g: tuple[float, ...]
    tau_s: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.g) != len(self.tau_s) or not self.g:
            raise InputError(
                "tau_s",
                "have one time for each share in g",
                f"{counted(len(self.g), 'share')} and {counted(len(self.tau_s), 'time')}",
                "give as many times as shares, at least one",
            )
        for name, values in (("g", self.g), ("tau_s", self.tau_s)):
            for index, value in enumerate(values):
                require_positive(f"{name}[{index}]", value, "leave out a term that does not relax")
        total = math.fsum(self.g)
        if total > 1.0 - 1e-9:
            raise InputError(
                "g",
                "sum to less than 1",
                f"{total:g}",
                "lower a share: a solid keeps a long-term share g_inf above 0",
            )

    @cached_property
    def retardation(self) -> Spectrum:
        """Spectrum of the creep compliance.

        The amplitudes sum to 1 / g_inf - 1, and the times are the retardation times.
        """
        rate = 1.0 / np.array(self.tau_s)
        drive = np.sqrt(np.array(self.g) * rate)
        rates, modes = np.linalg.eigh(np.diag(rate) - np.outer(drive, drive))
        return Spectrum((drive @ modes) ** 2 / rates, 1.0 / rates)


class HereditaryIntegral:
    """Hereditary integral with a spectrum's step response, for inputs linear within each step.

    If the input at the end of a step is ``x``, the response there is ``y = instant_factor x +
    history``. The history is known before the step. A condition on y, such as a contact, therefore
    determines x without iteration. No memory is allocated after construction.

    Parameters
    ----------
    spectrum
        Step response.
    shape
        Shape of the input.
    step_s
        Length of every step [s].

    Raises
    ------
    InputError
        If the step is not positive and finite.
    """

    STATE = ("_terms", "history")
    """Attributes that later steps depend on."""

    def __init__(self, spectrum: Spectrum, shape: tuple[int, ...], *, step_s: float) -> None:
        ratio = (
            require_positive("step_s", step_s, "use the length of a tick, 0.001") / spectrum.time_s
        )
        fall = -np.expm1(-ratio)
        mean = fall / ratio
        self.instant_factor = float(1.0 + spectrum.amplitude @ (1.0 - mean))
        """Response at the end of a step in which the input rises from 0 to 1.

        For a short step, the response is about 1.
        """
        self._keep = 1.0 - fall
        self._gain = spectrum.amplitude * mean * fall
        self._terms = np.zeros((len(ratio), *shape))
        self._scaled = np.zeros(shape)
        self.history = np.zeros(shape)
        """Response to all previous inputs at the end of the next step.

        If the input at the end of the next step is zero, this is the whole response.
        """

    def advance(self, value: ArrayLike) -> None:
        """Complete a step with the input `value` at its end."""
        for term, keep, gain in zip(self._terms, self._keep, self._gain, strict=True):
            term *= keep
            np.multiply(value, gain, out=self._scaled)
            term += self._scaled
        np.add.reduce(self._terms, axis=0, out=self.history)

    def become(self, other: "HereditaryIntegral", of: Callable[[Array], Array]) -> None:
        """Copy the state of another integral, and convert it by a linear map of the inputs.

        Parameters
        ----------
        other
            Integral of the same spectrum and step.
        of
            Linear function that maps an input of the other integral to an input of this integral.
        """
        for term, known in zip(self._terms, other._terms, strict=True):
            term[:] = of(known)
        np.add.reduce(self._terms, axis=0, out=self.history)
