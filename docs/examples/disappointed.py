"""A trust rule: theta falls by a step after each suggestion that somebody followed and saw to be wrong."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Disappointed:
    """The rule with its step."""

    step: float = 0.1
    uses_answer = True
    feedback = "true"

    def update(self, theta, event):
        """Return theta after an event."""
        wrong = event.followed & event.shown & ~event.right
        return np.clip(theta - self.step * wrong, 0.0, 1.0)


strongly = Disappointed(0.3)
