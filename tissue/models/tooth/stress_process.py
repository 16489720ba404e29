"""Background computation of the stress in a tooth, in this process or in a separate process.

In one Python process, ticks and stress computations wait for each other, because both need the
interpreter lock. The 99th percentile of these waiting times is almost a millisecond. A separate
process avoids the wait. The separate process receives the removed material and the force of the
bur, and sends its frames at the end of the run.
"""

import os
import pickle
import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kernels.cores import limit_cores
from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from meshes.voxels.volume import VoxelVolume
from tissue.models.bone.bricks import BrickGrid, BrickStore, voxels_of
from tissue.models.tooth.field import SolveRecord, StressField
from tissue.system.child import Helper

ASSEMBLY_S = 3600.0
SOLVE_S = 600.0
"""Longest wait for one stress computation in the other process [s].

`ASSEMBLY_S` limits the wait for the first answer of the process. Both limits are reached only if
the process hangs.
"""


@dataclass(frozen=True, eq=False)
class Drilled:
    """Input of a stress computation: changes of the drilled voxels, and the load.

    Attributes
    ----------
    time_s
        Time of the state [s].
    rows, left
        Rows, in the brick store, of the bricks (blocks of voxels) that lost material since the last
        input, shape (n,). Remaining fractions of the voxels in these bricks, 65535 = full, shape
        (n, 512).
    force_N, point_m
        Force on the tooth [N] and its point of action [m], shape (3,) each.
    """

    time_s: float
    rows: Ints
    left: NDArray[np.uint16]
    force_N: Array
    point_m: Array


@dataclass(frozen=True, eq=False)
class Bricks:
    """Copy of the bricks (blocks of voxels) before the first cut.

    Attributes
    ----------
    places, remaining
        Grid position of each brick, and remaining fraction of its voxels, as in `BrickStore`.
    grid
        Lattice of the bricks.
    """

    places: Ints
    remaining: NDArray[np.uint16]
    grid: BrickGrid

    @classmethod
    def of(cls, store: BrickStore) -> "Bricks":
        """Copy the bricks of a store."""
        return cls(store.places, store.remaining.numpy().copy(), store.grid)


class InlineStressSolver:
    """Stress solver that runs in the caller's process, when `wait` is called.

    Parameters
    ----------
    whole
        The whole tooth in voxels.
    store
        Bricks (blocks) of the finer voxels that are drilled.
    options
        Further arguments of `StressField`.
    """

    def __init__(self, whole: VoxelVolume, store: BrickStore | Bricks, **options: Any) -> None:
        bricks = Bricks.of(store) if isinstance(store, BrickStore) else store
        self.field = StressField(whole, **options)
        self.compliance = self.field.compliance
        self.reference_m = self.field.reference_m
        self.root_guessed = self.field.root_guessed
        self.series = self.field.series
        self.records = self.field.records
        self._places = bricks.places
        self._before = bricks.remaining
        self._grid: dict[str, Any] = {
            "origin_m": bricks.grid.origin_m,
            "spacing_m": bricks.grid.spacing_m,
        }
        self._begun: Drilled | None = None

    @property
    def scheduling(self) -> str:
        """Description of where the stress is computed."""
        return "between the ticks"

    def begin(self, state: Drilled) -> None:
        """Store the input of the next stress computation."""
        self._begun = state

    def wait(self) -> SolveRecord | None:
        """Update the particles from the drilled voxels, and solve for the stress.

        Return None if `begin` was not called.
        """
        state = self._begun
        self._begun = None
        if state is None:
            return None
        lost = self._before[state.rows].astype(np.int64) - state.left
        self._before[state.rows] = state.left
        voxels, steps = voxels_of(self._places, state.rows, lost)
        self.field.remove(voxels, steps, **self._grid)
        self.field.solve(state.time_s, state.force_N, state.point_m)
        return self.records[-1]

    def finish(self) -> None:
        """Complete the stress computation that was begun."""
        self.wait()


class StressProcess:
    """Stress solver in a separate process, at a lower priority than the ticks.

    The parameters are described in `InlineStressSolver`.

    Raises
    ------
    InputError
        If `StressField` rejects the arguments.
    HelperLostError
        If the process ends, is stopped or hangs. `__init__` and every wait for the process may
        raise this error. The computed stresses are then lost.
    """

    def __init__(self, whole: VoxelVolume, store: BrickStore, **options: Any) -> None:
        self._helper = Helper("tissue.models.tooth.stress_process", does="solves the stress")
        self._helper.send((whole, Bricks.of(store), options))
        self.compliance, self.reference_m, self.root_guessed, self.series = self._helper.receive(
            longest_s=ASSEMBLY_S
        )
        self.records: list[SolveRecord] = []
        self._begun = self._finished = False

    @property
    def scheduling(self) -> str:
        """Description of the priority and the cores of the stress computation."""
        return self._helper.priority.described

    def begin(self, state: Drilled) -> None:
        """Send the input of a stress computation to the other process."""
        self._helper.priority.step_back()
        self._helper.send(state)
        self._begun = True

    def wait(self) -> SolveRecord | None:
        """Wait for the stress computation that was begun.

        Return None if `begin` was not called.
        """
        if not self._begun:
            return None
        self._begun = False
        self._helper.priority.hurry()
        self.records.append(self._helper.receive(longest_s=SOLVE_S))
        return self.records[-1]

    def finish(self) -> None:
        """Wait for the stress computation that was begun, fetch all results and end the process."""
        if self._finished:
            return
        self.wait()
        self._finished = True
        self._helper.send(None)
        self.series.frames.extend(self._helper.receive(longest_s=SOLVE_S))
        self._helper.end()


StressSolver = InlineStressSolver | StressProcess
"""Stress solver: a tick begins a computation, and the run waits for its result between ticks."""


def _serve() -> None:
    """Compute the stress for every input from the standard input, until the standard input ends.

    Results are written to the standard output. Nothing else may be written there.
    """
    limit_cores(1)  # the other cores are for the ticks
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)

    def answer(message: object) -> None:
        pickle.dump(message, answers, protocol=5)
        answers.flush()

    try:
        whole, bricks, options = pickle.load(sys.stdin.buffer)
        here = InlineStressSolver(whole, bricks, **options)
        answer(
            (here.compliance, here.reference_m, here.root_guessed, replace(here.series, frames=[]))
        )
        while (sent := pickle.load(sys.stdin.buffer)) is not None:
            here.begin(sent)
            answer(here.wait())
        answer(here.series.frames)
    except (EOFError, BrokenPipeError):
        return  # the process with the ticks ended first
    except InputError as problem:
        answer(problem)
    except Exception as problem:
        answer(RuntimeError(f"the stress could not be solved: {type(problem).__name__}: {problem}"))


if __name__ == "__main__":
    _serve()
