"""Compliance of the nodes near a tool, gathered side by side and kept while they stay near.

Each node nearby has a slot. Nodes that may carry load have the first slots, and a row for each of
their three components. A row holds the displacements of all slots for a unit force, slot by slot. A
change of force is thus added to all displacements in packs of numbers that follow each other in
memory. Read from the compliance itself, each of the same blocks lies in three other places. A tick
gathers only the nodes that came near or began to work.
"""

import numpy as np
import warp as wp

from kernels.contact_state import Body, block

__all__ = [
    "LANES",
    "LOADED",
    "SLOTS",
    "STALE",
    "Pack",
    "Patch",
    "add_node",
    "drop_idle",
    "drop_left",
    "gather_again",
    "gather_all_again",
    "keep_loaded",
    "move_all",
    "moved_at",
    "new_patch",
    "push",
]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

LANES = 16
"""Numbers in a pack.

A block of nine takes 0.7 ns with 16, against 1.0 ns with 8, 0.8 ns with 32 and 3.9 ns straight from
the compliance.
"""
Pack = wp.types.vector(length=LANES, dtype=wp.float64)


SLOTS, LOADED, STALE = 0, 1, 2
"""Places in the counts of `Patch`: slots, those loaded, and 1 where rows must be gathered again."""


@wp.struct
class Patch:
    """Nodes near the tool, s at most."""

    count: wp.array(dtype=wp.int32)  # [3], see SLOTS
    node: wp.array(dtype=wp.int32)  # [slot]
    slot: wp.array(dtype=wp.int32)  # [node], -1 for none
    near_mark: wp.array(dtype=wp.int32)  # [node], tick in which it was nearby
    loaded_mark: wp.array(dtype=wp.int32)  # [node], tick in which it was loaded
    row: wp.array2d(dtype=wp.float64)  # [3 loaded slot, 3 slot], with scale [m/N]
    row_packs: wp.array2d(dtype=Pack)  # the same memory
    moved: wp.array(dtype=wp.float64)  # [3 slot], displacement [m]
    moved_packs: wp.array(dtype=Pack)  # the same memory


@wp.func
def moved_at(patch: Patch, slot: int):
    """Return the displacement of a slot [m]."""
    return wp.vec3d(patch.moved[3 * slot], patch.moved[3 * slot + 1], patch.moved[3 * slot + 2])


