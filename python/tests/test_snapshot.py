"""Snapshots, and the oracle."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

import stillroom
from conftest import pushing, random_action, same


def play(env: stillroom.ArmPointNav, actions: list[int]) -> list[tuple]:
    return [env.step(action) for action in actions]


def test_a_restored_environment_goes_on_to_the_same_bits(kitchens: dict) -> None:
    actions = pushing(kitchens[8])
    env = stillroom.ArmPointNav(kitchens[8])
    env.reset(options={"fixed": 0})
    half = next(step for step, taken in enumerate(play(env, actions)) if taken[4]["displacement_m"]) + 1
    assert 5 < half < len(actions) - 5, "things move before and after the snapshot"
    env.reset(options={"fixed": 0})
    play(env, actions[:half])
    snapshot = env.snapshot()
    expected = play(env, actions[half:])
    env.reset(seed=9)
    kept = pickle.loads(pickle.dumps(snapshot))
    for one in (snapshot, kept):
        for other in (env, stillroom.ArmPointNav(kitchens[8])):
            _, info = other.restore(one)
            assert info["state_hash"] == snapshot.state_hash and info["step"] == snapshot.step == half
            found = play(other, actions[half:])
            assert [step[4] for step in found] == [step[4] for step in expected]
            assert all(same(a[0], b[0]) and a[1] == b[1] for a, b in zip(found, expected, strict=True))


def test_a_snapshot_that_does_not_fit_is_refused(kitchens: dict) -> None:
    env = stillroom.ArmPointNav(kitchens[1])
    env.reset(seed=3)
    play(env, [random_action(1, 0, 0, step) for step in range(5)])
    snapshot = env.snapshot()
    with pytest.raises(ValueError, match="a snapshot of kitchen 1 is none of kitchen 8"):
        stillroom.ArmPointNav(kitchens[8]).restore(snapshot)
    with pytest.raises(ValueError, match="other settings"):
        stillroom.ArmPointNav(kitchens[1], max_steps=7).restore(snapshot)
    record = json.loads(snapshot.to_bytes())
    record["actions"][2] = (record["actions"][2] + 1) % 4
    with pytest.raises(ValueError, match="leads to another state"):
        stillroom.Snapshot.from_bytes(json.dumps(record).encode())
    with pytest.raises(ValueError, match="no snapshot"):
        stillroom.Snapshot.from_bytes(b"{}")


def test_an_episode_that_has_ended_is_restored_as_ended(kitchens: dict) -> None:
    env = stillroom.ArmPointNav(kitchens[1], max_steps=3)
    env.reset(seed=3)
    play(env, [0, 1, 2])
    env.restore(env.snapshot())
    assert env.batch.ended(0)
    env.reset()
    assert not env.batch.ended(0)


@pytest.mark.parametrize("variant", ["fast", "careful"])
def test_the_oracle_brings_the_target_to_its_goal(kitchens: dict, variant: str) -> None:
    env = stillroom.ArmPointNav(kitchens[8])
    oracle = stillroom.oracle(env, variant)
    disturbance_m = []
    for number in range(3):
        _, info = env.reset(options={"fixed": number})
        terminated = False
        while not terminated:
            action = oracle()
            assert oracle.action() == action, "asking again changes nothing"
            _, _, terminated, truncated, info = env.step(action)
            assert not truncated
        assert info["success"]
        disturbance_m.append(info["disturbance_m"])
    if variant == "careful":
        assert max(disturbance_m) < 0.01


def test_the_oracle_corrects_another_policy(kitchens: dict) -> None:
    env = stillroom.ArmPointNav(kitchens[8])
    env.reset(options={"fixed": 0})
    oracle = stillroom.oracle(env)
    for step in range(6):
        oracle()
        env.step(random_action(8, 0, 0, step))
    for _ in range(150):
        _, _, terminated, _, info = env.step(oracle())
        if terminated:
            break
    assert info["success"]


def test_the_oracle_of_many_is_that_of_each(kitchens: dict) -> None:
    many = stillroom.VectorEnv(2, kitchens=[kitchens[8]], threads=2)
    many.reset(options={"fixed": [0, 5]})
    single = stillroom.ArmPointNav(kitchens[8])
    single.reset(options={"fixed": 5})
    all_of, one = stillroom.oracle(many), stillroom.oracle(single)
    for _ in range(20):
        actions = all_of()
        assert actions.dtype == np.int64 and actions[1] == one()
        many.step(actions)
        single.step(int(actions[1]))
    with pytest.raises(ValueError, match="none of"):
        stillroom.oracle(single, "slow")


@pytest.mark.parametrize("side", [224, 61])
def test_a_frame_over_what_stood_still_is_one_drawn_anew(kitchens: dict, side: int) -> None:
    env = stillroom.ArmPointNav(kitchens[8], frame_side=side)
    env.reset(options={"fixed": 0})
    for step, action in enumerate(pushing(kitchens[8])[:40]):
        observation, *_ = env.step(action)
        if step % 4 == 3:
            fresh = stillroom.ArmPointNav(kitchens[8], frame_side=side)
            anew, _ = fresh.restore(stillroom.Snapshot.from_bytes(env.snapshot().to_bytes()))
            assert np.array_equal(anew["depth"], observation["depth"])
