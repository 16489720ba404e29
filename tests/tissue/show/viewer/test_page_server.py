"""The server of a page: whom it answers, and what goes between it and the page."""

import asyncio
import json
from contextlib import asynccontextmanager
from types import SimpleNamespace

import pytest

pytest.importorskip("aiohttp")
import aiohttp
import psutil

from tissue.show.viewer.web import server as served
from tissue.show.viewer.web.server import (
    HOST,
    MessageError,
    PageServer,
    parse,
    refusal,
)

HOME = {"Host": "127.0.0.1:80", "Origin": "http://127.0.0.1:80", "token": "abc", "path": "/socket"}


class Counted:
    """A session that counts frames and keeps what it was given."""

    kind = "live"

    def __init__(self):
        self.over, self.taken, self.attended, self.count = False, [], [], 0

    def hello(self):
        return {"scene": "wall"}

    def take(self, do, values):
        self.taken.append((do, values))
        self.over = self.over or do == "end"

    def attend(self, attended):
        self.attended.append(attended)

    def leave(self):
        self.over = True

    def frame(self, drawing):
        self.count += 1
        return {"count": self.count}, b"picture" if drawing else None


@asynccontextmanager
async def serving(session):
    """A server of a session, and a client for it."""
    opened = asyncio.get_running_loop().create_future()
    page = PageServer(session)
    task = asyncio.ensure_future(page.serve(opened.set_result))
    address = await asyncio.wait_for(opened, 60.0)
    async with aiohttp.ClientSession() as client:
        yield address, client
    session.over = True
    await asyncio.wait_for(task, 60.0)


@asynccontextmanager
async def connected(session):
    """An open socket of a page that shows a session."""
    async with serving(session) as (address, client):
        home, _, ws = parts(address)
        async with client.ws_connect(ws, headers={"Origin": home}) as page_socket:
            yield page_socket


def parts(address):
    """An address without its token, its origin, and its socket."""
    home, token = address.split("/?token=")
    return home, token, f"{home.replace('http', 'ws')}/socket?token={token}"


async def until(holds):
    """Let the server work until something holds."""
    while not holds():
        await asyncio.sleep(0.01)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({}, None),
        ({"path": "/", "Origin": None}, None),
        ({"Host": "localhost:80"}, "address"),
        ({"Host": "evil.example:80"}, "address"),
        ({"Host": "127.0.0.1:81"}, "address"),
        ({"Origin": "http://evil.example"}, "page"),
        ({"Origin": "null"}, "page"),
        ({"Origin": "https://127.0.0.1:80"}, "page"),
        ({"Origin": None}, "page"),
        ({"path": "/", "Origin": "http://127.0.0.1:8000"}, "page"),
        ({"token": ""}, "token"),
        ({"token": "abcd"}, "token"),
        ({"token": "äbc"}, "token"),
    ],
)
def test_only_this_page_with_its_token_is_answered(change, why):
    asked = {**HOME, **change}
    headers = {name: asked[name] for name in ("Host", "Origin") if asked[name] is not None}
    request = SimpleNamespace(headers=headers, query={"token": asked["token"]}, path=asked["path"])
    found = refusal(request, 80, "abc")
    assert (found is None) == (why is None)
    assert why is None or why in found


def test_requests_without_the_token_or_by_another_name_get_403():
    async def ask():
        session = Counted()
        async with serving(session) as (address, client):
            home, token, ws = parts(address)
            found = []
            for url, headers in (
                (address, {}),
                (f"{home}/", {}),
                (f"{home}/other", {}),
                (address, {"Host": f"evil.example:{home.rsplit(':', 1)[1]}"}),
            ):
                async with client.get(url, headers=headers) as answer:
                    found.append((answer.status, (await answer.text())[:8]))
            async with client.get(f"{home}/other?token={token}") as answer:
                found.append((answer.status, "missing"))
            refused = []
            for url, headers in ((ws, {}), (ws.replace(token, "x"), {"Origin": home})):
                with pytest.raises(aiohttp.WSServerHandshakeError) as error:
                    await client.ws_connect(url, headers=headers)
                refused.append(error.value.status)
            return found, refused, session.attended

    found, refused, attended = asyncio.run(ask())
    assert found == [(200, "<!DOCTYP"), *[(403, "refused:")] * 3, (404, "missing")]
    assert refused == [403] * 2 and attended == []


def test_the_page_is_served_on_this_machine_alone_and_loads_nothing_else():
    async def ask():
        async with serving(Counted()) as (address, client):
            port = int(parts(address)[0].rsplit(":", 1)[1])
            async with client.get(address) as answer:
                headers, text = answer.headers, await answer.text()
            mine = psutil.Process().net_connections(kind="tcp")
            served_at = [each.laddr for each in mine if each.status == "LISTEN"]
            return headers, text, {each.ip for each in served_at if each.port == port}

    headers, text, listening = asyncio.run(ask())
    assert listening == {"127.0.0.1"}
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; ") and "frame-ancestors 'none'" in policy
    assert f"connect-src ws://{HOST}:" in policy and "unsafe" not in policy and "http" not in policy
    assert (headers["Referrer-Policy"], headers["Cache-Control"]) == ("no-referrer", "no-store")
    nonce = policy.split("script-src 'nonce-")[1].split("'")[0]
    assert text.count(f'nonce="{nonce}"') == 2 and "{{" not in text
    assert not [word for word in ("http://", "https://", "//cdn", "src=") if word in text]


