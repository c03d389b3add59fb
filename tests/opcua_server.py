"""An OPC UA server with two stations, for tests: `python opcua_server.py PORT [USER PASSWORD]`."""

from __future__ import annotations

import asyncio
import sys
from typing import Any

from asyncua import Server, ua
from asyncua.crypto.permission_rules import User, UserRole


class Users:
    """Lets in one user."""

    def __init__(self, *known: str) -> None:
        self.known = known

    def get_user(self, _: Any, username: str | None = None, password: str | None = None, **__: Any) -> User | None:
        return User(UserRole.User) if (username, password) == self.known else None


async def serve(port: int, *known: str) -> None:
    server = Server(user_manager=Users(*known) if known else None)
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    space = await server.register_namespace("line")
    for station in ("A", "B"):
        folder = await server.nodes.objects.add_object(space, station)
        for what in ("Pick", "Next", "Answer", "Light"):
            node = await folder.add_variable(ua.NodeId(f"{station}.{what}", space), what, "")
            await node.set_writable()
    async with server:
        print("ready", flush=True)
        await asyncio.sleep(3600)


if __name__ == "__main__":
    asyncio.run(serve(int(sys.argv[1]), *sys.argv[2:]))
