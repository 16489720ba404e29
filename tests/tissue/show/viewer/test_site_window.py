"""`tissue view` of an imported bone.

A click places the site, Return saves it, and nothing else in the scene changes.
"""

import tomllib

import numpy as np
import pytest
from imported_bone import SCENE, imported_bone

from tissue import InputError
from tissue.scene.texts import anatomy_of, save_site, with_site
from tissue.show.viewer.run_scene import Choice
from tissue.show.viewer.view import view


@pytest.fixture(scope="module")
def driven(drive, tmp_path_factory):
    """Return the results of the window, the folder of the bone and the folder of the pictures."""
    folder, out = (
        imported_bone(tmp_path_factory.mktemp("bones") / "mine"),
        tmp_path_factory.mktemp("window"),
    )
    return drive("site_driver.py", folder, out), folder, out


@pytest.mark.slow
def test_a_click_puts_the_site_and_return_saves_it(driven):
    found, folder, out = driven
    assert found["before"].startswith(
        "centre (0.00, 0.00, 23.00) mm, normal (0.000, 0.000, 1.000), LPS"
    )
    assert found["missed"] == found["before"]
    centre, normal, text = found["picked"]
    # the pixel towards the eye over a ball about 0
    assert np.linalg.norm(np.subtract(centre, found["seen"])) < 1.0
    assert np.degrees(np.arccos(np.dot(normal, centre) / np.linalg.norm(centre))) < 3.0
    assert "not saved yet" in text
    assert found["turned"] == text
    assert found["saved"].endswith(f"saved into {folder / 'scene.toml'}")
    anatomy = anatomy_of(folder / "scene.toml")
    assert anatomy["centre_mm"] == pytest.approx(centre, abs=1e-3)
    assert anatomy["normal"] == pytest.approx(normal, abs=1e-6)
    assert {path.name for path in out.iterdir()} == {"start.png", "picked.png", "saved.png"}


@pytest.mark.parametrize("option", [{"field": "von_mises_MPa"}, {"hide": ("cortical",)}])
def test_what_only_a_run_has_is_refused(tmp_path, option):
    name = next(iter(option))
    with pytest.raises(InputError, match=f"{name} must be left out for an imported bone"):
        view(imported_bone(tmp_path / "mine"), Choice(**option), screenshot=tmp_path / "site.png")


@pytest.mark.parametrize(
    "text",
    [
        SCENE,
        SCENE.replace("\n", "\r\n"),
        '[anatomy]\nkind = "bone"\nfile = "a]b.ply"',
        (
            "[voxels]\nspacing_mm = 1\n\n  [ anatomy ]  # mine\n# normal = [9, 9, 9]\nkind = "
            '"bone"\n\n# end\n[tool]\nnormal = 3\n'
        ),
        "[anatomy]\nnormal=[0,0,1]#out\ncentre_mm=[1,2,3]\n[[more]]\ncentre_mm = [0, 0, 0]\n",
    ],
)
def test_only_the_site_changes(text):
    changed = with_site(text, (1.23456, -2.0, 3.0), (0.0, 0.6, -0.8))
    before, after = tomllib.loads(text), tomllib.loads(changed)
    before["anatomy"] |= {"centre_mm": [1.235, -2.0, 3.0], "normal": [0.0, 0.6, -0.8]}
    assert after == before
    assert changed.count("#") == text.replace("# a remark within", "").count("#")
    assert ("\r\n" in text) == ("\r\n" in changed)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('anatomy = {kind = "bone"}\n', "must have a line"),
        ('anatomy.kind = "bone"\n', "must have a line"),
        ('note = """\n[anatomy]\n"""\n[anatomy]\nkind = "bone"\n', "by hand"),
    ],
)
def test_text_that_would_change_otherwise_is_refused_and_kept(tmp_path, text, sentence):
    scene = tmp_path / "scene.toml"
    scene.write_text(text, "utf-8")
    with pytest.raises(InputError, match=sentence):
        save_site(scene, (0, 0, 0), (0, 0, 1))
    assert scene.read_text("utf-8") == text
