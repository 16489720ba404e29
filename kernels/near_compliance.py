"""Copy of the compliance matrix for the nodes near a tool, in consecutive memory.

Each node near the tool has a slot. Nodes that may carry load (loaded nodes) have the first slots. A
loaded node also has three rows, one for each component of its force. A row holds the displacements
of the nodes in all slots due to a unit force, slot by slot. The displacements due to a change of
force are therefore computed from consecutive memory, which is read in packs of numbers. In the full
compliance matrix, in contrast, the three rows of each 3 x 3 block lie far apart. In each tick (1 ms
step), entries are copied only for nodes that are newly near the tool or newly loaded.
"""

import numpy as np
import warp as wp

from kernels.arrays import Doubles, Doubles2D, Int32s
from kernels.contact_state import Body, block

wp.set_module_options({"max_unroll": 1})

LANES = 16
"""Number of values in a pack. All values of a pack are read at once.

Reading a block of nine numbers takes 0.7 ns with packs of 16 numbers, 1.0 ns with packs of 8, and
0.8 ns with packs of 32. Reading the block from the full compliance takes 3.9 ns.
"""
Pack = wp.types.vector(length=LANES, dtype=wp.float64)


SLOTS, LOADED, STALE = 0, 1, 2
"""Indices into the counts of `Patch`.

The counts are: number of used slots, number of slots of loaded nodes, and a flag that is 1 if all
rows must be copied again.
"""


@wp.struct
class Patch:
    """Nodes near the tool, and the compliance between these nodes."""

    count: Int32s  # [3], see SLOTS
    node: Int32s  # [slot]
    slot: Int32s  # [node], -1 without a slot
    near_mark: Int32s  # [node], last tick in which the node was near the tool
    loaded_mark: Int32s  # [node], last tick in which the node was loaded
    row: Doubles2D  # [3 loaded slot, 3 slot], with scale [m/N]
    row_packs: wp.array2d(dtype=Pack)  # the same memory
    moved: Doubles  # [3 slot], displacement [m]
    moved_packs: wp.array(dtype=Pack)  # the same memory


@wp.func
def moved_at(patch: Patch, slot: int):
    """Return the displacement [m] of the node in the given slot."""
    return wp.vec3d(patch.moved[3 * slot], patch.moved[3 * slot + 1], patch.moved[3 * slot + 2])


@wp.func
def push(patch: Patch, slot: int, change: wp.vec3d, slots: int):
    """Add the displacements due to a ``change`` of force [N] on the loaded node at ``slot``.

    The displacements of the nodes in the first ``slots`` slots are updated.
    """
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
    """Recompute the displacements, under all loads, of the nodes in the first ``slots`` slots.

    The recomputation removes rounding errors, which accumulate when only changes are added.
    """
    for p in range((3 * slots + LANES - 1) // LANES):
        patch.moved_packs[p] = Pack()
    for k in range(patch.count[LOADED]):
        push(patch, k, body.force[patch.node[k]], slots)


@wp.func
def gather(body: Body, patch: Patch, loaded: int, slot: int):
    """Copy the compliance between the nodes of two slots into the rows of slot ``loaded``."""
    between = block(body, patch.node[loaded], patch.node[slot])
    for i in range(3):
        for j in range(3):
            patch.row[3 * loaded + i, 3 * slot + j] = between[i, j]


@wp.func
def gather_again(body: Body, patch: Patch):
    """Copy all compliance rows again, because the compliance has changed."""
    patch.count[STALE] = 0
    for loaded in range(patch.count[LOADED]):
        for slot in range(patch.count[SLOTS]):
            gather(body, patch, loaded, slot)


@wp.func
def swap(patch: Patch, p: int, q: int):
    """Exchange the nodes of the slots ``p`` and ``q`` in the copied compliance.

    In each row, the entries of the two slots are exchanged. The rows that belong to the two nodes
    are not exchanged.
    """
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
    """Assign a slot to a node that is newly near the tool."""
    slot = patch.count[SLOTS]
    patch.count[SLOTS] = slot + 1
    patch.node[slot] = node
    patch.slot[node] = slot
    for loaded in range(patch.count[LOADED]):
        gather(body, patch, loaded, slot)


@wp.func
def drop_left(patch: Patch, tick: int):
    """Free the slots of unloaded nodes that are no longer near the tool."""
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
    """Mark a node as loaded in this tick.

    If the node was not loaded before, three rows of the copied compliance are assigned to it.
    """
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
    """Free the compliance rows of nodes that are not loaded in this tick."""
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
    """Return an empty patch with memory for all ``nodes`` of a body.

    On a CPU, physical memory is used only for nodes near the tool, because zeros from NumPy take no
    physical memory until they are overwritten.
    """
    # The length is odd, because rows a multiple of a page apart would use the same cache lines.
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
    """Request a new copy of all rows in the next tick. Call this after scaling the compliance."""
    count = patch.count.numpy()
    count[STALE] = 1
    patch.count.assign(count)
