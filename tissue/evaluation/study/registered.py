"""The registered plan of a study's folder: its text, its hash, its changes, and the code that runs it."""

from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from meshes.base.errors import InputError
from meshes.base.whole_file import claim, whole_file
from tissue.evaluation.study.plan import Plan

__all__ = ["PLAN_FILE", "Registration", "code_sha256", "content_sha256", "register", "registered", "require_unchanged"]

PLAN_FILE = "plan.toml"
SOURCES = (".py", ".toml", ".npz")
"""Endings of the files of code and constants that figures can depend on."""

Registration = dict[str, str | int]
"""One registered plan: ``file``, ``sha256`` and ``trials_before``, the number of trials that were there before it."""


def register(folder: Path, plan: Plan, held: list[Registration], *, trials: int) -> list[Registration]:
    """Write the plan and its hash; an earlier one is kept under a name of its own. All registrations, newest last.

    Parameters
    ----------
    folder
        The study's folder, which exists.
    plan
        What is registered.
    held
        Registrations so far.
    trials
        Number of trials that the folder holds.
    """
    from tissue.evaluation.study.registration import plan_text  # imports figures, which a worker does not need

    kept = list(held)
    path = folder / PLAN_FILE
    if kept:
        earlier = f"plan-{len(kept)}.toml"
        claim(folder / earlier)
        path.replace(folder / earlier)
        kept[-1] = kept[-1] | {"file": earlier}
    text = plan_text(plan).encode("utf-8")
    if not kept and path.is_file() and path.read_bytes() != text:
        raise InputError(
            f"out must hold no {PLAN_FILE} of another origin, got one in {folder}: write it with `tissue study plan`"
        )
    with whole_file(path) as temporary:
        temporary.write_bytes(text)
    return [*kept, {"file": PLAN_FILE, "sha256": sha256(text).hexdigest(), "trials_before": trials}]


def registered(content: Mapping[str, Any]) -> list[Registration]:
    """Registrations of what a study.json holds, none for a study that began without.

    Raises
    ------
    TypeError, KeyError
        If it holds something else.
    """
    return [
        {"file": str(each["file"]), "sha256": str(each["sha256"]), "trials_before": int(each["trials_before"])}
        for each in content.get("registrations", [])
    ]


def require_unchanged(folder: Path, held: list[Registration]) -> None:
    """Refuse registered plans that were edited or taken away.

    Raises
    ------
    InputError
        If a plan's file is not the one whose hash was written.
    """
    for each in held:
        if (got := file_sha256(folder / str(each["file"]))) != each["sha256"]:
            raise InputError(
                f"{each['file']} must be as it was registered (SHA-256 {str(each['sha256'])[:12]}), got "
                f"{got[:12] or 'no such file'} in {folder}: put it back, or run another plan in a new folder"
            )


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, empty where it cannot be read."""
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def content_sha256(content: Mapping[str, object]) -> str:
    """SHA-256 of a trial's content; it finds a slip of an editor, not a person who computes it anew."""
    import json

    return sha256(json.dumps(content, sort_keys=True).encode("utf-8")).hexdigest()


@cache
def code_sha256() -> str:
    """SHA-256 over the names and bytes of all code and constants of this installation."""
    import kernels
    import meshes
    import tissue

    found = sha256()
    for package in (kernels, meshes, tissue):
        root = Path(package.__path__[0])
        for path in sorted(each for each in root.rglob("*") if each.suffix in SOURCES and each.is_file()):
            name = f"{package.__name__}/{path.relative_to(root).as_posix()}"
            found.update(name.encode("utf-8") + b"\0" + sha256(path.read_bytes()).digest())
    return found.hexdigest()
