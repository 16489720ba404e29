"""List what a user can see: `python tests/bench/public_surface.py [--record]`.

Prints public names with their parameters and members, commands with their flags, scene keys, and
files of run folders. Without `--record` it prints the differences from `public_surface.txt`.
"""

import argparse
import inspect
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import tissue

RECORDED = Path(__file__).with_suffix(".txt")
ROOT = RECORDED.parents[2]
RUNS = {
    "milling": ["milling", "--set", "voxels.spacing_mm=0.8"],
    "liver-press": ["liver-press"],
    "wall": ["wall"],
}


def command_output(*words: str) -> str:
    """Return what a command of the package prints."""
    ran = subprocess.run(
        [sys.executable, "-m", "tissue", *words],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    return ran.stdout


def parameters(name: str, called: object) -> Iterator[str]:
    """Yield the parameters of a function or a constructor."""
    try:
        found = inspect.signature(called).parameters
    except (TypeError, ValueError):
        return
    yield from (f"{name}({parameter})" for parameter in found if parameter != "self")


def names() -> Iterator[str]:
    """Yield public names, their members and their parameters."""
    for name in tissue.__all__:
        value = getattr(tissue, name)
        yield f"tissue.{name}"
        if not inspect.ismodule(value):
            yield from parameters(f"tissue.{name}", value)
        public = [member for member in dir(value) if not member.startswith("_")]
        if inspect.isclass(value):
            if not issubclass(value, BaseException) and not hasattr(value, "model_fields"):
                for member in public:
                    yield f"tissue.{name}.{member}"
                    yield from parameters(f"tissue.{name}.{member}", getattr(value, member))
        elif inspect.ismodule(value):
            yield from (f"tissue.{name}.{member}" for member in getattr(value, "__all__", public))


def flags() -> Iterator[str]:
    """Yield commands and their flags."""
    listed = command_output("--help").split("Commands", 1)[1]
    for command in re.findall(r"^│ ([a-z]+) ", listed, re.MULTILINE):
        yield f"command {command}"
        printed = command_output(command, "--help")
        yield from (f"command {command} {flag}" for flag in re.findall(r"--[a-z][\w-]*", printed))


def scene_keys() -> Iterator[str]:
    """Yield the keys of scenes, with the values of those that name a choice."""
    schema = json.loads(command_output("schema"))
    definitions = schema.get("$defs", {})

    def walk(node: dict, path: str, seen: tuple[str, ...]) -> Iterator[str]:
        if "$ref" in node:
            name = node["$ref"].rsplit("/", 1)[1]
            if name not in seen:
                yield from walk(definitions[name], path, (*seen, name))
        for part in ("anyOf", "oneOf", "allOf"):
            for inner in node.get(part, []):
                yield from walk(inner, path, seen)
        if isinstance(node.get("additionalProperties"), dict):
            yield from walk(node["additionalProperties"], f"{path}.*", seen)
        if isinstance(node.get("items"), dict):
            yield from walk(node["items"], f"{path}[]", seen)
        for value in node.get("enum", [node["const"]] if "const" in node else []):
            yield f"key {path} = {value}"
        for key, inner in node.get("properties", {}).items():
            where = f"{path}.{key}" if path else key
            yield f"key {where}"
            yield from walk(inner, where, seen)

    yield from walk(schema, "", ())


def files() -> Iterator[str]:
    """Yield files of run folders and columns of traces."""
    for name, words in RUNS.items():
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "run"
            command_output("run", *words, "--duration-s", "0.05", "--out", str(out))
            for path in sorted(out.rglob("*")):
                if path.is_file():
                    yield f"file {name}/{path.relative_to(out).as_posix()}"
            header = (out / "trace.csv").read_text("utf-8").split("\n", 1)[0]
            yield from (f"column {name} {column}" for column in header.split(","))


def main() -> None:
    """Record the list, or print its differences from the recorded one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--record", action="store_true", help="write public_surface.txt anew")
    chosen = parser.parse_args()
    found = sorted({*names(), *flags(), *scene_keys(), *files()})
    if chosen.record:
        RECORDED.write_text("\n".join(found) + "\n", encoding="utf-8")
        return
    recorded = RECORDED.read_text("utf-8").splitlines()
    for gone in sorted(set(recorded) - set(found)):
        print(f"- {gone}")
    for added in sorted(set(found) - set(recorded)):
        print(f"+ {added}")


if __name__ == "__main__":
    main()
