"""What an environment says of itself, and how it is found. tests/tests/system/environments.rs has runs of such."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import stillroom
from stillroom.description import F32_MOST, Refused, check_seen, describe
from stillroom.determinism import prove, try_out
from stillroom.film import Camera
from stillroom.masks import add_mask
from stillroom.serving import _takes_mode, find
from stillroom.trial import Tried
from stillroom.wrappers import ActionMasks, MujocoSnapshot


class Env(gymnasium.Env):
    """Counts its steps; `noise` is drawn beside the seed."""

    def __init__(self, observation=None, actions=None, noise=False):
        self.observation_space = observation or spaces.Box(-1.0, 1.0, (3,), np.float32)
        self.action_space = spaces.Discrete(3) if actions is None else actions
        self._noise = np.random.default_rng() if noise else None

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._steps = 0
        return self._seen(), {}

    def step(self, action):
        self._steps += 1
        return self._seen(), float(action), self._steps == 7, False, {}

    def _seen(self):
        random = self.np_random if self._noise is None else self._noise
        return random.uniform(-1, 1, 3).astype(np.float32)


def channels(observation):
    return describe(Env(observation), "mine").description["channels"]


def test_spaces_become_channels():
    (box,) = channels(spaces.Box(np.array([-4.8, -np.inf]), np.array([4.8, np.inf]), dtype=np.float64))
    assert (box["name"], box["dtype"], box["shape"], box["range"]) == ("observation", "f32", [2], [-F32_MOST, F32_MOST])
    (number,) = channels(spaces.Discrete(16, start=-3))
    assert (number["dtype"], number["range"], "shape" in number) == ("i32", [-3.0, 12.0], False)
    (image,) = channels(spaces.Box(0, 255, (84, 84), np.uint8))
    assert (image["dtype"], image["shape"], "range" in image) == ("u8", [84, 84], False)
    (bits,) = channels(spaces.MultiBinary(4))
    assert (bits["dtype"], bits["shape"], bits["range"]) == ("u8", [4], [0.0, 1.0])
    (grid,) = channels(spaces.MultiBinary((2, 3)))
    assert (grid["dtype"], grid["shape"], grid["range"]) == ("i32", [2, 3], [0.0, 1.0])
    (several,) = channels(spaces.MultiDiscrete([3, 5]))
    assert (several["dtype"], several["shape"], several["range"]) == ("i32", [2], [0.0, 4.0])
    both = describe(Env(spaces.Dict({"Goal-1": spaces.Discrete(2), "robot": spaces.Box(0, 1, (2,))})), "mine")
    assert both.observed == [("goal_1", "Goal-1"), ("observation_robot", "robot")]
    assert both.description["actions"] == {"kind": "discrete", "names": ["action_0", "action_1", "action_2"]}


def test_action_spaces_of_any_shape_become_lists():
    def actions(space):
        return describe(Env(actions=space), "mine").description["actions"]

    assert actions(spaces.MultiDiscrete([[3, 2], [4, 5]])) == {"kind": "multi_discrete", "counts": [3, 2, 4, 5]}
    box = spaces.Box(np.array([[-1.0], [-np.inf]]), np.array([[0.5], [np.inf]]), dtype=np.float64)
    assert actions(box) == {"kind": "box", "bounds": [[-1.0, 0.5], [-F32_MOST, F32_MOST]]}


class Masked(Env):
    """Allows what its `action_masks` says, as environments for sb3-contrib do."""

    def action_masks(self):
        return [self._steps % 2 == 0, True, False]

    def step(self, action):
        assert self.action_masks()[action]
        return super().step(action)


def test_a_mask_in_info_is_declared_and_kept_to():
    def mask(env):
        described = describe(env, "mine")
        add_mask(described, env)
        prove(env, lambda: env)
        return [channel["shape"] for channel in described.description["channels"] if channel["role"] == "mask"]

    assert mask(gymnasium.make("Taxi-v4")) == [[6]]
    assert mask(ActionMasks(Masked())) == [[3]]
    assert mask(Env()) == []
    with pytest.raises(Refused, match=r"has the shape \(3,\), not \(4,\)"):
        mask(ActionMasks(Masked(actions=spaces.Discrete(4))))


@pytest.mark.parametrize(
    ("observation", "actions", "problem"),
    [
        (None, spaces.Tuple([spaces.Discrete(2)]), "actions are Discrete, MultiDiscrete or Box"),
        (None, spaces.Box(-1, 1, (2,), np.int32), "numbers of int32"),
        (None, spaces.MultiDiscrete([3, 2], start=[0, 1]), "begin with"),
        (None, spaces.Discrete(3, start=1), "begin with 0"),
        (None, spaces.Discrete(255), "at most 254"),
        (spaces.Text(5), None, "observations are Box.*encode text as numbers in a wrapper"),
        (spaces.Tuple([spaces.Discrete(2)]), None, "observations are Box.*gymnasium.wrappers.FlattenObservation"),
        (spaces.Dict({"a": spaces.Dict({"b": spaces.Discrete(2)})}), None, "observations are Box"),
        (spaces.Dict({"7": spaces.Discrete(2)}), None, "begins with a letter"),
        (spaces.Box(0, 1, (2,), np.float16), None, "is of float16"),
    ],
)
def test_what_a_run_cannot_have_is_refused_in_a_sentence(observation, actions, problem):
    with pytest.raises(Refused, match=problem):
        describe(Env(observation, actions), "mine")


def test_what_is_seen_is_as_its_space_says():
    for space in (spaces.MultiBinary(4), spaces.MultiBinary((2, 3)), spaces.Box(-9, 9, (2,), np.int16)):
        check_seen(describe(Env(space), "mine"), space.sample())
    described = describe(Env(spaces.Dict({"a": spaces.Box(0, 1, (2,)), "b": spaces.Discrete(3)})), "mine")
    check_seen(described, {"a": np.zeros(2), "b": 1})
    for seen, problem in [
        ({"a": np.zeros(3, np.float32), "b": 1}, r"`a` is an array of \[3\] float32, and its space is Box"),
        ({"a": np.zeros(2, np.int64), "b": 1}, r"`a` is an array of \[2\] int64, and its space is Box"),
        ({"a": np.zeros(2)}, "has no `b`, which its space has"),
        (np.zeros(2), "has no `a`, which its space has"),
    ]:
        with pytest.raises(Refused, match=problem):
            check_seen(described, seen)


class Faulty(Env):
    """Its first step returns something else than it should."""

    def __init__(self, **instead):
        super().__init__()
        self._instead = instead

    def step(self, action):
        step = dict(zip(("observation", "reward", "terminated", "truncated", "info"), super().step(1), strict=True))
        return tuple((step | self._instead).values())


@pytest.mark.parametrize(
    ("instead", "problem"),
    [
        ({"reward": float("nan")}, "the environment's reward is nan, which is not finite"),
        (
            {"reward": np.zeros(2)},
            r"step\(\)'s reward is an array of \[2\] float64, not a number \(step 1 of the episode with seed 0\)",
        ),
        ({"reward": None}, "step..'s reward is None, not a number"),
        (
            {"observation": np.full(3, np.nan, np.float32)},
            r"the environment's observation `observation` at \[0\] is nan, which is not finite",
        ),
        ({"observation": np.full(3, 7, np.float32)}, "is 7.0, which is not between -1.0 and 1.0"),
        ({"observation": np.zeros(4, np.float32)}, r"is an array of \[4\] float32"),
        ({"info": {}}, "info of the environment's step.. has no `speed`, which the declaration names"),
        ({"info": {"speed": 3.0}}, "the environment's `speed` in info is 3.0, which is not between 0 and 2"),
        ({"more": 0}, r"step\(\) returned 6 values, not \(observation, reward, terminated, truncated, info\)"),
        ({"observation": None}, "observation `observation` is None, and its space is Box"),
        ({"terminated": "yes"}, r"step\(\)'s `terminated` is a str, not a bool"),
        ({"info": None}, r"step\(\)'s info is None, not a dict"),
    ],
)
def test_what_a_run_would_refuse_at_the_first_step_is_refused_before(instead, problem):
    speed = {"name": "speed", "role": "part", "dtype": "f32", "range": [0, 2]}
    described = describe(Env(), "mine")
    try_out(described, Faulty(info={"speed": 2.0}), [speed])
    with pytest.raises(Refused, match=problem):
        try_out(described, Faulty(**({"info": {"speed": 1.0}} | instead)), [speed])


class Late(Env):
    """Returns something else than it should from its fifth step on, or from each reset."""

    def __init__(self, method, returned, observation=None):
        super().__init__(observation)
        self._method, self._returned = method, returned

    def reset(self, **arguments):
        returned = super().reset(**arguments)
        return self._returned(returned) if self._method == "reset" else returned

    def step(self, action):
        returned = super().step(action)
        return self._returned(returned) if self._method == "step" and self._steps == 5 else returned


NEEDED = r"not \(observation, reward, terminated, truncated, info\)"


@pytest.mark.parametrize(
    ("method", "returned", "problem"),
    [
        ("step", lambda all_five: (*all_five[:1], None, *all_five[2:]), "step..'s reward is None, not a number"),
        ("step", lambda all_five: all_five[:4], f"step.. returned 4 values, {NEEDED}"),
        ("step", lambda all_five: None, f"step.. returned None, {NEEDED}"),
        ("step", lambda all_five: (*all_five[:1], np.zeros(2), *all_five[2:]), r"an array of \[2\] float64, not a num"),
        ("step", lambda all_five: (None, *all_five[1:]), "is None, and its space is Box"),
        ("step", lambda all_five: (*all_five[:2], "yes", *all_five[3:]), "step..'s `terminated` is a str, not a bool"),
        ("step", lambda all_five: (*all_five[:2], 1, *all_five[3:]), "step..'s `terminated` is an int, not a bool"),
        ("reset", lambda both: {"observation": 1}, r"reset.. returned a dict, not \(observation, info\)"),
        ("reset", lambda both: (both[0].tolist(), {}), "is a list, and its space is Box"),
    ],
)
def test_every_call_of_the_trial_is_checked_as_a_run_checks_it(method, returned, problem):
    described = describe(Env(), "mine")
    where = "step 5 of the episode with seed 1" if method == "step" else "reset.. of the episode with seed 1"
    with pytest.raises(Refused, match=rf"{problem}.* \({where}\)$"):
        prove(Tried(Late(method, returned), described), Env)


def test_bools_of_numpy_are_bools():
    prove(Tried(Late("step", lambda all_five: (*all_five[:2], np.bool_(True), *all_five[3:])), None), Env)


def test_a_dictionary_has_the_keys_of_its_space():
    space = spaces.Dict({"state": spaces.Box(-1, 1, (2,))})
    described = describe(Env(space), "mine")
    assert [channel["key"] for channel in described.description["channels"]] == ["state"]
    for seen, method, problem in [
        ([0.0, 0.0], "reset", r"reset\(\)'s observation is a list, not a dict: it has no `state`, which its space has"),
        (None, "step", r"step\(\)'s observation is None, not a dict: it has no `state`, which its space has"),
    ]:
        with pytest.raises(Refused, match=problem):
            check_seen(described, seen, method)
    for _ in range(2):
        check_seen(described, {"state": np.zeros(2, np.float32), "extra": 1})
    assert described.warnings == ["the environment's observation has `extra`, which its space has not: it is left out"]


def test_everything_that_is_wrong_with_spaces_is_said_at_once():
    with pytest.raises(
        Refused,
        match="observation `a` is of float16.*; and the environment's observation `b` is.*; and the .* actions begin with 1",
    ):
        describe(
            Env(
                spaces.Dict({"a": spaces.Box(0, 1, (2,), np.float16), "b": spaces.Text(3)}),
                spaces.Discrete(3, start=1),
            ),
            "mine",
        )


def test_an_environment_that_does_not_repeat_itself_is_refused():
    prove(Env(), Env)
    with pytest.raises(Refused, match="observation after 0 actions is another"):
        prove(Env(noise=True), Env)


@pytest.mark.parametrize("name", ["InvertedPendulum-v5", "Ant-v5"])
def test_a_mujoco_environment_goes_on_from_a_snapshot_to_the_same_bits(name: str):
    make = lambda: MujocoSnapshot(gymnasium.make(name, disable_env_checker=True))  # noqa: E731
    one, other = make(), make()
    actions = np.random.default_rng(0).uniform(-1, 1, (40, *one.action_space.shape)).astype(np.float32)
    one.reset(seed=1)
    other.reset(seed=2)
    for action in actions[:3]:
        one.step(action)
        other.step(-action)
    state = one.get_state()
    other.set_state(state)
    assert other.get_state() == state
    for action in actions:
        for expected, found in zip(one.step(action)[:4], other.step(action)[:4], strict=True):
            np.testing.assert_array_equal(expected, found)
    # The generator, too.
    np.testing.assert_array_equal(one.reset()[0], other.reset()[0])
    with pytest.raises(ValueError, match="7 bytes are no state"):
        one.set_state(state[:7])


@pytest.mark.parametrize(
    ("metadata", "problem"),
    [({"restore": "snapshots"}, 'not "replay"'), ({"restore": "snapshot"}, "has no get_state")],
)
def test_a_way_to_be_restored_that_there_is_not_is_refused(metadata, problem):
    env = Env()
    env.metadata = metadata
    with pytest.raises(Refused, match=problem):
        describe(env, "mine")


def test_an_environment_is_found_by_its_name(tmp_path: Path):
    (tmp_path / "mine.py").write_text("def make_env(size=1):\n    return size\ndef other():\n    return 0\n")
    file = tmp_path / "mine.py"
    make, name = find(f"{file}:make_env", {"size": 5}, None)
    assert (make(), name) == (5, "mine")
    assert find(f"{file}:other", {}, None)[1] == "other"
    assert find("gymnasium:CartPole-v1", {}, None)[0]().spec.id == "CartPole-v1"
    for spec in ("mine", f"{file}:nothing", "no.such:make_env", f"{tmp_path / 'none.py'}:make_env"):
        with pytest.raises(Refused):
            find(spec, {}, str(tmp_path))


def test_a_keyword_that_a_function_lacks_is_named(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("def make(size=3): ...\ndef other(**kwargs): return kwargs\n")
    with pytest.raises(Refused, match=r"make\(\) has no parameter 'siz'; it has size"):
        find(f"{file}:make", {"siz": 5}, None)
    assert find(f"{file}:other", {"siz": 5}, None)[0]() == {"siz": 5}


MINE = """import gymnasium
import numpy as np
class E(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1, 1, (2,))
    action_space = gymnasium.spaces.Discrete(2)
    def reset(self, *, seed=None, options=None):
        return np.zeros(2, np.float32), {}
    def step(self, action):
        return np.zeros(2, np.float32), 0.0, False, False, {}
