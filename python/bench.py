"""Steps per second of `stillroom.VectorEnv` beside the Rust actor and Gymnasium's `AsyncVectorEnv`.

    make bench-python ARGS="--kitchens 1,14 --pairs 15"

One core: the environments of an actor and a `VectorEnv` with one thread, both on the same core, take the same random
actions (all but Done) in the same episodes, in turns of 50 steps; what goes first alternates. Both are measured in
processor time of their thread, so that other programs on the machine count little. The hashes of all states must be
equal. The figure of a kitchen is the median over the pairs of turns.

All cores: `VectorEnv` with 1, 2, 4, ... threads and `AsyncVectorEnv` with a process an environment, in wall time.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
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
HOLD = 254


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


class Actor:
    """The environments of an actor in a process of its own: `actor bench-beside`."""

    def __init__(self, program: str, kitchen: int, core: int) -> None:
        sizes = ["--environments", str(ENVIRONMENTS), "--seed", str(SEED), "--steps", str(TURN_STEPS)]
        self.process = subprocess.Popen(
            [program, "bench-beside", "--kitchen", str(kitchen), *sizes], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        os.sched_setaffinity(self.process.pid, [core])

    def turn(self, actions: NDArray[np.int64], resets: NDArray[np.bool_]) -> tuple[float, int]:
        """Seconds of processor time, and the sum of the state hashes."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(np.where(resets, HOLD, actions).astype(np.uint8).tobytes())
        self.process.stdin.flush()
        nanoseconds, hashes = self.process.stdout.readline().split()
        return int(nanoseconds) / 1e9, int(hashes)

    def close(self) -> None:
        self.process.communicate()


def turn(env: stillroom.VectorEnv, actions: NDArray[np.int64], resets: NDArray[np.bool_]) -> tuple[float, int]:
    """The same of a `VectorEnv`."""
    hashes = []
    begun = time.thread_time()
    for row in actions:
        *_, infos = env.step(row)
        hashes.append(infos["state_hash"])
    seconds = time.thread_time() - begun
    return seconds, int(np.where(resets, np.uint64(0), np.array(hashes)).sum(dtype=np.uint64))


def one_core(program: str, kitchen: int, pairs: int, core: int, depth: str) -> tuple[list[float], list[float]]:
    """Steps per second of processor time in each pair of turns: of the actor, of the `VectorEnv`."""
    rust, python = [], []
    allowed = os.sched_getaffinity(0)
    actor = Actor(program, kitchen, core)
    os.sched_setaffinity(0, [core])
    env = stillroom.VectorEnv(ENVIRONMENTS, kitchens=[kitchen], threads=1, depth=depth)
    env.reset(seed=[SEED] * ENVIRONMENTS)
    schedule = Schedule()
    for number in range(WARM_UP_TURNS + pairs):
        chosen = schedule.turn()
        if number % 2 == 0:
            of_actor, of_env = actor.turn(*chosen), turn(env, *chosen)
        else:
            of_env, of_actor = turn(env, *chosen), actor.turn(*chosen)
        if of_actor[1] != of_env[1]:
            raise SystemExit(f"kitchen {kitchen}: the actor and the VectorEnv did not do the same in turn {number}")
        if number >= WARM_UP_TURNS:
            steps = ENVIRONMENTS * TURN_STEPS - int(chosen[1].sum())
            rust.append(steps / of_actor[0])
            python.append(steps / of_env[0])
    actor.close()
    env.close()
    os.sched_setaffinity(0, allowed)
    return rust, python


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
    parser.add_argument("--actor", default="target/release/actor", help="the program `actor`")
    parser.add_argument("--kitchens", default="1,8,14", help="numbers with commas between")
    parser.add_argument("--pairs", type=int, default=15, help="pairs of turns for each kitchen")
    parser.add_argument("--depth", default="uint16", help="what the VectorEnv gives: uint16 as the actor, or float32")
    parser.add_argument("--turns", type=int, default=10, help="turns for each figure of wall time; 0 measures none")
    parser.add_argument("--no-async", action="store_true", help="leave AsyncVectorEnv out")
    arguments = parser.parse_args()
    allowed = sorted(os.sched_getaffinity(0))
    print(f"{ENVIRONMENTS} environments, {stillroom.FRAME_SIDE} x {stillroom.FRAME_SIDE} pixels, {len(allowed)} cores")
    kitchens = [int(number) for number in arguments.kitchens.split(",")]
    medians = []
    for kitchen in kitchens:
        rust, python = one_core(arguments.actor, kitchen, arguments.pairs, allowed[-1], arguments.depth)
        shares = [mine / its for mine, its in zip(python, rust, strict=True)]
        medians.append(statistics.median(shares))
        print(
            f"kitchen {kitchen:2}  one core, {arguments.pairs} pairs: actor {statistics.median(rust):8,.0f}  VectorEnv "
            f"{statistics.median(python):8,.0f} steps/s of processor time; share {medians[-1]:.1%} "
            f"({min(shares):.1%} to {max(shares):.1%})",
            flush=True,
        )
    print(f"VectorEnv / actor, median of the kitchens: {statistics.median(medians):.1%}")
    if arguments.turns > 0:
        scaling(kitchens[0], len(allowed), arguments.turns, arguments.depth, with_async=not arguments.no_async)


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
            lambda number=number: stillroom.ArmPointNav(room, number=number, depth=depth)
            for number in range(ENVIRONMENTS)
        ]
        figure = rate(gymnasium.vector.AsyncVectorEnv(make), turns)
        print(f"kitchen {kitchen}, wall time: AsyncVectorEnv     {figure:8,.0f} steps/s", flush=True)


if __name__ == "__main__":
    main()
