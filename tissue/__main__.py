"""The ``tissue`` command, also by ``python -m tissue``: a stop is met from its first import to
its last clean-up.
"""

import signal
import sys
from typing import NoReturn

from tissue.system.stopping import Terminated, end_at_once, terminated_as_exception


def main() -> NoReturn:
    """Entry point; see `tissue.cli.main.main`."""
    try:
        with terminated_as_exception():
            from tissue.cli.main import main as command

            command()
    except KeyboardInterrupt as stopped:
        print("stopped before anything was begun", file=sys.stderr)
        end_at_once(stopped.exit_code if isinstance(stopped, Terminated) else 130)
    except SystemExit as ended:
        if isinstance(ended.code, int) and ended.code > 128:
            end_at_once(ended.code)
        raise
    finally:
        # once more while Python ends: it ends at once, and prints nothing
        signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    main()
