"""The server of the page: on this machine only, for requests that were meant for it, until Ctrl-C."""

from __future__ import annotations

import errno
import os
import socket
import threading
import webbrowser
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

import uvicorn
from fastapi import FastAPI

from fmu_export.errors import UserError

from .exploration import Exploration
from .page import install

HOST = "127.0.0.1"

POLICY = "default-src 'self' 'unsafe-inline' 'unsafe-eval' data:; frame-ancestors 'none'; form-action 'none'"
"""What pages may load: what this server has, and nothing from a network. Vue needs the unsafe ones."""

GRACE = 1
"""Seconds that open connections have at the end."""

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Message, Receive, Send], Awaitable[None]]


class Guard:
    """Lets through what was asked of this very address by a page of its own.

    A foreign page can have a name that leads here (DNS rebinding), then the Host is that name; or it can open a connection
    from the user's browser, then the Origin is another.
    """

    def __init__(self, app: Application, port: int) -> None:
        self.app = app
        names = [f"{name}:{port}" for name in (HOST, "localhost")]
        self.hosts = [name.encode() for name in names]
        self.origins = [None, *(f"http://{name}".encode() for name in names)]

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it with 403."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        if headers.get(b"host") in self.hosts and headers.get(b"origin") in self.origins:
            await self.app(scope, receive, _with_policy(send))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await send({"type": "http.response.start", "status": 403, "headers": [(b"content-type", b"text/plain")]})
            await send({"type": "http.response.body", "body": b"this page is for this machine only"})


def _with_policy(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], (b"content-security-policy", POLICY.encode())]
        await send(message)

    return sent


def listening(port: int) -> socket.socket:
    """Return a socket of this machine that listens on a port, 0: a free one; raises UserError where that is in use."""
    place = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    if os.name == "posix":  # a port in TIME_WAIT is free; on Windows this would take one that is in use
        place.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        place.bind((HOST, port))
        place.listen()
    except OSError as error:
        place.close()
        why = "is in use; another, or none for a free one" if error.errno == errno.EADDRINUSE else error.strerror
        raise UserError(f"--port {port} {why}") from None
    return place


def serve(exploration: Exploration, place: socket.socket, *, browser: bool, ready: Callable[[str], None]) -> None:
    """Serve the page until Ctrl-C, which it takes for its end; `ready` is called with the address."""
    port = place.getsockname()[1]
    address = f"http://{HOST}:{port}/"
    app = FastAPI(openapi_url=None)
    install(app, exploration)
    app.add_middleware(Guard, port=port)  # type: ignore[arg-type]
    config = uvicorn.Config(app, log_level="error", timeout_graceful_shutdown=GRACE, ws_per_message_deflate=False)
    server = _Server(config, lambda: _told(address, browser, ready), exploration.end)
    try:
        server.run(sockets=[place])
    except KeyboardInterrupt:  # uvicorn has ended by it, and hands it on
        pass
    finally:
        exploration.end()


def _told(address: str, browser: bool, ready: Callable[[str], None]) -> None:
    ready(address)
    if browser:
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()


class _Server(uvicorn.Server):
    """Says when it has begun, and at once when it is to end."""

    def __init__(self, config: uvicorn.Config, begun: Callable[[], None], ending: Callable[[], None]) -> None:
        super().__init__(config)
        self._begun, self._ending = begun, ending

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin."""
        await super().startup(sockets)
        self._begun()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End."""
        self._ending()
        await super().shutdown(sockets)
