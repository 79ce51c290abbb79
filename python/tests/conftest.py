"""What tests share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import stillroom

REPOSITORY = Path(__file__).resolve().parents[2]
WORD = 0xFFFFFFFF


def random_action(kitchen: int, environment: int, episode: int, step: int) -> int:
    """The random policy of the simulator's own tests: Philox4x32-10, all actions but Done."""
    block = 0
    while True:
        counter = [8 << 24 | kitchen << 16 | block, environment, episode, step]
        key = [11, 0]
        for _ in range(10):
            low, high = counter[0] * 0xD2511F53, counter[2] * 0xCD9E8D57
            counter = [high >> 32 ^ counter[1] ^ key[0], high & WORD, low >> 32 ^ counter[3] ^ key[1], low & WORD]
            key = [(key[0] + 0x9E3779B9) & WORD, (key[1] + 0xBB67AE85) & WORD]
        for word in counter:
            product = word * 20
            if product & WORD >= (2**32 - 20) % 20:
                return product >> 32
        block += 1


@pytest.fixture(scope="session")
def kitchens() -> dict[int, stillroom.Kitchen]:
    """Two kitchens, built once: one to train in, one with fixed episodes."""
    return {number: stillroom.Kitchen(number) for number in (1, 8)}


def pushing(kitchen: stillroom.Kitchen) -> list[int]:
    """Actions of an episode in which things are pushed: some random ones, then those of the fast oracle, in fixed
    episode 0 of kitchen 8."""
    env = stillroom.ArmPointNav(kitchen)
    env.reset(options={"fixed": 0})
    oracle = stillroom.oracle(env)
    actions: list[int] = []
    ended = False
    while not ended:
        actions.append(random_action(8, 0, 0, len(actions)) if len(actions) < 12 else oracle())
        _, _, terminated, truncated, info = env.step(actions[-1])
        ended = terminated or truncated
    assert info["disturbance_m"] > 0.05, "physics is at work"
    return actions


def same(a: dict, b: dict) -> bool:
    """Whether two observations are equal, bit for bit."""
    return a.keys() == b.keys() and all(
        np.array_equal(np.asarray(a[name]), np.asarray(b[name]))
        and np.asarray(a[name]).dtype == np.asarray(b[name]).dtype
        for name in a
    )
