"""One measurement of `bench/pairs.py`: a task is loaded from its files and swept.

    python bench/peers/swept.py TASK

The result is one line of JSON on standard output: the number of states. The processor time of the whole process counts,
with Python's start and Fast Downward's translator.
"""

from __future__ import annotations

import json
import sys

from planner import load, sweep

if __name__ == "__main__":
    print(json.dumps({"count": len(sweep(load(sys.argv[1])))}))
