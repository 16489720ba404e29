"""Every kind of scene in its coarsest form, and the files that they read."""

from typing import Any

import numpy as np

ON_BLOCK = {"points_mm": [[-1, 0, 0.2], [-1, 0, -0.8], [1, 0, -0.8]], "feed_mm_s": 40.0}
BURR = {"kind": "ball-burr", "diameter_mm": 2.0, "spin_rpm": 5000.0}
VOXELS = {"spacing_mm": 0.4, "margin_mm": 0.5}
BLOCK = {"kind": "block", "size_mm": [8.0, 6.0, 4.0]}
SLAB = {"kind": "slab", "size_mm": [26.0, 26.0, 28.0], "edge_mm": 6.0, "touch_edge_mm": 3.0}
PRESSED = {"points_mm": [[0, 0, 1.0], [0, 0, -1.5], [2, 0, -1.5]], "feed_mm_s": 60.0}
BALL = {"kind": "sphere-probe", "diameter_mm": 8.0}
LINEAR = {"order": 1, "interval_ms": 20.0}
HELD = {"device": "six-dof", "coupling": {"delay_ms": 1}}


def _scene(name: str, anatomy: dict, tool: dict, motion: dict, seconds: float, **more: Any) -> dict[str, Any]:
    return {
        "name": name,
        "duration_s": seconds,
        "anatomy": anatomy,
        "tool": tool,
        "motion": {"kind": "path", **motion},
        **more,
    }


def _cut(name: str, anatomy: dict, **more: Any) -> dict[str, Any]:
    return _scene(name, anatomy, BURR, ON_BLOCK, 0.03, **({"voxels": VOXELS} | more))


def _pressed(name: str, anatomy: dict, **more: Any) -> dict[str, Any]:
    return _scene(name, anatomy, BALL, PRESSED, 0.06, **({"organ": LINEAR} | more))


