"""Sparse voxel store: only bricks (blocks of 8 x 8 x 8 voxels) that hold bone are stored."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.bone_lookup import BEYOND, SURFACE_STEPS
from kernels.bricks import BRICK, BRICK_VOXELS, FULL, LOST, REACHED, Bricks
from kernels.mirror import filled, put
from meshes.base.arrays import Array, Bytes, Flags, Ints
from meshes.base.errors import InputError
from meshes.voxels.distances import OUTSIDE, near_the_surface
from meshes.voxels.volume import VoxelVolume

BYTES_PER_VOXEL = 14
"""Bytes stored per voxel of a brick.

Each of the arrays `remaining`, `swept`, `middle`, `older` and `nearby` takes 2 bytes. The array
`material` takes 4 bytes.
"""
NEVER_SWEPT = 65535
"""Stored value of `swept`, `middle` and `older` for a voxel that the tool has never reached."""
STORED_RATIO = FULL // 255
"""Value of a full voxel in the store (65535) divided by its value in a voxel volume (255)."""
CHANGED = ("remaining", "swept", "middle", "older", "alive")
"""Names of the arrays of `BrickStore` that carving reads and changes."""


@dataclass(frozen=True, eq=False)
class BrickGrid:
    """Lattice of bricks (blocks of voxels) that covers a bone.

    A lattice position may be empty.

    Attributes
    ----------
    origin_m
        Corner of the first brick [m], shape (3,): the corner with the lowest coordinates.
    spacing_m
        Edge length of a voxel [m].
    counts
        Number of bricks along x, y and z.
    layer_names
        Name of each layer.
    """

    origin_m: Array
    spacing_m: float
    counts: tuple[int, ...]
    layer_names: tuple[str, ...]

    def agrees(self, other: "BrickGrid") -> bool:
        """Return True if each brick position refers to the same point in space on both lattices."""
        return (
            self.spacing_m == other.spacing_m
            and self.counts == other.counts
            and np.array_equal(self.origin_m, other.origin_m)
        )


@dataclass(frozen=True, eq=False)
class BrickState:
    """Copy of the bricks that a tool has reached since the last call of `BrickStore.keep_base`.

    Attributes
    ----------
    grid
        Lattice on which the bricks lie.
    places
        Grid position of each copied brick, shape (n, 3).
    rows
        Dictionary with the values of the copied bricks. The keys are the names of the arrays that
        carving changes.
    flags
        Flags of the copied bricks, see `BrickStore.touched`.
    """

    grid: BrickGrid
    places: Ints
    rows: dict[str, NDArray[Any]]
    flags: Bytes


class BrickStore:
    """Voxels on a device, in the layout of :mod:`kernels.bricks`.

    The voxels come from one volume (`from_volume`), or from volumes added one by one (`add`).

    Parameters
    ----------
    grid
        Lattice of the bricks.
    device
        Warp device name.

    Attributes
    ----------
    grid
        Lattice of the bricks.
    volume
        Volume from which the store was made. Its filled fractions are those before any cut. None if
        the store was filled by `add`.
    start_steps
        Sum of `remaining` over each layer's voxels before any cut, shape (layers,).
    brick_of
        Brick row at each grid position, int32, shape (bx, by, bz), -1 where empty.
    remaining
        Filled fraction of each voxel as uint16 (65535 is full), shape (capacity, 512).
    swept
        Distance from each voxel's centre to the region that the tool has swept, uint16, shape
        (capacity, 512).
    middle
        Copy of `swept`, made at the last update of `older`, uint16, shape (capacity, 512). Each
        block of 2 x 2 x 2 voxels is updated separately, see `kernels.carving`.
    older
        Distance from each voxel's centre to the region swept by older cuts, uint16, shape
        (capacity, 512). Older cuts are all cuts except the most recent cuts, see `kernels.carving`.
    material
        Density and layer before any cut, packed in one word, uint32, shape (capacity, 512).
    nearby
        Distances of each voxel to the original surface and to the nearest boundary between layers,
        packed in one word, uint16, shape (capacity, 512).
    alive
        Array with a bit for each block of 2 x 2 x 2 voxels, uint64, shape (capacity,). A bit is 1
        if the block may hold bone or lies within two voxels of bone.
    touched
        Bit flags of each brick, uint8, shape (capacity,). `kernels.bricks.LOST` is set if the brick
        lost material since the last call of `take_touched`. `kernels.bricks.REACHED` is set if a
        tool came near the brick since the last call of `keep_base`.
    places
        Grid position of each stored brick, shape (bricks, 3).
    """

    def __init__(self, grid: BrickGrid, *, device: str) -> None:
        self.grid = grid
        self.volume: VoxelVolume | None = None
        self.start_steps = np.zeros(len(grid.layer_names), np.int64)
        self.places: Ints = np.zeros((0, 3), np.int64)
        self.brick_of: Any = wp.full(grid.counts, -1, dtype=wp.int32, device=device)
        self._device = device
        self.remaining: Any = wp.empty((0, BRICK_VOXELS), wp.uint16, device)
        self.swept, self.middle, self.older, self.nearby = (
            wp.empty_like(self.remaining) for _ in range(4)
        )
        self.material: Any = wp.empty((0, BRICK_VOXELS), wp.uint32, device)
        self.alive: Any = wp.empty(0, wp.uint64, device)
        self.touched: Any = wp.empty(0, wp.uint8, device)
        self._base: dict[str, NDArray[Any]] | None = None
        self._owner: object = None

    @classmethod
    def from_volume(cls, volume: VoxelVolume, *, device: str) -> "BrickStore":
        """Return a store on ``device`` with the bricks of ``volume`` that contain bone."""
        counts = tuple(-(-n // BRICK) for n in volume.shape)
        grid = BrickGrid(volume.origin_m, volume.spacing_m, counts, volume.layer_names)
        store = cls(grid, device=device)
        store.add(volume, at=(0, 0, 0))
        store.volume = volume
        return store

    def add(self, volume: VoxelVolume, *, at: tuple[int, int, int], margin: int = 0) -> bool:
        """Store the bricks of a volume at grid positions where no brick is stored yet.

        Parameters
        ----------
        volume
            Voxels with the spacing and the layers of the grid.
        at
            Position of the volume's first brick on the grid.
        margin
            Number of outer brick layers at each face of the volume that are not stored. These
            layers only provide the bone beyond the stored bricks.

        Returns
        -------
        True if the device arrays were replaced. The caller must then record the kernel launches
        again.
        """
        counts = tuple(-(-n // BRICK) for n in volume.shape)
        surface, layer, density, boundary = near_the_surface(volume)
        # `_blocked` pads with zeros, and the padding must be outside: `OUTSIDE` minus the distance
        # is padded.
        near = _blocked(OUTSIDE - surface, counts)
        holds: Flags = np.asarray(
            _blocked(volume.fraction, counts).any(axis=(1, 3, 5)) | near.any(axis=(1, 3, 5))
        )
        inner = tuple(slice(margin, n - margin) for n in counts)
        kept = np.zeros_like(holds)
        kept[inner] = holds[inner]
        first = len(self.places)
        if first == 0 and not kept.any():
            kept[inner][0, 0, 0] = True  # the kernels need at least one brick

        def stored(array: NDArray[Any]) -> NDArray[Any]:
            return _rows(_blocked(array, counts).transpose(0, 2, 4, 1, 3, 5)[kept])

        places = np.argwhere(kept)
        if len(places) == 0:
            return False
        fraction = stored(volume.fraction)
        stored_surface = stored(_filled_up(surface, counts))
        blocks = (fraction.astype(bool) | (stored_surface < OUTSIDE)).reshape(-1, 64, 8).any(axis=2)
        layers = stored(layer)
        # Density and layer share one word, so that reading both takes one cache line instead of
        # two.
        material = stored(density).astype(np.uint32) << np.uint32(16)
        material |= layers
        nearby = stored(boundary).astype(np.uint16) << np.uint16(8) | stored_surface
        alive = np.packbits(blocks, axis=1, bitorder="little").view("<u8").reshape(-1)
        never = np.full(fraction.shape, NEVER_SWEPT, dtype=np.uint16)
        filled = fraction.astype(np.uint16) * np.uint16(STORED_RATIO)
        rows = {
            "remaining": filled,
            "swept": never,
            "middle": never,
            "older": never,
            "material": material,
            "nearby": nearby,
            "alive": alive,
            "touched": np.zeros(len(alive), np.uint8),
        }
        grown = self._append(rows)
        if self._base is not None:
            self._base = {
                name: np.concatenate([old, rows[name]]) for name, old in self._base.items()
            }
        self.places = np.concatenate([self.places, places + np.array(at)])
        brick_of = self.brick_of.numpy()
        brick_of[tuple(self.places[first:].T)] = np.arange(first, len(self.places), dtype=np.int32)
        self.brick_of.assign(brick_of)
        for index in range(len(self.start_steps)):
            self.start_steps[index] += filled[layers == index].sum(dtype=np.int64)
        return grown

    def _append(self, rows: dict[str, NDArray[Any]]) -> bool:
        """Append rows to the arrays, and return True if the arrays had to grow.

        For the first rows, the arrays get exactly the needed length. Later they grow to twice the
        needed length.
        """
        first = len(self.places)
        last = first + len(rows["alive"])
        grows = last > len(self.alive)
        length = last if first == 0 else 2 * last
        for name, values in rows.items():
            old = getattr(self, name)
            if grows:
                new = wp.zeros((length, *values.shape[1:]), old.dtype, self._device)
                if first:
                    wp.copy(new[:first], old[:first])
                setattr(self, name, new)
            wp.copy(getattr(self, name)[first:last], put(values, old.dtype, self._device))
        return grows

    @property
    def on_device(self) -> Any:
        """Present device arrays of the store, for kernels."""
        arrays = {name: getattr(self, name) for name in Bricks.__annotations__}
        return filled(Bricks, self._device, **arrays)

    def take_touched(self) -> tuple[Ints, NDArray[np.uint16]]:
        """Return row numbers and voxel fractions of bricks that lost material since the last call.

        The cost is proportional to the number of these bricks, which is small in one tick.
        """
        flags = self.touched.numpy()
        rows = np.flatnonzero(flags[: len(self.places)] & LOST)
        flags[rows] &= REACHED
        self._send("touched", flags)
        return rows, self.remaining.numpy()[rows]

    def _send(self, name: str, host: NDArray[Any]) -> None:
        """Send an array that was changed on the host to the device.

        On a CPU, host and device share their memory.
        """
        array = getattr(self, name)
        if not array.device.is_cpu:
            array.assign(host)

    def begin(self, owner: object) -> None:
        """Allow only the cutter ``owner`` to copy and restore states.

        The next call of `state` stores a new base, see `keep_base`.
        """
        self._owner = owner
        self._base = None

    def _require_owner(self, owner: object) -> None:
        """Raise an error if another cutter has called `begin` after this cutter.

        Copied states are then not valid, because the other cutter may have cut the bone.
        """
        if self._owner is not owner:
            raise InputError(
                "bone",
                "be used by no later tool when its state is copied or restored",
                "a later tool",
                "make a bone for each loop, for example by bone.uncut()",
            )

    def keep_base(self) -> None:
        """Store a copy of the present bricks as the base to which later states refer.

        A state stores only the bricks that a tool has reached since the base was stored.
        """
        count = len(self.places)
        self._base = {name: getattr(self, name).numpy()[:count].copy() for name in CHANGED}
        flags = self.touched.numpy()
        flags &= LOST
        self._send("touched", flags)

    def state(self, owner: object) -> BrickState:
        """Return a copy of the bricks that a cutter has reached since the base was stored.

        The first call stores the base, see `keep_base`. The cost is proportional to the number of
        copied bricks.

        Raises
        ------
        InputError
            If another cutter has called `begin` after this cutter.
        """
        self._require_owner(owner)
        if self._base is None:
            self.keep_base()
        flags = self.touched.numpy()[: len(self.places)]
        rows = np.flatnonzero(flags & REACHED)
        changed = {name: getattr(self, name).numpy()[rows] for name in CHANGED}
        return BrickState(self.grid, self.places[rows], changed, flags[rows])

    def restore(self, state: BrickState, owner: object) -> None:
        """Restore a state that `state` has returned.

        Raises
        ------
        InputError
            If another cutter has called `begin` after this cutter, if the state belongs to another
            lattice, or if the state has bricks that this store does not hold.
        """
        self._require_owner(owner)
        if not self.grid.agrees(state.grid):
            raise InputError(
                "snapshot",
                f"be of the same region in voxels of {1e3 * self.grid.spacing_m:g} mm",
                f"another region or voxels of {1e3 * state.grid.spacing_m:g} mm",
                "make both loops from equal arguments",
            )
        assert self._base is not None, "a state was copied before"
        rows = self.brick_of.numpy()[tuple(state.places.T)]
        if (rows < 0).any():
            raise InputError(
                "snapshot",
                "lie within the bone that this loop has prepared",
                f"a snapshot with {int((rows < 0).sum())} further blocks of voxels",
                "use a larger reach_mm in both loops",
            )
        flags = self.touched.numpy()
        before = np.flatnonzero(flags[: len(self.places)] & REACHED)
        reset = np.setdiff1d(before, rows, assume_unique=True)
        for name, changed in state.rows.items():
            host = getattr(self, name).numpy()
            host[reset] = self._base[name][reset]
            host[rows] = changed
            self._send(name, host)
        flags[before] &= LOST
        flags[rows] |= state.flags
        self._send("touched", flags)

    def write_fraction(self, fraction: Bytes, rows: Ints) -> None:
        """Write the remaining fractions of the voxels in some bricks into `fraction` (255 is full).

        `fraction` has the shape of the volume. `rows` holds the row numbers of the bricks.
        """
        bricks = _bricks(_nearest(self.remaining.numpy()[rows]))
        for (x, y, z), brick in zip(BRICK * self.places[rows], bricks, strict=True):
            part = fraction[x : x + BRICK, y : y + BRICK, z : z + BRICK]
            part[:] = brick[: part.shape[0], : part.shape[1], : part.shape[2]]

    def fraction(self) -> Bytes:
        """Return the remaining fraction of every voxel of the grid (255 is full).

        If the store was made from a volume, the array has the shape of the volume.
        """
        whole = self.part((0, 0, 0), self.grid.counts)
        if self.volume is None:
            return whole
        return np.ascontiguousarray(whole[tuple(map(slice, self.volume.shape))])

    def part(self, first: tuple[int, ...], last: tuple[int, ...]) -> Bytes:
        """Return the remaining fraction of every voxel in a box of bricks (255 is full).

        The fraction is 0 where no brick is stored.

        Parameters
        ----------
        first, last
            Grid position of the box's first brick, and grid position one beyond its last brick
            along each axis.
        """
        brick_of = self.brick_of.numpy()[tuple(map(slice, first, last))]
        nx, ny, nz = (BRICK * n for n in brick_of.shape)
        dense = np.zeros((*brick_of.shape, BRICK, BRICK, BRICK), np.uint8)
        held = brick_of >= 0
        dense[held] = _bricks(_nearest(self.remaining.numpy()[brick_of[held]]))
        return np.ascontiguousarray(dense.transpose(0, 3, 1, 4, 2, 5).reshape(nx, ny, nz))

    def steps_by_layer(self) -> Ints:
        """Return the sum of `remaining` over the voxels of each layer, shape (layers,)."""
        count = len(self.places)
        remaining = self.remaining.numpy()[:count]
        # The lower byte of a word is the layer.
        layer = self.material.numpy()[:count].astype(np.uint8)
        return np.array(
            [remaining[layer == k].sum(dtype=np.int64) for k in range(len(self.grid.layer_names))]
        )


def voxels_of(places: Ints, rows: Ints, steps: Ints) -> tuple[Ints, Ints]:
    """Return the grid indices and the values of the voxels whose values are not 0.

    ``steps`` holds the values of the voxels in some bricks, shape (bricks, 512). ``rows`` holds the
    row numbers of these bricks in the store. ``places`` holds the grid positions of all bricks of
    the store. The returned indices have shape (n, 3).
    """
    row, column = np.nonzero(steps)
    # A row holds block after block, see `_rows`.
    block = column >> 3
    corner = column & 7
    inside = np.stack([block >> 4, (block >> 2) & 3, block & 3], axis=1) * 2
    inside += np.stack([corner >> 2, (corner >> 1) & 1, corner & 1], axis=1)
    return BRICK * places[rows[row]] + inside, steps[row, column]


def _nearest(remaining: NDArray[np.uint16]) -> Bytes:
    """Convert stored 16-bit fractions to 8-bit fractions, with rounding."""
    return (
        (remaining.astype(np.uint32) + np.uint32(STORED_RATIO // 2)) // np.uint32(STORED_RATIO)
    ).astype(np.uint8)


def _filled_up(surface: Bytes, counts: tuple[int, ...]) -> Bytes:
    """Return the stored distances to the surface, padded to whole bricks.

    The distance at a padded voxel is the distance at the nearest voxel of the volume plus one
    voxel. Padded voxels are always outside the bone.
    """
    pad = [(0, BRICK * count - n) for count, n in zip(counts, surface.shape, strict=True)]
    padded = np.pad(surface, pad, mode="edge")
    for axis, n in enumerate(surface.shape):
        part = np.moveaxis(padded, axis, 0)[n:]
        part[:] = np.clip(part.astype(np.int64) + SURFACE_STEPS, BEYOND, OUTSIDE)
    return padded


def _blocked(array: NDArray[Any], counts: tuple[int, ...]) -> NDArray[Any]:
    """Return a view of an array, padded to whole bricks, with axes (bx, 8, by, 8, bz, 8)."""
    pad = [(0, BRICK * count - n) for count, n in zip(counts, array.shape, strict=True)]
    padded = np.pad(array, pad) if any(after for _, after in pad) else array
    bx, by, bz = counts
    return padded.reshape(bx, BRICK, by, BRICK, bz, BRICK)


def _rows(bricks: NDArray[Any]) -> NDArray[Any]:
    """Convert bricks, shape (n, 8, 8, 8), to stored rows, shape (n, 512), block after block."""
    return (
        bricks.reshape(-1, 4, 2, 4, 2, 4, 2)
        .transpose(0, 1, 3, 5, 2, 4, 6)
        .reshape(-1, BRICK_VOXELS)
    )


def _bricks(rows: NDArray[Any]) -> NDArray[Any]:
    """Convert stored rows, shape (n, 512), to bricks, shape (n, 8, 8, 8)."""
    return (
        rows.reshape(-1, 4, 4, 4, 2, 2, 2)
        .transpose(0, 1, 4, 2, 5, 3, 6)
        .reshape(-1, BRICK, BRICK, BRICK)
    )
