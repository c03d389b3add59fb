"""Views of a user study: what participants see of their progress."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ...declare.declared import AnyText, Seldom, Truth, View, Whole, declared
from ...live.views import PersonView


@declared(kw_only=True)
class Waiting(View):
    """How many participants wait for a group, and how many a group has."""

    here: Whole
    of: Whole


@declared(kw_only=True)
class Progress(View):
    """A participant's progress: the present task or questionnaire (`what`), with its questions in their order.

    `over` is whether the task is over.
    """

    kind: AnyText
    stage: AnyText
    what: AnyText
    number: Whole
    of: Whole
    over: Truth
    completion: AnyText | None
    items: tuple[AnyText, ...]
    waiting: Annotated[
        Waiting | None, Seldom(), Field(description="While the participant waits for a group: how many do.")
    ] = None


@declared(kw_only=True)
class ParticipantView(PersonView):
    """A participant's view: the task, if there is one, and the progress."""

    study: Progress


@declared(kw_only=True)
class EnrolledView(ParticipantView):
    """The operator's view of a participant."""

    status: AnyText
    condition: AnyText | None
    simulated: Truth
