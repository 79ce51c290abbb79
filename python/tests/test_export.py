"""`orchestrator export`: onnxruntime computes what the learner does, and the page beside a model is true."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

import stillroom
from conftest import REPOSITORY, probed, record, weights_of

onnxruntime = pytest.importorskip("onnxruntime")


@pytest.fixture(scope="module")
def programs() -> dict[str, Path]:
    """The built programs."""
    found = {}
    for name in ("orchestrator", "learner"):
        found[name] = Path(os.environ.get(f"STILLROOM_{name.upper()}", REPOSITORY / "target/release" / name))
        if not found[name].exists():
            pytest.skip(f"{found[name]} is not there: make build")
    return found


def orchestrator(programs: dict[str, Path], folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs the orchestrator in a folder."""
    command = [programs["orchestrator"], *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=240)


def run_with_weights(
    programs: dict[str, Path], folder: Path, weights: dict[str, np.ndarray], settings: list[str]
) -> None:
    """A run `run` whose checkpoint holds these weights."""
    save_file(weights, folder / "start.safetensors")
    options = [word for setting in settings for word in ("--set", setting)]
    words = ("import", "start.safetensors", "--preset", "demo", "--run", "run")
    done = orchestrator(programs, folder, *words, *options)
    assert done.returncode == 0, done.stderr


CASES = [
    # encoder, input_pool, hidden, action space, goal, previous action, steps, columns
    ("cnn", 4, 64, "large", "polar", True, 250, 4),
    ("resnet", 2, 128, "small", "polar", True, 16, 64),
    ("cnn", 2, 32, "small", "cartesian", False, 16, 64),
]


@pytest.mark.parametrize(("encoder", "pool", "hidden", "space", "goal", "previous", "steps", "columns"), CASES)
def test_a_model_computes_what_the_learner_does(
    programs: dict[str, Path],
    kitchens: dict,
    tmp_path: Path,
    encoder: str,
    pool: int,
    hidden: int,
    space: str,
    goal: str,
    previous: bool,
    steps: int,
    columns: int,
) -> None:
    actions = {"large": 21, "small": 13}[space]
    settings = [
        f"network.encoder={encoder}",
        f"network.input_pool={pool}",
        f"network.hidden={hidden}",
        f"network.goal={goal}",
        f"network.previous_action={str(previous).lower()}",
        f"episode.action_space={space}",
    ]
    run_with_weights(programs, tmp_path, weights_of(encoder, pool, hidden, actions, previous), settings)
    for form in ("onnx", "safetensors"):
        done = orchestrator(programs, tmp_path, "export", "run", "--format", form, "--out", f"policy.{form}")
        assert done.returncode == 0, done.stderr
    alone = load_file(tmp_path / "policy.safetensors")
    start = load_file(tmp_path / "start.safetensors")
    assert alone.keys() == start.keys()
    assert all(np.array_equal(alone[name], start[name]) for name in start)

    batch = record(steps, columns, space, kitchens[1])
    expected = probed(programs["learner"], tmp_path, "policy.safetensors", batch, goal)
    policy = onnxruntime.InferenceSession(tmp_path / "policy.onnx", providers=["CPUExecutionProvider"])
    names = {value.name for value in policy.get_inputs()}
    assert names == {"depth", "goal", "belief"} | ({"previous_action"} if previous else set())
    facts = policy.get_modelmeta().custom_metadata_map
    assert len(json.loads(facts["actions"])) == actions
    assert (facts["depth_unit"], facts["goal_unit"]) == ("millimetre", "metre")

    def play(chosen: slice) -> tuple[np.ndarray, np.ndarray]:
        """Log-probabilities and values of some columns, one after the other in time."""
        belief = np.zeros((len(range(columns)[chosen]), hidden), np.float32)
        log_probs, values = [], []
        for step in range(steps):
            belief[batch["episode_start"][step][chosen]] = 0
            rows = {
                "depth": batch["frames"][step][chosen].astype(np.uint16),
                "goal": batch["goal_m"][step][chosen],
                "previous_action": (batch["previous_action"][step][chosen] + actions) % (actions + 1),
                "belief": belief,
            }
            log_prob, value, belief = policy.run(None, {name: rows[name] for name in names})
            log_probs.append(log_prob)
            values.append(value)
        return np.stack(log_probs), np.stack(values)

    log_probs, values = play(slice(None))
    assert np.abs(log_probs - expected["log_probs"]).max() < 1e-5
    assert np.abs(values - expected["values"]).max() < 1e-4
    assert np.array_equal(log_probs.argmax(2), expected["log_probs"].argmax(2))
    assert len(set(log_probs.argmax(2).ravel())) > 1, "the policy does not always choose the same"
    alone_log_probs, _ = play(slice(1, 2))
    assert alone_log_probs.shape[1] == 1
    assert np.abs(alone_log_probs[:, 0] - expected["log_probs"][:, 1]).max() < 1e-5


