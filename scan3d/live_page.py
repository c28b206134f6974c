"""A page in which contacts grow while a rod moves, served by the program that finds them to the browsers of this machine."""

from __future__ import annotations

import threading
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.files.shapes import table
from scan3d.live import Live, LiveContact
from scan3d.pictures import parts
from scan3d.pictures.page import as_json, page_data, page_of, strips
from scan3d.pictures.parts import Scene
from scan3d.units import UNITS_M

_WAITING = b"""<!DOCTYPE html><html lang="en"><meta charset="utf-8"><meta http-equiv="refresh" content="1">
<title>waiting - scan3d</title><p>Waiting for the first contact.</html>"""


class LivePage:
    """The page of a `Live` at `url`, until the ``with`` block ends: contacts so far, their force and phase, and the rod.

    What the page of a scan shows of contacts is shown here four times a second.
    """

    def __init__(self, live: Live, port: int = 0) -> None:
        """`port` of this machine, by default one that is free.  Raises InputError for a port that is not."""
        self._live = live
        self._center: Array | None = None
        try:
            self._server = ThreadingHTTPServer(("127.0.0.1", port), self._handler())
        except (OSError, OverflowError, TypeError) as error:
            raise InputError(
                f"port {port} can't be served: {error}; choose another one, or 0 for one that is free"
            ) from None
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_port}/"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def __enter__(self) -> LivePage:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        building, view = threading.Lock(), self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                with building:
                    answer = view._answer(self.path)
                self.send_response(HTTPStatus.OK if answer else HTTPStatus.NOT_FOUND)
                self.send_header(
                    "Content-Type", "application/json" if self.path == "/data" else "text/html; charset=utf-8"
                )
                self.send_header("Content-Length", str(len(answer)))
                with suppress(ConnectionError):  # the tab may be closed
                    self.end_headers()
                    self.wfile.write(answer)

            def log_message(self, *_: Any) -> None:
                """The terminal belongs to the program that finds the contacts."""

        return Handler

    def _answer(self, path: str) -> bytes:
        contacts = list(self._live.contacts)
        if path not in ("/", "/data"):
            return b""
        if not contacts:
            return _WAITING if path == "/" else b"{}"
        scene = Scene("live", self._live.unit, contacts=_table(contacts))
        # that of the first contacts, about which the view turns
        center = self._center = scene.points.mean(axis=0) if self._center is None else self._center
        data, rod = page_data(scene, center), _rod(self._live)
        data["layers"].append(strips("rod", [rod], center, parts.ROD, 3.0) | {"on": True})
        reach = np.linalg.norm(np.concatenate([scene.points, rod]) - center, axis=1)
        words = "contact" if len(contacts) == 1 else "contacts"
        data |= {"radius": float(reach.max()), "live": f"{self._live.state}, {len(contacts)} {words} as they came"}
        return page_of(scene, data) if path == "/" else as_json(data).encode()


def _table(contacts: list[LiveContact]) -> Any:
    """The columns of contacts that pages show."""
    columns: dict[str, Any] = {
        **dict(zip("xyz", np.array([one.point for one in contacts]).T, strict=True)),
        **dict(zip(("nx", "ny", "nz"), np.array([one.normal for one in contacts]).T, strict=True)),
        "phase": np.array([one.phase for one in contacts], dtype=np.uint8),
        "force": np.array([one.force_N for one in contacts]),
    }
    return table(columns)


def _rod(live: Live) -> Array:
    """(p, 3) the rod in the last row, from the clamp on, in the unit of contacts."""
    row = live.last_row
    assert row is not None
    base = row.position_m[0]
    line = np.stack([base, base + row.rod.length_m * row.axes()[0, 1]])
    if live.state != "air":  # of a row whose place is unknown as well, its reactions tell how the rod bends
        curved, rest = parts.bent_rods(row, np.zeros(1, dtype=np.int64), live.model == "spatial")
        bent = np.concatenate([curved[0], rest[0, 1:]])
        line = bent if np.isfinite(bent).all() else line  # a row that came in between touches nothing
    return np.asarray(line / UNITS_M[live.unit])
