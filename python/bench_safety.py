"""A task with a cost, in Stillroom: reward r, r' = r - 2 cost, r and then r', and PPO-Lagrangian.

    make bench-safety ARGS="--jobs 14"

The task is Safety-Gymnasium's SafetyHopperVelocity-v1 (examples/cheetah.py): a step faster than 0.7402 m/s costs 1. All
ways have the same settings and as many frames. Return, of r, and cost are of the last 100 training episodes.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from bench_curves import MUJOCO, Recipe, add_arguments, interval, last, read_stillroom, run_all, stillroom_words, timed

TASK = "SafetyHopperVelocity-v1"
# The Zoo's for MuJoCo, with its 2,048 steps from eight environments.
SETTINGS = MUJOCO._replace(environments=8, steps=256)
WAYS = {
    "r": SETTINGS,
    "r'": SETTINGS._replace(rewards=("careful",)),
    "r, then r'": SETTINGS._replace(rewards=("r", "careful")),
    "PPO-Lagrangian": SETTINGS._replace(rewards=("constrained",)),
}

# The sum of r and the cost of an episode, by their names in a run's metrics.
FIGURES = ("score", "too_fast")


def settings_of(way: str, options: argparse.Namespace) -> Recipe:
    """The settings, with other frames for a rehearsal."""
    return WAYS[way]._replace(frames=options.frames or SETTINGS.frames)


def measure(job: tuple[str, int], deadline: float, options: argparse.Namespace) -> dict[str, Any] | None:
    """A run; none if time is over before its end."""
    way, seed = job
    settings = settings_of(way, options)
    with tempfile.TemporaryDirectory(prefix="safety-") as place:
        run = Path(place, "run")
        words = [options.orchestrator, *stillroom_words(TASK, seed, settings, run, options)]
        times = timed(words, deadline, options.device)
        if not times:
            return None
        found = {of: last(read_stillroom(run, f"episode/{of}")) for of in FIGURES}
    return {"way": way, "seed": seed, "frames": settings.frames, "cores": options.cores} | times | found


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    add_arguments(parser, Path("safety.jsonl"))
    options = parser.parse_args()

    def read() -> list[dict[str, Any]]:
        runs = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
        of = (options.frames or SETTINGS.frames, options.cores)
        return [run for run in runs if (run["frames"], run["cores"]) == of]

    done = {(run["way"], run["seed"]) for run in read()}
    jobs = [(way, seed) for seed in range(1, options.seeds + 1) for way in WAYS]
    all_well = run_all([job for job in jobs if job not in done], options, measure)
    print("| way | frames | seeds | return | cost |", "|---" * 5 + "|", sep="\n")
    for way in WAYS:
        if runs := [run for run in read() if run["way"] == way and run["score"] is not None]:
            both = ("{:.1f} [{:.1f}, {:.1f}]".format(*interval([run[of] for run in runs])) for of in FIGURES)
            print(f"| {way} | {runs[0]['frames']:,} | {len(runs)}", *both, sep=" | ", end=" |\n")
    sys.exit(not all_well)


if __name__ == "__main__":
    main()
