"""A policy under two physics engines: the same episodes and the same random numbers under rapier and under MuJoCo.

    make bench-transfer ARGS="--episodes 60"

Episodes are fixed ones of the test kitchens with novel targets, the first ones of each kitchen. The result of each in an
engine is a line beside the policy, in a file of its digest; a second start goes on where the first was stopped.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

import stillroom
from stillroom.mujoco_kitchen import MujocoKitchenEnv

ENGINES = {"rapier": stillroom.KitchenEnv, "MuJoCo": MujocoKitchenEnv}
# Episodes that are played together: the network takes them as one batch.
BATCH = 10
# What has moved further is displaced, metres; as in SRwoD.
DISPLACED_M = 0.01
SAMPLES = 10_000


def play(policy: Path, engine: str, kitchen: int, episodes: list[int]) -> list[dict[str, Any]]:
    """Plays fixed episodes of one kitchen; what came of each."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    network = onnxruntime.InferenceSession(str(policy), options, providers=["CPUExecutionProvider"])
    envs = [ENGINES[engine](kitchen, carried_goal="object_to_goal") for _ in episodes]
    begun = [env.reset(options={"fixed": episode}) for env, episode in zip(envs, episodes, strict=True)]
    observations, infos = [observation for observation, _ in begun], [info for _, info in begun]
    randoms = [np.random.default_rng([kitchen, episode]) for episode in episodes]
    beliefs = np.zeros((len(episodes), 512), np.float32)
    alive = list(range(len(episodes)))
    while alive:
        rows = {name: np.stack([observations[i][name] for i in alive]) for name in ("depth", "goal", "previous_action")}
        log_probs, _, beliefs[alive] = network.run(None, rows | {"belief": beliefs[alive]})
        for row, i in zip(log_probs, list(alive), strict=True):
            shares = np.cumsum(np.exp(row.astype(np.float64)))
            action = int(np.searchsorted(shares, randoms[i].random() * shares[-1], side="right"))
            observations[i], _, terminated, truncated, infos[i] = envs[i].step(min(action, len(row) - 1))
            if terminated or truncated:
                alive.remove(i)
    return [
        {
            "engine": engine,
            "kitchen": kitchen,
            "episode": episode,
            "success": bool(info["success"]),
            "undisturbed": bool(info["success_without_disturbance"]),
            "length": info["step"],
            "disturbance_m": info["disturbance_m"],
            "moved": sorted(name for name, moved_m in info["displacement_m"].items() if moved_m > DISPLACED_M),
        }
        for episode, info in zip(episodes, infos, strict=True)
    ]


def novel(kitchen: int, count: int) -> list[int]:
    """The first fixed episodes with a novel target."""
    env, found = stillroom.KitchenEnv(kitchen), []
    for number in range(env.kitchen.fixed_episodes):
        if len(found) == count:
            break
        if env.reset(options={"fixed": number})[1]["target"] in stillroom.TARGETS[6:]:
            found.append(number)
    return found


def left(played: list[dict[str, Any]], engines: list[str], count: int) -> Iterator[tuple[str, int, list[int]]]:
    """Engines, kitchens and batches of their episodes that were not played, kitchens in turn."""
    known = {(line["engine"], line["kitchen"], line["episode"]) for line in played}
    episodes = {kitchen: novel(kitchen, count) for kitchen in stillroom.kitchens("test")}
    for first in range(0, count, BATCH):
        for kitchen, numbers in episodes.items():
            for engine in engines:
                numbered = numbers[first : first + BATCH]
                if batch := [number for number in numbered if (engine, kitchen, number) not in known]:
                    yield engine, kitchen, batch


def interval(rows: NDArray[Any]) -> str:
    """A mean and its 95% interval: a bootstrap over episodes."""
    drawn = np.random.default_rng(1).integers(len(rows), size=(SAMPLES, len(rows)))
    low, high = np.percentile(rows[drawn].mean(-1), [2.5, 97.5])
    return f"{rows.mean():.4g} [{low:.4g}, {high:.4g}]"


def table(lines_of_episodes: list[dict[str, Any]]) -> str:
    """The figures in Markdown, of the episodes that were played in both engines."""
    by_episode: dict[tuple[int, int], dict[str, Any]] = {}
    for line in lines_of_episodes:
        by_episode.setdefault((line["kitchen"], line["episode"]), {})[line["engine"]] = line
    played = [engines for engines in by_episode.values() if len(engines) == len(ENGINES)]
    if not played:
        return "no episode was played in both engines"
    figures = [
        ("success (SR), %", "success", 100),
        ("without disturbance (SRwoD), %", "undisturbed", 100),
        ("d at the end, m", "disturbance_m", 1),
        ("actions", "length", 1),
    ]
    lines = [f"| {len(played)} episodes | rapier | MuJoCo | MuJoCo - rapier |", "|---|---|---|---|"]
    for label, key, scale in figures:
        columns = [np.array([episode[engine][key] for episode in played]) * float(scale) for engine in ENGINES]
        lines.append(f"| {label} | " + " | ".join(map(interval, [*columns, columns[1] - columns[0]])) + " |")
    for label, key, _ in figures[:2]:
        same = np.array([episode["rapier"][key] == episode["MuJoCo"][key] for episode in played])
        lines.append(f"| the same {label} | | | {interval(same * 100.0)} |")
    counts = [Counter(name for episode in played for name in episode[engine]["moved"]) for engine in ENGINES]
    both = Counter(
        name for episode in played for name in set(episode["rapier"]["moved"]) & set(episode["MuJoCo"]["moved"])
    )
    lines += ["", "| moved by more than 1 cm, episodes | rapier | MuJoCo | both |", "|---|---|---|---|"]
    lines.append(f"| anything | {_any(played, 'rapier')} | {_any(played, 'MuJoCo')} | |")
    for name, _ in (counts[0] + counts[1]).most_common(10):
        lines.append(f"| {name} | {counts[0][name]} | {counts[1][name]} | {both[name]} |")
    return "\n".join(lines)


def _any(played: list[dict[str, Any]], engine: str) -> int:
    return sum(bool(episode[engine]["moved"]) for episode in played)


def main() -> None:
    """Plays what is left, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", type=Path, required=True, help="an ONNX file of `orchestrator export`")
    parser.add_argument("--episodes", type=int, default=360, help="of each kitchen; all are 360")
    parser.add_argument("--engines", nargs="+", choices=ENGINES, default=list(ENGINES))
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    digest = hashlib.sha256(arguments.policy.read_bytes()).hexdigest()[:12]
    known = arguments.policy.with_suffix(f".{digest}.jsonl")
    played = [json.loads(line) for line in known.read_text().splitlines()] if known.exists() else []
    with ProcessPoolExecutor(arguments.processes) as pool, known.open("a") as out:
        batches = left(played, arguments.engines, arguments.episodes)
        tasks = [pool.submit(play, arguments.policy, *batch) for batch in batches]
        for task in as_completed(tasks):
            for episode in task.result():
                print(json.dumps(episode), file=out, flush=True)
                played.append(episode)
    print(table(played))


if __name__ == "__main__":
    main()
