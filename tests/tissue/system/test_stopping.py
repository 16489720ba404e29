"""End of a process after a stop."""

import subprocess
import sys
import textwrap


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
