"""Compliance of touchable nodes from one factor: eliminated last, what is left of the stiffness is the inverse of it.

With the touchable unknowns t last, ``K = L U`` has the Schur complement ``S = K_tt - K_tr K_rr^-1 K_rt = L_tt U_tt`` in
its last block, and ``W = S^-1`` is ``H K^-1 H^T``. No back-substitution is made: on 36,000 unknowns, 1,350 of them
touchable, those took twenty times as long.
"""

import numpy as np
from scipy.linalg import solve_triangular

from meshes.base.arrays import Array, Ints
from tissue.fem.solvers.direct import factorised
from tissue.fem.solvers.dissection import dissection
from tissue.fem.solvers.held_body import HeldBody, pointwise_graph

__all__ = ["schur_compliance_m_N"]


def schur_compliance_m_N(body: HeldBody, touchable: Ints) -> Array:
    """Compliance of some nodes [m/N], shape (3t, 3t), x, y, z node by node; zero for held components.

    Raises
    ------
    InputError
        If the matrix cannot be factorised.
    """
    order = dissection(body.nodes_m, pointwise_graph(body.stiffness))
    order = np.concatenate([order[~np.isin(order, touchable)], touchable])
    last = np.isin((3 * touchable[:, None] + np.arange(3)).ravel(), body.free)
    _, _, factor = factorised(body, order)
    count = int(last.sum())
    upper = factor.U[-count:, -count:].toarray()
    # S = U^T D^-1 U with D the diagonal of U: its inverse is V D V^T with V the inverse of U, scaled.
    half = solve_triangular(upper, np.diag(np.sqrt(np.diag(upper))))
    whole = np.zeros((len(last), len(last)))
    whole[np.ix_(last, last)] = half @ half.T
    return whole
