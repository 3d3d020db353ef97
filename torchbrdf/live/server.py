"""A server on the loopback address that shows spheres and relights them as the page turns the light.

It answers `GET /` with the page and `GET /frame?rotation=w,x,y,z&stops=s` with all pictures, one after another, as
8-bit RGBA. It opens no file and answers only requests for localhost: the name in the Host header tells them from those
of a foreign page whose own name was pointed to this address.
"""

import math
import os
import socket
import sys
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock
from typing import Any, Protocol
from urllib.parse import parse_qs

import torch
from torch import Tensor

from torchbrdf.images import exposure_for, exposure_for_light, tone_map
from torchbrdf.live._page import content_security_policy, page

HOST = "127.0.0.1"
LARGEST_STOPS = 20.0
_HOST_NAMES = (HOST, "localhost")


class Relightable(Protocol):
    """Spheres under a light that turns.

    labels  one for each picture
    mask    (1, S, S) bool, the sphere
    """

    @property
    def labels(self) -> tuple[str, ...]: ...  # noqa: D102

    @property
    def mask(self) -> Tensor: ...  # noqa: D102

    def render(self, rotation: Tensor) -> Tensor:
        """Linear radiance (K, 3, S, S) under probe.rotated(rotation)."""

    def mirror_ball(self, rotation: Tensor) -> Tensor:
        """(3, S, S): the rotated probe in a perfect mirror."""


def listen(port: int = 0) -> socket.socket:
    """A socket that listens on the loopback address; 0 = any free port. OSError where it cannot."""
    listener = socket.socket()
    if os.name == "posix":  # elsewhere this would share a port that is in use
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
        listener.listen(16)
    except OSError as error:
        listener.close()
        advice = "give another port, or 0 for any that is free"
        raise OSError(f"cannot listen on {HOST}, port {port}: {error.strerror}; {advice}") from None
    return listener


def rotation_matrix(text: str) -> Tensor:
    """(3, 3) of a unit quaternion "w,x,y,z"; it is normalised, so that the matrix is orthonormal. Else ValueError."""
    try:
        w, x, y, z = map(float, text.split(","))
        length = math.hypot(w, x, y, z)
    except ValueError:
        length = 0.0
    if not abs(length - 1) < 1e-3:
        raise ValueError(f"rotation must be a unit quaternion w,x,y,z, got {text[:80]!r}")
    w, x, y, z = w / length, x / length, y / length, z / length
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.tensor(rows)


class LiveServer(ThreadingHTTPServer):
    """Serves the pictures of `spheres` on a socket of `listen`, which it closes.

    title, light  what was photographed, and the light's name, for the page
    All pictures share the exposure that takes the 99th percentile of the first, under the light as it is, to white.
    The mirror ball comes last and has its own, because it shows the light itself.
    """

    allow_reuse_port = False

    def __init__(self, spheres: Relightable, listener: socket.socket, title: str, light: str) -> None:
        """Render the first pictures, which set the exposures."""
        super().__init__(listener.getsockname(), _Requests, bind_and_activate=False)
        self.socket.close()
        self.socket, self.server_address = listener, listener.getsockname()
        self._spheres, self._rendering, self.closed = spheres, Lock(), False
        mask = spheres.mask.cpu()
        self._nearest = _nearest(mask)
        with torch.inference_mode():
            upright = torch.eye(3, dtype=torch.float32)
            first, mirrored = spheres.render(upright), spheres.mirror_ball(upright)
            exposure = exposure_for(first[0].cpu(), mask)
            gains = [exposure] * len(first) + [exposure_for_light(mirrored.cpu().amax(0)[mask[0]])]
        self._gains = torch.tensor(gains, dtype=torch.float32)[:, None, None]
        self.page = page(title, light, spheres.labels, mask.shape[-1]).encode()

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.server_address[1]}/"

    def frame(self, rotation: Tensor, stops: float) -> bytes:
        """All pictures and the mirror ball under the turned light, (K + 1, S, S, 4) bytes; one at a time is rendered.

        rotation  (3, 3), of the light
        stops     exposure beside that of the first pictures
        Pixels outside the mask continue the nearest ones inside, so that a picture clipped to a disc has no other rim.
        """
        with self._rendering, torch.inference_mode():
            if self.closed:
                raise ConnectionAbortedError
            shown = torch.cat([self._spheres.render(rotation), self._spheres.mirror_ball(rotation)[None]])
            pixels = shown.flatten(2).cpu().float()[..., self._nearest] * self._gains
            rgba = torch.full((len(pixels), pixels.shape[-1], 4), 255, dtype=torch.uint8)
            rgba[..., :3] = (tone_map(pixels, 2.0**stops) * 255).round().to(torch.uint8).movedim(1, 2)
            return rgba.numpy().tobytes()

    def serve_until_interrupted(self) -> None:
        """Serve until Ctrl-C, then close."""
        try:
            self.serve_forever()
        except KeyboardInterrupt:
            pass
        finally:
            self.server_close()

    def server_close(self) -> None:
        """Stop listening. A frame that is being rendered ends first, and none begins."""
        super().server_close()
        with self._rendering:
            self.closed = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print the traceback, unless only the browser went away."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


