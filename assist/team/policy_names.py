"""The names of team policies, for commands that show them in their help and import no policy for that."""

POLICIES = ("none", "reactive", "attention", "attention-never", "attention-outlook", "priority", "whittle", "rollout")
"""The names that `policies.named` accepts."""

BASELINES = ("none", "reactive")
"""Policies that others are compared with."""

WEIGHING = tuple(name for name in POLICIES if name not in BASELINES)
"""Policies that weigh the cost of a suggestion."""

SELDOM = 25.0
"""Percentage of people who get a suggestion below which a policy hardly assists anybody."""


def hardly_assists(policy: str, assisted: float) -> bool:
    """Return whether a policy weighs costs, and suggests something to so few people (in percent) that it is said."""
    return policy in WEIGHING and assisted < SELDOM
