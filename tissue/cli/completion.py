"""``tissue --install-completion``."""

from collections.abc import Callable
from typing import Literal

from cyclopts import App

from tissue.cli.terminal import console

__all__ = ["completion_command"]

Shell = Literal["bash", "zsh", "fish"]
SHELLS: dict[str, Shell] = {"bash": "bash", "zsh": "zsh", "fish": "fish"}


def completion_command(app: App) -> Callable[..., None]:
    """Return the command that installs shell completion for an application."""

    def install_completion(*, shell: str | None = None) -> None:
        """Install the completion of commands and options in a shell.

        Parameters
        ----------
        shell
            bash, zsh or fish; default the shell in use.
        """
        from cyclopts.completion.detect import ShellDetectionError, detect_shell

        from meshes.base.errors import InputError
        from tissue.scene.named_parts import nearest

        if (chosen := shell) is None:
            try:
                chosen = detect_shell()
            except ShellDetectionError:
                chosen = "one that is not recognised"
        if chosen not in SHELLS:
            close = nearest(chosen, list(SHELLS)) if shell else ""
            raise InputError(
                "--shell",
                f"be one of {', '.join(SHELLS)}",
                f"{chosen}{close}",
                "choose one of these",
            )
        path = app.install_completion(shell=SHELLS[chosen])
        console.print(f"wrote {path}: open a new {chosen} to use it")

    return install_completion