def kinds(files: dict[str, str]) -> dict[str, dict[str, Any]]:
    """Table of every kind of scene by its name; `files` as `write_files` gives them."""
    placed = {"centre_mm": [0.0, 0.0, 6.0], "normal": [0.0, 0.0, 1.0], "cortical_thickness_mm": 0.3}
    glenoid = {"kind": "glenoid", "guide_hole_diameter_mm": 3.2, "guide_hole_depth_mm": 4.0}
    reamer = {
        "kind": "flat-reamer",
        "diameter_mm": 8.0,
        "spin_rpm": 500.0,
        "length_mm": 3.0,
        "peg_diameter_mm": 3.0,
        "peg_length_mm": 2.0,
    }
    ream = {"points_mm": [[0, 0, 1.0], [0, 0, -1.0]], "feed_mm_s": 50.0}
    image = {"file": files["image"], "threshold": 100.0}
    layers = {f"{name}_file": files[name] for name in ("enamel", "dentin", "pulp", "ligament")}
    bur = {"kind": "ball-burr", "diameter_mm": 1.0, "spin_rpm": 100000.0}
    drill = {"points_mm": [[0, 0, 0.3], [0, 0, -0.7]], "feed_mm_s": 30.0}
    fine = {"spacing_mm": 0.25, "margin_mm": 0.5}
    liver = {"kind": "liver", "edge_mm": 18.0, "touch_edge_mm": 10.0}
    tets = {"kind": "liver", "file": files["tets"], "touch_edge_mm": 8.0, "held": "part", "held_part": "1"}
    push = {"kind": "thrust", "thrust_N": 20.0, "start_mm": [0, 0, 0.2], "depth_mm": 1.0, "max_feed_mm_s": 40.0}
    wall = {"points_mm": [[0, 0, 1.0], [0, 0, -3.0]], "feed_mm_s": 50.0}
    slow = {"points_mm": [[0, 0, 1.0], [0, 0, -3.0], [3, 0, -3.0]], "feed_mm_s": 6.0}
    found = {
        "block": _cut("block", BLOCK),
        "block, drill": _cut("block-drill", BLOCK) | {"tool": BURR | {"kind": "twist-drill", "length_mm": 6.0}},
        "block, cylinder": _cut("block-cylinder", BLOCK) | {"tool": BURR | {"kind": "cylinder", "length_mm": 6.0}},
        "block, pear": _cut("block-pear", BLOCK) | {"tool": BURR | {"kind": "pear-bur", "length_mm": 6.0}},
        "block, thrust": _cut("block-thrust", BLOCK) | {"motion": push},
        "block, replay": _cut("block-replay", BLOCK) | {"motion": {"kind": "replay", "file": files["poses"]}},
        "block, STL": _cut("block-stl", {"kind": "block", "file": files["bone"], **placed}),
        "block, image": _cut("block-image", {"kind": "block", **image}, voxels={"spacing_mm": 0.5}),
        "block, image with a site": _cut("block-image-site", {"kind": "block", **image, **placed}),
        "block by hand": _cut("block-hand", BLOCK) | HELD | {"duration_s": 0.5},
        "block by hand, thrust": _cut("block-push", BLOCK) | HELD | {"motion": {k: v for k, v in push.items() if k != "max_feed_mm_s"}}| {"duration_s": 0.5},
        "block by hand, still": _cut("block-still", BLOCK) | HELD | {"tool": BURR | {"spin_rpm": 0.0}, "duration_s": 0.5},
        "glenoid": _scene("glenoid-reamer", glenoid, reamer, ream, 0.03, voxels={"spacing_mm": 0.5, "margin_mm": 0.5}),
        "glenoid, hemisphere": _scene(
            "glenoid-hemisphere", glenoid, {k: v for k, v in reamer.items() if not k.startswith(("length", "peg"))} | {"kind": "hemispherical-reamer"}, ream, 0.03,
            voxels={"spacing_mm": 0.5, "margin_mm": 0.5},
        ),
        "glenoid, STL": _cut("glenoid-stl", {"kind": "glenoid", "file": files["bone"], **placed}),
        "molar": _scene("molar-bur", {"kind": "molar"}, bur, drill, 0.04, voxels=fine),
        "molar, caries": _scene("molar-caries", {"kind": "molar", "caries_depth_mm": 2.0}, bur, drill, 0.04, voxels=fine),
        "molar, stress": _scene(
            "molar-stress", {"kind": "molar"}, bur, drill, 0.06, voxels=fine, stress={"cell_mm": 1.5, "interval_ms": 20.0}
        ),
        "molar, surfaces": _scene("molar-layers", {"kind": "molar", **layers}, bur, drill, 0.04, voxels=fine),
        "molar, labels": _scene("molar-labels", {"kind": "molar", "file": files["labels"]}, bur, drill, 0.04, voxels=fine),
        "liver": _pressed("liver", liver),
        "liver, tetrahedra": _pressed("liver-tets", tets, organ=LINEAR | {"nodule_part": "3"}),
        "liver, surface": _pressed("liver-surface", {"kind": "liver", "file": files["organ"], "edge_mm": 12.0, "held": "plane", "held_below_mm": -30.0}),
        "slab": _pressed("slab", SLAB),
        "slab, nodule": _pressed(
            "slab-nodule",
            SLAB | {"nodule_diameter_mm": 12.0, "nodule_centre_mm": [0.0, 0.0, -13.0]},
            organ=LINEAR | {"young_end_kPa": 20.0},
        ),
        "slab, cylinder": _pressed("slab-cylinder", SLAB) | {"tool": {"kind": "cylinder-probe", "diameter_mm": 8.0}},
        "slab, shell": _pressed("slab-shell", SLAB) | {"tool": {"kind": "shell-probe", "file": files["finger"]}},
        "slab, fibres": _pressed(
            "slab-fibres", SLAB, organ=LINEAR | {"fibre_direction": [1.0, 0.0, 0.0], "fibre_modulus_ratio": 2.0}
        ),
        "slab, reduced": _pressed("slab-reduced", SLAB, organ=LINEAR | {"path": "reduced", "basis_size": 20, "young_kPa": 8.0, "poisson_ratio": 0.4}),
        "slab by hand": _pressed("slab-hand", SLAB) | HELD | {"duration_s": 0.6},
        "needle": _scene(
            "needle-script", {"kind": "layers", "interval_ms": 20.0, "vessel_wall_depth_mm": 6.0}, {"kind": "needle"},
            {"points_mm": [[0, 0, 1], [0, 0, -30]], "feed_mm_s": 400.0}, 0.07,
        ),
        "needle by hand": _scene(
            "needle-hand", {"kind": "layers", "interval_ms": 0.0}, {"kind": "needle"},
            {"points_mm": [[0, 0, 1], [0, 0, -20]], "feed_mm_s": 40.0}, 0.6, **HELD,
        ),
        "wall": _scene("wall-script", {"kind": "wall"}, BALL, wall, 0.06),
        "wall by hand": _scene("wall-hand", {"kind": "wall"}, BALL, slow, 1.1, **HELD),
        "wall by hand, touch": _scene("wall-touch", {"kind": "wall"}, BALL, slow, 1.1, device="touch"),
        "wall, predicted": _scene("wall", {"kind": "wall"}, BALL, slow, 1.1, **HELD, prediction="koopman"),
        "wall, held force": _scene("wall-hold", {"kind": "wall"}, BALL, slow, 1.1, **HELD, prediction="hold"),
    }  # fmt: skip
    for name in ("block, image", "block, image with a site"):
        deeper = [[-1, 0, 0.2], [-1, 0, -1.8], [1, 0, -1.8]]  # through the air of the image above its bone
        found[name]["motion"] = found[name]["motion"] | {"points_mm": deeper, "feed_mm_s": 80.0}
    for name, feed in (("block by hand", 8.0), ("block by hand, still", 3.0), ("slab by hand", 20.0)):
        found[name]["motion"] = found[name]["motion"] | {"feed_mm_s": feed}
    found["block by hand, still"]["duration_s"] = 0.9
    return found


