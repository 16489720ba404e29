"""Commands of ``tissue``, one per file."""

from tissue.cli.assess import assess
from tissue.cli.calibrate import calibrate
from tissue.cli.chart import chart
from tissue.cli.compare import compare
from tissue.cli.devices import devices
from tissue.cli.fit import fit
from tissue.cli.import_ import import_
from tissue.cli.report import report
from tissue.cli.run import run
from tissue.cli.scenes import scenes
from tissue.cli.schema import schema
from tissue.cli.stability import stability
from tissue.cli.study import study
from tissue.cli.sweep import sweep
from tissue.cli.train import train
from tissue.cli.view import view

__all__ = ["COMMANDS"]

COMMANDS = (
    run,
    import_,
    scenes,
    view,
    report,
    fit,
    sweep,
    compare,
    stability,
    devices,
    calibrate,
    assess,
    train,
    chart,
    study,
    schema,
)
"""Commands in the order in which help lists them."""
