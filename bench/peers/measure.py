"""What every peer's program has in common: one thread, processor time, one JSON document as its answer."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal, TypedDict

from .export import Export

#: The figures that a peer can have.
Figure = Literal["depth_s", "rays_s", "physics_s", "whole_step_s"]


class Result(TypedDict, total=False):
    """Processor time of one frame or step of a kitchen under a policy, seconds, and what was checked on the way.

    `rays_s` is a frame for which nothing had to be prepared: less work than a frame of ours.
    """

    depth_s: float
    rays_s: float
    physics_s: float
    whole_step_s: float
    checks: dict[str, float]


class Answer(TypedDict):
    """What a peer's program prints."""

    peer: str
    results: dict[str, dict[str, Result]]  # policy, kitchen number
    notes: list[str]


def shortest_s(call: Callable[[], object], repeats: int = 3) -> float:
    """Processor time (of all threads) of the quickest of some calls, seconds."""
    times = []
    for _ in range(repeats):
        started = time.process_time()
        call()
        times.append(time.process_time() - started)
    return min(times)


def main(measure: Callable[[Export], list[Answer]]) -> None:
    """The program: reads the exported folder named on the command line, measures, prints."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    export = Export.load(parser.parse_args().folder)
    json.dump(measure(export), sys.stdout)