"""


@pytest.mark.parametrize(
    ("line", "instead", "said"),
    [
        (9, "return self.count(None)", "the environment's step() raised TypeError: no number (mine.py:11)"),
        (9, "return np.zeros(-1)", "step() raised ValueError: negative dimensions are not allowed (mine.py:9)"),
        (7, "raise ValueError", "the environment's reset() raised ValueError (mine.py:7)"),
        (2, "import numpy as np; 1 / 0", "importing mine.py raised ZeroDivisionError: division by zero (mine.py:2)"),
        (
            4,
            "def __init__(self): self.x",
            "cannot be made: AttributeError: 'E' object has no attribute 'x' (mine.py:4)",
        ),
        (3, "def E(): return None", "E() returned None, which is no gymnasium.Env"),
        (3, "def E(): return 5", "E() returned an int, which is no gymnasium.Env"),
        (3, "import sys\ndef E(): sys.exit(4)", "the environment's E() called sys.exit(4) (mine.py:4)"),
    ],
)
def test_an_exception_is_one_sentence_with_its_place(tmp_path: Path, line: int, instead: str, said: str) -> None:
    lines = MINE.splitlines()
    old = lines[line - 1]
    lines[line - 1] = " " * (len(old) - len(old.lstrip())) + instead
    lines += ["    def count(self, number):", "        raise TypeError('no\\nnumber')"]
    text = "\n".join(lines[:3] if line == 3 else lines) + "\n"
    (tmp_path / "mine.py").write_text(text)
    command = [sys.executable, "-m", "stillroom", "serve", f"{tmp_path / 'mine.py'}:E", "--describe"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    last = done.stderr.splitlines()[-1]
    assert last.startswith("stillroom: error: ") and last.endswith(said), done.stderr


def described_by(tmp_path: Path, text: str) -> subprocess.Popen[str]:
    """A process that describes an environment, as the orchestrator starts it."""
    (tmp_path / "mine.py").write_text(text)
    command = [sys.executable, "-m", "stillroom", "serve", f"{tmp_path / 'mine.py'}:E", "--describe", "--lifeline"]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, start_new_session=True)


def test_a_trial_reports_each_call_before_it_is_made(tmp_path: Path):
    with described_by(tmp_path, MINE) as process:
        assert process.stdout is not None
        *calls, answer = [json.loads(line) for line in process.stdout]
        assert process.wait(20) == 0
    assert answer["name"] == "e"
    assert calls[0] == {"call": "", "place": "it is being made"}
    for call, place in [("reset()", "reset()"), ("step()", "step 7")]:
        assert {"call": call, "place": f"{place} of the episode with seed 1"} in calls


def test_a_trial_that_hangs_says_where_and_ends_with_its_parent(tmp_path: Path):
    step = "        return np.zeros(2, np.float32), 0.0"
    hangs = MINE.replace(step, f"        import time; time.sleep(1000)\n{step}")
    with described_by(tmp_path, hangs) as process:
        assert process.stdin is not None and process.stdout is not None and process.stderr is not None
        while json.loads(process.stdout.readline())["call"] != "step()":
            pass
        # The call is reported before it is made.
        time.sleep(0.5)
        process.send_signal(signal.SIGUSR1)
        while "mine.py" not in (line := process.stderr.readline()):
            assert line, "nothing is said"
        assert line.endswith("line 9 in step\n")
        process.stdin.close()
        assert process.wait(20) == -signal.SIGKILL


def test_a_function_with_any_keywords_takes_a_render_mode():
    assert _takes_mode(lambda **kwargs: kwargs) and _takes_mode(lambda render_mode=None: render_mode)
    assert not _takes_mode(lambda size=3: size)


def test_a_process_answers_with_its_description_alone(tmp_path: Path):
    (tmp_path / "mine.py").write_text(
        "import gymnasium\nprint('noise')\ndef make_env():\n    print('more')\n    return gymnasium.make('CartPole-v1')\n"
    )
    command = [sys.executable, "-m", "stillroom", "serve", "mine:make_env", "--path", str(tmp_path), "--describe"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["name"] == "mine"
    assert "noise" in done.stderr
    done = subprocess.run([*command[:-1]], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (done.returncode, done.stderr.splitlines()[-1]) == (
        2,
        "stillroom: error: --actor is missing: the orchestrator starts this, `stillroom up --env ...`",
    )


@pytest.mark.parametrize(
    ("drawn", "problem"),
    [
        (RuntimeError("no display"), r"step 1: its render\(\) raised RuntimeError: no display \(.*_serving.py:\d+\)"),
        (NotImplementedError(), r"step 1: its render\(\) raised NotImplementedError \(.*_serving.py:\d+\)"),
        (
            gymnasium.error.DependencyNotInstalled("no pygame: `pip install pygame`"),
            r"step 1: its render\(\) raised DependencyNotInstalled: no pygame: `pip install pygame` \(.*_serving.py:\d+\)",
        ),
        (None, r"step 1: its render\(\) returned object \(\), not uint8 of height, width and 3"),
    ],
)
def test_a_picture_that_is_not_drawn_is_said_with_its_step(drawn, problem, capfd):
    class Drawn(Env):
        render_mode = "rgb_array"
        calls = 0

        def render(self):
            self.calls += 1
            if self.calls == 1:
                return np.zeros((4, 4, 3), np.uint8)
            if drawn is not None:
                raise drawn
            return None

    camera = Camera(Drawn())
    camera.reset(seed=1)
    assert camera.problem is None
    for _ in range(2):
        camera.step(0)
    assert camera.problem is not None and re.fullmatch(problem, camera.problem)
    # Where something is not installed, the sentence is all.
    assert ("Traceback" in capfd.readouterr().err) == isinstance(drawn, RuntimeError)


def test_every_episode_has_a_seed_of_its_own():
    seeds = {stillroom.episode_seed(seed, env, episode) for seed in (1, 2) for env in range(9) for episode in range(99)}
    assert len(seeds) == 2 * 9 * 99
    assert all(0 <= seed < 2**31 for seed in seeds)
    assert stillroom.episode_seed(1, 0, 0) == stillroom.episode_seed(1, 0, 0)
