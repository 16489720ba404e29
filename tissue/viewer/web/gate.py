"""Who may see a page: requests to this machine's own address, with the token, from no other site."""

from collections.abc import Callable
from secrets import compare_digest, token_urlsafe
from typing import TYPE_CHECKING

from aiohttp import web

if TYPE_CHECKING:
    from aiohttp.typedefs import Handler, Middleware

__all__ = ["HOST", "SOCKET", "gate", "new_token", "refusal"]

HOST = "127.0.0.1"
"""Address that is served; no other machine reaches it."""
SOCKET = "/socket"
TOKEN_BYTES = 24
HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Of every answer: nothing is kept, no other site embeds it, and the token in the address is not sent on."""


def new_token() -> str:
    """A random token of 192 bits that can stand in an address."""
    return token_urlsafe(TOKEN_BYTES)


def refusal(*, host: str, origin: str | None, given: str, port: int, token: str, socket: bool) -> str | None:
    """Why a request is refused, or None.

    A page of another site that asks by a name which it lets point here (DNS rebinding) is known by its Host, one that
    opens the socket by its Origin, which browsers always send then.

    Parameters
    ----------
    host, origin
        Headers of the request.
    given
        Token in its address.
    port, token
        Where it is served and the token that opens it.
    socket
        Whether it opens the socket.
    """
    home = f"{HOST}:{port}"
    if host != home:
        return "the address must be the one that tissue printed"
    if (socket and origin is None) or (origin is not None and origin != f"http://{home}"):
        return "the page must be the one that tissue serves"
    if not compare_digest(given.encode(), token.encode()):
        return "the address must hold the token that tissue printed"
    return None


def gate(token: str, port: Callable[[], int]) -> "Middleware":
    """Middleware that answers 403 to what `refusal` refuses; ``port`` is known once it is served."""

    @web.middleware
    async def judge(request: web.Request, handler: "Handler") -> web.StreamResponse:
        why = refusal(
            host=request.headers.get("Host", ""),
            origin=request.headers.get("Origin"),
            given=request.query.get("token", ""),
            port=port(),
            token=token,
            socket=request.path == SOCKET,
        )
        if why is not None:
            return web.Response(status=403, text=f"refused: {why}\n", headers=HEADERS)
        answer = await handler(request)
        if not answer.prepared:
            answer.headers.update(HEADERS)
        return answer

    return judge
