"""What a run adds to a step of an environment of your own, beside the bare loop and Gymnasium's `AsyncVectorEnv`.

    make bench-env ARGS="--seconds 3"

Everything is measured in processor time, so that other programs of the machine count little: of an actor's process of
16 environments whose learner answers at once (actor/engine/examples/instant_learner.rs), of a loop over 16 environments
in one process, and of all processes of an `AsyncVectorEnv` with shared memory, in turns; the least counts. Of
two environments one does nothing, the other takes 50 us to draw. Both observe 4 x 84 x 84 bytes, as an Atari game does.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import stillroom

ENVIRONMENTS = 16
SHAPE = (4, 84, 84)
BUSY_US = 50.0
# Steps between two looks at the clock.
TURN_STEPS = 200
# Microseconds of processor time and of the clock for a step of one environment.
Cost = tuple[float, float]


class Nothing(gymnasium.Env):
    """Does nothing, or draws for some microseconds."""

    def __init__(self, busy_us: float = 0.0) -> None:
        self.observation_space = gymnasium.spaces.Box(0, 255, SHAPE, np.uint8)
        self.action_space = gymnasium.spaces.Discrete(2)
        self._seen, self._info = np.zeros(SHAPE, np.uint8), {}  # type: ignore[var-annotated]
        self._busy_ns = int(busy_us * 1000)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Every episode begins alike."""
        self._seen.fill(0)
        return self._seen, self._info

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Processor time passes, in which an image is drawn."""
        if self._busy_ns:
            until = time.thread_time_ns() + self._busy_ns
            self._seen.fill(action)
            while time.thread_time_ns() < until:
                pass
        return self._seen, 0.0, False, False, self._info


def make_env(busy_us: float = 0.0) -> gymnasium.Env:
    """Called by actors, too."""
    return Nothing(busy_us)


def processor_ns(processes: Iterable[int]) -> int:
    """What processes have used, by Linux's scheduler."""
    tasks = [task for process in processes for task in Path(f"/proc/{process}/task").iterdir()]
    return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks)


@contextmanager
def configured(busy_us: float, orchestrator: str) -> Iterator[Path]:
    """The configuration of a run, which is ended before it trains."""
    with tempfile.TemporaryDirectory() as folder:
        training = stillroom.train(
            make_env,
            frames=10**9,
            run=Path(folder) / "run",
            env_kwargs={"busy_us": busy_us},
            settings={"learner.device": "cpu", "recording.enabled": False},
            options=["--actors", "1", "--envs-per-actor", str(ENVIRONMENTS), "--preset", "gym"],
            orchestrator=orchestrator,
        )
        training.stop()
        yield training.path / "config.toml"


def of_run(config: Path, seconds: float, learner: str) -> Cost:
    """An actor whose learner answers at once."""
    told = subprocess.run([learner, str(config), str(seconds)], stdout=subprocess.PIPE, check=True).stdout
    steps, *spent_ns = map(int, told.split())
    processor_us, wall_us = (ns / steps / 1000 for ns in spent_ns)
    return processor_us, wall_us


def of_loop(busy_us: float, seconds: float) -> Cost:
    """A loop over the environments."""
    envs = [make_env(busy_us) for _ in range(ENVIRONMENTS)]
    return per_step(lambda: [env.step(0) for env in envs], seconds, lambda: [os.getpid()])


def of_async(busy_us: float, seconds: float) -> Cost:
    """All processes of an AsyncVectorEnv."""
    envs = gymnasium.vector.AsyncVectorEnv([lambda: make_env(busy_us)] * ENVIRONMENTS, shared_memory=True)
    envs.reset(seed=0)
    actions = np.zeros(ENVIRONMENTS, np.int64)
    processes = [os.getpid(), *(process.pid for process in envs.processes)]
    try:
        return per_step(lambda: envs.step(actions), seconds, lambda: processes)
    finally:
        envs.close()


def of_copies(seconds: float) -> Cost:
    """A copy of what an environment observes, into memory that comes round again."""
    pairs = [(np.zeros(SHAPE, np.uint8), np.ones(SHAPE, np.uint8)) for _ in range(ENVIRONMENTS)]
    return per_step(lambda: [np.copyto(to, seen) for to, seen in pairs], seconds, lambda: [os.getpid()])


def per_step(step: Callable[[], Any], seconds: float, processes: Callable[[], list[int]]) -> Cost:
    """What a step of one environment costs."""
    steps, begun, before = 0, time.monotonic(), processor_ns(processes())
    while time.monotonic() < begun + seconds:
        for _ in range(TURN_STEPS):
            step()
        steps += TURN_STEPS * ENVIRONMENTS
    return (processor_ns(processes()) - before) / steps / 1000, (time.monotonic() - begun) / steps * 1e6


def least(costs: Iterable[Cost]) -> Cost:
    """Of each figure, as `timeit` takes it: other programs only add, by emptying the caches."""
    processor_us, wall_us = map(min, zip(*costs, strict=True))
    return processor_us, wall_us


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--orchestrator", default="orchestrator")
    parser.add_argument("--learner", required=True, help="the built example instant_learner")
    parser.add_argument("--seconds", type=float, default=3.0, help="for each figure")
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    print(f"a copy of {np.prod(SHAPE)} bytes: {of_copies(arguments.seconds)[0]:.2f} us")
    print("microseconds of processor time for a step (and steps/s), 16 environments")
    print("environment    bare loop   in a run   added   share of the loop   AsyncVectorEnv   beside the run")
    for name, busy_us in [("does nothing", 0.0), (f"{BUSY_US:.0f} us", BUSY_US)]:
        with configured(busy_us, arguments.orchestrator) as config:
            rounds = [
                (
                    of_loop(busy_us, arguments.seconds),
                    of_run(config, arguments.seconds, arguments.learner),
                    of_async(busy_us, arguments.seconds),
                )
                for _ in range(arguments.rounds)
            ]
        (loop, _), (run, run_wall), (beside, beside_wall) = map(least, zip(*rounds, strict=True))
        print(
            f"{name:14} {loop:9.2f} {run:10.2f} {run - loop:7.2f} {loop / run:19.2f} {beside:16.2f}"
            f" {beside / run:15.1f}x  ({1e6 / run_wall:,.0f}/s and {1e6 / beside_wall:,.0f}/s)",
            flush=True,
        )


if __name__ == "__main__":
    main()
