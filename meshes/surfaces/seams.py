"""Close the seams of a surface that was put together from two parts whose edges nearly meet."""

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array

__all__ = ["close_seams", "open_loops"]

Faces = NDArray[np.int64]


def close_seams(points: Array, faces: Faces, *, first_part: int, within: float) -> tuple[Array, Faces]:
    """Join the open loops of two parts by ribbons of triangles, and fill every other open loop.

    Parameters
    ----------
    points
        Vertices, shape (n, 3).
    faces
        Triangles wound outward, shape (m, 3).
    first_part
        Number of vertices that belong to the first part; all others belong to the second.
    within
        Largest mean distance between two loops that belong together.

    Returns
    -------
    Vertices and triangles; those that are added come last.
    """
    loops = open_loops(faces)
    ours = [loop for loop in loops if loop[0] < first_part]
    theirs = [loop for loop in loops if loop[0] >= first_part]
    added: list[Faces] = []
    single: list[Faces] = []
    for loop in ours:
        apart = [_apart(points[loop], points[other]) for other in theirs]
        if apart and min(apart) < within:
            other = theirs.pop(int(np.argmin(apart)))
            added.append(_ribbon(points, loop, other))
        else:
            single.append(loop)
    middles: list[Array] = []
    for loop in single + theirs:
        centre = len(points) + len(middles)
        middles.append(points[loop].mean(axis=0))
        added.append(np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), centre)]))
    vertices = np.concatenate([points, np.array(middles).reshape(-1, 3)])
    return vertices, np.concatenate([faces, *added])


def open_loops(faces: Faces) -> list[Faces]:
    """Closed chains of the directed edges that belong to one triangle only, in the direction of that triangle."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = int(faces.max()) + 1 if len(faces) else 1
    code, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    following = defaultdict(list)
    for start, end in edges[~np.isin(code, back)].tolist():
        following[start].append(end)
    loops = []
    for start in list(following):
        while following[start]:
            loops += _loops_from(start, following)
    return [np.array(loop, dtype=np.int64) for loop in loops]


def _loops_from(start: int, following: dict[int, list[int]]) -> list[list[int]]:
    """Follow edges from a vertex, and split off a loop wherever a vertex comes again."""
    chain, loops = [start], []
    while following[chain[-1]]:
        vertex = following[chain[-1]].pop()
        if vertex in chain:
            at = chain.index(vertex)
            loops.append(chain[at:])
            del chain[at + 1 :]
        else:
            chain.append(vertex)
    return loops


def _apart(points: Array, others: Array) -> float:
    """Mean distance of the points of two loops from each other."""
    from scipy.spatial import cKDTree

    there, back = cKDTree(others).query(points)[0], cKDTree(points).query(others)[0]
    return float(max(there.mean(), back.mean()))


def _ribbon(points: Array, loop: Faces, other: Faces) -> Faces:
    """Triangles between two loops that run in opposite directions, along the shorter diagonal at every step."""
    along = other[::-1]
    nearest = int(np.linalg.norm(points[along] - points[loop[0]], axis=1).argmin())
    first = np.append(loop, loop[0])
    second = np.roll(along, -nearest)
    second = np.append(second, second[0])
    i, j, triangles = 0, 0, []
    while i < len(loop) or j < len(other):
        forward = np.inf if i == len(loop) else np.linalg.norm(points[first[i + 1]] - points[second[j]])
        aside = np.inf if j == len(other) else np.linalg.norm(points[first[i]] - points[second[j + 1]])
        if forward <= aside:
            triangles.append((first[i + 1], first[i], second[j]))
            i += 1
        else:
            triangles.append((second[j], second[j + 1], first[i]))
            j += 1
    return np.array(triangles, dtype=np.int64)
