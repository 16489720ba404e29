"""Rigid motions of a body, and the names of the motions that its supports leave free."""

import numpy as np

from meshes.base.arrays import Array, Flags

__all__ = ["free_modes", "rigid_modes"]

LEAST_HOLD = 1e-6
"""Largest motion of the held components in a free motion, relative to the body's own motion."""
STRAIGHT = 1e-4
"""Largest distance of a unit direction from an axis at which the axis' letter names it."""


def rigid_modes(nodes_m: Array, about_m: Array) -> Array:
    """Return nodal displacements of the six unit rigid motions, shape (n, 3, 6).

    Three translations come first, then three rotations.
    """
    modes = np.zeros((len(nodes_m), 3, 6))
    modes[:, :, :3] = np.eye(3)
    modes[:, :, 3:] = np.cross(np.eye(3)[None], (nodes_m - about_m)[:, None, :]).transpose(0, 2, 1)
    return modes


def free_modes(nodes_m: Array, held: Flags) -> list[str]:
    """Return the names of the rigid motions that move no held component.

    The list is empty if the body is supported.

    Parameters
    ----------
    nodes_m
        Nodes of one connected body [m], shape (n, 3).
    held
        Components that are fixed, shape (n, 3).
    """
    centre = nodes_m.mean(axis=0)
    size = max(float(np.linalg.norm(nodes_m - centre, axis=1).max()), 1e-300)
    rows = rigid_modes((nodes_m - centre) / size, np.zeros(3))[held]
    values, vectors = np.linalg.eigh(rows.T @ rows / max(len(rows), 1))
    free = vectors[:, values < LEAST_HOLD**2].T
    if len(free) == 0:
        return []
    return _named(_reduced(free[:, [3, 4, 5, 0, 1, 2]]), centre, size)


def _reduced(rows: Array) -> Array:
    """Return the row echelon form.

    It separates motions along and about the axes if possible.
    """
    rows = rows.copy()
    done = 0
    for column in range(6):
        if done == len(rows):
            break
        best = done + int(np.abs(rows[done:, column]).argmax())
        if abs(rows[best, column]) < STRAIGHT:
            continue
        rows[[done, best]] = rows[[best, done]]
        rows[done] /= rows[done, column]
        others = np.arange(len(rows)) != done
        rows[others] -= rows[others, column, None] * rows[done]
        done += 1
    return rows


def _named(rows: Array, centre: Array, size: float) -> list[str]:
    """Return names of motions given as rotation and translation of the scaled body.

    Rotations come first.
    """
    turns = []
    slides = []
    for row in rows:
        turn = row[:3]
        shift = row[3:]
        if np.abs(turn).max() < STRAIGHT:
            slides.append(f"translation along {_direction(shift)}")
            continue
        point = centre + size * np.cross(turn, shift) / (turn @ turn)
        place = ", ".join(
            f"{value:.3g}" for value in np.where(np.abs(point) < STRAIGHT * size, 0.0, point)
        )
        pitch = turn @ shift / (turn @ turn)
        kind = "rotation" if abs(pitch) < STRAIGHT else "screw motion"
        turns.append(f"{kind} about {_direction(turn)} through ({place}) m")
    return [*slides, *turns]


def _direction(vector: Array) -> str:
    """Return the letter of an axis, or the components of a unit vector."""
    unit = vector / np.linalg.norm(vector)
    unit = unit if unit[np.abs(unit).argmax()] > 0.0 else -unit
    main = int(np.abs(unit).argmax())
    if np.abs(np.delete(unit, main)).max() < STRAIGHT:
        return "xyz"[main]
    return (
        "("
        + ", ".join(f"{value:.3g}" for value in np.where(np.abs(unit) < STRAIGHT, 0.0, unit))
        + ")"
    )