def _nearest(mask: Tensor) -> Tensor:
    """(S * S,) flat index of the nearest pixel under a mask (1, S, S), which is a pixel itself where it is under it."""
    from scipy.ndimage import distance_transform_edt  # 0.1 s, which other commands need not wait

    rows, columns = distance_transform_edt(~mask[0].numpy(), return_distances=False, return_indices=True)
    return torch.from_numpy(rows * mask.shape[-1] + columns).long().flatten()


def _stops(text: str) -> float:
    try:
        stops = float(text)
    except ValueError:
        stops = math.nan
    if not abs(stops) <= LARGEST_STOPS:
        raise ValueError(f"stops must be a number from {-LARGEST_STOPS:g} to {LARGEST_STOPS:g}, got {text[:80]!r}")
    return stops


class _Requests(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"  # one connection for all frames
    disable_nagle_algorithm = True  # else the second part of an answer waits up to 40 ms for an acknowledgement
    server_version, sys_version = "torchbrdf", ""
    server: LiveServer

    def do_GET(self) -> None:
        """The page, a frame, or one line on what is wrong."""
        if self.server.closed:  # a connection that is kept alive outlasts the socket
            raise ConnectionAbortedError
        hosts = self.headers.get_all("Host", [])
        path, _, query = self.path.partition("?")
        if [host.partition(":")[0].lower() in _HOST_NAMES for host in hosts] != [True]:
            self._answer(HTTPStatus.FORBIDDEN, f"this page is served as {self.server.url} only")
        elif path == "/":
            self._answer(HTTPStatus.OK, self.server.page, "text/html; charset=utf-8")
        elif path == "/frame":
            try:
                given = parse_qs(query, keep_blank_values=True, max_num_fields=8)
                rotation = rotation_matrix(given.get("rotation", [""])[-1])
                stops = _stops(given.get("stops", ["0"])[-1])
            except ValueError as error:
                self._answer(HTTPStatus.BAD_REQUEST, str(error))
            else:
                self._answer(HTTPStatus.OK, self.server.frame(rotation, stops), "application/octet-stream")
        else:
            self._answer(HTTPStatus.NOT_FOUND, "there is nothing here; the page is at /")

    do_HEAD = do_GET

    def log_message(self, *_: object) -> None:
        """Say nothing: a frame is no news."""

    def _answer(self, status: HTTPStatus, content: bytes | str, kind: str = "text/plain; charset=utf-8") -> None:
        body = content if isinstance(content, bytes) else f"{content}\n".encode()
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(body))),
            ("Content-Security-Policy", content_security_policy()),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cache-Control", "no-store"),
        ):
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)
