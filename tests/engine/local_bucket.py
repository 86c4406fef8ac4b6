"""Cloud storage on this machine: a folder as a bucket, spoken to as GDAL's /vsis3/ does."""

from __future__ import annotations

import http.server
import re
import threading
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def bucket(folder):
    """Serve a folder's files as the bucket "town"; gives GDAL's settings, and the list of what was asked for."""
    asked = []

    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_HEAD(self):
            self.answer(False)

        def do_GET(self):
            self.answer(True)

        def answer(self, whole):
            asked.append(self.path)
            name = self.path.partition("?")[0]
            file = Path(folder) / name.rpartition("/")[2]
            if not name.startswith("/town/") or not file.is_file():
                self.send(404, b"", whole)
                return
            content = file.read_bytes()
            part = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
            if part is None:
                self.send(200, content, whole)
                return
            low, high = int(part[1]), min(int(part[2] or len(content)), len(content) - 1)
            place = {"Content-Range": f"bytes {low}-{high}/{len(content)}"}
            self.send(206, content[low : high + 1], whole, **place)

        def send(self, code, content, whole, **headers):
            self.send_response(code)
            for name, value in {"Content-Length": str(len(content)), "Accept-Ranges": "bytes", **headers}.items():
                self.send_header(name, value)
            self.end_headers()
            if whole:
                self.wfile.write(content)

        def log_message(self, *words):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        settings = {
            "AWS_S3_ENDPOINT": f"127.0.0.1:{server.server_port}",
            "AWS_HTTPS": "NO",
            "AWS_VIRTUAL_HOSTING": "FALSE",
            "AWS_NO_SIGN_REQUEST": "YES",
        }
        try:
            yield settings, asked
        finally:
            server.shutdown()