def write_files(folder) -> dict[str, str]:
    """Write the files that the scenes read, and another valid one of each; paths by what they are."""
    import trimesh

    def saved(mesh, name):
        path = folder / f"{name.replace(' ', '-')}.stl"
        mesh.export(path)
        return {name: str(path)}

    found: dict[str, str] = {}
    for prefix, height, top in (("", 12.0, 0.6), ("other ", 14.0, 0.5)):
        found |= saved(trimesh.creation.box((30.0, 20.0, height)), f"{prefix}bone")
        finger = trimesh.creation.capsule(height=0.8 * height, radius=0.3 * height, count=[8, 8])
        finger.apply_translation([0.0, 0.0, -finger.bounds[0, 2]])
        found |= saved(finger, f"{prefix}finger")
        organ = trimesh.creation.icosphere(subdivisions=2, radius=2.5 * height)
        found |= saved(organ, f"{prefix}organ")
        found |= saved(_brick((8, 6, top), 12.0), f"{prefix}enamel")
        found |= saved(_hollow(height - 8.0), f"{prefix}dentin")
        found |= saved(_brick((2, 2, 19.4 - height), height - 8.0), f"{prefix}pulp")
        found |= saved(_brick((8, 6, 0.5 * top), -0.5 * top), f"{prefix}ligament")
        found[f"{prefix}image"] = _image(folder / f"{prefix}image.vti", 1.0 if not prefix else 0.95)
        found[f"{prefix}labels"] = _labels(folder / f"{prefix}labels.vti", 17 if not prefix else 15)
        found[f"{prefix}tets"] = _tets(folder / f"{prefix}tets.vtu", 0.03 if not prefix else 0.036)
        found[f"{prefix}poses"] = _poses(folder / f"{prefix}poses.csv", 1 if not prefix else 2)
    found |= saved(_brick((2, 2, 0.4), 11.6), "other caries")
    found["other predictor"] = _predictor(folder / "predictor.npz")
    return found


def _brick(size, bottom):
    """A box of a size [mm] over a height."""
    import trimesh

    made = trimesh.creation.box(size)
    made.apply_translation((0.0, 0.0, bottom + 0.5 * size[2]))
    return made


def _hollow(bottom):
    """Dentin around a pulp that begins at a height."""
    import trimesh

    inner = _brick((2, 2, 11.4 - bottom), bottom)
    inner.invert()
    return trimesh.util.concatenate([_brick((8, 6, 12), 0.0), inner])


def _image(path, spacing):
    """A block of 30 x 20 x 12 voxels about the origin, denser in its upper half, with air around it."""
    import pyvista

    image = pyvista.ImageData(dimensions=(33, 23, 15), spacing=(spacing,) * 3)
    image.origin = tuple(-0.5 * spacing * (count - 1) for count in image.dimensions)
    grey = np.zeros((32, 22, 14))
    grey[1:-1, 1:-1, 1:7] = 150.0
    grey[1:-1, 1:-1, 7:-1] = 300.0
    image.cell_data["grey"] = grey.ravel(order="F")
    image.save(path)
    return str(path)


def _labels(path, top):
    import pyvista

    labels = np.zeros((64, 32, 28), dtype=np.int16)
    labels[4:top, 4:27, 4:23] = 2
    labels[top:58, 4:27, 4:23] = 3
    labels[27:45, 13:18, 11:16] = 0
    tooth = pyvista.ImageData(dimensions=labels.shape, spacing=(0.22,) * 3)
    tooth.point_data["labels"] = labels.ravel(order="F")
    tooth.save(path)
    return str(path)


def _tets(path, thickness):
    import pyvista

    from meshes.tets.structured import box

    mesh = box((0.06, 0.05, thickness), (6, 5, 3))
    cells = np.hstack([np.full((len(mesh.cells), 1), 4), mesh.cells]).ravel()
    grid = pyvista.UnstructuredGrid(cells, np.full(len(mesh.cells), 10, np.uint8), 1e3 * mesh.nodes_m)
    grid.cell_data["part"] = np.digitize(mesh.nodes_m[mesh.cells].mean(axis=1)[:, 2], (0.01, 0.02)).astype(np.int32) + 1
    grid.save(path)
    return str(path)


def _poses(path, step):
    rows = [f"{0.001 * i},{-1 + 0.02 * i},0,{0.2 - 0.02 * i},0,0,0,1" for i in range(31)]
    head = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw"
    path.write_text("\n".join([head, *rows[::step]]) + "\n")
    return str(path)


def _predictor(path):
    """A predictor of the wall that looks less far ahead than the one that comes with tissue."""
    from dataclasses import replace

    from tissue.prediction.trained import Trained, shipped_file

    shipped = Trained.read(shipped_file("wall"))
    Trained.write(replace(shipped, operator=replace(shipped.operator, A=0.98 * shipped.operator.A)), path)
    return str(path)
