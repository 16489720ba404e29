"""A sample of constants as the file of materials that a scene takes, so that anybody can run it."""

import json
from collections.abc import Sequence
from dataclasses import replace

from meshes.base.arrays import Array
from tissue.materials.constants import Constant
from tissue.materials.scene_constants import Materials

__all__ = ["sample_name", "sample_text", "sampled"]

SOURCE = "a sample of a band"


def sample_name(number: int, count: int) -> str:
    """Name of the file of a sample, such as ``sample_017.toml`` of 256."""
    return f"sample_{number:0{len(str(count - 1))}d}.toml"


def sampled(constants: Materials, names: Sequence[str], x: Array) -> Materials:
    """Constants with those of a sample in place, by their names ``TABLE.MATERIAL.NAME``, values of shape (p,)."""
    values = (Constant(value, value, value, SOURCE, "L") for value in map(float, x))
    drawn = {name: one for name, one in zip(names, values, strict=True) if not name.startswith("density.")}
    return replace(constants, given={**constants.given, **drawn}, names=(), matrix=())


def sample_text(constants: Materials, names: Sequence[str], x: Array) -> str:
    """The TOML file of a sample; a factor of the density, which no scene takes, is a comment."""
    lines = [f"# {name} = {float(value)!r}, which no file of materials holds" for name, value in
             zip(names, x, strict=True) if name.startswith("density.")]  # fmt: skip
    for name, one in sampled(constants, names, x).given.items():
        lines += [
            "",
            f"[{name}]",
            f"value = {one.value!r}",
            f"range = [{one.low!r}, {one.high!r}]",
            f"source = {json.dumps(one.source)}",
            f"confidence = {json.dumps(one.confidence)}",
        ]
    return "\n".join(lines).lstrip("\n") + "\n"
