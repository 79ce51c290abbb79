"""Behaviour cloning of the oracle: `python python/examples/behaviour_cloning.py --episodes 24`.

The oracle plays episodes near the target; a network learns to choose what it chose from what the robot saw.
"""

from __future__ import annotations

import argparse

import numpy as np
import torch
from torch.nn import functional as F

import stillroom
from stillroom.network import Network


def demonstrations(count: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Episodes of the oracle: depth, goals, previous actions, and its actions."""
    env = stillroom.KitchenEnv(1, preset="demo")
    oracle = stillroom.oracle(env)
    episodes, successes = [], 0
    observation, info = env.reset(seed=1)
    while len(episodes) < count:
        steps, ended = [], False
        while not ended:
            action = oracle()
            steps.append((observation["depth"], observation["goal"], observation["previous_action"], action))
            observation, _, terminated, truncated, info = env.step(action)
            ended = terminated or truncated
        successes += info["success"]
        episodes.append(tuple(np.array(part) for part in zip(*steps, strict=True)))
        observation, info = env.reset()
    print(f"the oracle succeeds in {successes} of {count} episodes, {sum(len(e[3]) for e in episodes)} steps")
    return episodes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=24)
    parser.add_argument("--epochs", type=int, default=15)
    arguments = parser.parse_args()
    torch.manual_seed(1)
    episodes = demonstrations(arguments.episodes)
    network = Network(encoder="cnn", input_pool=4, hidden=128)
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
    for epoch in range(arguments.epochs):
        losses, right, steps = [], 0, 0
        for depth, goal, previous, actions in episodes:
            rows = (torch.from_numpy(previous) + 1) % (network.actions + 1)
            pooled = network.pool(torch.from_numpy(depth))
            embedded = network.embed(pooled, network.coordinates(torch.from_numpy(goal)), rows)
            beliefs, _ = network.belief(embedded[:, None])
            logits = network.actor(beliefs[:, 0])
            chosen = torch.from_numpy(actions)
            loss = F.cross_entropy(logits, chosen)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
            right += int((logits.argmax(1) == chosen).sum())
            steps += len(actions)
        print(f"epoch {epoch + 1:2}: cross-entropy {np.mean(losses):.3f}, {right / steps:.0%} of its actions")


if __name__ == "__main__":
    main()
