"""The page of a saved run as its command sees it: served and ended."""

import subprocess
import sys

import pytest

from tissue.show.viewer.run_scene import Choice
from tissue.show.viewer.view import serve_view
from tissue.system.stopping import Terminated

SERVED = "print('ready http://127.0.0.1:1/?token=x', flush=True); "


@pytest.fixture
def child(monkeypatch):
    """Runs other code in place of the page's process; gives the processes that were started."""
    started = []

    def run(code, *, environments=({},)):
        def start(folder, choice, environment, output):
            pipe = subprocess.PIPE
            process = subprocess.Popen(
                [sys.executable, "-c", code], stdout=pipe, stderr=output, text=True
            )
            started.append((process, environment))
            return process

        monkeypatch.setattr("tissue.show.viewer.view._start", start)
        monkeypatch.setattr(
            "tissue.show.viewer.view.drawing_environments", lambda: iter(environments)
        )
        return started

    return run


@pytest.mark.parametrize("stop", [KeyboardInterrupt, Terminated])
def test_ctrl_c_ends_the_page_and_a_signal_the_command(child, tmp_path, stop):
    started = child(SERVED + "import time; time.sleep(600)")

    def interrupt(address):
        raise stop(15) if stop is Terminated else stop

    if stop is Terminated:
        with pytest.raises(Terminated):
            serve_view(tmp_path, Choice(), interrupt)
    else:
        serve_view(tmp_path, Choice(), interrupt)
    ((process, _),) = started
    assert process.poll() is not None, "its process is left behind"
