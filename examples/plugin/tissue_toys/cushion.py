"""A tissue: its scene keys, its model, and the function that builds the parts of a run."""

from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from tissue import register
from tissue.models.tissue_model import Response, ToolMotion, WallModel
from tissue.motion.motion import Motion
from tissue.scene.anatomy import Part
from tissue.scene.tool import Probe
from tissue.simulation.builders.parts import Parts


class Cushion(Part):
    """Cushion with its face at z = 0. Its stiffness increases with the depth."""

    kind: Literal["cushion"] = "cushion"
    """A cushion."""
    stiffness_N_m: float = Field(100.0, ge=1, le=1e4)
    """Stiffness at the face."""
    hardening_mm: float = Field(10.0, ge=0.1, le=1000)
    """Depth at which the ratio of force to depth is twice the stiffness at the face."""


class CushionModel(WallModel):
    """Cushion with the force F = k d (1 + d / d0) at a depth d below the plane z = 0.

    The base class is a wall with a linear force. k is the stiffness at the face, and d0 is the
    hardening depth.
    """

    layer_names = ("cushion",)

    def __init__(self, cushion: Cushion, *, radius_m: float) -> None:
        super().__init__(cushion.stiffness_N_m, radius_m=radius_m)
        self.hardening_m = 1e-3 * cushion.hardening_mm

    def respond(self, motion: ToolMotion) -> Response:
        """Return the response of a linear wall, with force and stiffness increased with depth."""
        response = super().respond(motion)
        depth_m = 1e-3 * response.measures[0]
        response.wrench *= 1.0 + depth_m / self.hardening_m
        response.edge[:] = response.wrench
        # the slope of k d (1 + d / d0)
        response.stiffness_N_m = response.stiffness_N_m * (1.0 + 2.0 * depth_m / self.hardening_m)
        return response


def largest_force_N(scene: Any) -> float:
    """Return the force at the deepest point of the scripted motion [N].

    The force scale of a device is chosen from this force.
    """
    depth_m = max(-1e-3 * min(point[2] for point in scene.motion.points_mm), 0.0)
    cushion = scene.anatomy
    return float(cushion.stiffness_N_m * depth_m * (1.0 + 1e3 * depth_m / cushion.hardening_mm))


def draw(run: Any, path: Path) -> None:
    """Draw an additional picture for a run: the force as a function of depth."""
    from tissue.show.figures.figure import figure, save

    chart = figure(5.0, 3.5)
    axes = chart.subplots()
    axes.plot(run.trace["depth_mm"], run.trace["model_force_z_N"])
    axes.set(xlabel="depth / mm", ylabel="force / N")
    # space for the labels of the axes
    chart.subplots_adjust(left=0.15, bottom=0.17)
    save(chart, path)


@register.tissue(
    "cushion", Cushion, tool=Probe, force_N=largest_force_N, pictures={"cushion.png": draw}
)
def build(scene: Any, motion: Motion, **settings: Any) -> Parts:
    """Return the parts of a run in which a ball presses the cushion."""
    model = CushionModel(scene.anatomy, radius_m=0.5e-3 * scene.tool.diameter_mm)
    stated = (
        f"{scene.anatomy.stiffness_N_m:g} N/m at its face, twice that "
        f"{scene.anatomy.hardening_mm:g} mm deep"
    )
    return Parts(motion, model, notes={"cushion": stated})
