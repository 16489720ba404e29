"""The calls that `import tissue` offers: the engine's, with a demand on fidelity met first and pictures drawn."""

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec

from meshes.base.progress import silent
from tissue.figures.report import draw_pictures
from tissue.scene.scene import Scene
from tissue.scene.unused_keys import require_used
from tissue.simulation import simulate as engine
from tissue.simulation.run import Run

__all__ = ["simulate"]

P = ParamSpec("P")


def _public(run_scene: Callable[Concatenate[Scene, P], Run]) -> Callable[Concatenate[Scene, P], Run]:
    """Choose the settings that a scene's demand on fidelity asks for, and give the run what draws its pictures."""

    @wraps(run_scene)
    def called(scene: Scene, /, *arguments: P.args, **options: P.kwargs) -> Run:
        """Run a scene at the settings that its demand asks for."""
        chosen: dict[str, str] = {}
        if scene.fidelity is not None:
            from tissue.evaluation.charts.fidelity import with_fidelity

            require_used(scene)
            scene, chosen["fidelity"] = with_fidelity(scene, report=options.get("progress") or silent)  # type: ignore[arg-type]
        run = run_scene(scene, *arguments, **options)
        run.parts.notes |= chosen
        run.draw = draw_pictures
        return run

    return called


simulate = _public(engine.simulate)
