"""The nodes of the assistant's own OPC UA server: an object for each person and robot, with variables and a method.

A person's object has the variables `Suggestion`, `Finished`, `Seq`, `Action`, `Begin` and `Answer` and the method
`Report`; a robot's has `Person`, `Suggestion` and `Arrived`. Clients may write `Action`, `Begin` and `Arrived`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

from .transport import Located, Message

NAMESPACE = "urn:kitassist"
UNKNOWN = -1  # `Seq` in a call that does not say which advice the person had seen


class Reporting(Protocol):
    """What clients report."""

    def acted(self, person: str, text: str) -> Message:
        """Return what is reported by a text that is written to `Action`."""

    def begun(self, person: str, identifier: str) -> Message:
        """Return what is reported by an id that is written to `Begin`."""

    async def called(self, person: str, parent: Any, *given: Any) -> Any:
        """Answer a call of `Report`; with a status if its arguments are wrong."""


@dataclass
class _Object:
    """The node of a person or robot, and its variables by name."""

    node: Any
    variables: dict[str, Any] = field(default_factory=dict)


class Nodes:
    """The nodes of a server; there are no people and robots at first.

    Parameters
    ----------
    ua : module
        The library's types.
    server : object
        The library's server, which does not listen yet.
    space : int
        Number of the namespace.
    reporting : Reporting
    last : dict
        The last value of each node that clients have written, also to a server before this one.
    """

    def __init__(self, ua: Any, server: Any, space: int, reporting: Reporting, last: dict[str, Any]) -> None:
        self._ua, self._server, self._space, self._reporting, self._last = ua, server, space, reporting, last
        self._objects: dict[str, _Object] = {}  # of people and robots, by their path
        self._inputs: dict[str, Callable[[str], Message | None]] = {}  # what written values report

    async def prepare(self) -> None:
        """Add the objects `People` and `Robots`."""
        for name in ("People", "Robots"):
            await self._server.nodes.objects.add_folder(self._id(name), f"{self._space}:{name}")

    async def show(self, path: str, content: Mapping[str, Any]) -> None:
        """Show values of a person or robot, whose nodes are made when they are first needed."""
        if path not in self._objects and "Answer" not in content:
            self._objects[path] = await (self._person(path) if path.startswith("People/") else self._robot(path))
        if path in self._objects:  # unless the person has left meanwhile
            for name, value in content.items():
                await self._objects[path].variables[name].write_value(self.typed(value))

    async def remove(self, path: str) -> None:
        """Remove the nodes of a person who has left."""
        found = self._objects.pop(path, None)
        if found is not None:
            for node in found.variables.values():
                self._inputs.pop(node.nodeid.to_string(), None)
                self._last.pop(node.nodeid.to_string(), None)
            await self._server.delete_nodes([found.node], recursive=True)

    def written(self, node: str, value: Any) -> Message | None:
        """Return what a value reports that a client has written; None if it says nothing, or was there before."""
        if node not in self._inputs:
            return None
        before, self._last[node] = self._last.get(node, ""), value
        return None if value in (None, before) else self._inputs[node](str(value))

    def typed(self, value: Any) -> Any:
        """Return a value with its type in OPC UA; None becomes an empty text."""
        types = self._ua.VariantType
        kind = {bool: types.Boolean, int: types.Int64}.get(type(value), types.String)
        return self._ua.Variant("" if value is None else value, kind)

    def _id(self, path: str) -> Any:
        return self._ua.NodeId(path, self._space)

    async def _object(self, path: str) -> _Object:
        folder, name = path.split("/", 1)
        parent = self._server.get_node(self._id(folder))
        return _Object(await parent.add_object(self._id(path), f"{self._space}:{name}"))

    async def _variable(
        self, of: _Object, name: str, value: Any, reports: Callable[[str], Message | None] | None = None
    ) -> None:
        """Add a variable; if clients may write it, with what its values report."""
        path = f"{of.node.nodeid.Identifier}/{name}"
        node = await of.node.add_variable(self._id(path), f"{self._space}:{name}", self.typed(value))
        of.variables[name] = node
        if reports is not None:
            self._inputs[node.nodeid.to_string()] = reports  # before clients may write, so that no value is lost
            await node.set_writable()

    async def _person(self, path: str) -> _Object:
        types, person, own = self._ua.VariantType, path.removeprefix("People/"), await self._object(path)
        for name, value in (("Suggestion", ""), ("Finished", False), ("Seq", UNKNOWN), ("Answer", "")):
            await self._variable(own, name, value)
        await self._variable(own, "Action", "", _unless_empty(partial(self._reporting.acted, person)))
        await self._variable(own, "Begin", "", _unless_empty(partial(self._reporting.begun, person)))
        await own.node.add_method(
            self._id(f"{path}/Report"), f"{self._space}:Report", partial(self._reporting.called, person),
            [types.String, types.String, types.Int64], [types.String, types.String, types.Int64],
        )  # fmt: skip
        return own

    async def _robot(self, path: str) -> _Object:
        own, robot = await self._object(path), int(path.removeprefix("Robots/"))
        for name in ("Person", "Suggestion"):
            await self._variable(own, name, "")
        await self._variable(own, "Arrived", "", lambda person: Located(robot, person or None))
        return own


def _unless_empty(reports: Callable[[str], Message]) -> Callable[[str], Message | None]:
    """Return a function that reports nothing of an empty text."""
    return lambda value: reports(value) if value else None