def test_a_policy_file_of_16_bits_acts_as_the_run_does(
    programs: dict[str, Path], kitchens: dict, tmp_path: Path
) -> None:
    """Rounded to 16 bits and widened again each weight is within half a unit of its last place, and nearly every step
    that environments saw gets the same action."""
    steps, columns = 250, 4
    settings = ["network.encoder=cnn", "network.input_pool=2", "network.hidden=256", "network.goal=cartesian"]
    run_with_weights(programs, tmp_path, weights_of("cnn", 2, 256, 21), settings)
    done = orchestrator(
        programs, tmp_path, "export", "run", "--format", "safetensors", "--half", "--out", "policy.safetensors"
    )
    assert done.returncode == 0, done.stderr
    exact, half = load_file(tmp_path / "start.safetensors"), load_file(tmp_path / "policy.safetensors")
    assert half.keys() == exact.keys() and all(array.dtype == np.float16 for array in half.values())
    for name, array in half.items():
        assert np.array_equal(array, exact[name].astype(np.float16)), name
        rounding = np.maximum(np.abs(exact[name]) * 2.0**-11, 2.0**-25)
        assert (np.abs(array.astype(np.float32) - exact[name]) <= rounding).all(), name

    # It says itself what it is.
    loaded = stillroom.load(tmp_path / "policy.safetensors")
    assert (loaded.goal, loaded.frames, loaded.carried_goal) == ("cartesian", 0, "object_to_goal")
    assert all(array.dtype == np.float32 for array in loaded.weights.values())
    assert loaded.environment()["action_space"] == "large"

    batch = record(steps, columns, "large", kitchens[1])
    full, rounded = (
        probed(programs["learner"], tmp_path, name, batch, "cartesian")["log_probs"]
        for name in ("start.safetensors", "policy.safetensors")
    )
    same = (full.argmax(2) == rounded.argmax(2)).mean()
    apart = np.abs(full - rounded).max()
    print(f"the same action in {same:.2%} of {steps * columns} steps; log-probabilities to {apart:.1e}")
    assert same > 0.97 and 0 < apart < 0.05
    assert len(set(full.argmax(2).ravel())) > 1, "the policy does not always choose the same"


def test_goals_in_every_direction_are_those_of_the_network(programs: dict[str, Path], tmp_path: Path) -> None:
    """ONNX has no atan2: the graph makes one."""
    run_with_weights(programs, tmp_path, weights_of("cnn", 4, 16, 21), ["network.hidden=16"])
    assert orchestrator(programs, tmp_path, "export", "run", "--out", "policy.onnx").returncode == 0
    axis = [-2.0, -1.0, -1e-3, 0.0, 1e-3, 1.0, 2.0]
    goals = np.array([(x, y, z) for x in axis for y in axis for z in axis], np.float32)
    count = len(goals)
    batch = {
        "frames": np.full((1, count, 224, 224), 900, np.int32),
        "goal_m": goals[None],
        "previous_action": np.zeros((1, count), np.int64),
        "episode_start": np.ones((1, count), np.bool_),
    }
    expected = probed(programs["learner"], tmp_path, "start.safetensors", batch)["log_probs"][0]
    policy = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    rows = {
        "depth": batch["frames"][0].astype(np.uint16),
        "goal": goals,
        "previous_action": np.full(count, 21),
        "belief": np.zeros((count, 16), np.float32),
    }
    log_probs, _, _ = policy.run(None, rows)
    assert np.abs(log_probs - expected).max() < 1e-5
    assert np.ptp(log_probs[:, 0]) > 1e-2, "the policy looks at its goal"


