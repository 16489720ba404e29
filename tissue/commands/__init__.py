"""The commands of ``tissue``, one a file."""

from tissue.commands.assess import assess
from tissue.commands.calibrate import calibrate
from tissue.commands.chart import chart
from tissue.commands.run import run
from tissue.commands.scenes import scenes
from tissue.commands.stability import stability
from tissue.commands.study import study
from tissue.commands.train import train
from tissue.commands.view import view

__all__ = ["COMMANDS"]

COMMANDS = (run, scenes, view, stability, calibrate, assess, train, chart, study)
"""In the order in which help lists them."""
