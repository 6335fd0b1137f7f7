"""Checks whether a machine was quiet while something was timed."""

import os
import time
from pathlib import Path
from typing import Any

AGAIN = 0.05  # the floor may differ from itself by this share
OTHERS = 0.2  # cores that other processes may use


class Watch:
    """Measures, while its block runs, how many cores other processes use."""

    def __enter__(self) -> "Watch":
        self.begun, self.busy, self.own = time.monotonic(), _busy_seconds(), time.process_time()
        return self

    def __exit__(self, *_: object) -> None:
        seconds = time.monotonic() - self.begun
        busy = _busy_seconds()
        self.others: float | None = None
        if busy is not None and self.busy is not None:
            self.others = max(0.0, (busy - self.busy - (time.process_time() - self.own)) / max(seconds, 1e-9))

    def state(self) -> dict[str, Any]:
        """Cores that other processes used (None if the system does not say), and the load average of a minute."""
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
        return {"others_cores": self.others, "load_average": load}


def unrest(state: dict[str, Any]) -> str:
    """Why a machine was not quiet, in words; "" if it was."""
    reasons = []
    if abs(state.get("floor_again", 1.0) - 1) > AGAIN:
        reasons.append(f"the floor, timed twice, differed by {100 * abs(state['floor_again'] - 1):.0f} %")
    if (state.get("others_cores") or 0.0) > OTHERS:
        reasons.append(f"other processes used {state['others_cores']:.1f} cores")
    return " and ".join(reasons)


def _busy_seconds() -> float | None:
    """Seconds that all processors together have worked since the system started, by Linux; else None."""
    try:
        user, nice, system, _, _, *rest = map(int, Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9])
    except (OSError, ValueError):
        return None
    return (user + nice + system + sum(rest[:2])) / os.sysconf("SC_CLK_TCK")
