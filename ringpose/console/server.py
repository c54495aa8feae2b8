"""The server of the pages, by viser, for browsers on this machine only.

viser answers to any web page that a browser on this machine shows: it checks neither the origin of a request nor the
host that it names, so that a foreign page could read and set the controls. It has no option for that; the function with
which it opens its websocket server is therefore replaced by one that refuses such requests while the server is made.
"""

import http
import logging
import os
import re
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import rich
import viser
import websockets.asyncio.server
from viser import _messages
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from ringpose.errors import DeviceError, UsageError

FIRST_PORT = 8080
"""The port of a page for which none was asked; if it is in use, the next free one is taken."""

MAX_PORTS = 100
"""Number of ports that are tried."""

LOOPBACK_NAMES = ("127.0.0.1", "localhost", "::1")
"""Names of this machine that a browser sends; another name may be one that a foreign page has made to lead here."""

PANEL_PX = (400, 600, 900)
"""Widths of the panel; the first leaves more than half of a page of 1024 px to the scene. The pictures grow with it."""

PAGE_STYLE = """<style>
html { font-size: clamp(14px, 0.9vw, 26px); }
@media (max-width: 36em) {
  .mantine-Paper-root[style*="max-height: 60%"],
  .mantine-Paper-root[style*="max-height: 60%"] .mantine-ScrollArea-content > div { width: 100% !important; }
  div:has(> .mantine-Paper-root[style*="max-height: 60%"]):not(
    :has(.mantine-ScrollArea-content > div > [style*="display: none"])) > div:has(canvas) { height: 40% !important; }
}
</style>"""
"""Texts and controls grow with the window, from 1800 px on.

In windows of at most 36 em, viser puts the panel, 20 em wide, over the lower 60 % of the scene. Here it then takes all
the width, and the scene what is left above it, or the whole window while the panel is closed.
"""

BELOW_ALL = 1e9
"""Order of a control below those that are added later."""

Serve = Callable[..., Any]


def opened_server(host: str, port: int | None) -> viser.ViserServer:
    """A server whose page has its controls at the right, without viser's buttons for sharing with other machines.

    Without a port the first free one from `FIRST_PORT` on is taken; one that was asked for and cannot be opened is a
    `DeviceError`.
    """
    rich.reconfigure(stderr=True)  # viser reports by rich; stdout is for records
    listening = _listening(host, port)
    with _guarded_serve(listening, host) as opened, _quiet():  # the address is in a record
        server = viser.ViserServer(host=host, port=listening.getsockname()[1], label="ringpose", verbose=False)
    if not opened:
        server.stop()
        listening.close()
        finding = f"viser {viser.__version__} opens its server in another way, so that the page cannot be protected"
        raise UsageError("the page", finding, "pip install 'viser==1.1.1'")
    _restrict_messages(server)
    server.gui.configure_theme(show_share_button=False, show_logo=False, control_width="large", dark_mode=True)
    server.gui.main_panel.dock_right()
    server.gui.main_panel.set_width(PANEL_PX[0])
    server.gui.set_panel_label("ringpose")
    server.gui.add_html(PAGE_STYLE, order=BELOW_ALL)
    widths = {f"{each}": each for each in PANEL_PX}
    width: Any = server.gui.add_dropdown("panel width (px)", list(widths), order=BELOW_ALL)
    width.on_update(lambda _: server.gui.main_panel.set_width(widths.get(width.value, PANEL_PX[0])))
    _widen_in_wide_windows(server, width)
    server.scene.set_up_direction("-y")
    # viser's lights, shadows and reflections take five times as long for each frame without a GPU
    server.scene.configure_default_lights(enabled=False)
    server.scene.configure_environment_map(None)
    server.scene.add_light_ambient("/ambient", intensity=0.8)
    server.scene.add_light_directional("/lamp", intensity=2.5, position=(-1.0, -1.0, -1.0))
    return server


