"""Parsing of a file in a separate process.

Some libraries terminate the process when they parse a damaged file.

The child process runs one function and returns its results through a pipe, as a line of JSON and
the bytes of arrays. The child process is killed if it takes too long or uses too much memory, or
when the process that started it ends.
"""

import faulthandler
import json
import os
import subprocess
import sys
from contextlib import suppress
from importlib import import_module
from io import BytesIO
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

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

_DIE_WITH_PARENT = 1
"""Value of PR_SET_PDEATHSIG on Linux."""


def start_code(module: str, function: str) -> str:
    """Return Python code that imports a function from this copy of the source code and calls it.

    The function reads its arguments from `sys.argv[1:]`.
    """
    return (
        f"import sys; sys.path.append(sys.argv.pop(1)); from {module} import {function}; "
        f"{function}()"
    )


def python_command(code: str, *arguments: str) -> list[str]:
    """Return the command that runs code from `start_code` in a new process, or an empty list.

    The list is empty if no Python process can be started.
    """
    if not sys.executable:
        return []
    # -P: a file in the working folder must not replace a module of Python.
    return [sys.executable, "-P", "-c", code, str(Path(__file__).resolve().parents[2]), *arguments]


def kill_with_parent() -> None:
    """Request that the system kills this process when the thread that started it ends.

    This works on Linux only.
    """
    if sys.platform.startswith("linux"):
        import ctypes
        import signal

        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)


Facts = dict[str, Any]
"""Dictionary from names to values that JSON can represent."""
Answer = tuple[Facts, "dict[str, NDArray[np.number]]"]
"""Result of a parser: a dictionary of values, and a dictionary of arrays."""

_START = start_code("meshes.base.isolated_parser", "_serve")
_LONGEST_S = 60.0
_BYTES_A_SECOND = 1_000_000
"""File size [byte] that adds one second to the time limit `_LONGEST_S` of a parser.

On a busy machine, VTK files are read at 2 to 5 MB per second.
"""
_LEAST_BYTES = 2 << 30
_BYTES_A_BYTE = 64
"""Allowed memory per byte of the file [byte]. The total is at least ``_LEAST_BYTES``.

The factor is large, because a compressed label image may be many times smaller than its content.
"""
_LIBRARIES_BYTES = 256 << 20
"""Memory of the Python interpreter and its libraries [byte].

The memory limit for a file's content does not include this memory.
"""
_LOOK_EVERY_S = 0.05
"""Interval [s] at which the elapsed time and the memory of a parser are checked.

In this interval, a process can allocate about 0.1 GB. This is little compared with the smallest
memory limit, 2 GiB.
"""


def parse_isolated(
    parser: str,
    file: Path,
    *,
    what: str,
    remedy: str,
    **options: object,
) -> Answer:
    """Run a parser on a file in a separate process.

    Parameters
    ----------
    parser
        Name of a function of this package, written as ``module:function``. The function takes the
        path and the options, and returns a pair: a dictionary of values that JSON can represent,
        and a dictionary of arrays. The function may raise InputError, or DamagedFileError with a
        description of the damage. Any other exception means that the file is damaged. The text of
        such an exception is not shown to the user.
    file
        File, or folder of files.
    what, remedy
        Expected kind of file, such as "VTK surface", and instruction for the user if the kind
        differs. Both are used in messages.
    options
        Further arguments of the function. JSON must be able to represent them.

    Returns
    -------
    Result of the function.

    Raises
    ------
    InputError
        If the function raises an InputError, fails, crashes, uses too much memory, or takes longer
        than 60 s plus one second per megabyte.
    """
    if not sys.executable:
        raise InputError(
            "file",
            "be read in a separate Python process",
            f"{file.name}, but sys.executable is empty, so that Python cannot be started",
            "read the file with a `tissue` command",
        )
    if not file.is_dir():
        require_regular(file)
    size = sum(
        each.stat().st_size
        for each in (file.rglob("*") if file.is_dir() else [file])
        if each.is_file()
    )
    limit_s = _LONGEST_S + size / _BYTES_A_SECOND
    # The child process does not have the context variables of this process, so the memory limit is
    # passed to it.
    request = json.dumps([parser, str(file.absolute()), options, given_limit_GB()])
    answer, arrays = _asked(request, limit_s, max(_LEAST_BYTES, _BYTES_A_BYTE * size))
    if "refused" in answer:
        raise InputError(*answer["refused"])
    if "problem" in answer:
        raise InputError(
            "file", f"be a readable {what}", f"{file.name} ({answer['problem']})", remedy
        )
    return answer["facts"], arrays


