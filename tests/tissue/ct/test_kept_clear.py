"""Names of labels as a scene's keys: valid, distinct, and reported where they differ."""

import re

import numpy as np

from meshes.base.progress import silent
from meshes.ct.labels import Labels
from meshes.images.frame import Image
from tissue.ct.request import ImportRequest, kept_clear, plain_names
from tissue.scene.scene import KeepClear

NAMES = (
    "Canal!",
    "canal",
    "canal_2",
    "Kanal größe",
    "神経",
    "___",
    "CANAL",
    "2",
    "é" * 300,
    "a b  c",
)


def cubes(names):
    """A label of a cube of 4 mm each."""
    values = np.zeros((8 * len(names), 8, 8), dtype=np.uint8)
    for number in range(len(names)):
        values[8 * number + 2 : 8 * number + 6, 2:6, 2:6] = number + 1
    return Labels(Image(values, (1.0,) * 3, "labels", ()), dict(enumerate(names, start=1)))


def wanted(tmp_path, *names):
    return ImportRequest(
        tmp_path / "ct.nrrd", tmp_path / "labels.nrrd", region="bone", keep_clear=names
    )


def test_every_name_is_one_that_a_scene_takes():
    found = plain_names(NAMES)
    assert found[:7] == [
        "canal",
        "canal_2",
        "canal_2_2",
        "kanal_grosse",
        "structure",
        "structure_2",
        "canal_3",
    ]
    assert len(set(found)) == len(found) and max(map(len, found)) < 80
    scene = KeepClear(files={name: f"keep_clear_{name}.ply" for name in found})
    assert all(re.fullmatch("[a-z0-9][a-z0-9_]*", name) for name in scene.files)


def test_another_name_is_reported(tmp_path):
    surfaces, sentences = kept_clear(
        wanted(tmp_path, "Canal!", "canal"), cubes(("Canal!", "canal")), silent
    )
    assert sentences == [
        "keep clear: Canal!, called canal in the scene",
        "keep clear: canal, called canal_2 in the scene",
    ]
    assert (
        surfaces["canal"].vertices_m[:, 0].max() < 8e-3 < surfaces["canal_2"].vertices_m[:, 0].min()
    )
