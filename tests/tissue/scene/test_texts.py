"""Folders of the files that a scene names, of Linux and of Windows."""

import pytest

from tissue.scene.anatomy import BlockSurface
from tissue.scene.load import load_scene
from tissue.scene.texts import folders_of


@pytest.mark.parametrize(
    ("file", "folders"),
    [
        ("scan", []),
        ("/data/Quillfeather/scan", ["/data/Quillfeather/"]),
        ("/data/Quillfeather/scan/", ["/data/Quillfeather/"]),
        ("/scan.nii", []),  # a root names nobody
        ("C:\\Users\\ana\\scan.nrrd", ["C:\\Users\\ana\\"]),
    ],
)
def test_folders_end_before_the_name_of_the_file(file, folders):
    scene = load_scene("milling")
    there = BlockSurface(file=file)  # a scene that is read makes a file absolute
    assert folders_of(scene.model_copy(update={"anatomy": there})) == folders


def test_a_file_may_follow_the_name_of_a_part():
    changes = {"device": "touch", "perception": "observer:/data/ana/me.json"}
    assert folders_of(load_scene("wall", changes)) == ["/data/ana/"]
