"""Tables of parts that accept parts from outside the package.

These are devices, hands, renderers, predictors and perceptual maps.
"""

from pathlib import Path

import numpy as np
import pytest

from tissue import InputError, Scene, load_scene, simulate
from tissue.cli.calibrate import calibrate
from tissue.cli.study import PlanOptions
from tissue.materials.constants import listed
from tissue.scene.part import Registry
from tissue.scene.registry import CUTTING_MATERIALS, DEVICES, GROUPS, RENDERERS, SCENES, TABLES


def run_of(**changes):
    """A short run of a ball that a hand presses on a wall."""
    given = {"device": "touch", "duration_s": 0.6, "coupling.stiffness_N_m": 300.0}
    return simulate(
        load_scene(
            "wall", given | {key.replace("__", "."): value for key, value in changes.items()}
        )
    )


def force_N(run):
    """Force across the wall over time."""
    return np.abs(run.trace["device_force_z_N"])


def test_a_table_loads_lists_and_refuses():
    table = Registry("renderer", {"proxy": dict})
    assert (
        list(table) == ["proxy"]
        and len(table) == 1
        and "proxy" in table
        and callable(table["proxy"])
    )
    with pytest.raises(
        InputError,
        match=r"^renderer must be one of proxy, got prox \(did you mean proxy\?\). Choose one",
    ):
        table["prox"]
    with pytest.raises(
        InputError,
        match=r"^name must not be one of proxy, got proxy. Choose another name for this renderer$",
    ):
        table.add("proxy", dict)
    table.remove("proxy")
    assert table.names == ()
    with pytest.raises(InputError, match=r"^renderer must be one of"):
        table.remove("proxy")


class Half:
    """A spring of half the stiffness that it was given."""

    def __init__(self, loop):
        self.stiffness_N_m = 0.5 * loop.stiffness_N_m

    def render(self, device, device_velocity, proxy, proxy_velocity, dt):
        return self.stiffness_N_m * (proxy - device)

    def pause(self):
        pass


def test_a_renderer_from_outside_plays(added):
    added(RENDERERS, "half", Half)
    soft, stiff = run_of(renderer="half"), run_of(renderer="penalty")
    assert force_N(soft).max() > 0.05
    assert not np.array_equal(force_N(soft), force_N(stiff))
    with pytest.raises(
        InputError,
        match=r"renderer must be one of penalty, passivity, proxy or half, got halv \(did you",
    ):
        load_scene("wall", {"renderer": "halv"})
    assert (
        Scene.model_json_schema()["$defs"]["Device"]["properties"]["renderer"]["enum"][-1] == "half"
    )


def test_the_page_and_the_help_texts_list_every_name():
    page = (Path(__file__).parents[3] / "docs" / "commands.md").read_text("utf-8")
    assert CUTTING_MATERIALS.known == listed("cutting")
    for table in {
        id(table): table for each in TABLES.values() for table in each if table is not SCENES
    }.values():
        row = f"| `{table.key}` | {', '.join(f'`{name}`' for name in table)} |"
        assert row in page
    for name in (*DEVICES, *GROUPS):
        assert name in calibrate.__doc__
    for name in GROUPS:
        assert name in PlanOptions.__doc__
