"""Many environments."""

from __future__ import annotations

import inspect
import sys
import threading
import time

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import stillroom
from conftest import random_action, same

COUNT = 4


def make(kitchens: dict, **arguments: object) -> stillroom.VectorEnv:
    return stillroom.VectorEnv(COUNT, kitchens=list(kitchens.values()), **arguments)


def actions_of(step: int) -> np.ndarray:
    return np.array([random_action(1, index, 0, step) for index in range(COUNT)])


def row(observations: dict, index: int) -> dict:
    return {name: array[index] for name, array in observations.items()}


@pytest.mark.parametrize("threads", [1, 3])
def test_many_are_as_each_alone(kitchens: dict, threads: int) -> None:
    many = make(kitchens, threads=threads, max_steps=60)
    assert many.batch.threads == threads
    rooms = [kitchens[1], kitchens[8], kitchens[1], kitchens[8]]
    singles = [stillroom.ArmPointNav(room, number=i // 2, max_steps=60) for i, room in enumerate(rooms)]
    observations, infos = many.reset(seed=5)
    assert many.observation_space.contains(observations)
    ended, moved = [False] * COUNT, 0
    oracle = stillroom.oracle(many)
    for index, env in enumerate(singles):
        observation, info = env.reset(seed=5 + index)
        assert same(observation, row(observations, index)) and info["state_hash"] == infos["state_hash"][index]
    for step in range(130):
        actions = actions_of(step) if step < 10 else oracle()
        observations, rewards, terminated, truncated, infos = many.step(actions)
        for index, env in enumerate(singles):
            # Gymnasium's `NextStep`: the step after the last one resets.
            if ended[index]:
                observation, info = env.reset()
                result = (0.0, False, False)
            else:
                observation, *result, info = env.step(int(actions[index]))
            ended[index] = bool(result[1] or result[2])
            assert same(observation, row(observations, index))
            assert tuple(result) == (rewards[index], terminated[index], truncated[index])
            for name in ("state_hash", "episode_number", "step", "success", "disturbance_m", "wrist_object_m"):
                assert infos[name][index] == info[name], name
            assert stillroom.TARGETS[infos["target"][index]] == info["target"]
            assert many.displacement_m(index) == info["displacement_m"]
            moved += len(info["displacement_m"])
    assert moved > 0, "physics was at work"


def test_autoreset_in_the_same_step(kitchens: dict) -> None:
    same_step = make(kitchens, autoreset_mode=AutoresetMode.SAME_STEP, max_steps=5)
    next_step = make(kitchens, max_steps=5, copy=True)
    assert same_step.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    same_step.reset(seed=1)
    next_step.reset(seed=1)
    for step in range(5):
        expected = next_step.step(actions_of(step))
        found = same_step.step(actions_of(step))
        assert ("final_obs" in found[4]) == (step == 4)
    infos = found[4]
    assert found[3].all() and np.array_equal(found[1], expected[1])
    assert infos["_final_obs"].all() and infos["_final_info"].all()
    assert np.array_equal(infos["final_info"]["state_hash"], expected[4]["state_hash"])
    begun = next_step.step(actions_of(5))
    for index in range(COUNT):
        assert same(infos["final_obs"][index], row(expected[0], index))
        assert same(row(found[0], index), row(begun[0], index))
    assert np.array_equal(infos["state_hash"], begun[4]["state_hash"])
    assert (begun[1] == 0).all() and (begun[4]["step"] == 0).all()


def test_without_autoreset_the_caller_resets_some(kitchens: dict) -> None:
    env = make(kitchens, autoreset_mode="Disabled", max_steps=2)
    env.reset(seed=1)
    env.step(actions_of(0))
    mask = np.array([True, False, False, False])
    _, infos = env.reset(seed=8, options={"reset_mask": mask})
    assert list(infos["step"]) == [0, 1, 1, 1]
    env.step(actions_of(1))
    with pytest.raises(ValueError, match="environment 1 has ended: reset it"):
        env.step(actions_of(2))
    env.reset(options={"reset_mask": ~mask})
    assert env.step(actions_of(2))[3].tolist() == [True, False, False, False]


def test_observations_are_views_unless_copies_are_asked_for(kitchens: dict) -> None:
    env = make(kitchens)
    first, _ = env.reset(seed=1)
    kept = first["depth"].copy()
    shared = np.from_dlpack(first["depth"])
    second = env.step(np.full(COUNT, 17))[0]
    assert first["depth"] is second["depth"] and not np.array_equal(first["depth"], kept)
    assert np.shares_memory(shared, second["depth"])
    copying = make(kitchens, copy=True)
    first, _ = copying.reset(seed=1)
    copying.step(np.full(COUNT, 17))
    assert np.array_equal(first["depth"], kept)


def test_the_lock_of_python_is_free_during_a_step(kitchens: dict) -> None:
    env = stillroom.VectorEnv(32, kitchens=[kitchens[1]], threads=1)
    env.reset(seed=1)
    counted, stop = [0], threading.Event()

    def count() -> None:
        while not stop.is_set():
            counted[0] += 1
            time.sleep(0.0002)

    other = threading.Thread(target=count)
    interval = sys.getswitchinterval()
    # Nobody takes the lock from a thread that does not give it.
    sys.setswitchinterval(100.0)
    try:
        other.start()
        steps = 0
        for step in range(30):
            before = counted[0]
            env.step(np.array([random_action(1, index, 0, step) for index in range(32)]))
            steps += counted[0] > before
    finally:
        sys.setswitchinterval(interval)
        stop.set()
        other.join()
    assert steps > 15, f"another thread ran during {steps} of 30 steps"


def test_a_reward_of_arrays(kitchens: dict) -> None:
    env = make(kitchens, reward=lambda parts: -parts["failed_action"], max_steps=20)
    env.reset(seed=1)
    total = 0.0
    for step in range(25):
        _, rewards, _, _, infos = env.step(actions_of(step))
        assert np.array_equal(rewards, -infos["reward_parts"]["failed_action"].astype(np.float64))
        total += rewards.sum()
    assert total < 0


def test_gymnasium_makes_it() -> None:
    env = gymnasium.make_vec(
        "stillroom/ArmPointNav-v0", num_envs=2, vectorization_mode="vector_entry_point", kitchens=[1], frame_side=32
    )
    observations, _ = env.reset(seed=1)
    assert isinstance(env, stillroom.VectorEnv) and observations["depth"].shape == (2, 32, 32)
    assert env.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP


def test_a_moment_of_one_environment_is_restored_in_another(kitchens: dict) -> None:
    env = make(kitchens, copy=True)
    env.reset(seed=1)
    for step in range(20):
        env.step(actions_of(step))
    before, _ = env.restore(2, env.snapshot(0))
    assert same(row(before, 2), row(before, 0)) and not same(row(before, 1), row(before, 0))
    after = env.step(np.full(COUNT, 16))[4]
    assert after["state_hash"][0] == after["state_hash"][2]


def test_what_is_wrong_is_said(kitchens: dict) -> None:
    for arguments, words in [
        ({"autoreset_mode": "Sometimes"}, "Sometimes"),
        ({"render_mode": "human"}, "rgb_array"),
        ({"kitchens": "kitchens"}, 'none of "train", "validation", "test"'),
        ({"kitchens": []}, "at least one kitchen"),
        ({"kitchens": [1], "scenes": "a.toml"}, "either kitchens or scenes"),
        ({"scenes": "a.toml"}, r"a\.toml: there is no such file"),
        ({"threads": -1}, "threads is -1, not 1 to"),
        ({"threads": 0}, "threads is 0, not 1 to"),
    ]:
        with pytest.raises(ValueError, match=words):
            stillroom.VectorEnv(1, **arguments)
    env = make(kitchens)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(actions_of(0))
    with pytest.raises(ValueError, match="seed has 2 items for 4"):
        env.reset(seed=[1, 2])
    env.reset(seed=1)
    with pytest.raises(ValueError, match="3 actions for 4"):
        env.step(np.zeros(3, np.int64))
    with pytest.raises(ValueError, match=r"actions of shape \(4, 1\) for 4"):
        env.step(np.zeros((4, 1), np.int64))
    with pytest.raises(ValueError, match="actions are integers"):
        env.step(np.full(4, 0.5))
    with pytest.raises(ValueError, match="environment 2: there are actions 0 to 20, not -1"):
        env.step(np.array([0, 0, -1, 0]))


def test_both_kinds_have_the_same_task_arguments() -> None:
    one, many = (inspect.signature(kind).parameters for kind in (stillroom.ArmPointNav, stillroom.VectorEnv))
    own = {"num_envs", "kitchens", "scenes", "autoreset_mode", "threads", "copy"}
    shared = {name: parameter.default for name, parameter in many.items() if name not in own}
    of_one = {name: parameter.default for name, parameter in one.items()}
    assert shared == {name: of_one[name] for name in of_one if name not in {"kitchen", "scene", "number"}}


def test_an_ended_moment_begins_anew_in_the_mode_of_the_same_step(kitchens: dict) -> None:
    kitchen = next(iter(kitchens.values()))
    one = stillroom.ArmPointNav(kitchen, max_steps=2)
    one.reset(seed=1)
    while not any(one.step(0)[2:4]):
        pass
    env = stillroom.VectorEnv(1, kitchens=[kitchen], max_steps=2, autoreset_mode="SameStep")
    env.reset(seed=1)
    env.restore(0, one.snapshot())
    _, rewards, terminated, truncated, infos = env.step(np.array([0]))
    assert rewards[0] == 0 and not terminated[0] and not truncated[0]
    assert infos["step"][0] == 0


def test_processes_of_gymnasium_take_hashes_of_all_64_bits(kitchens: dict) -> None:
    make = [
        lambda number=number: stillroom.ArmPointNav(kitchens[1], number=number, frame_side=32) for number in range(4)
    ]
    with_processes = gymnasium.vector.AsyncVectorEnv(make, context="fork")
    _, infos = with_processes.reset(seed=[1] * 4)
    with_processes.close()
    _, expected = stillroom.VectorEnv(4, kitchens=kitchens[1], frame_side=32).reset(seed=[1] * 4)
    assert np.array_equal(infos["state_hash"], expected["state_hash"]) and infos["state_hash"].dtype == np.uint64
    assert (infos["state_hash"] >= 2**63).any(), "the test has seen a large one"


def test_actions_may_be_a_column_of_a_matrix(kitchens: dict) -> None:
    envs = [make(kitchens, frame_side=32) for _ in range(2)]
    matrix = np.arange(4 * 9).reshape(4, 9) % 20
    for env in envs:
        env.reset(seed=1)
    column, copied = envs[0].step(matrix[:, 3]), envs[1].step(matrix[:, 3].copy())
    assert np.array_equal(column[4]["state_hash"], copied[4]["state_hash"])


def test_only_kitchens_in_use_are_built(monkeypatch: pytest.MonkeyPatch, kitchens: dict) -> None:
    built = []
    monkeypatch.setattr("stillroom.vector.kitchen_of", lambda kitchen: built.append(kitchen) or kitchens[1])
    stillroom.VectorEnv(2, kitchens="train", frame_side=32)
    assert built == stillroom.kitchens("train")[:2]


@pytest.mark.parametrize("rewards", [None, np.zeros(3), np.zeros((COUNT, 1))])
def test_a_reward_of_another_shape_is_refused(kitchens: dict, rewards: object) -> None:
    env = make(kitchens, reward=lambda _parts: rewards, frame_side=32)
    env.reset(seed=1)
    with pytest.raises(ValueError, match="not one number for each of 4"):
        env.step(actions_of(0))
    # A function that raises in an episode's last step does not hide its end.
    one = stillroom.ArmPointNav(kitchens[1], reward=lambda parts: parts["none"], max_steps=1, frame_side=32)
    one.reset(seed=1)
    with pytest.raises(KeyError):
        one.step(0)
    with pytest.raises(gymnasium.error.ResetNeeded):
        one.step(0)
