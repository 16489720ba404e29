"""Server of a page on this machine: access control, and pictures and values over a WebSocket."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from secrets import compare_digest, token_urlsafe
from typing import TYPE_CHECKING, Any, Protocol

from aiohttp import WSCloseCode, WSMsgType, web

from tissue.system.child import own_process

if TYPE_CHECKING:
    from aiohttp.typedefs import Handler

LARGEST = 1024
"""Largest size of a message [bytes].

The longest expected message contains the name of a field, and has some hundred bytes.
"""
LONGEST_REASON = 123
"""Longest reason for closing a WebSocket, according to RFC 6455 [bytes]."""
Values = dict[str, float | bool | str]
NUMBERS = {
    "size": {"wide": (64.0, 8192.0), "tall": (64.0, 8192.0)},
    "move": {"right": (-4.0, 4.0), "up": (-4.0, 4.0)},
    "turn": {"right": (-4.0, 4.0), "up": (-4.0, 4.0)},
    "zoom": {"by": (0.2, 5.0)},
    "depth": {"notches": (-20.0, 20.0)},
    "time": {"time_s": (-1e6, 1e6)},
}
"""Ranges of the numbers in messages, keyed by message and entry."""
WORDS = ("key", "field", "layer")
SWITCHES = ("pause", "play", "cut")
"""Messages whose only entry is the bool ``on``; messages in `WORDS` have only the text ``name``."""
ALONE = ("reset", "end", "seen")
"""Messages without entries."""


class MessageError(ValueError):
    """Error for a message that a page of this program would never send."""


def parse(text: str) -> tuple[str, Values]:
    """Parse the JSON text of a message, and return its command and a dict of its other entries.

    Raises
    ------
    MessageError
        If the message is invalid.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        raise MessageError("a message must be JSON") from None
    do = found.pop("do", None) if isinstance(found, dict) else None
    if not isinstance(do, str):
        raise MessageError("a message must be an object with do")
    ranges = NUMBERS.get(do, {})
    names = {*ranges, *(["name"] if do in WORDS else []), *(["on"] if do in SWITCHES else [])}
    if (not names and do not in ALONE) or set(found) != names:
        raise MessageError(f"{do[:40]!a} must be a known message with its entries alone")
    for name, value in found.items():
        low, high = ranges.get(name, (0.0, 0.0))
        kind = {"name": str, "on": bool}.get(name, int | float)
        fits = isinstance(value, kind) and (kind is bool or not isinstance(value, bool))
        # an integer may be too large for a float; NaN is in no range
        if not fits or (name in ranges and not low <= value <= high):
            raise MessageError(f"{name} of {do} must be in its range")
    return do, found