OWN = """import gymnasium
import numpy as np
box = gymnasium.spaces.Box
SPACES = {
    "box": box(-1, 1, (3,), np.float64),
    "dict": gymnasium.spaces.Dict({"state": box(-1, 1, (3,)), "Goal-1": gymnasium.spaces.Discrete(4, start=1)}),
    "image": gymnasium.spaces.Dict({"observation": box(0, 255, (40, 36, 3), np.uint8), "state": box(-1, 1, (2,))}),
}
class Own(gymnasium.Env):
    action_space = gymnasium.spaces.Discrete(3)
    def __init__(self, kind):
        self.observation_space = SPACES[kind]
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return self.seen(), {}
    def step(self, action):
        self.steps += 1
        return self.seen(), float(action), self.steps == 9, False, {}
    def seen(self):
        self.observation_space.seed(int(self.np_random.integers(1000)))
        return self.observation_space.sample()
def make(kind):
    return Own(kind)
"""


@pytest.mark.parametrize("memory", ["none", "gru"])
@pytest.mark.parametrize("kind", ["box", "dict", "image", "CartPole-v1"])
def test_the_page_of_an_environment_of_ones_own_runs_as_it_is_printed(
    programs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, memory: str
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "states"))
    (tmp_path / "own").mkdir()
    (tmp_path / "own/reach-it.py").write_text(OWN)
    is_own = not kind.endswith("-v1")
    env = "own/reach-it.py:make" if is_own else f"gymnasium:{kind}"
    words = ["up", "--run", "run", "--python", sys.executable, "--env", env, "--actors", "1", "--envs-per-actor", "2"]
    words += ["--env-kwargs", json.dumps({"kind": kind})] if is_own else []
    settings = [f"network.memory={memory}", "network.hidden=16", "ppo.rollout_steps=8", "ppo.minibatches=1"]
    settings += ["learner.device=cpu"]
    done = orchestrator(programs, tmp_path, *words, "--frames", "32", *(f"--set={setting}" for setting in settings))
    assert done.returncode == 0, done.stderr
    done = orchestrator(programs, tmp_path, "export", "run", "--out", "policy.onnx")
    assert done.returncode == 0, done.stderr
    (program,) = re.findall(r"```python\n(.*?)```", (tmp_path / "policy.md").read_text(), re.S)
    assert ("states" in program) == (memory == "gru")
    ran = f"{program}\nassert ended and {'env.steps == 9' if is_own else 'True'}"
    done = subprocess.run([sys.executable, "-c", ran], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, program + done.stderr


def test_the_page_beside_a_model_is_a_program_that_runs(programs: dict[str, Path], tmp_path: Path) -> None:
    run_with_weights(programs, tmp_path, weights_of("cnn", 4, 16, 21), ["network.hidden=16", "episode.max_steps=20"])
    first = orchestrator(programs, tmp_path, "export", "run", "--out", "fetch.onnx")
    assert first.returncode == 0 and "fetch.md says what it takes and gives" in first.stdout, first.stderr
    page = (tmp_path / "fetch.md").read_text()
    (program,) = re.findall(r"```python\n(.*?)```", page, re.S)
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"(success|failure) after \d+ steps\n", done.stdout), done.stdout

    # What is there stays as it is.
    before = (tmp_path / "fetch.onnx").read_bytes()
    again = orchestrator(programs, tmp_path, "export", "run", "--out", "fetch.onnx")
    assert again.returncode == 2 and "fetch.onnx exists" in again.stderr
    assert (tmp_path / "fetch.onnx").read_bytes() == before
    (tmp_path / "other.md").write_text("mine")
    other = orchestrator(programs, tmp_path, "export", "run", "--out", "other.onnx")
    assert other.returncode == 2 and "other.md exists" in other.stderr and not (tmp_path / "other.onnx").exists()
    nothing = orchestrator(programs, tmp_path, "export", "nowhere", "--out", "x.onnx")
    assert nothing.returncode == 2 and "nowhere does not exist" in nothing.stderr