def _asked(request: str, limit_s: float, most_bytes: int) -> Answer:
    """Run `_answer` in a child process, and return the result of `_answer`.

    If the process crashes or exceeds a limit, the result contains a description of this problem.
    """
    import numpy as np

    command = python_command(_START, request, str(os.getpid()), str(limit_s))
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:
        try:
            output, problem = _output(process, limit_s, most_bytes)
        finally:
            process.kill()
    if problem is not None:
        return {"problem": problem}, {}
    try:
        with np.load(BytesIO(output), allow_pickle=False) as stored:
            answer, *arrays = (stored[name] for name in stored.files)
        facts: Facts = json.loads(str(answer))
        return facts, dict(zip(facts.pop("arrays"), arrays, strict=True))
    except MemoryError:
        return {"problem": "it takes too much memory"}, {}
    except (BadZipFile, EOFError, ValueError):
        return {"problem": f"its parser crashed with exit code {process.returncode}"}, {}


def _output(
    process: subprocess.Popen[bytes], longest_s: float, most_bytes: int
) -> tuple[bytes, str | None]:
    """Return the output of a process, or a description of the limit that the process exceeded."""
    import psutil

    most_bytes = min(most_bytes, memory_limit_bytes() + _LIBRARIES_BYTES)
    end = monotonic() + longest_s
    while True:
        try:
            return process.communicate(timeout=_LOOK_EVERY_S)[0], None
        except subprocess.TimeoutExpired:
            if monotonic() > end:
                return b"", f"its parser took longer than {longest_s:g} s"
        except MemoryError:
            return b"", "it takes too much memory"
        # If the process has exited, its output is read in the next iteration.
        with suppress(psutil.Error):
            if psutil.Process(process.pid).memory_info().rss > most_bytes:
                return b"", f"its parser took more than {most_bytes / 2**30:.2g} GiB of memory"


def _serve() -> None:
    """Parse the file that is named on the command line of this child process.

    The result is written to the standard output.
    """
    import numpy as np

    request, parent, limit_s = sys.argv[1:]
    # A running parent kills this process after limit_s. After twice this time, the process ends
    # itself, because its parent has died. Only Linux kills a child process together with its
    # parent.
    faulthandler.dump_traceback_later(2.0 * float(limit_s), exit=True)
    kill_with_parent()
    # If the parent died before the call above, the call has no effect.
    if sys.platform.startswith("linux") and os.getppid() != int(parent):
        return
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # discard output of the libraries
    answer, arrays = _answer(request)
    answer["arrays"] = list(arrays)
    np.savez(answers, json.dumps(answer), *arrays.values())
    answers.flush()
    os._exit(0)  # exit at once; a library could hang in its cleanup after damaged input


def _answer(request: str) -> Answer:
    """Run a parser, and return its values and arrays, or a description of its error."""
    name, file, options, max_memory_GB = json.loads(request)
    module, function = name.split(":")
    try:
        with memory_limit(max_memory_GB):
            facts, arrays = getattr(import_module(module), function)(Path(file), **options)
        return {"facts": facts}, arrays
    except InputError as problem:
        return {"refused": [str(field) for field in problem.args]}, {}
    except DamagedFileError as problem:
        # The text is one line and truncated, because it may quote damaged content of the file.
        return {"problem": " ".join(str(problem).split())[:160]}, {}
    # VTK, SciPy and pyarrow raise many undocumented types of errors for a damaged file, and any of
    # them must reach the parent process as an answer.
    except Exception:
        return {"problem": "it is damaged or cut off"}, {}