@wp.func
def push(patch: Patch, slot: int, change: wp.vec3d, slots: int):
    """Move the first slots by a change of force on a loaded one."""
    row = 3 * slot
    for p in range((3 * slots + LANES - 1) // LANES):
        patch.moved_packs[p] = (
            patch.moved_packs[p]
            + patch.row_packs[row, p] * change[0]
            + patch.row_packs[row + 1, p] * change[1]
            + patch.row_packs[row + 2, p] * change[2]
        )


@wp.func
def move_all(body: Body, patch: Patch, slots: int):
    """Compute the displacements of the first slots under all loads, afresh.

    Sums of changes would keep their rounding errors.
    """
    for p in range((3 * slots + LANES - 1) // LANES):
        patch.moved_packs[p] = Pack()
    for k in range(patch.count[LOADED]):
        push(patch, k, body.force[patch.node[k]], slots)


@wp.func
def gather(body: Body, patch: Patch, loaded: int, slot: int):
    """Copy a block of the compliance to its place.

    A block that is not available yet is looked for again in the next tick.
    """
    between = block(body, patch.node[loaded], patch.node[slot])
    for i in range(3):
        for j in range(3):
            patch.row[3 * loaded + i, 3 * slot + j] = between[i, j]
    if not wp.isfinite(between[0, 0] + between[1, 1] + between[2, 2]):
        patch.count[STALE] = 1


@wp.func
def gather_again(body: Body, patch: Patch):
    """Gather all rows again, after the compliance was scaled or where some of it was missing."""
    patch.count[STALE] = 0
    for loaded in range(patch.count[LOADED]):
        for slot in range(patch.count[SLOTS]):
            gather(body, patch, loaded, slot)


@wp.func
def swap(patch: Patch, p: int, q: int):
    """Exchange two slots; their rows stay."""
    first = patch.node[p]
    second = patch.node[q]
    patch.node[p] = second
    patch.node[q] = first
    patch.slot[second] = p
    patch.slot[first] = q
    for j in range(3):
        shift = patch.moved[3 * p + j]
        patch.moved[3 * p + j] = patch.moved[3 * q + j]
        patch.moved[3 * q + j] = shift
    for row in range(3 * patch.count[LOADED]):
        for j in range(3):
            entry = patch.row[row, 3 * p + j]
            patch.row[row, 3 * p + j] = patch.row[row, 3 * q + j]
            patch.row[row, 3 * q + j] = entry


@wp.func
def add_node(body: Body, patch: Patch, node: int):
    """Give a node that came near a slot."""
    slot = patch.count[SLOTS]
    patch.count[SLOTS] = slot + 1
    patch.node[slot] = node
    patch.slot[node] = slot
    for loaded in range(patch.count[LOADED]):
        gather(body, patch, loaded, slot)


@wp.func
def drop_left(patch: Patch, tick: int):
    """Free the slots of nodes that are no longer nearby; none of them carries load."""
    slot = patch.count[SLOTS] - 1
    while slot >= patch.count[LOADED]:
        node = patch.node[slot]
        if patch.near_mark[node] != tick:
            last = patch.count[SLOTS] - 1
            if slot != last:
                swap(patch, slot, last)
            patch.slot[node] = -1
            patch.count[SLOTS] = last
        slot -= 1


@wp.func
def keep_loaded(body: Body, patch: Patch, node: int, tick: int):
    """Let a node carry load in this tick; it gets one of the first slots, and rows."""
    patch.loaded_mark[node] = tick
    loaded = patch.count[LOADED]
    slot = patch.slot[node]
    if slot >= loaded:
        if slot != loaded:
            swap(patch, slot, loaded)
        patch.count[LOADED] = loaded + 1
        for other in range(patch.count[SLOTS]):
            gather(body, patch, loaded, other)


@wp.func
def drop_idle(patch: Patch, tick: int):
    """Free the rows of nodes that are not loaded in this tick."""
    slot = patch.count[LOADED] - 1
    while slot >= 0:
        if patch.loaded_mark[patch.node[slot]] != tick:
            last = patch.count[LOADED] - 1
            if slot != last:
                swap(patch, slot, last)
                for p in range((3 * patch.count[SLOTS] + LANES - 1) // LANES):
                    for j in range(3):
                        patch.row_packs[3 * slot + j, p] = patch.row_packs[3 * last + j, p]
            patch.count[LOADED] = last
        slot -= 1


def new_patch(nodes: int, device: str) -> Patch:
    """Return a patch with space for all of a body's nodes.

    On a CPU the patch takes memory only for the nodes near the tool, because NumPy allocates no
    memory for zeros until they are written.
    """
    # odd: rows whole pages apart would share their places in a cache
    packs = -(-3 * nodes // LANES) | 1
    patch = Patch()
    rows = np.zeros((3 * nodes, LANES * packs))
    patch.row = wp.array(rows, dtype=wp.float64, device=device, copy=device != "cpu")
    patch.moved = wp.zeros(LANES * packs, dtype=wp.float64, device=device)
    patch.row_packs = wp.array(
        ptr=patch.row.ptr, dtype=Pack, shape=(3 * nodes, packs), device=device
    )
    patch.moved_packs = wp.array(ptr=patch.moved.ptr, dtype=Pack, shape=packs, device=device)
    patch.count = wp.zeros(3, dtype=wp.int32, device=device)
    patch.slot = wp.full(nodes, -1, dtype=wp.int32, device=device)
    for name in ("node", "near_mark", "loaded_mark"):
        setattr(patch, name, wp.zeros(nodes, dtype=wp.int32, device=device))
    return patch


def gather_all_again(patch: Patch) -> None:
    """Request that all rows are read again in the next tick, after the compliance was scaled."""
    count = patch.count.numpy()
    count[STALE] = 1
    patch.count.assign(count)
