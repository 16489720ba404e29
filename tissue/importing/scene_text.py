"""The scene that an import writes: the imported bone in the place of another scene's, or a first plunge into it."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from meshes.base.errors import InputError
from tissue.importing.placing import Placed
from tissue.scene.load import load_scene
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool

__all__ = ["scene_name", "scene_text", "stated", "toml"]

USUAL = {"glenoid": "glenoid", **dict.fromkeys(("vertebra", "vertebra:left", "vertebra:right"), "pedicle")}
"""Scene whose tool and motion are taken at a site where none is asked for."""
PLUNGE: Mapping[str, Mapping[str, object]] = {
    "voxels": {"spacing_mm": 0.2},
    "tool": {"kind": "ball-burr", "diameter_mm": 4.0, "flutes": 6, "spin_rpm": 20000.0},
    "motion": {"kind": "path", "points_mm": [[0, 0, 3], [0, 0, -2]], "feed_mm_s": 1.0},
}
"""What a scene does with a bone that nothing else is known of: a ball burr goes in 2 mm along the normal."""
ARRAY = re.compile(r"(?<== )\[[^\"]*?\n\]")
"""An array that is written over several lines."""
HOLE = ("guide_hole_diameter_mm", "guide_hole_depth_mm")
OF_SCENE = ("duration_s", "seed")


def scene_name(folder: Path) -> str:
    """Name of a scene in a folder."""
    plain = re.sub(r"[^a-z0-9_-]+", "-", folder.resolve().name.lower()).strip("-_")
    return plain or "imported"


def scene_text(
    *,
    name: str,
    description: str,
    placed: Placed | None,
    dense: bool,
    files: Mapping[str, str],
    keep_clear: Mapping[str, str],
    like: str | None,
    replay: str | None,
) -> str:
    """TOML of a scene of an imported bone.

    Parameters
    ----------
    dense
        Whether there is a density file.
    files
        Names of the files by the scene's keys: ``file`` and ``density_file``.
    keep_clear
        Name of the surface file of each structure that the tool must not touch.
    like
        Scene whose tool and motion are taken; None: the usual one of the site.
    replay
        File of poses that the tool follows instead.
    """
    tables = _taken(like, placed)
    anatomy: dict[str, object] = {"kind": "bone", **files, "scale_mm": 1.0}
    if placed is not None:
        anatomy |= {
            "centre_mm": [round(value, 3) for value in (1e3 * placed.site.centre_m).tolist()],
            "normal": [round(value, 6) for value in placed.site.rotation[:, 2].tolist()],
            "along": [round(value, 6) for value in placed.site.rotation[:, 0].tolist()],
        }
        if dense and placed.articular_radius_mm:
            anatomy["articular_radius_mm"] = placed.articular_radius_mm
    anatomy |= tables.pop("anatomy", {})
    if replay is not None:
        tables["motion"] = {"kind": "replay", "file": replay}
        tables[""].pop("duration_s", None)
    head = {"name": name, "description": description, **tables.pop("")}
    whole: dict[str, object] = {**head, "anatomy": anatomy}
    if keep_clear:
        whole["keep_clear"] = {"files": dict(keep_clear)}
    return _commented(toml(whole | tables), placed)


def stated(scene: Scene) -> dict[str, Any]:
    """What a scene states itself, without defaults."""
    return scene.model_dump(mode="json", exclude_unset=True, exclude_none=True)


def _taken(like: str | None, placed: Placed | None) -> dict[str, dict[str, object]]:
    """Tables of the scene that is followed: its head under an empty name, its guide hole, tool, motion and the like."""
    wanted = like or USUAL.get((placed.kind if placed else None) or "")
    if wanted is None:
        return {"": {}, **{part: dict(table) for part, table in PLUNGE.items()}}
    scene: Scene = load_scene(wanted)
    if not isinstance(scene.tool, Tool):
        raise InputError(f"like must be a scene in which a tool cuts, got {like}: use milling or glenoid")
    table = stated(scene)
    hole = {key: table["anatomy"][key] for key in HOLE if key in table["anatomy"]}
    parts = ("voxels", "tool", "motion", "cutting", "output", "device", "fidelity")
    return {
        "": {key: table[key] for key in OF_SCENE if key in table},
        "anatomy": hole,
        **{part: table[part] for part in parts if part in table},
    }


def toml(table: Mapping[str, object]) -> str:
    """TOML of a scene's table, its arrays of numbers each on a line."""
    import tomli_w

    text = tomli_w.dumps(dict(table))
    return ARRAY.sub(
        lambda found: re.sub(r",?\s+(?=\])", "", re.sub(r"(?<=\[)\s+", "", re.sub(r",\s+", ", ", found[0]))), text
    )


def _commented(text: str, placed: Placed | None) -> str:
    """The text with a word on what a person may want to change."""
    remarks = {
        "file = ": "mm, in the frame of the image (LPS)",
        "density_file = ": "apparent density, kg/m3",
        "centre_mm = ": "the site, mm in the frame of the image (LPS); the motion is given from there",
        "normal = ": "out of the bone: the site's z",
        "along = ": "the site's x",
    }
    lines = []
    inside = False
    for line in text.splitlines():
        inside = line == "[anatomy]" if line.startswith("[") and line.endswith("]") and " " not in line else inside
        remark = next((each for key, each in remarks.items() if inside and line.startswith(key)), None)
        lines.append(f"{line}  # {remark}" if remark and not line.endswith("[") else line)
    if placed is None:
        lines.insert(
            0, "# No site yet: pick one by `tissue view` of this folder, or write anatomy.centre_mm and normal."
        )
    return "\n".join(lines) + "\n"
