"""What a log determines, from draws in place of a normal law."""

from dataclasses import replace

import numpy as np

from tissue.fitting.identifiability import Identified
from tissue.fitting.nuts import SHARES, Draws
from tissue.fitting.posterior import Posterior

__all__ = ["drawn_information"]

FEW = 500
"""Draws at which combinations are evaluated, each from loads at all times."""


def drawn_information(found: Identified, posterior: Posterior, draws: Draws) -> Identified:
    """The same directions, with the spread of constants and the intervals of combinations from draws.

    Parameters
    ----------
    found
        By the normal law about the maximum.
    posterior
        Constants given the log.
    draws
        Of it.
    """
    z = draws.together[:, : len(posterior.names)]
    few = [posterior.target.x(each) for each in z[:: max(len(z) // FEW, 1)]]
    combinations = []
    for each in found.combinations:
        low, value, high = np.quantile([each.of(x) for x in few], SHARES).tolist()
        combinations.append(replace(each, low=low, value=value, high=high))
    return replace(found, contraction=np.std(z, axis=0), combinations=tuple(combinations))
