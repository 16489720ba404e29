"""Better tetrahedra by moving inner nodes, one at a time, to where their worst cell is best."""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from meshes.tets.checks import mean_ratio

__all__ = ["smooth"]

_DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_FIRST_STEP = 0.25
_SMALLEST_STEP = 0.004


def smooth(
    nodes: NDArray[np.float64],
    cells: NDArray[np.int64],
    movable: NDArray[np.bool_],
    enough: float,
    *,
    sweeps: int = 3,
) -> tuple[NDArray[np.float64], int]:
    """Move nodes of cells worse than `enough` by pattern search on the worst mean ratio around each.

    A move is kept only where the worst cell around the node improves, so no cell falls below the worst one next to it.

    Parameters
    ----------
    nodes, cells
        Nodes, shape (n, 3), and cells, shape (m, 4).
    movable
        Whether a node may move, shape (n,).
    enough
        Mean ratio from which a cell is left alone.
    sweeps
        Times to go through the cells.

    Returns
    -------
    Nodes, shape (n, 3), and how many of them moved.
    """
    nodes = nodes.copy()
    order = np.argsort(cells.ravel(), kind="stable")
    starts = np.searchsorted(cells.ravel()[order], np.arange(len(nodes) + 1))
    moved: set[int] = set()
    for _ in range(sweeps):
        quality = mean_ratio(nodes, cells)
        bad = np.flatnonzero(quality < enough)
        # Worst cells first: what they gain, their neighbours start from.
        wanted = cells[bad[np.argsort(quality[bad])]].ravel()
        wanted = wanted[np.sort(np.unique(wanted, return_index=True)[1])]
        changed = 0
        for node in wanted[movable[wanted]]:
            star = cells[order[starts[node] : starts[node + 1]] // 4]
            best = _best_place(nodes, star, int(node), enough)
            if best is not None:
                nodes[node] = best
                moved.add(int(node))
                changed += 1
        if not changed:
            break
    return nodes, len(moved)


def _best_place(
    nodes: NDArray[np.float64], star: NDArray[np.int64], node: int, enough: float
) -> NDArray[np.float64] | None:
    """Where the worst of the cells around a node is best; None where it is already."""
    corners = nodes[star]
    slot = star == node
    here = nodes[node]
    size = float(np.abs(corners - here).max())
    score = float(mean_ratio(nodes, star).min())
    if score >= enough:
        return None
    start, step = here, _FIRST_STEP
    centre = corners[~slot].mean(axis=0)
    while step > _SMALLEST_STEP:
        tries = np.concatenate([here + step * size * _DIRECTIONS, here + np.array([[0.5], [1.0]]) * (centre - here)])
        moved = np.where(slot[None, :, :, None], tries[:, None, None, :], corners[None])
        flat = moved.reshape(-1, 3)
        worst = mean_ratio(flat, np.arange(len(flat)).reshape(-1, 4)).reshape(len(tries), -1).min(axis=1)
        best = int(worst.argmax())
        if worst[best] > score + 1e-6:
            here, score = tries[best], float(worst[best])
        else:
            step *= 0.5
    return None if here is start else here
