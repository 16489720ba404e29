"""Poses in, wrenches out: over UDP by the example clients, and on the topics of ROS 2.

The packages of ROS 2 are a stand-in, as in `test_ros2`.
"""

import importlib.util
import json
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from network_client import HELLO, REFUSED, WRENCH, UdpClient
from ros2_stand_in import LOG, write_packages

import tissue
from tissue.links.pose_server import serve_network, serve_ros2
from tissue.scene.coupling import Hardware

CLIENTS = Path(__file__).resolve().parents[3] / "examples/clients"
STAND_INS = ("rclpy", "geometry_msgs", "crtk_msgs", "stand_in_messages")
TIPS_MM = np.array([[0.0, 0.0, 1.0 - 0.01 * step] for step in range(120)])


def expected():
    """Wrenches of the test wall for `TIPS_MM`; the first pose is the start."""
    loop = tissue.Loop("wall")
    loop.reset(TIPS_MM[0])
    return np.array([np.zeros(6), *(loop.step(tip) for tip in TIPS_MM[1:])])


@pytest.fixture
def served():
    """Port of a server of the test wall in a second thread."""
    ready, stop, ports = threading.Event(), threading.Event(), []

    def opened(address):
        ports.append(int(address.rpartition(":")[2]))
        ready.set()

    loop = tissue.Loop("wall")
    hardware = Hardware(address="udp://127.0.0.1:0")
    thread = threading.Thread(
        target=serve_network, args=(loop, hardware), kwargs={"opened": opened, "ends": stop.is_set}
    )
    thread.start()
    assert ready.wait(10.0)
    yield ports[0]
    stop.set()
    thread.join(10.0)
    assert not thread.is_alive()


def test_the_client_in_python_gets_the_wrench_of_every_pose(served):
    spec = importlib.util.spec_from_file_location("pose_client", CLIENTS / "pose_client.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for _ in range(2):  # a second client begins with the uncut tissue
        client = module.PoseClient(served)
        wrenches = np.array([client.move(tuple(tip)) for tip in 1e-3 * TIPS_MM])
        client.close()
        np.testing.assert_allclose(wrenches, expected(), atol=1e-9)
    assert wrenches[-1, 2] > 0.1


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_client_in_c_gets_the_same_force(served, tmp_path):
    program = tmp_path / "pose_client"
    source = CLIENTS / "pose_client.c"
    subprocess.run(["cc", "-O2", "-Wall", "-Werror", "-o", program, source], check=True)
    found = [
        subprocess.run([*words, str(served), "600"], capture_output=True, text=True, check=True)
        for words in ([program], [sys.executable, CLIENTS / "pose_client.py"])
    ]
    by_c, by_python = (each.stdout.split(";")[0] for each in found)
    assert by_c == by_python and float(by_c.split()[2]) > 0.1


def test_a_client_says_once_that_no_server_answers(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        words = [sys.executable, CLIENTS / "pose_client.py", str(port), "10"]
        with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as client:
            first = client.stderr.readline()
            time.sleep(0.5)
            client.kill()
            rest = client.stderr.read()
    assert first == f"no server answers at 127.0.0.1:{port} yet\n" and rest == ""


def test_a_server_says_that_it_prepares_and_ends_at_once_on_sigterm():
    words = [
        sys.executable,
        "-m",
        "tissue",
        "serve",
        "liver-press",
        "--address",
        "udp://127.0.0.1:0",
    ]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as server:
        first = server.stderr.readline()
        server.terminate()
        assert server.wait(20.0) == -signal.SIGTERM
        rest = server.stderr.read()
    assert first == "preparing the tissue of liver-press; clients are answered afterwards\n"
    assert rest == ""


def test_a_pose_that_cannot_be_used_is_refused_with_a_sentence(served):
    with UdpClient(f"udp://127.0.0.1:{served}") as client:
        client.next(HELLO)
        assert client.receive()[0] == HELLO
        client.pose(0.0, 0.0, 1e-3)
        assert client.receive()[0] == WRENCH
        client.pose(0.0, 0.0, 1.0)
        kind, *_, payload = client.receive()
        assert kind == REFUSED and b"10 mm in 1 ms" in payload


def test_a_pose_on_servo_cp_is_answered_with_its_force(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(write_packages(tmp_path / "packages"))
    monkeypatch.setenv(LOG, str(tmp_path / "log"))
    import rclpy
    from geometry_msgs.msg import PoseStamped

    wanted = expected()
    opened = []
    try:
        for tip in 1e-3 * TIPS_MM:
            message = PoseStamped()
            message.pose.position.x, message.pose.position.y, message.pose.position.z = tip.tolist()
            rclpy.incoming.append(("/tissue/servo_cp", message))
        far = PoseStamped()
        far.pose.position.z = 1.0
        rclpy.incoming.append(("/tissue/servo_cp", far))
        loop = tissue.Loop("wall")
        answers = serve_ros2(loop, opened=opened.append, ends=lambda: not rclpy.incoming)
    finally:
        for name in [name for name in sys.modules if name.split(".")[0] in STAND_INS]:
            del sys.modules[name]
    assert answers == len(TIPS_MM) and opened == ["/tissue/servo_cp"]
    entries = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    forces = [each["wrench"] for each in entries if each["topic"] == "/tissue/measured_cf"]
    found = [[*each["force"].values(), *each["torque"].values()] for each in forces]
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    places = [each["pose"] for each in entries if each["topic"] == "/tissue/measured_cp"]
    assert [each["position"]["z"] for each in places] == (1e-3 * TIPS_MM[:, 2]).tolist()
    assert any(each["topic"] == "error" and "10 mm in 1 ms" in each["message"] for each in entries)
