"""The image server: frames of a scene over TCP to any number of clients, and `/stream.mjpg` for browsers.

One thread runs an event loop with all connections; frames are rendered in another. The protocol is in `wire.images`
and ringpose-images(5). Memory is bounded: every client has a queue of the newest `MAX_QUEUED` frames, which all clients
share, one frame being sent, and one message being read.
"""

import asyncio
import math
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable, Coroutine, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ringpose.errors import DeviceError
from ringpose.simulate.serve import image_clients
from ringpose.simulate.serve.image_camera import ImageCamera
from ringpose.types.scene import Scene
from ringpose.types.truth import Truth
from ringpose.wire import images as wire
from ringpose.wire.images import MalformedMessage, ServedFrame

MAX_CLIENTS = 32

WORKERS = min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, 4)
"""Frames that are rendered at once; the kernels run in parallel."""

MAX_CONNECTIONS = 128
"""Including those that have not been admitted yet; more are closed at once."""

SEND_BUFFER = 1 << 18

HANDSHAKE_S = 5.0
"""Time for the first message of a client."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageSetup:
    """Configuration of the image server."""

    host: str = "127.0.0.1"
    port: int = 0
    """0 for any free port."""
    clock: wire.Clock = "wall"
    rate_hz: float = 5.0
    secret: bytes | None = None


class ImageServer:
    """Serves inside the block of its context.

    `truth_record` is that of `ImageCamera`; `on_truth` receives the truth of each shot that is begun, `report` a
    message when a connection is closed because of its input.
    """

    def __init__(
        self,
        scene: Scene,
        setup: ImageSetup,
        truth_record: Callable[[Truth], Mapping[str, Any]],
        on_truth: Callable[[Mapping[str, Any]], None] | None = None,
        report: Callable[[str], None] | None = None,
    ) -> None:
        self._setup, self._report = setup, report
        self._camera = ImageCamera(scene, setup.rate_hz, setup.clock, truth_record, report)
        self._on_truth = on_truth
        self._clients: set[image_clients.Client] = set()
        self._viewers: set[image_clients.Viewer] = set()
        self._connections = 0
        self._showing: asyncio.Task[None] | None = None
        self._failure: BaseException | None = None
        self.rejected = 0
        """Connections that were closed because of their input."""
        self._renderer = ThreadPoolExecutor(max_workers=WORKERS, thread_name_prefix="exposures")
        self._in_flight = 0
        """Frames that are being rendered."""
        self._thread = threading.Thread(target=self._run, name="image server", daemon=True)
        self._socket: socket.socket | None = None

    def __enter__(self) -> "ImageServer":
        host, port = self._setup.host, self._setup.port
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._socket = socket.create_server((host, port), family=family, backlog=MAX_CLIENTS)
        except OSError as error:
            finding = f"cannot be opened: {(error.strerror or str(error)).lower()}"
            raise DeviceError(f"tcp://{host}:{port}", finding, "choose another port, or 0 for a free one") from error
        # A client that is slow to read receives the newest frames, not those that wait in a large buffer.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        self.port = int(self._socket.getsockname()[1])
        started = threading.Event()
        self._started = started
        self._thread.start()
        started.wait()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(RuntimeError):  # the loop has ended by a failure
            self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()
        self._renderer.shutdown(wait=True, cancel_futures=True)
        self._camera.close()

    @property
    def uris(self) -> dict[str, str]:
        """The value of --camera for clients, and the address for browsers."""
        host = f"[{self._setup.host}]" if ":" in self._setup.host else self._setup.host
        token = "" if self._setup.secret is None else f"?token={wire.stream_token(self._setup.secret)}"
        return {"camera": f"tcp://{host}:{self.port}", "stream": f"http://{host}:{self.port}/stream.mjpg{token}"}

    # The event loop

    def _run(self) -> None:
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._loop.set_exception_handler(self._on_failure)
        self._stop = asyncio.Event()
        self._changed = asyncio.Event()
        self._exposed: asyncio.Queue[tuple[float, asyncio.Future[ServedFrame]]] = asyncio.Queue()
        server = await asyncio.start_server(self._connected, sock=self._socket)
        producer = asyncio.create_task(self._produce())
        stopped = asyncio.create_task(self._stop.wait())
        self._started.set()
        try:
            await asyncio.wait({producer, stopped}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            server.close()
            for client in self._clients:
                client.writer.transport.abort()
            for viewer in self._viewers:
                viewer.writer.transport.abort()
            stopped.cancel()
            producer.cancel()
            with suppress(asyncio.CancelledError):
                await producer  # raises a failure of the renderer
        if self._failure is not None:
            raise self._failure

    def _on_failure(self, _: asyncio.AbstractEventLoop, context: Mapping[str, Any]) -> None:
        """End the server when a task has failed, which is a bug; a connection that cannot be accepted is reported."""
        if "socket" in context:
            if self._report is not None:
                self._report(f"a connection could not be accepted: {context.get('exception')}")
            return
        self._failure = context.get("exception") or RuntimeError(str(context.get("message")))
        self._stop.set()

    async def _produce(self) -> None:
        """Expose frame after frame, several at once, and publish them in order."""
        expose = self._expose_in_lockstep if self._setup.clock == "lockstep" else self._expose_by_the_clock
        await asyncio.gather(expose(), self._publish_in_order())

    async def _expose_in_lockstep(self) -> None:
        exposed = 0
        while True:
            await self._until(self._all_await_frames)
            stamp_s = self._camera.start_s + exposed / self._setup.rate_hz
            exposed += 1
            self._expose(self._loop.time(), stamp_s)

    async def _expose_by_the_clock(self) -> None:
        """Expose the frames of a shot at the given rate; where rendering takes longer, the next shot is late."""
        rate_hz, slot, began_s = self._setup.rate_hz, 0, self._loop.time()
        while True:
            await self._until(lambda: self._in_flight < WORKERS)
            slot += 1
            if self._camera.is_between_shots:
                was_idle = not self._is_watched()
                await self._until(self._is_watched)
                due = math.ceil((self._loop.time() - began_s) * rate_hz)
                if not was_idle:
                    self._camera.dropped += max(due - slot, 0)
                slot = max(due, slot)
            begin_s = began_s + slot / rate_hz
            stamp_s = begin_s - self._loop.time() + time.time()
            self._expose(begin_s, stamp_s)

    def _expose(self, begin_s: float, stamp_s: float) -> None:
        self._in_flight += 1
        frame = self._loop.run_in_executor(self._renderer, self._camera.next_exposure(stamp_s))
        self._exposed.put_nowait((begin_s, frame))

    async def _publish_in_order(self) -> None:
        """Publish each frame when it is rendered, not before it is exposed."""
        while True:
            begin_s, future = await self._exposed.get()
            frame = await future
            await asyncio.sleep(begin_s + frame.exposure_s - self._loop.time() if self._setup.clock == "wall" else 0.0)
            self._in_flight -= 1
            if frame.step == 0 and self._on_truth is not None and frame.truth is not None:
                self._on_truth(frame.truth)
            self._publish(frame)
            self._changed.set()

    def _publish(self, frame: ServedFrame) -> None:
        for client in self._clients:
            client.offer(frame)
        if self._viewers and self._camera.is_brightest(frame) and (self._showing is None or self._showing.done()):
            self._showing = asyncio.create_task(self._show(frame))

    async def _show(self, frame: ServedFrame) -> None:
        """Send a frame to the browsers; it is encoded once."""
        picture = await self._loop.run_in_executor(None, image_clients.jpeg, frame)
        for viewer in self._viewers:
            viewer.offer(picture)

    async def _until(self, condition: Callable[[], bool]) -> None:
        while not condition():
            self._changed.clear()
            await self._changed.wait()

    def _is_watched(self) -> bool:
        return bool(self._viewers) or any(client.awaits_frames for client in self._clients)

    def _all_await_frames(self) -> bool:
        """Whether time may advance: no client that receives frames is still busy with earlier ones."""
        receiving = [client for client in self._clients if client.is_subscribed]
        is_free = self._in_flight < WORKERS
        return is_free and bool(receiving) and all(client.awaits_more_than(self._in_flight) for client in receiving)

    # Connections

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections += 1
        try:
            if self._connections <= MAX_CONNECTIONS:
                await self._serve_connection(reader, writer)
        finally:
            self._connections -= 1
            writer.transport.abort()
            self._changed.set()

    async def _serve_connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.transport.set_write_buffer_limits(high=0)  # drain() then waits until all is sent
        try:
            if len(self._clients) + len(self._viewers) >= MAX_CLIENTS:
                raise MalformedMessage(f"{MAX_CLIENTS} clients are connected already")
            try:
                async with asyncio.timeout(HANDSHAKE_S):
                    begun = await reader.readexactly(4)
            except TimeoutError:
                raise MalformedMessage(f"no message came within {HANDSHAKE_S:g} s") from None
            if begun == b"GET ":
                await self._serve_browser(reader, writer)
            else:
                await self._serve_client(reader, writer, begun)
        except MalformedMessage as problem:
            await self._reject(writer, str(problem))
        except asyncio.IncompleteReadError as error:
            if error.partial:
                await self._reject(writer, "the connection ended within a message")
        except (OSError, TimeoutError):  # the client has gone, or does not read
            pass

    async def _reject(self, writer: asyncio.StreamWriter, finding: str) -> None:
        """Report to the client and to the user why a connection is closed."""
        self.rejected += 1
        if self._report is not None:
            address = writer.get_extra_info("peername") or ("a client",)
            self._report(f"{address[0]}: connection closed: {finding}")
        with suppress(OSError, TimeoutError):
            writer.write(wire.message({"type": "error", "message": finding}))
            async with asyncio.timeout(1.0):
                await writer.drain()
                writer.write_eof()

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, begun: bytes) -> None:
        hello = await image_clients.received(reader, begun)
        if hello.type != "hello" or hello.values.get("protocol") != wire.PROTOCOL:
            raise MalformedMessage(f"the first message must be a hello with the protocol {wire.PROTOCOL}")
        if self._setup.secret is not None:
            await self._authenticate(self._setup.secret, reader, writer)
        writer.write(wire.message(wire.greeting_header(self._camera.greeting)))
        await image_clients.drained(writer)
        client = image_clients.Client(writer, self._changed)
        self._clients.add(client)
        try:
            await _first_ended(client.send_frames(), self._answer_requests(client, reader))
        finally:
            self._clients.discard(client)

    async def _authenticate(self, secret: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonce = secrets.token_hex(16)
        writer.write(wire.message({"type": "challenge", "nonce": nonce}))
        await image_clients.drained(writer)
        answer = await image_clients.received(reader)
        expected = wire.challenge_answer(secret, nonce)
        if answer.type != "proof" or not secrets.compare_digest(answer.text("proof").encode(), expected.encode()):
            raise MalformedMessage("the shared secret is wrong")

    async def _answer_requests(self, client: image_clients.Client, reader: asyncio.StreamReader) -> None:
        while True:
            begun = await reader.readexactly(1)  # between messages a client may be silent
            request = wire.request_in(await image_clients.received(reader, begun))
            answer = self._answer(client, request)
            if answer is not None:
                client.writer.write(wire.message(answer))
                await image_clients.drained(client.writer)
            self._changed.set()

    def _answer(self, client: image_clients.Client, request: wire.Request) -> Mapping[str, Any] | None:
        """Carry out a request; None if it needs no answer."""
        if isinstance(request, wire.Subscribe | wire.Unsubscribe):
            client.subscribe(request)
            return None
        problem = self._camera.set(request)
        if problem is not None:
            return {"type": "refused", "message": problem}
        return {"type": "done", "from_frame": self._camera.first_frame_with(request)}

    # Browsers

    async def _serve_browser(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer a request for the stream, or for the page that shows it."""
        request = await image_clients.browser_request(reader)
        # A page from elsewhere could reach a loopback address under a name of its own.
        if image_clients.is_loopback(self._setup.host) and not image_clients.is_loopback(request.host):
            writer.write(
                image_clients.http("403 Forbidden", "text/plain", b"address this server as 127.0.0.1 or localhost\n")
            )
        elif not self._is_admitted(request.token):
            writer.write(image_clients.http("403 Forbidden", "text/plain", b"the token is wrong\n"))
        elif request.path == "/":
            query = "" if self._setup.secret is None else f"?token={request.token}"
            writer.write(
                image_clients.http("200 OK", "text/html", f'<!DOCTYPE html><img src="/stream.mjpg{query}">'.encode())
            )
        elif request.path == "/stream.mjpg":
            await self._stream(reader, writer)
        else:
            writer.write(image_clients.http("404 Not Found", "text/plain", b"there are / and /stream.mjpg\n"))
        await image_clients.drained(writer)
        writer.close()
        await writer.wait_closed()

    def _is_admitted(self, token: str) -> bool:
        secret = self._setup.secret
        return secret is None or secrets.compare_digest(token.encode(), wire.stream_token(secret).encode())

    async def _stream(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        viewer = image_clients.Viewer(writer)
        self._viewers.add(viewer)
        self._changed.set()
        try:
            await _first_ended(viewer.send_pictures(), reader.read(1))
        finally:
            self._viewers.discard(viewer)


async def _first_ended(*works: Coroutine[Any, Any, Any]) -> None:
    """Run both until one of them ends; its error is raised, and the other is cancelled."""
    tasks = [asyncio.create_task(work) for work in works]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
