"""Steps per second of `stillroom.VectorEnv` with 1, 2, 4, ... threads, beside Gymnasium's `AsyncVectorEnv` with a process
an environment, in wall time. All take the same random actions (all but Done) in the same episodes.

    make bench-python ARGS="--kitchens 1,14 --turns 10"
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass, field

import gymnasium
import numpy as np
from numpy.typing import NDArray

import stillroom

ENVIRONMENTS = 32
SEED = 1
EPISODE_STEPS = 200
TURN_STEPS = 50
# As many turns as an episode has, and one more, in which the last environments begin theirs.
WARM_UP_TURNS = EPISODE_STEPS // TURN_STEPS + 1
DONE = 20


@dataclass
class Schedule:
    """Actions, chosen beforehand. Environments are in different phases of their episodes, as in a rollout: in its first
    episode each says Done some steps after the one before."""

    random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(SEED))
    taken: NDArray[np.int64] = field(default_factory=lambda: np.zeros(ENVIRONMENTS, np.int64))
    ended: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(ENVIRONMENTS, np.bool_))
    step: int = 0

    def turn(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Actions [steps, environments], and where a `VectorEnv` ignores the action and begins an episode instead."""
        actions = self.random.integers(DONE, size=(TURN_STEPS, ENVIRONMENTS))
        resets = np.zeros(actions.shape, np.bool_)
        for row, reset in zip(actions, resets, strict=True):
            if self.step < EPISODE_STEPS:
                row[np.arange(ENVIRONMENTS) * EPISODE_STEPS // ENVIRONMENTS == self.step] = DONE
            reset[:] = self.ended
            self.taken = np.where(self.ended, 0, self.taken + 1)
            self.ended = ~reset & ((row == DONE) | (self.taken == EPISODE_STEPS))
            self.step += 1
        return actions, resets


def rate(env: gymnasium.vector.VectorEnv, turns: int) -> float:
    """Steps per second of wall time; steps that only reset do not count."""
    schedule = Schedule()
    env.reset(seed=[SEED] * ENVIRONMENTS)
    for _ in range(WARM_UP_TURNS):
        for row in schedule.turn()[0]:
            env.step(row)
    steps = 0
    chosen = [schedule.turn() for _ in range(turns)]
    begun = time.perf_counter()
    for actions, resets in chosen:
        for row in actions:
            env.step(row)
        steps += ENVIRONMENTS * TURN_STEPS - int(resets.sum())
    seconds = time.perf_counter() - begun
    env.close()
    return steps / seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kitchens", default="1,8,14", help="numbers with commas between")
    parser.add_argument("--depth", default="uint16", help="what the VectorEnv gives: uint16 as the actor, or float32")
    parser.add_argument("--turns", type=int, default=10, help="turns of 50 steps for each figure")
    parser.add_argument("--no-async", action="store_true", help="leave AsyncVectorEnv out")
    arguments = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    print(f"{ENVIRONMENTS} environments, {stillroom.FRAME_SIDE} x {stillroom.FRAME_SIDE} pixels, {cores} cores")
    for number in arguments.kitchens.split(","):
        scaling(int(number), cores, arguments.turns, arguments.depth, with_async=not arguments.no_async)


def scaling(kitchen: int, cores: int, turns: int, depth: str, *, with_async: bool) -> None:
    """Prints what more threads bring, and processes."""
    # All are in one kitchen that is built once; processes that are forked have it, too.
    room = stillroom.Kitchen(kitchen)
    threads = 1
    while threads <= cores:
        figure = rate(stillroom.VectorEnv(ENVIRONMENTS, kitchens=[room], threads=threads, depth=depth), turns)
        print(f"kitchen {kitchen}, wall time: VectorEnv, {threads} threads {figure:8,.0f} steps/s", flush=True)
        threads *= 2
    if with_async:
        make = [
            lambda number=number: stillroom.KitchenEnv(room, number=number, depth=depth)
            for number in range(ENVIRONMENTS)
        ]
        figure = rate(gymnasium.vector.AsyncVectorEnv(make), turns)
        print(f"kitchen {kitchen}, wall time: AsyncVectorEnv     {figure:8,.0f} steps/s", flush=True)


if __name__ == "__main__":
    main()
