"""WebSocket connections that push views to clients after every change."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any

from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from .service import Service

DROPPED, REMOVED, DENIED, ENDS = 1013, 4404, 4403, 1012
"""Close codes: the client did not read or has too many connections, the person left, access is denied, the service
ends."""

router = APIRouter()


async def _converse(socket: WebSocket, send: Coroutine[Any, Any, int], dropped: asyncio.Event) -> None:
    """Send messages until there are no more, the client disconnects, or the client stops reading."""

    async def read() -> None:
        with suppress(RuntimeError, WebSocketDisconnect):
            while (await socket.receive())["type"] != "websocket.disconnect":
                pass

    sending, reading = asyncio.create_task(send), asyncio.create_task(read())
    tasks = sending, reading, asyncio.create_task(dropped.wait())
    gone = False
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        gone = reading.done()
    except asyncio.CancelledError:
        pass  # the server ends and waits no longer; it would log a traceback of each connection
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
    failed = not sending.cancelled() and sending.exception() is not None
    if dropped.is_set() or not (gone or failed or sending.cancelled()):
        await _hang_up(socket, DROPPED if sending.cancelled() else sending.result())


async def _hang_up(socket: WebSocket, code: int) -> None:
    with suppress(RuntimeError, WebSocketDisconnect, asyncio.TimeoutError):
        await asyncio.wait_for(socket.close(code), 1.0)


def _accepted(socket: WebSocket) -> str | None:
    return "kitassist" if "kitassist" in socket.scope.get("subprotocols", ()) else None


@router.websocket("/api/people/{name}/events")
async def person_events(socket: WebSocket, name: str) -> None:
    """Push a person's view: now, and after every change."""
    service: Service = socket.app.state.service
    if socket.state.caller.person not in (None, name) or name not in service.views:
        await socket.close(DENIED)
        return
    if service.is_crowded(name):
        await socket.close(DROPPED)
        return
    await socket.accept(_accepted(socket))
    if name not in service.views:
        await _hang_up(socket, REMOVED)
        return
    service.heard(socket.state.caller.person)
    watcher = service.watch(name)

    async def send() -> int:
        while (message := await watcher.messages.get()) is not None:
            await socket.send_text(message.decode())
        return ENDS if name in service.views else REMOVED

    try:
        await _converse(socket, send(), watcher.dropped)
    finally:
        service.leave(name, watcher)


@router.websocket("/api/team/events")
async def team_events(socket: WebSocket) -> None:
    """Push the operator's view: now, and after every change."""
    service: Service = socket.app.state.service
    if socket.state.caller.person is not None:
        await socket.close(DENIED)
        return
    await socket.accept(_accepted(socket))
    changed = service.operator()

    async def send() -> int:
        while True:
            await changed.wait()
            changed.clear()
            await socket.send_text((await service.team()).decode())
            await asyncio.sleep(service.pause_between)

    try:
        await _converse(socket, send(), asyncio.Event())
    finally:
        service.operator_leaves(changed)
