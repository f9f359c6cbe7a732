"""A server for this machine's browser alone: pages that are made when they are asked for."""

from __future__ import annotations

import html
import json
import threading
import webbrowser
from collections.abc import Callable, Mapping
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from ccdiff_env.errors import CcdiffError, ConfigError

__all__ = ["Answer", "LocalServer"]

HOST = "127.0.0.1"
MAX_QUERY = 2000
"""Letters of a query, at most."""

#: What a path gives: text of a page, or what JSON can hold. Called with the query's words.
Answer = Callable[[Mapping[str, str]], str | dict[str, Any]]


class LocalServer:
    """Answers at 127.0.0.1, one request at a time.

    Pages of other sites get no answer: neither by a name that leads here, nor by a request from
    their pages.

    Parameters
    ----------
    answers
        By path.
    port
        Where; 0 takes a free one.

    Raises
    ------
    ConfigError
        If the port is taken.
    """

    def __init__(self, answers: Mapping[str, Answer], port: int = 0) -> None:
        lock = threading.Lock()

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:  # the name is that of http.server
                parts = urlsplit(self.path)
                answer = answers.get(parts.path)
                known = (f"{HOST}:{server.server_port}", f"localhost:{server.server_port}")
                site = self.headers.get("Sec-Fetch-Site", "none")
                if self.headers.get("Host") not in known or site not in ("none", "same-origin"):
                    self._send(HTTPStatus.FORBIDDEN, _said("Only for this machine's own pages."))
                elif answer is None or len(parts.query) > MAX_QUERY:
                    self._send(HTTPStatus.NOT_FOUND, _said("There is no such page."))
                else:
                    with lock:
                        self._answer(answer, dict(parse_qsl(parts.query)))

            def _answer(self, answer: Answer, words: Mapping[str, str]) -> None:
                try:
                    found = answer(words)
                except (CcdiffError, OSError) as error:
                    self._send(HTTPStatus.BAD_REQUEST, _said(str(error)))
                else:
                    self._send(HTTPStatus.OK, found)

            def _send(self, status: HTTPStatus, found: str | dict[str, Any]) -> None:
                page = isinstance(found, str)
                body = (found if page else json.dumps(found)).encode()  # type: ignore[union-attr]
                self.send_response(status)
                kind = "text/html" if page else "application/json"
                self.send_header("Content-Type", f"{kind}; charset=utf-8")
                self.send_header("Content-Length", str(len(body)))
                self.send_header("Cache-Control", "no-store")
                self.send_header("X-Content-Type-Options", "nosniff")
                with suppress(ConnectionError):  # a browser may have gone on to another page
                    self.end_headers()
                    self.wfile.write(body)

            def log_message(self, format: str, *args: Any) -> None:
                """Say nothing: the page shows what goes wrong."""

        try:
            server = ThreadingHTTPServer((HOST, port), Handler)
        except (OSError, OverflowError) as error:
            raise ConfigError(f"port {port} cannot be used: {error}") from None
        self._server = server

    @property
    def address(self) -> str:
        """Where the first page is."""
        return f"http://{HOST}:{self._server.server_port}/"

    def run(self, *, open_it: bool = False) -> None:
        """Answer until interrupted; print the address first."""
        print(f"{self.address} (Ctrl-C ends it)", flush=True)
        if open_it:
            webbrowser.open(self.address)
        try:
            self._server.serve_forever()
        except KeyboardInterrupt:
            print()
        finally:
            self._server.server_close()

    def start(self) -> threading.Thread:
        """Answer in a thread of its own, until :meth:`stop`."""
        thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        thread.start()
        return thread

    def stop(self) -> None:
        """Answer no more."""
        self._server.shutdown()
        self._server.server_close()


def _said(text: str) -> str:
    """A page of one sentence."""
    return (
        '<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>ccdiff-env</title>'
        '<meta name="color-scheme" content="light dark">'
        f'<main style="font: 15px system-ui; padding: 24px">{html.escape(text)}</main></html>'
    )
