"""End of a process after a stop."""

import subprocess
import sys
import textwrap

import pytest


def test_a_stopped_process_ends_although_a_thread_waits_for_work():
    """Its exit handlers run, and what it printed is not lost."""
    script = """
        import atexit
        from concurrent.futures import ThreadPoolExecutor

        from tissue.system.stopping import end_at_once

        atexit.register(lambda: print("exit handler"))
        idle = ThreadPoolExecutor(1)
        idle.submit(int).result()
        print("printed")
        end_at_once(143)
    """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    assert ended.returncode == 143
    assert ended.stdout.split("\n")[:2] == ["printed", "exit handler"]


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_stop_is_not_lost_in_a_package_that_catches_every_exception(name: str) -> None:
    """Code with the module name of trimesh receives the signal and catches its exception."""
    script = f"""
        import signal
        import textwrap
        import time

        from tissue.system.stopping import terminated_as_exception

        # a shell starts programs in the background with an ignored SIGINT
        signal.signal(signal.SIGINT, signal.default_int_handler)
        package = textwrap.dedent('''
            import signal
            try:
                signal.raise_signal(signal.{name})
            except BaseException:
                pass
        ''')
        try:
            with terminated_as_exception():
                exec(package, {{"__name__": "trimesh.base"}})
                time.sleep(30.0)
        except KeyboardInterrupt as stopped:
            print(type(stopped).__name__)
    """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=25.0, check=False)
    expected = {"SIGINT": "KeyboardInterrupt", "SIGTERM": "Terminated"}[name]
    assert ended.stdout.strip() == expected, ended.stderr
