"""``tissue calibrate``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from meshes.base.errors import InputError, names_of_caller
from tissue.cli.terminal import ADDRESS, Flag, MaybeWhole, Whole, console, left_out, problems
from tissue.system.owned_folder import OutputLock
from tissue.system.stopping import Terminated

if TYPE_CHECKING:
    from tissue.evaluation.calibration.answers import Answer
    from tissue.evaluation.calibration.session import Plan, Session, TrialLog


def calibrate(
    *,
    observer: str | None = None,
    ask: Flag = False,
    population: Path | None = None,
    out: Path | None = None,
    device: str | None = None,
    address: str | None = None,
    trials: MaybeWhole = None,
    numbers: MaybeWhole = None,
    seed: Whole = 0,
    overwrite: Flag = False,
) -> None:
    """Estimate how a person perceives force, from an adaptive session of questions.

    The results are the smallest force difference that the person feels, and the exponent of the
    power law between force and perceived intensity. With --population, the distribution over many
    persons is estimated from their sessions. Each answer is written to disk before the next
    question. After an interruption, the same command continues the session.

    Parameters
    ----------
    observer
        Simulated person who answers: simulated:SEED or simulated:GROUP:SEED, where GROUP is novice,
        intermediate or expert.
    ask
        Ask a real person, who feels forces on the device and answers with the keyboard.
    population
        Folder with the logs of many sessions (*.trials.jsonl).
    out
        File to write; default observer.json, or population.json with --population. The log of the
        answers and a picture are written to the same folder.
    device
        Device that plays forces to a person: haply, forcedimension, sigma-7, openhaptics, network,
        recorded, or a device of an installed package. The devices mouse (default), touch, omni and
        six-dof play no force; bars on the screen show the forces instead.
    address
        Address of a real device, as in the key hardware.address of a scene; default the usual
        address of the device.
    trials
        Number of comparisons of two forces; default 120.
    numbers
        Number of questions in which the person rates a force by a number; default 24.
    seed
        Seed for the order of the questions or, with --population, for the random draws.
    overwrite
        Replace the files of an earlier session.
    """
    if sum((observer is not None, ask, population is not None)) != 1:
        raise InputError(
            "exactly one of --observer, --ask and --population",
            "be given",
            "none or more than one of them",
            "try --observer simulated:1 --out observer.json",
        )
    if population is not None:
        left_out(
            "with --population, which uses sessions that have ended",
            "remove it",
            device=device,
            address=address,
            trials=trials,
            numbers=numbers,
        )
        from tissue.evaluation.calibration.population_fit import fit_population

        target = out or Path("population.json")
        with OutputLock(target, folder=False):
            lines = fit_population(
                population, target, seed=seed, overwrite=overwrite, progress=problems.is_terminal
            )
        console.print(*lines, sep="\n")
        return
    from tissue.evaluation.calibration.answers import questioner
    from tissue.evaluation.calibration.session import Plan

    device = device or "mouse"
    target = out or Path("observer.json")
    name = observer or f"person on {device}"
    asking = questioner(observer, device, address=address or "", read=input, show=console.print)
    naming = names_of_caller(ADDRESS)
    with naming, OutputLock(target, folder=False), asking as (answer, limit_N):
        counts: dict[str, Any] = {"trials": trials, "numbers": numbers}
        given = {each: count for each, count in counts.items() if count is not None}
        plan = Plan(seed=seed, force_limit_N=limit_N, **given)
        _session(target, name, plan, answer, overwrite=overwrite)


def _session(target: Path, name: str, plan: "Plan", answer: "Answer", *, overwrite: bool) -> None:
    """Run a session, or continue it after the last answer in its log, and write the results."""
    from meshes.base.whole_file import whole_file
    from tissue.evaluation.calibration.answers import begin
    from tissue.evaluation.calibration.population_fit import draw_session
    from tissue.perception.observer import write_observer

    log = begin(target, name, plan, overwrite=overwrite)
    if log.repaired:
        problems.print(f"{log.path} ends in the middle of a line, so its last trial is asked again")
    if log.session.trial:
        problems.print(f"continuing at trial {log.session.trial + 1} of {log.path}")
    _ask_all(log, answer)
    session = log.session
    # Both files are moved into place together. If one of them exists, the session is complete.
    with whole_file(target.with_suffix(".png")) as drawn:
        draw_session(session, drawn)
        write_observer(session.observer(name), target, overwrite=overwrite)
    console.print(*session.lines(), sep="\n")
    for note in session.notes():
        problems.print("note:", note)
    files = ", ".join(str(each) for each in (target, log.path, target.with_suffix(".png")))
    console.print(f"wrote {files}")


def _ask_all(log: "TrialLog", answer: "Answer") -> None:
    """Ask the remaining questions; after Ctrl-C, print how to continue."""
    from tissue.evaluation.calibration.answers import StoppedError
    from tissue.evaluation.calibration.session import read_log

    session: Session = log.session
    try:
        while not session.complete:
            asked = session.ask()
            log.take(asked, answer(asked, session.trial))
    except (KeyboardInterrupt, StoppedError) as stopped:
        log.close()
        problems.print(
            f"stopped after trial {read_log(log.path)[1].trial}. All answers are in {log.path}. "
            "The same command continues the session"
        )
        # 130 is 128 plus the number of SIGINT, as shells expect.
        sys.exit(stopped.exit_code if isinstance(stopped, Terminated) else 130)
    log.close()
