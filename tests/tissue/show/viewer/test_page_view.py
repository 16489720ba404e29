"""The page of a saved run as its command sees it: served, ended, refused."""

import subprocess
import sys

import pytest

from tissue import InputError
from tissue.show.viewer.run_scene import Choice
from tissue.show.viewer.view import serve_view, view
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


def test_where_one_library_fails_to_draw_the_next_is_taken(child, tmp_path):
    code = "import sys; sys.exit('EGL is missing')"
    started = child(code, environments=({"A": "1"}, {"A": "2"}))
    with pytest.raises(
        InputError, match=r"^--web must serve a page, but EGL is missing: install libegl1 and "
    ):
        serve_view(tmp_path, Choice(), print)
    assert [environment for _, environment in started] == [{"A": "1"}, {"A": "2"}]
    child("", environments=())
    with pytest.raises(InputError, match="but this machine has no OpenGL library: "):
        serve_view(tmp_path, Choice(), print)
    child("import sys; sys.exit(3)")
    with pytest.raises(InputError, match="but its process ended with exit code 3: "):
        serve_view(tmp_path, Choice(), print)


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


def test_a_page_is_refused_for_an_imported_bone_and_without_its_server(
    whole, tmp_path, monkeypatch
):
    monkeypatch.setattr("tissue.show.viewer.view.is_imported", lambda path: True)
    with pytest.raises(InputError, match=r"^web must be left out for an imported bone"):
        view(tmp_path, opened=print)
    monkeypatch.setattr("tissue.show.viewer.view.is_imported", lambda path: False)
    monkeypatch.setattr("tissue.simulation.live.window.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"^--web must have aiohttp to serve its page, got none"):
        view(whole, opened=print)
