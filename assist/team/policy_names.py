"""The names of team policies, for commands that show them in their help and import no policy for that."""

POLICIES = ("none", "reactive", "attention", "attention-never", "attention-outlook", "priority", "whittle", "rollout")
"""The names that `policies.named` accepts."""
