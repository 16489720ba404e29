"""``tissue train``."""

from pathlib import Path

from tissue.cli.terminal import Flag, MaybeWhole, Overrides, Whole, console
from tissue.system.owned_folder import OutputLock
from tissue.system.progress import progress


def train(
    scene: str,
    /,
    *,
    trials: Whole = 12,
    out: Path | None = None,
    set_: Overrides = (),
    cores: MaybeWhole = None,
    overwrite: Flag = False,
) -> None:
    """Train a predictor of the force in a scene, and validate it on runs not used for training.

    In the training runs, simulated hands of novices, intermediates and experts move the tool.

    Parameters
    ----------
    scene
        Name of a built-in scene, or a TOML file.
    trials
        Number of simulated runs, at least six. One run in four is used for validation.
    out
        File to write; default SCENE.npz.
    set_
        KEY=VALUE replaces an entry of the scene, such as device=six-dof; may be repeated.
    cores
        Processor cores to use; default all.
    overwrite
        Replace an existing file.
    """
    from meshes.base.errors import counted
    from meshes.base.whole_file import require_new_file
    from tissue.scene.load import load_scene, parse_overrides
    from tissue.scene.registry import PREDICTORS
    from tissue.simulation.builders.prediction import ADAPTIVE

    loaded = load_scene(scene, parse_overrides(set_))
    path = out or Path(f"{loaded.name}.npz")
    require_new_file(path, overwrite=overwrite)
    with OutputLock(path, folder=False), progress() as report:
        report("starting Warp", 0.0)
        from tissue.evaluation.training import train as trained_on

        found = trained_on(loaded, trials=trials, cores=cores, progress=report)
        found.write(path, overwrite=overwrite)
    facts = found.facts
    checked = found.facts["validation"]
    errors = {kind: sum(each) for kind, each in checked["errors"].items()}
    best = min(errors, key=lambda kind: errors[kind])
    advice = f"{best} has the smallest error; use it with --set prediction={best}"
    if PREDICTORS[best].trained or best == ADAPTIVE:
        advice += f" --set coupling.predictor_file={path}"
    lines = [
        f"{len(facts['delays'])} delays, {facts['samples']} samples",
        f"error on {counted(len(checked['held_out']), 'held-out run')} in % of the force, "
        f"{', '.join(map(str, checked['horizons_ms']))} ms ahead:",
        *(
            f"{kind:>18}  " + "  ".join(f"{100.0 * e:6.2f}" for e in errors)
            for kind, errors in checked["errors"].items()
        ),
        f"written to {path}. {advice}",
    ]
    console.print(*lines, sep="\n")
