# SPDX-License-Identifier: Apache-2.0
"""Another server's pages on this machine, under a policy that lets them talk to this machine alone."""

from __future__ import annotations

import contextlib
import http.client
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

HOST = "127.0.0.1"
_PATIENCE_S = 30.0
_PIECE = 1 << 16
#: What is passed on of an answer.
_HEADERS = ("Content-Type", "Content-Length", "Content-Encoding", "Cache-Control")


@contextlib.contextmanager
def page_server(source: int, data: int) -> Iterator[int]:
    """Serve the pages of `http://127.0.0.1:source` on another port of 127.0.0.1; yields the port.

    Parameters
    ----------
    source : port of the server whose pages they are
    data : port that the pages may talk to; others, on this machine or elsewhere, the browser refuses
    """
    policy = (
        "default-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' data: blob:; "
        f"connect-src 'self' data: blob: http://{HOST}:{data}; form-action 'none'; frame-ancestors 'none'"
    )

    class Handler(BaseHTTPRequestHandler):
        timeout = _PATIENCE_S

        def do_GET(self) -> None:
            with contextlib.closing(http.client.HTTPConnection(HOST, source, timeout=_PATIENCE_S)) as connection:
                try:
                    connection.request("GET", self.path)
                    answer = connection.getresponse()
                except OSError:
                    self.send_error(502)
                    return
                self.send_response(answer.status)
                for name in _HEADERS:
                    if value := answer.getheader(name):
                        self.send_header(name, value)
                self.send_header("Content-Security-Policy", policy)
                self.end_headers()
                with contextlib.suppress(OSError):  # the browser went away
                    while piece := answer.read(_PIECE):
                        self.wfile.write(piece)

        def log_message(self, format: str, *arguments: Any) -> None:
            """Say nothing."""

    with ThreadingHTTPServer((HOST, 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, name="pages", daemon=True)
        thread.start()
        try:
            yield server.server_address[1]
        finally:
            server.shutdown()
            thread.join(_PATIENCE_S)
