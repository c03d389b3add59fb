"""Reader for the policies (alpha vectors) that SARSOP computes for a problem in POMDPX."""

from __future__ import annotations

import xml.parsers.expat
from pathlib import Path

import numpy as np

from planner.system.errors import InputFileError

from ..person.alpha_vectors import VectorPolicy
from ..person.pomdp import AssistPOMDP
from .observed import Observed


def read_policy(path: Path | str, pomdp: AssistPOMDP) -> VectorPolicy:
    """Read the policy that SARSOP wrote for a problem exported by `write_pomdpx`.

    SARSOP numbers observed values and hidden pairs in the order of the problem file: x from first to last, and
    beta * T + theta. It writes six significant digits. The vectors of a state's copies become vectors of the state. An
    action that a state lacks is read as "nothing". Goals have the value 0 and no vectors.

    Parameters
    ----------
    path : path
    pomdp : AssistPOMDP

    Raises
    ------
    InputFileError
        The file is malformed, or its numbers of states, hidden pairs or robot actions are not the problem's. A policy
        for other costs or another discount factor has the same numbers and is read.
    """
    observed = Observed.of(pomdp)
    reader = _PolicyReader(str(path), observed)
    reader.read(Path(path))
    choices = pomdp.model.choices
    state = observed.state[np.array(reader.value, dtype=np.int64)]
    keep = np.flatnonzero(~choices.goal[state])
    keep = keep[np.argsort(state[keep], kind="stable")]
    missing = ~choices.goal.copy()
    missing[state[keep]] = False
    if missing.any():
        raise InputFileError(f"{path}:{reader.end}: no alpha vector for state {int(missing.argmax())}")
    vectors = np.array([reader.vectors[i] for i in keep]).reshape(len(keep), *pomdp.grid.shape)
    action = np.array(reader.action, dtype=np.int64)[keep]
    action = np.where(action < pomdp.robot_actions[state[keep]], action, 0)
    first = np.searchsorted(state[keep], np.arange(len(choices) + 1)).astype(np.int64)
    return VectorPolicy(pomdp, vectors, action, first)


class _PolicyReader:
    """Reads a policy as a stream of XML elements, so that each error has a line number."""

    def __init__(self, name: str, observed: Observed) -> None:
        self.name, self.observed = name, observed
        self.value: list[int] = []
        self.action: list[int] = []
        self.vectors: list[list[float]] = []
        self.end = 1
        self.text: list[str] | None = None
        self.declared: int | None = None
        self.parser = xml.parsers.expat.ParserCreate()
        self.parser.StartElementHandler = self.begin
        self.parser.CharacterDataHandler = self.characters
        self.parser.EndElementHandler = self.finish

    def fail(self, message: str) -> InputFileError:
        return InputFileError(f"{self.name}:{self.parser.CurrentLineNumber}: {message}")

    def read(self, path: Path) -> None:
        try:
            with path.open("rb") as stream:
                self.parser.ParseFile(stream)
        except xml.parsers.expat.ExpatError as error:
            message = xml.parsers.expat.ErrorString(error.code)
            raise InputFileError(f"{self.name}:{error.lineno}: not a policy in XML: {message}") from None
        self.end = self.parser.CurrentLineNumber
        if self.declared is None:
            raise self.fail("no <AlphaVector> element; expected a policy of SARSOP")
        if self.declared != len(self.vectors):
            raise self.fail(f"{len(self.vectors)} vectors; the file declares {self.declared}")

    def number(self, attributes: dict[str, str], name: str, limit: int | None = None) -> int:
        try:
            number = int(attributes[name])
        except (KeyError, ValueError):
            raise self.fail(f"attribute {name}: expected a whole number") from None
        if number < 0 or (limit is not None and number >= limit):
            raise self.fail(
                f"attribute {name} is {number}; expected 0 to {(limit or 0) - 1}: another problem's policy?"
            )
        return number

    def begin(self, tag: str, attributes: dict[str, str]) -> None:
        pomdp = self.observed.pomdp
        if tag == "AlphaVector":
            for name, expected, what in (
                ("vectorLength", pomdp.prior.size, "hidden pairs"),
                ("numObsValue", len(self.observed.state), "states"),
            ):
                if self.number(attributes, name) != expected:
                    raise self.fail(f"{name} is {attributes[name]}, but the problem has {expected} {what}")
            self.declared = self.number(attributes, "numVectors")
        elif tag == "Vector":
            if self.declared is None:
                raise self.fail("<Vector> outside of <AlphaVector>")
            self.action.append(self.number(attributes, "action", int(pomdp.robot_actions.max(initial=1))))
            self.value.append(self.number(attributes, "obsValue", len(self.observed.state)))
            self.text = []
        elif tag != "Policy":
            raise self.fail(f"<{tag}>: expected <Policy>, <AlphaVector> or <Vector>")

    def characters(self, text: str) -> None:
        if self.text is not None:
            self.text.append(text)

    def finish(self, tag: str) -> None:
        if tag != "Vector" or self.text is None:
            return
        try:
            numbers = [float(word) for word in "".join(self.text).split()]
        except ValueError as error:
            raise self.fail(str(error)) from None
        if len(numbers) != self.observed.pomdp.prior.size or not np.isfinite(numbers).all():
            raise self.fail(
                f"a vector of {len(numbers)} numbers; expected {self.observed.pomdp.prior.size} finite ones"
            )
        self.vectors.append(numbers)
        self.text = None
