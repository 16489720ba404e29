"""The commands of ``tissue``, one a file."""

from tissue.commands.run import run
from tissue.commands.scenes import scenes
from tissue.commands.stability import stability
from tissue.commands.view import view

__all__ = ["COMMANDS"]

COMMANDS = (run, scenes, view, stability)
"""In the order in which help lists them."""
