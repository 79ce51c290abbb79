"""Every task of the declaration has environments, with observations, infos and states that follow from it."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import stillroom


def names(task: str, role: str) -> set[str]:
    return {channel["name"] for channel in stillroom.channels(task) if channel["role"] == role}


@pytest.mark.parametrize("task", stillroom.tasks())
def test_what_a_task_declares_is_what_its_environment_returns(task: str) -> None:
    env = stillroom.KitchenEnv(1, task=task, frame_side=16, max_steps=10)
    seen, info = env.reset(seed=3)
    assert env.observation_space.contains(seen) and seen["goal"].any()
    assert names(task, "outcome") | {"success", "success_without_disturbance", "action_failed"} <= info.keys()
    assert info["reward_parts"].keys() == names(task, "part")
    assert names(task, "state") <= env.state().keys()
    lengths = {channel["name"]: channel["shape"] for channel in stillroom.channels(task) if channel["role"] == "state"}
    assert {name: list(np.shape(env.state()[name])) for name in lengths} == lengths
    ended = False
    while not ended:
        seen, _, terminated, truncated, info = env.step(1)
        ended = terminated or truncated
    assert info["step"] == 10 and env.observation_space.contains(seen)
    # A scalar is a number of Python's own.
    assert isinstance(env.state()["base_yaw_rad"], float)


def test_one_drives_to_a_point() -> None:
    env = gymnasium.make("stillroom/PointNav-v0", kitchen=7, goal_distance_max_m=2.0, render_mode="rgb_array")
    _, info = env.reset(seed=1)
    start_m = info["goal_distance_m"]
    assert env.unwrapped.action_names == ["Stop", "MoveAhead", "TurnLeft", "TurnRight"] and 0.5 <= start_m <= 2.0
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=1)
    seen, reward, *_, info = env.step(1)
    progress_m = info["reward_parts"]["goal_progress_m"]
    assert progress_m == pytest.approx(start_m - info["goal_distance_m"], abs=1e-6)
    assert reward == pytest.approx(progress_m - 0.01, abs=1e-6)
    assert env.render().ndim == 3
    _, _, terminated, _, info = env.step(0)
    assert terminated and not info["success"] and info["action_failed"]
    # The goal as it is seen, and where it is.
    state = env.unwrapped.state()
    (x, y, z), yaw = seen["goal"], state["base_yaw_rad"]
    base_x, base_z = state["base_position_m"]
    goal = [base_x + x * np.cos(yaw) + z * np.sin(yaw), y, base_z - x * np.sin(yaw) + z * np.cos(yaw)]
    assert np.allclose(goal, state["goal_position_m"], atol=1e-4)


def test_many_drive_as_each_does_alone() -> None:
    actions = np.random.default_rng(5).integers(1, 4, (12, 6))
    settings = {"task": "point_nav", "frame_side": 16, "max_steps": 5, "reward": "r_prime"}
    many = stillroom.VectorEnv(6, kitchens=[1, 8], autoreset_mode="SameStep", threads=2, **settings)
    seen, infos = many.reset(seed=2)
    alone = [stillroom.KitchenEnv([1, 8][index % 2], number=index // 2, **settings) for index in range(6)]
    hashes = [env.reset(seed=2 + index)[1]["state_hash"] for index, env in enumerate(alone)]
    assert list(infos["state_hash"]) == hashes
    for row in actions:
        seen, rewards, terminated, truncated, infos = many.step(row)
        for index, env in enumerate(alone):
            own, reward, *ended, info = env.step(row[index])
            assert (reward, any(ended)) == (rewards[index], terminated[index] or truncated[index])
            if any(ended):
                last = infos["final_obs"][index]
                assert all(np.array_equal(last[name], own[name]) for name in own)
                own, info = env.reset()
            assert info["state_hash"] == infos["state_hash"][index]
            assert all(np.array_equal(seen[name][index], own[name]) for name in own)


def test_moments_of_any_task_are_kept_and_belong_to_it() -> None:
    env = stillroom.KitchenEnv(8, task="point_nav", frame_side=16)
    env.reset(seed=4, options={"episode": 2})
    env.step(1)
    snapshot = env.snapshot()
    twins = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    went = [env.step(action)[4]["state_hash"] for action in (1, 2, 1)]
    for twin in twins:
        assert [twin.step(action)[4]["state_hash"] for action in (1, 2, 1)] == went
    env.restore(stillroom.Snapshot.from_bytes(snapshot.to_bytes()))
    assert [env.step(action)[4]["state_hash"] for action in (1, 2, 1)] == went
    with pytest.raises(ValueError, match="other settings"):
        stillroom.KitchenEnv(8, task="arm_point_nav", frame_side=16).restore(snapshot)


def test_what_another_task_has_is_refused_with_a_sentence() -> None:
    env = stillroom.KitchenEnv(8, task="point_nav", frame_side=8)
    with pytest.raises(ValueError, match="has neither fixed nor drawn episodes: reset with a seed"):
        env.reset(options={"fixed": 0})
    env.reset(seed=1)
    with pytest.raises(ValueError, match="of arm_point_nav: make the environment with"):
        stillroom.oracle(env)
    for arguments, problem in [
        ({"task": "cook"}, 'task is \'cook\', none of "arm_point_nav", "point_nav"'),
        ({"task": "point_nav", "action_space": "small"}, 'none of "large"'),
    ]:
        with pytest.raises(ValueError, match=problem):
            stillroom.KitchenEnv(8, **arguments)
    with pytest.raises(TypeError, match=r"kitchen is 'seven', not an integer: give a number of stillroom.kitchens"):
        stillroom.KitchenEnv("seven")
    with pytest.raises(ValueError, match=r"kitchen is 0, not 1 to .*scene="):
        stillroom.KitchenEnv(0)


def test_a_kept_moment_has_the_sign_of_its_goal() -> None:
    env = stillroom.ArmPointNav(1, carried_goal="object_to_goal", frame_side=8)
    env.reset(seed=1)
    again = pickle.loads(pickle.dumps(env))
    assert again.state()["state_hash"] == env.state()["state_hash"]
    with pytest.raises(ValueError, match="other settings"):
        stillroom.ArmPointNav(1, frame_side=8).restore(env.snapshot())


def test_the_axes_of_the_goal_are_right_up_and_ahead() -> None:
    env = stillroom.ArmPointNav(1, frame_side=8)
    seen, _ = env.reset(seed=1)
    state = env.state()
    # From the wrist to the target in the world, turned by minus the yaw (positive to the right).
    x, y, z = state["target_position_m"] - state["wrist_position_m"]
    yaw = state["base_yaw_rad"]
    right, ahead = x * np.cos(yaw) - z * np.sin(yaw), x * np.sin(yaw) + z * np.cos(yaw)
    assert np.allclose(seen["goal"], [right, y, ahead], atol=1e-5)