def _listening(host: str, port: int | None) -> socket.socket:
    """A socket at this port, or at the first free one from `FIRST_PORT` on."""
    ports = range(FIRST_PORT, FIRST_PORT + MAX_PORTS) if port is None else (port,)
    reasons = []
    for each in ports:
        try:
            return socket.create_server((host, each))
        except OSError as error:
            reasons.append(os.strerror(error.errno or 0).lower())  # its own text repeats the address
    place = f"http://{host}:{ports[0]}" if port is not None else f"ports {ports[0]} to {ports[-1]} at {host}"
    raise DeviceError(place, reasons[0], "end what uses it, or choose another --port")


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress what viser reports by rich."""
    rich.get_console().quiet = True
    try:
        yield
    finally:
        rich.get_console().quiet = False


WIDE_PX = 1800
"""Width of the scene from which a new browser gets the second width of the panel, as its texts are larger."""


def _widen_in_wide_windows(server: viser.ViserServer, width: Any) -> None:
    """Widen the panel once for each browser, so that its user can still choose another width."""
    seen: set[int] = set()

    def widen(camera: Any) -> None:
        is_new, wide = camera.client.client_id not in seen, camera.image_width > WIDE_PX
        seen.add(camera.client.client_id)
        if is_new and wide and width.value == f"{PANEL_PX[0]}":
            width.value = f"{PANEL_PX[1]}"
            server.gui.main_panel.set_width(PANEL_PX[1])

    def connected(client: viser.ClientHandle) -> None:
        client.camera.on_update(widen)

    server.on_client_connect(connected)


@contextmanager
def _guarded_serve(listening: socket.socket, host: str) -> Iterator[list[bool]]:
    """Let viser open its server at this socket, with `refusal` in front; the list is empty if it did not."""
    serve: Serve = websockets.asyncio.server.serve
    opened: list[bool] = []
    log = logging.getLogger("ringpose.console")
    log.setLevel(logging.CRITICAL)  # a client that breaks the protocol is not a fault of ours, and loses its connection

    def guarded(handler: Any, _host: str, _port: int, *, process_request: Any, **options: Any) -> Any:
        opened.append(True)

        def checked(connection: ServerConnection, request: Request) -> Response | None:
            headers = request.headers
            if problem := refusal(headers.get_all("Host"), headers.get_all("Origin"), host):
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{problem}\n")
            response: Response | None = process_request(connection, request)
            if response is not None:  # a foreign page must not show this one as a part of itself
                response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
            return response

        return serve(handler, sock=listening, process_request=checked, logger=log, **options)

    websockets.asyncio.server.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield opened
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc, assignment]


def refusal(hosts: Sequence[str], origins: Sequence[str], host: str) -> str:
    """Why a request with these headers `Host` and `Origin` is refused; empty if it is not.

    It must name this machine or `host`, and come from a page of the same address.

    The port is that of the browser's address, which differs from ours if it is forwarded (ssh -L). Programs other than
    browsers send no origin.
    """
    match = re.fullmatch(r"\[?([^\[\]@/]*?)\]?(:[0-9]+)?", hosts[0].lower()) if len(hosts) == 1 else None
    if match is None or match[1] not in (*LOOPBACK_NAMES, host):
        return "ringpose: refused: this page is at 127.0.0.1 and localhost only"
    if origins and [each.lower() for each in origins] not in ([f"http://{match[0]}"], [f"https://{match[0]}"]):
        return "ringpose: refused: a page of another origin asked for this one"
    return ""


def _restrict_messages(server: viser.ViserServer) -> None:
    """Let messages set nothing but the values of controls, to values of their types, and share nothing elsewhere."""
    messages, update = server._websock_server, server.gui._handle_gui_updates

    async def checked(client_id: Any, message: _messages.GuiUpdateMessage) -> None:
        try:
            if list(message.updates) != ["value"]:
                raise TypeError("only the value of a control can be set")
            await update(client_id, message)
        except (TypeError, ValueError, OverflowError, AssertionError) as problem:
            sys.stderr.write(f"ringpose: a message to the page was refused: {' '.join(str(problem).split())}\n")

    messages.unregister_handler(_messages.GuiUpdateMessage, update)
    messages.register_handler(_messages.GuiUpdateMessage, checked)
    messages.unregister_handler(_messages.ShareUrlRequest)
