"""What a run adds to a step of an environment of your own, beside the bare loop and Gymnasium's `AsyncVectorEnv`.

    make bench-env ARGS="--seconds 10"

Everything is measured in processor time, so that a learner and other programs on the machine count little: of the
actor's process in a real run of 16 environments, of a loop over 16 environments in one process, and of all processes of
an `AsyncVectorEnv` with shared memory. Of two environments one does nothing, the other computes for 50 us. Both
observe 28,224 bytes, as many as four images of 84 x 84: 7,056 numbers, which cost a learner less than images.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import stillroom

ENVIRONMENTS = 16
NUMBERS = 84 * 84
BUSY_US = 50.0
# Steps between two looks at the clock.
TURN_STEPS = 200
SETTINGS = {
    "learner.device": "cpu",
    "learner.threads": 1,
    "recording.enabled": False,
    "network.hidden": 32,
    "ppo.rollout_steps": 128,
    "ppo.epochs": 1,
}


class Nothing(gymnasium.Env):
    """Does nothing, or computes for some microseconds."""

    def __init__(self, busy_us: float = 0.0) -> None:
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (NUMBERS,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(2)
        self._seen, self._info = np.zeros(NUMBERS, np.float32), {}  # type: ignore[var-annotated]
        self._busy_ns = int(busy_us * 1000)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Nothing is drawn."""
        return self._seen, self._info

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Processor time passes."""
        if self._busy_ns:
            until = time.thread_time_ns() + self._busy_ns
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


def of_run(busy_us: float, seconds: float, orchestrator: str) -> float:
    """Microseconds of an actor's process for a step."""
    with tempfile.TemporaryDirectory() as folder:
        options = ["--actors", "1", "--envs-per-actor", str(ENVIRONMENTS), "--preset", "gym"]
        training = stillroom.train(
            make_env,
            frames=10**9,
            run=Path(folder) / "run",
            env_kwargs={"busy_us": busy_us},
            settings=SETTINGS,
            options=options,
            orchestrator=orchestrator,
        )
        try:
            (actor,) = wait_for(lambda: actors(training.path), 60.0)
            began = at_boundary(training, actor)
            time.sleep(seconds)
            ended = at_boundary(training, actor)
        finally:
            training.stop()
    return (ended[1] - began[1]) / (ended[0] - began[0]) / 1000


def actors(run: Path) -> list[int]:
    """The actors' processes of a run."""
    found = []
    for process in Path("/proc").iterdir():
        try:
            words = (process / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if b"--actor" in words and str(run / "config.toml").encode() in words:
            found.append(int(process.name))
    return found


def at_boundary(training: stillroom.Training, actor: int) -> tuple[int, int]:
    """Frames and nanoseconds when a rollout has just been trained on."""
    frames = training.frames
    wait_for(lambda: training.frames > frames, 120.0)
    return training.frames, processor_ns([actor])


def wait_for(look: Callable[[], Any], seconds: float) -> Any:
    """What `look` finds at last."""
    until = time.monotonic() + seconds
    while not (found := look()):
        if time.monotonic() > until:
            raise SystemExit(f"bench-env: error: nothing came within {seconds:.0f} s")
        time.sleep(0.002)
    return found


def of_loop(busy_us: float, seconds: float) -> float:
    """Microseconds of a loop over the environments for a step."""
    envs = [make_env(busy_us) for _ in range(ENVIRONMENTS)]
    return per_step(lambda: [env.step(0) for env in envs], seconds, lambda: [os.getpid()])


def of_async(busy_us: float, seconds: float) -> float:
    """The same of all processes of an AsyncVectorEnv."""
    envs = gymnasium.vector.AsyncVectorEnv([lambda: make_env(busy_us)] * ENVIRONMENTS, shared_memory=True)
    envs.reset(seed=0)
    actions = np.zeros(ENVIRONMENTS, np.int64)
    processes = [os.getpid(), *(process.pid for process in envs.processes)]
    try:
        return per_step(lambda: envs.step(actions), seconds, lambda: processes)
    finally:
        envs.close()


def per_step(step: Callable[[], Any], seconds: float, processes: Callable[[], list[int]]) -> float:
    """Microseconds for a step of one environment."""
    steps, until, began = 0, time.monotonic() + seconds, processor_ns(processes())
    while time.monotonic() < until:
        for _ in range(TURN_STEPS):
            step()
        steps += TURN_STEPS * ENVIRONMENTS
    return (processor_ns(processes()) - began) / steps / 1000


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--orchestrator", default="orchestrator")
    parser.add_argument("--seconds", type=float, default=10.0, help="for each figure")
    arguments = parser.parse_args()
    print("microseconds of processor time for a step, 16 environments, 28,224 bytes observed")
    print("environment    bare loop   in a run   added   share of the loop   AsyncVectorEnv   beside the run")
    for name, busy_us in [("does nothing", 0.0), (f"{BUSY_US:.0f} us", BUSY_US)]:
        loop = of_loop(busy_us, arguments.seconds)
        run = of_run(busy_us, arguments.seconds, arguments.orchestrator)
        beside = of_async(busy_us, arguments.seconds)
        ratios = f"{loop / run:19.2f} {beside:16.2f} {beside / run:15.1f}x"
        print(f"{name:14} {loop:9.2f} {run:10.2f} {run - loop:7.2f} {ratios}", flush=True)


if __name__ == "__main__":
    main()
