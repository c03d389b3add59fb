"""OPC UA servers with two stations, for tests: each line of standard input starts one, as `PORT [USER PASSWORD]`.

To build what every server has takes seconds. It is done once; each server is then a fork, which forgets everything when
it is killed. Its process id is printed as soon as it listens.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from typing import Any

from asyncua import Server, ua
from asyncua.crypto.permission_rules import User, UserRole


class Users:
    """Lets in one user, or everybody."""

    known: tuple[str, ...] = ()

    def get_user(self, _: Any, username: str | None = None, password: str | None = None, **__: Any) -> User | None:
        return User(UserRole.User) if not self.known or (username, password) == self.known else None


async def prepared(users: Users) -> Server:
    server = Server(user_manager=users)
    await server.init()
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    space = await server.register_namespace("line")
    for station in ("A", "B"):
        folder = await server.nodes.objects.add_object(space, station)
        for what in ("Pick", "Next", "Answer", "Light"):
            node = await folder.add_variable(ua.NodeId(f"{station}.{what}", space), what, "")
            await node.set_writable()
    return server


async def serve(server: Server, port: int) -> None:
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
    async with server:
        print(os.getpid(), flush=True)
        await asyncio.sleep(3600)


def main() -> None:
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for servers
    users = Users()
    server = asyncio.run(prepared(users))
    for line in sys.stdin:
        port, *users.known = line.split()
        users.known = tuple(users.known)
        if os.fork() == 0:
            asyncio.run(serve(server, int(port)))


if __name__ == "__main__":
    main()
