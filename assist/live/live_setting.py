"""The setting of a live session, which its events and views read: one declared field for each option."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from ..declare.catalogue import FIRST
from ..declare.declared import Beside, Expected, Number, Seed, Text, declared
from ..person.settings import Setting


def _texts_beside(folder: Path, text: str) -> str:
    """Return a file of texts with a path from a folder; a language unchanged."""
    return str(folder / text) if text.endswith(".toml") else text


@declared
class LiveSetting(Setting):
    """The setting of a live session.

    What it has beside `Setting` may be another when the session is opened again: no recorded event depends on it.
    """

    language: Annotated[
        Text,
        Beside(_texts_beside),
        Expected("en, de, or a file such as fr.toml"),
        Field(description="Language of people's pages."),
    ] = FIRST
    seed: Annotated[Seed, Field(description="Random seed of simulated people.")] = 0
    pace: Annotated[Number, Field(gt=0, le=1e9, description="Mean seconds between actions of simulated people.")] = 3.0
    tick: Annotated[
        Number, Field(gt=0, le=1e9, description="Seconds without an event after which the robot decides again.")
    ] = 2.0
    people_store: Annotated[
        Text | None,
        Beside(),
        Expected("a file"),
        Field(
            description="File with what earlier sessions have learned about people of the same names; it is kept there."
        ),
    ] = None
    keep_people: Annotated[
        Number, Field(gt=0, le=36_500, description="Days after which the store forgets a person.")
    ] = 30.0
