"""Whole files of every kind that is read, small ones, to be damaged."""

import json
import shutil
from pathlib import Path

import numpy as np

CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], dtype=float
)
FACES = np.array(
    [
        [0, 2, 1],
        [0, 3, 2],
        [4, 5, 6],
        [4, 6, 7],
        [0, 1, 5],
        [0, 5, 4],
        [1, 2, 6],
        [1, 6, 5],
        [2, 3, 7],
        [2, 7, 6],
        [3, 0, 4],
        [3, 4, 7],
    ]
)
TETS = np.array([[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]])
RUN_FILES = ("summary.json", "trace.csv")
DRAWN_FILES = ("bone.vti", "fields.pvd", "fields/frame_0000.vtu", "carving/poses.npz")


def obj_text(first: int = 1) -> str:
    """A cube of 40 mm in OBJ."""
    lines = [f"v {x} {y} {z}" for x, y, z in 40.0 * CORNERS] + [f"f {a} {b} {c}" for a, b, c in FACES + first]
    return "\n".join(lines) + "\n"


def msh_text() -> str:
    """A cube of 40 mm of six tetrahedra in two named parts, in Gmsh's text of version 2."""
    nodes = [f"{i} {x} {y} {z}" for i, (x, y, z) in enumerate(40.0 * CORNERS, 1)]
    cells = [f"{i} 4 2 {1 + i // 4} 1 {' '.join(map(str, tet + 1))}" for i, tet in enumerate(TETS, 1)]
    names = ['3 1 "liver"', '3 2 "nodule"']
    sections = (("PhysicalNames", names), ("Nodes", nodes), ("Elements", cells))
    blocks = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    for name, lines in sections:
        blocks += [f"${name}", str(len(lines)), *lines, f"$End{name}"]
    return "\n".join(blocks) + "\n"


def write_meshes(folder: Path) -> dict[str, list[Path]]:
    """Surfaces and tetrahedra in every format, by reader."""
    import pyvista
    import trimesh

    mesh = trimesh.Trimesh(40.0 * CORNERS, FACES, process=False)
    text = {"obj": obj_text(), "msh": msh_text()}
    for name, kind, options in (
        ("binary.stl", "stl", {}),
        ("text.stl", "stl_ascii", {}),
        ("binary.ply", "ply", {}),
        ("text.ply", "ply", {"encoding": "ascii"}),
    ):
        made = mesh.export(file_type=kind, **options)
        (folder / name).write_bytes(made.encode() if isinstance(made, str) else made)
    for kind, content in text.items():
        (folder / f"cube.{kind}").write_text(content)
    surface = pyvista.PolyData.from_regular_faces(40.0 * CORNERS, FACES)
    surface.save(folder / "cube.vtp")
    surface.save(folder / "binary.vtk")
    surface.save(folder / "text.vtk", binary=False)
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: TETS}, 40.0 * CORNERS)
    grid.cell_data["part"] = np.arange(6) // 3
    grid.save(folder / "cube.vtu")
    grid.save(folder / "tets.vtk", binary=False)
    write_images(folder)
    plain = ("binary.stl", "text.stl", "binary.ply", "text.ply", "cube.obj")
    return {
        "surface": [folder / name for name in plain],
        "surface apart": [folder / name for name in ("cube.vtp", "binary.vtk", "text.vtk")],
        "tets": [folder / "cube.msh"],
        "image": [folder / name for name in ("ct.nrrd", "ct.nii", "ct.mha", "ct.tif")],
        "image apart": [folder / "ct.vti"],
        "tets apart": [folder / name for name in ("cube.vtu", "tets.vtk")],
    }


def write_images(folder: Path) -> None:
    """A small image in every format."""
    import pyvista
    import SimpleITK

    values = np.arange(6 * 5 * 4, dtype=np.int16).reshape(4, 5, 6)
    image = SimpleITK.GetImageFromArray(values)
    image.SetSpacing((0.5, 0.5, 0.6))
    for name in ("ct.nrrd", "ct.nii", "ct.mha"):
        SimpleITK.WriteImage(image, str(folder / name))
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(values.astype(np.uint16)), str(folder / "ct.tif"))
    grid = pyvista.ImageData(dimensions=(6, 5, 4), spacing=(0.5, 0.5, 0.6))
    grid.point_data["density"] = values.ravel()
    grid.save(folder / "ct.vti")


def write_own(folder: Path) -> dict[str, list[Path]]:
    """Files and folders that tissue itself writes, by reader."""
    import pyvista

    from tissue.evaluation.calibration.session import Plan as Calibration
    from tissue.evaluation.calibration.trial_log import TrialLog
    from tissue.evaluation.study.folder import StudyFolder
    from tissue.evaluation.study.plan import Plan
    from tissue.evaluation.study.trial import Trial
    from tissue.perception.observer import Observer, write_observer
    from tissue.scene.load import load_scene
    from tissue.simulation.simulate import simulate

    run = folder / "run"
    made = simulate(
        load_scene("milling", {"voxels.spacing_mm": 0.8, "duration_s": 1.0, "motion.feed_mm_s": 40.0}), out=run
    )
    made.save(run, pictures=False)
    lines = (run / "trace.csv").read_text().splitlines(keepends=True)
    (run / "trace.csv").write_text("".join(lines[:1] + lines[1::10]))
    summary = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps(summary | {"simulated_s": 1e-3 * len(lines[1::10])}))
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: TETS}, 40.0 * CORNERS)
    grid.cell_data["von_mises_kPa"] = np.arange(6.0)
    (run / "fields").mkdir()
    grid.save(run / "fields" / "frame_0000.vtu")
    (run / "fields.pvd").write_text(
        '<VTKFile type="Collection" version="0.1"><Collection><DataSet timestep="0.0" file="fields/frame_0000.vtu"/>'
        "</Collection></VTKFile>\n"
    )
    write_observer(
        Observer(name="anna", mean=np.array([0.0, 1.7, -1.6, -1.6, -3.9, -1.6]), covariance=0.01 * np.eye(6), trials=3),
        folder / "observer.json",
    )
    log = TrialLog(folder / "anna.trials.jsonl", "anna", Calibration(trials=6, numbers=2))
    while not log.session.complete:
        log.take(log.session.ask(), 1)
    log.close()
    plan, study = Plan(trials=1, tasks=("T2",), groups=("novice",), sensitivity=False), StudyFolder(folder / "study")
    study.begin(plan)
    for key in plan.all_trials():
        study.write(Trial(key, 7, tuple({"method": each, "force_error": 0.1} for each in plan.methods), 0.0))
    study.write_tables()
    shipped = Path(__file__).resolve().parents[2] / "tissue" / "prediction" / "trained" / "wall.npz"
    shutil.copy(shipped, folder / "wall.npz")
    shutil.copy(run / "trace.csv", folder / "poses.csv")
    shutil.copy(run / "scene.toml", folder / "scene.toml")
    return {
        "poses": [folder / "poses.csv"],
        "scene": [folder / "scene.toml"],
        "predictor": [folder / "wall.npz"],
        "observer": [folder / "observer.json"],
        "trials": [folder / "anna.trials.jsonl"],
        "table": [folder / "study" / "trials.csv"],
        "study": [study.path / "study.json", *sorted((study.path / "trials").iterdir())[:1]],
        "assess": [run / name for name in RUN_FILES],
        "run apart": [run / name for name in DRAWN_FILES],
    }
