"""Parsing of a file in a separate process.

The parsers of some libraries end their process on a damaged file.

The child runs one named function and sends plain numbers back through a pipe: a line of JSON, then
the bytes of the arrays. It is ended when it takes too long or too much memory, and ends with the
process that started it.
"""

import faulthandler
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from typing import IO, TYPE_CHECKING, Any

from meshes.base.errors import DamagedFileError, InputError
from meshes.base.file_limits import (
    given_limit_GB,
    memory_limit,
    memory_limit_bytes,
    require_regular,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["Answer", "kill_with_parent", "parse_isolated", "python_command", "start_code"]

_DIE_WITH_PARENT = 1
"""PR_SET_PDEATHSIG of Linux."""


def start_code(module: str, function: str) -> str:
    """Return code that calls a function of this checkout.

    The function finds its arguments in `sys.argv[1:]`.
    """
    return (
        f"import sys; sys.path.append(sys.argv.pop(1)); from {module} import {function}; "
        f"{function}()"
    )


def python_command(code: str, *arguments: str) -> list[str]:
    """Return the command that runs `start_code` in another Python; empty if none can be started."""
    if not sys.executable:
        return []
    # -P: a file of the working folder must not stand in for a module of Python.
    return [sys.executable, "-P", "-c", code, str(Path(__file__).resolve().parents[2]), *arguments]


def kill_with_parent() -> None:
    """Make the system kill this process when the thread that started it ends.

    This works on Linux only.
    """
    if sys.platform.startswith("linux"):
        import ctypes
        import signal

        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)


Facts = dict[str, Any]
"""Values that JSON can hold, by name."""
Answer = tuple[Facts, "dict[str, NDArray[np.number]]"]
"""Result of a parser: facts, and arrays by name."""

_START = start_code("meshes.base.isolated_parser", "_serve")
_LONGEST_S = 60.0
_BYTES_A_SECOND = 1_000_000
"""Time that a parser may take [s], and bytes of the file for each further second.

VTK files are read at 2 to 5 MB a second on a busy machine.
"""
_LEAST_BYTES = 2 << 30
_BYTES_A_BYTE = 64
"""Bytes of memory allowed for each byte of the file, at least ``_LEAST_BYTES`` in all.

Label images are compressed to a hundredth.
"""
_LIBRARIES_BYTES = 256 << 20
"""Memory of the interpreter and its libraries.

It does not count against the memory limit of files.
"""
_LOOK_EVERY_S = 0.05
"""Interval at which time and memory of a parser are checked [s].

A process takes some 0.1 GB of memory in it, little against the smallest allowance of 2 GiB.
"""
_LAST_S = 2.0
"""Time that a parser whose pipe has closed has to end, so that its exit code is known [s]."""


def parse_isolated(
    parser: str,
    file: Path,
    *,
    what: str,
    remedy: str,
    longest_s: float | None = None,
    **options: object,
) -> Answer:
    """Run a parser on a file in a separate process.

    Parameters
    ----------
    parser
        ``module:function`` of this checkout. The function takes the path and the options, and
        returns a pair: a dictionary of values that JSON can hold, and a dictionary of arrays. It
        may raise InputError, or DamagedFileError with a description of the damage. Any other
        exception means that the file is damaged; its text is of no use to a user.
    file
        File, or folder of files.
    what, remedy
        Expected kind of file ("VTK surface"), and the instruction for the user if the file is
        another.
    longest_s
        Time limit [s]; None: 60 s and a second for each megabyte.
    options
        Further arguments of the function, values that JSON can hold.

    Returns
    -------
    Result of the function.

    Raises
    ------
    InputError
        If the function raises it, fails, crashes, or takes too long or too much memory.
    """
    if not sys.executable:
        raise InputError(
            "file",
            "be read by a second Python process, which could not be started",
            file.name,
            "read the file with a command of tissue",
        )
    if not file.is_dir():
        require_regular(file)
    size = sum(
        each.stat().st_size
        for each in (file.rglob("*") if file.is_dir() else [file])
        if each.is_file()
    )
    limit_s = longest_s if longest_s is not None else _LONGEST_S + size / _BYTES_A_SECOND
    # The child has no context variables of this process, so the memory limit is sent along.
    request = json.dumps([parser, str(file.absolute()), options, given_limit_GB()])
    command = python_command(_START, request, str(os.getpid()), str(limit_s))
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:
        monitor = _Monitor(process, limit_s, max(_LEAST_BYTES, _BYTES_A_BYTE * size))
        try:
            assert process.stdout is not None
            answer, arrays = _receive(process.stdout)
        except (ValueError, MemoryError) as problem:
            with suppress(subprocess.TimeoutExpired):
                process.wait(_LAST_S)  # its pipe closes before it has ended
            process.kill()
            process.wait()
            reason = monitor.reason or (
                "it takes too much memory" if isinstance(problem, MemoryError) else ""
            )
            reason = reason or f"its parser crashed with exit code {process.returncode}"
            raise InputError(
                "file", f"be a readable {what}", f"{file.name} ({reason})", remedy
            ) from None
        except BaseException:
            process.kill()
            raise
        finally:
            monitor.done.set()
    if "refused" in answer:
        raise InputError(*answer["refused"])
    if "problem" in answer:
        raise InputError(
            "file", f"be a readable {what}", f"{file.name} ({answer['problem']})", remedy
        )
    return answer["facts"], arrays


