"""The server of the page: for this machine only, and it ends by Ctrl-C."""

import asyncio

import pytest

from cosim.errors import UserError
from cosim.explore.server import Guard, listening


@pytest.mark.parametrize(
    ("kind", "headers", "passes"),
    [
        ("http", {"host": "127.0.0.1:8000"}, True),
        ("http", {"host": "localhost:8000", "origin": "http://localhost:8000"}, True),
        ("http", {"host": "rebound.example:8000"}, False),
        ("http", {"host": "127.0.0.1:8001"}, False),
        ("http", {}, False),
        ("websocket", {"host": "127.0.0.1:8000", "origin": "http://127.0.0.1:8000"}, True),
        ("websocket", {"host": "127.0.0.1:8000", "origin": "https://foreign.example"}, False),
        ("websocket", {"host": "127.0.0.1:8000", "origin": "null"}, False),
    ],
)
def test_only_what_a_page_of_its_own_asks_gets_through(kind, headers, passes):
    reached, sent = [], []

    async def app(scope, _receive, send):
        reached.append(scope)
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    scope = {"type": kind, "headers": [(name.encode(), value.encode()) for name, value in headers.items()]}
    asyncio.run(Guard(app, 8000)(scope, None, send))  # type: ignore[arg-type]
    assert bool(reached) is passes
    if passes:
        assert b"default-src 'self'" in dict(sent[0]["headers"])[b"content-security-policy"]
    else:
        assert sent[0] == {"type": "websocket.close", "code": 1008} or sent[0]["status"] == 403


def test_a_port_in_use_is_a_sentence_and_none_is_a_free_one():
    with listening(0) as place:
        host, port = place.getsockname()
        assert host == "127.0.0.1"
        with pytest.raises(UserError, match=f"^--port {port} is in use; another, or none for a free one$"):
            listening(port)
