"""An OPC UA server with two stations, for tests: `python opcua_server.py PORT`."""

from __future__ import annotations

import asyncio
import sys

from asyncua import Server, ua


async def serve(port: int) -> None:
    server = Server()
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
    asyncio.run(serve(int(sys.argv[1])))
