"""OpenIGTLink server: several clients, one that leaves, one that reads nothing, invalid bytes."""

import json
import socket
import time
from pathlib import Path

import numpy as np
import pytest

from tissue.links import igtl_messages as igtl
from tissue.links import igtl_server
from tissue.links.igtl_server import IgtlServer

HELD = json.loads((Path(__file__).parents[2] / "fixtures" / "igtl_vectors.json").read_text("utf-8"))
TRANSFORM = bytes.fromhex(HELD["messages"]["transform"])
STRING = bytes.fromhex(HELD["messages"]["string"])


@pytest.fixture
def server():
    made = IgtlServer(0)
    yield made
    made.close()


def until(server, done, *, longest_s=60.0):
    """Poll a server until something is so; all that it received meanwhile."""
    limit, found = time.monotonic() + longest_s, []
    while not done(found):
        assert time.monotonic() < limit, found
        found += server.poll(0.01)[1]
    return found


def connect(server, count=1):
    """Clients of a server."""
    before = len(server.clients)
    made = [socket.create_connection(server.address) for _ in range(count)]
    until(server, lambda _: len(server.clients) == before + count)
    return made


def read(client, size):
    """Read `size` bytes of a client's connection."""
    client.settimeout(60.0)
    came = b""
    while len(came) < size:
        came += client.recv(size - len(came))
    return came


def test_all_clients_get_what_is_sent_and_what_they_send_comes_piece_by_piece(server):
    one, two = connect(server, 2)
    with one, two:
        assert server.address[0] == "127.0.0.1"
        assert server.send(STRING) == 2
        assert read(one, len(STRING)) == read(two, len(STRING)) == STRING
        two.sendall(TRANSFORM[:50])
        until(server, lambda _: server.clients[1]._inbox)
        two.sendall(TRANSFORM[50:] + STRING)
        found = until(server, lambda found: len(found) == 2)
        assert [each.header.kind for each in found] == ["TRANSFORM", "STRING"]
        assert found[0].client is server.clients[1] and found[0].content == TRANSFORM[58:]
        assert server.send(STRING, to=[server.clients[0]]) == 1


def crc_wrong():
    """A message one bit of whose body is another."""
    message = bytearray(TRANSFORM)
    message[-1] ^= 1
    return bytes(message)


def huge():
    """A header that announces more than any message has."""
    message = bytearray(TRANSFORM)
    message[42:50] = (2**62).to_bytes(8, "big")
    return bytes(message)


@pytest.mark.parametrize(
    "garbage",
    [
        b"GET / HTTP/1.1\r\nHost: localhost\r\nAccept: everything that there is\r\n\r\n",
        crc_wrong(),
        huge(),
    ],
    ids=["http", "crc", "huge"],
)
def test_a_client_that_sends_garbage_is_disconnected_and_no_other(server, garbage):
    good, bad = connect(server, 2)
    with good, bad:
        bad.sendall(garbage)
        until(server, lambda _: server.refused == 1)
        assert read_end(bad)
        assert server.send(STRING) == 1 and read(good, len(STRING)) == STRING


def read_end(client):
    """Return True if the other end has closed a connection."""
    client.settimeout(60.0)
    try:
        return client.recv(1) == b""
    except ConnectionResetError:
        return True


@pytest.mark.parametrize("seed", range(20))
def test_random_bytes_raise_nothing(server, seed):
    rng = np.random.default_rng(seed)
    message = bytearray(TRANSFORM * 3)
    for place in rng.integers(0, len(message), 1 + seed % 4):
        message[place] = rng.integers(0, 256)
    good, bad = connect(server, 2)
    with good, bad:
        bad.sendall(bytes(message) if seed % 5 else rng.bytes(500))
        bad.shutdown(socket.SHUT_WR)
        until(server, lambda _: len(server.clients) == 1)
        assert server.send(STRING) == 1 and read(good, len(STRING)) == STRING


def test_a_client_that_takes_nothing_misses_the_stream_and_is_then_disconnected(
    server, monkeypatch
):
    slow, quick = connect(server, 2)
    with slow, quick:
        held = server.clients[0]
        piece = igtl.packed("STRING", "a", igtl.string_body("a" * 60_000), time_s=0.0)
        for _ in range(1000):  # 60 MB are more than the system holds for a connection
            held.put(piece)
        held.write()
        assert held.waits
        assert server.send(TRANSFORM, is_stream=True) == 1, "only the other client takes it"
        assert read(quick, len(TRANSFORM)) == TRANSFORM
        monkeypatch.setattr(igtl_server, "STALLED_S", 0.05)
        until(server, lambda _: len(server.clients) == 1)
        assert server.refused == 1
