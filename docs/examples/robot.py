"""A robot asks where to go, goes there, says what is to be said, and asks again: python robot.py LINK [NUMBER].

LINK is the operator's, and NUMBER that of the robot, if there are several. The service is one with `travel_time`
above 0, so that it waits for the robot to arrive. Here driving is played; it ends when everybody has finished.
"""

from __future__ import annotations

import sys
import time

from assist.web.client import Client


def drive(to: str) -> None:
    """Go to somebody's bench; a real robot takes longer."""
    print(f"going to {to}", flush=True)
    time.sleep(0.05)


def main(link: str, number: str = "1") -> None:
    """Serve people until all have finished."""
    service, robot = Client(link), int(number)
    said = None
    while not all(person["finished"] for person in service.team()["people"]):
        errand = service.robot(robot)
        if errand["person"] is not None and not errand["arrived"]:
            drive(errand["person"])
            errand = service.arrived(errand["person"], robot=robot)
        if errand["suggestion"] is not None and errand["reason"] != said:
            said = errand["reason"]
            print(f"to {errand['person']}: {errand['suggestion']}, which saves {said['saving']:.2f}", flush=True)
        time.sleep(0.05)


if __name__ == "__main__":
    main(*sys.argv[1:])