class _Monitor:
    """Ends a process that takes too long or too much memory; `reason` names which."""

    def __init__(self, process: subprocess.Popen[bytes], longest_s: float, most_bytes: int) -> None:
        import psutil

        self.reason = ""
        self.done = Event()
        most_bytes = min(most_bytes, memory_limit_bytes() + _LIBRARIES_BYTES)

        def end_when_over() -> None:
            """Monitor the process until `done` is set, and kill it if it exceeds a limit.

            The reason for killing it is recorded.
            """
            end = monotonic() + longest_s
            while not self.done.wait(_LOOK_EVERY_S):
                try:
                    taken = psutil.Process(process.pid).memory_info().rss
                except psutil.Error:
                    return  # it has ended
                if monotonic() > end:
                    self.reason = f"its parser took longer than {longest_s:g} s"
                elif taken > most_bytes:
                    self.reason = (
                        f"its parser took more than {most_bytes / 2**30:.2g} GiB of memory"
                    )
                if self.reason:
                    process.kill()
                    return

        Thread(target=end_when_over, daemon=True).start()


def _receive(answers: IO[bytes]) -> Answer:
    """Return the child's answer; raise ValueError if it is incomplete."""
    import numpy as np

    answer: Facts = json.loads(answers.readline() or b"{")
    arrays = {}
    for name, kind, shape in answer.get("arrays", ()):
        array = np.empty(shape, dtype=np.dtype(kind))
        if array.dtype.hasobject:
            raise ValueError(kind)
        if array.size and answers.readinto(array.reshape(-1).view(np.uint8).data) != array.nbytes:  # type: ignore[attr-defined]
            raise ValueError(name)
        arrays[name] = array
    return answer, arrays


def _serve() -> None:
    """Parse the file named on the command line in this child process.

    The answer goes to the standard output.
    """
    import numpy as np

    request, parent, limit_s = sys.argv[1:]
    # A parent that lives ends this process at limit_s. Twice as late it ends itself: its parent has
    # died, and only Linux kills it with its parent.
    faulthandler.dump_traceback_later(2.0 * float(limit_s), exit=True)
    kill_with_parent()
    # The parent died before the call above, which then has no effect.
    if sys.platform.startswith("linux") and os.getppid() != int(parent):
        return
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # discards the output of the libraries
    name, file, options, max_memory_GB = json.loads(request)
    module, function = name.split(":")
    arrays: Mapping[str, NDArray[np.number]] = {}
    try:
        with memory_limit(max_memory_GB):
            facts, arrays = getattr(import_module(module), function)(Path(file), **options)
        arrays = {key: np.ascontiguousarray(array) for key, array in arrays.items()}
        answer = {
            "facts": facts,
            "arrays": [(key, each.dtype.str, each.shape) for key, each in arrays.items()],
        }
    except InputError as problem:
        answer = {"refused": [str(field) for field in problem.args]}
    except DamagedFileError as problem:
        # One line, cut off because it may quote the damaged content of the file.
        answer = {"problem": " ".join(str(problem).split())[:160]}
    except Exception:  # the libraries raise many kinds, none documented
        answer = {"problem": "it is damaged or cut off"}
        arrays = {}
    answers.write(json.dumps(answer).encode() + b"\n")
    for array in arrays.values():
        if array.size:
            answers.write(array.reshape(-1).view(np.uint8).data)
    answers.flush()
    os._exit(0)  # a library damaged by the file must not hang while it is taken down