def test_figures_and_pictures_arrive_and_the_next_picture_waits_until_the_last_was_seen():
    async def ask():
        session, seen = Counted(), []
        async with connected(session) as page_socket:
            first = await page_socket.receive_json()
            while len(seen) < 8:
                seen.append((await page_socket.receive()).data)
            await page_socket.send_json({"do": "seen"})
            while seen.count(b"picture") < 2:
                seen.append((await page_socket.receive()).data)
            await page_socket.send_json({"do": "move", "right": 0.1, "up": -0.2})
            await until(lambda: session.taken)
            await page_socket.close()
            await until(lambda: len(session.attended) == 2)
        return first, seen, session

    first, seen, session = asyncio.run(ask())
    assert first == {"hello": {"scene": "wall"}}
    assert seen[:8].count(b"picture") == 1
    counts = [json.loads(each)["count"] for each in seen if isinstance(each, str)]
    assert counts == sorted(counts) and len(counts) >= 7
    assert session.taken == [("move", {"right": 0.1, "up": -0.2})] and session.attended == [
        True,
        False,
    ]


HOSTILE = {
    "no JSON": "{",
    "an unknown one": '{"do": "wipe"}',
    "a number of 400 digits": '{"do": "zoom", "by": 1' + 400 * "0" + "}",
    "a negative one": '{"do": "turn", "right": -1' + 400 * "0" + ', "up": 0}',
    "an exponent": '{"do": "time", "time_s": 1e400}',
    "a lone surrogate": r'{"do": "\ud800"}',
    "a surrogate pair": r'{"do": "\ud83d\ude00"}',
    "long words": json.dumps({"do": "\U0001f600" * 60}, ensure_ascii=False),
    "long control characters": json.dumps({"do": "\x00" * 100}),
}


@pytest.mark.parametrize("hostile", HOSTILE)
def test_hostile_messages_close_the_socket_with_a_reason_and_the_next_page_is_served(
    hostile, caplog
):
    async def ask():
        session = Counted()
        async with serving(session) as (address, client):
            home, _, ws = parts(address)
            async with client.ws_connect(ws, headers={"Origin": home}) as page_socket:
                await page_socket.send_str(HOSTILE[hostile])
                message = await page_socket.receive()
                while message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY):
                    message = await page_socket.receive()
            async with client.ws_connect(ws, headers={"Origin": home}) as page_socket:
                hello = await page_socket.receive_json()
                await page_socket.send_json({"do": "zoom", "by": 2})
                await until(lambda: session.taken)
        return message, hello, session.taken

    message, hello, taken = asyncio.run(ask())
    assert (message.type, message.data) == (aiohttp.WSMsgType.CLOSE, 1008)
    assert message.extra.isascii() and 10 < len(message.extra) <= 123
    assert hello == {"hello": {"scene": "wall"}} and taken == [("zoom", {"by": 2})]
    assert not caplog.records  # an exception of a handler is logged


def test_a_page_that_reads_no_more_is_cut_off_and_the_frames_go_on(monkeypatch):
    """A half-open connection: the page sends and reads nothing, and its buffers are full."""
    monkeypatch.setattr(served, "SENDS_S", 0.2)

    class Large(Counted):
        def frame(self, drawing):
            self.count += 1
            return {"count": self.count, "much": 4_000_000 * "x"}, None

    async def ask():
        session = Large()
        async with serving(session) as (address, _):
            home, _, ws = parts(address)
            host, port = home.removeprefix("http://").split(":")
            _reader, writer = await asyncio.open_connection(host, int(port), limit=1024)
            writer.write(
                f"GET {ws.split(port)[1]} HTTP/1.1\r\nHost: {host}:{port}\r\nOrigin: "
                f"{home}\r\nUpgrade: websocket\r\n"
                "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
                "Sec-WebSocket-Version: 13\r\n\r\n".encode()
            )
            await asyncio.wait_for(until(lambda: len(session.attended) == 2), 20.0)
            count = session.count
            await asyncio.wait_for(until(lambda: session.count > count + 3), 20.0)
            writer.transport.abort()
        return session.attended

    assert asyncio.run(ask()) == [True, False]


def test_a_newer_page_takes_the_place_of_the_older():
    async def ask():
        session = Counted()
        async with serving(session) as (address, client):
            home, _, ws = parts(address)
            async with (
                client.ws_connect(ws, headers={"Origin": home}) as older,
                client.ws_connect(ws, headers={"Origin": home}) as newer,
            ):
                async for _ in older:
                    pass
                await newer.send_json({"do": "pause", "on": True})
                await until(lambda: session.taken)
                return older.close_code, list(session.attended)

    code, attended = asyncio.run(ask())
    assert code == 4001 and attended == [True, True]  # the older one's end is no end of looking


def test_it_ends_when_no_page_comes_back(monkeypatch):
    monkeypatch.setattr(served, "LEFT_S", 0.05)

    async def ask():
        session = Counted()
        async with serving(session) as (address, client):
            await until(lambda: session.count > 10)
            before = session.over
            home, _, ws = parts(address)
            async with client.ws_connect(ws, headers={"Origin": home}):
                pass
            await until(lambda: session.over)
            return before

    assert asyncio.run(ask()) is False  # one that never was open is waited for


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "1",
        "null",
        '{"do": 1}',
        "{}",
        '{"do": "seen", "x": 1}',
        '{"do": "size", "wide": 640}',
        '{"do": "size", "wide": 640, "tall": 1e9}',
        '{"do": "move", "right": NaN, "up": 0}',
        '{"do": "move", "right": "0", "up": 0}',
        '{"do": "move", "right": true, "up": 0}',
        '{"do": "pause", "on": 1}',
        '{"do": "key", "name": 3}',
        '{"do": "move", "right": Infinity, "up": 0}',
        "[" * 1000,
        '{"do": ["size"]}',
    ],
)
def test_other_messages_are_refused(text):
    with pytest.raises(MessageError):
        parse(text)