PAGE = Path(__file__).parent / "page"
FRAME_S = 1.0 / 30.0
REST_S = 0.004
"""Shortest time per frame that is left for reading the messages of the page [s].

Messages cannot be read while a picture is drawn. Without this time, the picture would lag behind
the mouse. `FRAME_S` is the time between two frames.
"""
LEFT_S = 8.0
"""Time for which a page may be closed before its session ends [s], long enough for a reload."""
SENDS_S = 5.0
"""Time for which a page may accept no data before its connection is closed [s].

The server waits for the page after each frame. Without this limit, a page that does not respond
would stop the session.
"""
CLOSES_S = 2.0
"""Time limit for closing a page from the server [s]."""
REPLACED = 4001
"""Code with which a page is closed when another page replaces it.

In RFC 6455, codes from 4000 on are free for applications.
"""
POLICY = (
    "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src data:; "
    "connect-src ws://{home}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Security policy: the page may load only its own content and its socket."""


class Session(Protocol):
    """Content of a page, and responses to its messages."""

    kind: str
    """Kind of the page: ``live`` or ``view``."""

    @property
    def over(self) -> bool:
        """True if the session has ended."""
        ...

    def hello(self) -> dict[str, Any]:
        """Return the data that a page needs when it is opened."""
        ...

    def take(self, do: str, values: Values) -> None:
        """Carry out a message of the page: its command ``do`` with its other entries."""
        ...

    def attend(self, attended: bool) -> None:
        """Handle the opening (``attended`` is True) or the closing of a page."""
        ...

    def leave(self) -> None:
        """End the session because no page was opened again."""
        ...

    def frame(self, drawing: bool) -> tuple[dict[str, Any] | None, bytes | None]:
        """Advance by one frame; return new values, and a picture if `drawing` is true."""
        ...


class PageServer:
    """Server of a session with one page.

    Parameters
    ----------
    session
        Session to serve.

    Attributes
    ----------
    address
        Address of the page, with a random token; empty until `serve` has started the server.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._token = token_urlsafe(TOKEN_BYTES)
        self._port = 0
        self.address = ""
        self._socket: web.WebSocketResponse | None = None
        self._line: asyncio.Transport | None = None
        self._drawing = True
        self._left_s = 0.0
        self._opened = False

    async def serve(self, opened: Callable[[str], object], *, port: int = 0) -> None:
        """Call ``opened`` with the address, and serve until the session is over."""
        app = web.Application(middlewares=[self._gate])
        app.router.add_get("/", self._page)
        app.router.add_get(SOCKET, self._connect)
        runner = web.AppRunner(
            app, access_log=None, handle_signals=False, shutdown_timeout=CLOSES_S
        )
        await runner.setup()
        try:
            site = web.TCPSite(runner, HOST, port)
            await site.start()
            self._port = int(runner.addresses[0][1])
            self.address = f"http://{HOST}:{self._port}/?token={self._token}"
            opened(self.address)
            await self._run()
        finally:
            if self._socket is not None:
                await _close(self._socket, self._line, WSCloseCode.OK, "over")
            await runner.cleanup()

    async def _run(self) -> None:
        """Run frame after frame until the session is over."""
        loop = asyncio.get_running_loop()
        session = self._session
        while not session.over:
            began = loop.time()
            socket = self._socket
            if socket is None and self._opened and began - self._left_s > LEFT_S:
                session.leave()
            figures, picture = session.frame(socket is not None and self._drawing)
            if socket is not None and not socket.closed:
                try:
                    async with asyncio.timeout(SENDS_S):
                        if figures is not None:
                            await socket.send_str(json.dumps(figures))
                        if picture is not None:
                            self._drawing = False
                            await socket.send_bytes(picture)
                except ConnectionError:
                    pass  # its own loop finds it closed
                except TimeoutError:
                    _cut(self._line)
            await asyncio.sleep(max(FRAME_S - (loop.time() - began), REST_S))

    @web.middleware
    async def _gate(self, request: web.Request, handler: "Handler") -> web.StreamResponse:
        """Respond to refused requests with status 403."""
        why = refusal(request, self._port, self._token)
        if why is not None:
            return web.Response(status=403, text=f"refused: {why}\n", headers=HEADERS)
        answer = await handler(request)
        if not answer.prepared:
            answer.headers.update(HEADERS)
        return answer

    async def _page(self, request: web.Request) -> web.Response:
        # 96 random bits, which no content of the page can guess
        nonce = token_urlsafe(12)
        policy = POLICY.format(nonce=nonce, home=f"{HOST}:{self._port}")
        text = page_text(self._session.kind, nonce)
        return web.Response(
            text=text, content_type="text/html", headers={"Content-Security-Policy": policy}
        )

    async def _connect(self, request: web.Request) -> web.WebSocketResponse:
        # There is no heartbeat. On one machine the system reports that a page is gone, and a
        # picture may take seconds to draw.
        socket = web.WebSocketResponse(timeout=CLOSES_S, max_msg_size=LARGEST)
        await socket.prepare(request)
        before = self._socket
        its_line = self._line
        self._socket = socket
        self._line = request.transport
        self._drawing = self._opened = True
        if before is not None:
            await _close(before, its_line, REPLACED, "another page shows it now")
        session = self._session
        loop = asyncio.get_running_loop()
        await socket.send_str(json.dumps({"hello": session.hello()}))
        session.attend(True)
        try:
            async for message in socket:
                if message.type is not WSMsgType.TEXT:
                    raise MessageError("a message must be text")
                do, values = parse(message.data)
                if do == "seen":
                    self._drawing = True
                else:
                    session.take(do, values)
                # pictures are drawn between messages, however many messages come
                await asyncio.sleep(0.0)
                if request.transport is None or request.transport.is_closing():
                    break  # the page is gone, and its earlier messages are ignored
        except MessageError as error:
            await _close(socket, request.transport, WSCloseCode.POLICY_VIOLATION, str(error))
        finally:
            if self._socket is socket:
                self._socket = None
                self._left_s = loop.time()
                session.attend(False)
        return socket


async def _close(
    socket: web.WebSocketResponse, line: asyncio.Transport | None, code: int, reason: str
) -> None:
    """Close the socket of a page with a code and a reason.

    The connection is cut if the page no longer reads.
    """
    try:
        async with asyncio.timeout(CLOSES_S):
            message = reason.encode("ascii", "backslashreplace")[:LONGEST_REASON]
            await socket.close(code=code, message=message)
    except TimeoutError:
        _cut(line)


def _cut(line: asyncio.Transport | None) -> None:
    """End a connection at once and discard pending data."""
    if line is not None:
        line.abort()


def page_text(kind: str, nonce: str) -> str:
    """Return the HTML text of a page.

    Scripts and styles are part of the text, so the page loads no other files. The token is
    therefore needed only in the address of the page.
    """
    text = (PAGE / f"{kind}.html").read_text("utf-8")
    script = "\n".join(
        (PAGE / name).read_text("utf-8") for name in ("common.js", "plot.js", f"{kind}.js")
    )
    style = (PAGE / "page.css").read_text("utf-8")
    return (
        text.replace("{{nonce}}", nonce).replace("{{style}}", style).replace("{{script}}", script)
    )


HOST = "127.0.0.1"
"""Address of the server, which other machines cannot reach."""
SOCKET = "/socket"
TOKEN_BYTES = 24
"""Length of the random token [bytes]; 192 bits cannot be guessed."""
HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Headers of each response.

The headers forbid that the response is stored, that other sites embed the page, and that the token
in the address is passed on.
"""


def refusal(request: web.BaseRequest, port: int, token: str) -> str | None:
    """Return the reason why a request is refused, or None.

    Another website may let its own host name point to this machine (DNS rebinding). The Host header
    of such a request contains that host name. If another website opens the WebSocket, the Origin
    header names that website, because browsers always send this header with a WebSocket.
    """
    home = f"{HOST}:{port}"
    origin = request.headers.get("Origin")
    if request.headers.get("Host", "") != home:
        return "the address must be the one that tissue printed"
    if origin != f"http://{home}" and (origin is not None or request.path == SOCKET):
        return "the page must be the one that tissue serves"
    if not compare_digest(request.query.get("token", "").encode(), token.encode()):
        return "the address must hold the token that tissue printed"
    return None


def serve(make: Callable[[], Session], *, beside_ticks: bool) -> None:
    """Create a session and serve it until the session is over.

    The address is printed on standard output after the word ``ready``.

    Parameters
    ----------
    make
        Function that creates the session.
    beside_ticks
        True if another process computes the ticks of a live run. This process then gets a lower
        priority.
    """
    standard_output = own_process(beside_ticks=beside_ticks)
    import pyvista

    # drawn in software, smooth edges take three times as long
    pyvista.global_theme.multi_samples = 1
    server = PageServer(make())
    asyncio.run(
        server.serve(lambda address: print(f"ready {address}", file=standard_output, flush=True))
    )
