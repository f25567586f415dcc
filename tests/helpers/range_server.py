"""A folder on the web, for tests of surveys by URL."""

import functools
import http.server
import threading
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import ClassVar


class Ranges(http.server.SimpleHTTPRequestHandler):
    """Serves byte ranges, as object stores do, and says how many bytes went out."""

    sent = 0
    whole_files_alone = False
    headers_beside: ClassVar[dict[str, str]] = {}
    shift = 0
    """Bytes that it is wrong by."""
    requests = 0
    stalled = None
    """An event: nothing is sent before it."""

    def do_GET(self):
        if self.stalled is not None:
            type(self).requests += 1
            self.stalled.wait(30)
            return
        file = Path(self.translate_path(self.path))
        if not file.is_file():
            self.send_error(404)
            return
        data = file.read_bytes()
        asked = self.headers.get("Range")
        if asked and not self.whole_files_alone:
            first, _, last = asked.removeprefix("bytes=").partition("-")
            first = int(first) + self.shift
            total, data = len(data), data[int(first) : int(last) + 1 if last else None]
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {first}-{int(first) + len(data) - 1}/{total}")
        else:
            self.send_response(200)
        self.send_header("Accept-Ranges", "none" if self.whole_files_alone else "bytes")
        self.send_header("Content-Length", str(len(data)))
        for name, value in self.headers_beside.items():
            self.send_header(name, value)
        self.end_headers()
        with suppress(ConnectionError):
            for start in range(0, len(data), 1 << 20):
                self.wfile.write(data[start : start + (1 << 20)])
                type(self).sent += len(data[start : start + (1 << 20)])

    def log_message(self, *args):
        pass


@contextmanager
def serving(folder):
    """Serve a folder; gives its address, and the handler that counts."""
    handler = type("Handler", (Ranges,), {"sent": 0})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(handler, directory=folder)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}", handler
        server.shutdown()
