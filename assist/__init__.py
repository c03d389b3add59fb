"""From the exact cost-to-go to a robot that assists a team."""

from .attention import (
    BASE,
    NOBODY,
    AttentionSwitching,
    NoAssistance,
    Reactive,
    TeamAction,
    TeamPolicy,
    TeamState,
    distances,
)
from .belief import Grid, ImpossibleObservationError
from .choices import Choices
from .errors import MissingExtraError
from .human import NOTHING, Human, HumanModel, Population
from .pomdp import AssistPOMDP
from .simulate import Episode, Pool, Setting, Summary, simulate, summarise
from .solver import Policy, solve

__all__ = [
    "BASE",
    "NOBODY",
    "NOTHING",
    "AssistPOMDP",
    "AttentionSwitching",
    "Choices",
    "Episode",
    "Grid",
    "Human",
    "HumanModel",
    "ImpossibleObservationError",
    "MissingExtraError",
    "NoAssistance",
    "Policy",
    "Pool",
    "Population",
    "Reactive",
    "Setting",
    "Summary",
    "TeamAction",
    "TeamPolicy",
    "TeamState",
    "distances",
    "simulate",
    "solve",
    "summarise",
]
