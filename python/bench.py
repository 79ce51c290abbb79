"""Steps per second of `stillroom.VectorEnv` beside the Rust simulator itself and Gymnasium's `AsyncVectorEnv`.

    make bench-python ARGS="--kitchens 1,14 --seconds 3"

One core: `actor bench` and a `VectorEnv` with one thread take the same environments through random actions (all but
Done); both are measured in processor time, so that other programs on the machine do not count. All cores: `VectorEnv`
with 1, 2, 4, ... threads and `AsyncVectorEnv` with a process an environment, in wall time.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import time
from collections.abc import Callable

import gymnasium
import numpy as np

import stillroom

ENVIRONMENTS = 32


def actor(program: str, kitchen: int, seconds: float) -> float:
    """Steps per second of processor time of the Rust simulator."""
    command = [program, "bench", "--kitchens", str(kitchen), "--policies", "random", "--seconds", str(seconds)]
    output = subprocess.run([*command, "--no-memory", "--json"], check=True, capture_output=True).stdout
    rows = json.loads(output)["measurements"]
    return next(1.0 / row["whole_step_s"] for row in rows if row["environments"] == ENVIRONMENTS)


def rate(env: gymnasium.vector.VectorEnv, seconds: float, clock: Callable[[], float]) -> float:
    """Steps per second of `clock`; steps that only reset do not count."""
    random = np.random.default_rng(1)
    env.reset(seed=1)
    # One after the other through the episode, as the actor's are: half of them is ahead.
    for _ in range(50):
        env.step(random.integers(20, size=ENVIRONMENTS))
    steps = 0
    ended = np.zeros(ENVIRONMENTS, np.bool_)
    begun = clock()
    while (elapsed := clock() - begun) < seconds:
        _, _, terminated, truncated, _ = env.step(random.integers(20, size=ENVIRONMENTS))
        steps += ENVIRONMENTS - int(ended.sum())
        ended = np.logical_or(terminated, truncated)
    env.close()
    return steps / elapsed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--actor", default="target/release/actor", help="the program `actor`")
    parser.add_argument("--kitchens", default="1,8,14", help="numbers with commas between")
    parser.add_argument("--seconds", type=float, default=2.0, help="time for each figure")
    parser.add_argument("--rounds", type=int, default=3, help="repetitions, of which the median is taken")
    parser.add_argument("--no-async", action="store_true", help="leave AsyncVectorEnv out")
    arguments = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    print(f"{ENVIRONMENTS} environments, {stillroom.FRAME_SIDE} x {stillroom.FRAME_SIDE} pixels, {cores} cores")
    shares = []
    for kitchen in map(int, arguments.kitchens.split(",")):
        room = stillroom.Kitchen(kitchen)
        rust, python = [], []
        for _ in range(arguments.rounds):
            rust.append(actor(arguments.actor, kitchen, arguments.seconds))
            env = stillroom.VectorEnv(ENVIRONMENTS, kitchens=[room], threads=1)
            python.append(rate(env, arguments.seconds, time.process_time))
        share = statistics.median(python) / statistics.median(rust)
        shares.append(share)
        print(
            f"kitchen {kitchen:2}  one core: actor {statistics.median(rust):8,.0f}  VectorEnv "
            f"{statistics.median(python):8,.0f} steps/s of processor time ({share:.0%})"
        )
    print(f"VectorEnv / actor, median of the kitchens: {statistics.median(shares):.1%}")
    kitchen = int(arguments.kitchens.split(",")[0])
    room = stillroom.Kitchen(kitchen)
    threads = 1
    while threads <= cores:
        env = stillroom.VectorEnv(ENVIRONMENTS, kitchens=[room], threads=threads)
        figure = rate(env, arguments.seconds, time.perf_counter)
        print(f"kitchen {kitchen}, wall time: VectorEnv, {threads} threads {figure:8,.0f} steps/s")
        threads *= 2
    if not arguments.no_async:
        make = [lambda number=number: stillroom.ArmPointNav(kitchen, number=number) for number in range(ENVIRONMENTS)]
        env = gymnasium.vector.AsyncVectorEnv(make)
        figure = rate(env, arguments.seconds, time.perf_counter)
        print(f"kitchen {kitchen}, wall time: AsyncVectorEnv     {figure:8,.0f} steps/s")


if __name__ == "__main__":
    main()
