"""Stable-Baselines3's PPO, unchanged, in one kitchen: `python python/examples/ppo_sb3.py --steps 4096`.

Small frames in metres, episodes that begin near the target: a minute shows that everything fits together, not a policy.
"""

from __future__ import annotations

import argparse

import gymnasium
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

import stillroom


def make(number: int) -> gymnasium.Env:
    """One environment: its own episodes in kitchen 1, which all of them share."""
    return gymnasium.make(
        "stillroom/ArmPointNav-v0",
        kitchen=1,
        number=number,
        preset="demo",
        depth="float32",
        frame_side=56,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=4096)
    arguments = parser.parse_args()
    environments = DummyVecEnv([lambda number=number: make(number) for number in range(4)])
    model = PPO("MultiInputPolicy", environments, n_steps=256, batch_size=256, seed=1, device="cpu", verbose=1)
    model.learn(total_timesteps=arguments.steps)
    env = make(9)
    observation, info = env.reset(seed=1)
    total, ended = 0.0, False
    while not ended:
        action, _ = model.predict(observation)
        observation, reward, terminated, truncated, info = env.step(int(action))
        total += reward
        ended = terminated or truncated
    print(f"{stillroom.__version__}: one episode, return {total:.2f}, disturbance {info['disturbance_m']:.3f} m")


if __name__ == "__main__":
    main()
