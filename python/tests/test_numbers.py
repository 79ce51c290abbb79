"""Tasks of numbers, with images or without: onnxruntime and `stillroom.load` compute what `learner probe` does."""

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
from conftest import REPOSITORY

onnxruntime = pytest.importorskip("onnxruntime")
torch = pytest.importorskip("torch")

TASK = REPOSITORY / "learner/tests/support/numbers.toml"
# Name, type, shape, and features that the convolutions leave.
IMAGES = [("heat", np.float32, (2, 45, 36), 128), ("screen", np.uint8, (36, 40, 3), 64)]
IMAGES += [("depth", np.uint16, (1, 41, 36), 64)]
NUMBERS, HIDDEN, STEPS, COLUMNS = 9, 20, 40, 5


def program(name: str) -> Path:
    """A built program."""
    found = Path(os.environ.get(f"STILLROOM_{name.upper()}", REPOSITORY / "target/release" / name))
    if not found.exists():
        pytest.skip(f"{found} is not there: make build")
    return found


# Of each kind its declaration, how many outputs the actor has, and actions.
DISCRETE = 'kind = "discrete"\nnames = ["left", "stay", "right"]'
KINDS = {
    "discrete": (DISCRETE, 3),
    "choices": ('kind = "multi_discrete"\ncounts = [3, 2]', 5),
    "masked": (DISCRETE, 3),
    "masked_choices": ('kind = "multi_discrete"\ncounts = [3, 2]', 5),
    "box": ('kind = "box"\nbounds = [[-1, 1], [-0.25, 2]]', 2),
    "images": (DISCRETE, 3),
    "privileged": (DISCRETE, 3),
}
# Those with the embedding of the last action.
TOLD_PREVIOUS = ("discrete", "images", "masked")
# What the critic alone is given of the nine numbers: where the door is.
DOOR = 'name = "door"\nrole = "observation"'
PRIVILEGED = 3


CLIP = 0.8
# What a page's program imports as the run's environment: all that its policy is given, for three steps.
MINE = """
import gymnasium, numpy
SPACES = {{"discrete": gymnasium.spaces.Discrete(3), "choices": gymnasium.spaces.MultiDiscrete([3, 2]),
    "box": gymnasium.spaces.Box(numpy.float32([-1, -0.25]), numpy.float32([1, 2]))}}

class Mine:
    action_space = SPACES["{space}"]
    steps = 0

    def reset(self, seed):
        return self.step(self.action_space.sample())[::4]

    def step(self, action):
        assert self.action_space.contains(action), action
        self.steps += 1
        seen = {{"speed": numpy.ones(4, numpy.float32), "door": numpy.array([-1], numpy.int32), "room": 1}}
        seen |= {{name: numpy.zeros(shape, kind) for name, kind, shape in {images}}}
        return seen, 0.0, self.steps > 3, False, {{"action_mask": numpy.ones({outputs}, numpy.int8)}}

make_env = Mine
"""


def weights_of(memory: str, kind: str, normalized: bool) -> dict[str, np.ndarray]:
    """Weights of a network with layers of 12 and 10."""
    random = np.random.default_rng(3)
    shapes: dict[str, tuple[int, ...]] = {}
    outputs = KINDS[kind][1]
    more = PRIVILEGED if kind == "privileged" else 0
    inputs = NUMBERS - more

    def layer(name: str, outputs: int, inputs: int) -> None:
        shapes[f"{name}.weight"], shapes[f"{name}.bias"] = (outputs, inputs), (outputs,)

    of_images = 0
    for image, _, shape, features in IMAGES if kind == "images" else []:
        channels, of_images = min(shape), of_images + 512
        for index, size in (("0", (32, channels, 8, 8)), ("2", (64, 32, 4, 4)), ("4", (64, 64, 3, 3))):
            shapes[f"images.{image}.{index}.weight"], shapes[f"images.{image}.{index}.bias"] = size, size[:1]
        layer(f"images.{image}.7", 512, features)
    if memory == "none" and of_images:
        layer("mlp.0", 12, inputs)
        layer("mlp.2", 10, 12)
        layer("actor", outputs, 10 + of_images)
        layer("critic", 1, 10 + of_images)
    elif memory == "none":
        for head, width, seen in (("actor", outputs, inputs), ("critic", 1, inputs + more)):
            layer(f"{head}.0", 12, seen)
            layer(f"{head}.2", 10, 12)
            layer(f"{head}.4", width, 10)
    else:
        layer("mlp.0", 12, inputs)
        layer("mlp.2", 10, 12)
        layer("actor", outputs, HIDDEN)
        layer("critic", 1, HIDDEN + more)
        inputs = 10 + of_images
        if kind in TOLD_PREVIOUS:
            shapes["previous_action_embedder.weight"] = (outputs + 1, 16)
            inputs += 16
        gates = {"gru": 3, "lstm": 4}[memory] * HIDDEN
        shapes["belief.weight_ih_l0"], shapes["belief.weight_hh_l0"] = (gates, inputs), (gates, HIDDEN)
        shapes["belief.bias_ih_l0"] = shapes["belief.bias_hh_l0"] = (gates,)
    if kind == "box":
        shapes["log_std"] = (outputs,)
    # Many inputs add up.
    scale = {name: 0.4 if np.prod(shape[1:]) < 100 else 0.05 for name, shape in shapes.items()}
    weights = {name: random.normal(0, scale[name], shape).astype(np.float32) for name, shape in shapes.items()}
    if normalized:
        weights["observation_norm.running_mean"] = random.normal(0, 1, NUMBERS).astype(np.float32)
        # More than 16 bits hold, and less.
        weights["observation_norm.running_var"] = np.geomspace(1e-9, 1e9, NUMBERS).astype(np.float32)
    return weights


def batch_of(kind: str) -> dict[str, np.ndarray]:
    """What `learner probe` is given."""
    random, size = np.random.default_rng(4), (STEPS, COLUMNS)
    ended = random.random(size) < 0.1
    start = np.vstack([np.ones((1, COLUMNS), bool), ended[:-1]])
    actions = random.integers(0, 3, size)
    previous = np.where(start, 0, 1 + np.vstack([np.zeros((1, COLUMNS), int), actions[:-1]]))
    if kind not in TOLD_PREVIOUS:
        previous = np.zeros(size, int)
        drawn = random.normal(0, 1, (*size, 2)).astype(np.float32)
        actions = drawn if kind == "box" else random.integers(0, [3, 2], (*size, 2))
        actions = random.integers(0, 3, size) if kind == "privileged" else actions
    table = random.normal(0, 1, (3, *size)).astype(np.float32)
    masks = {}
    if kind.startswith("masked"):
        chosen = np.split(actions.reshape(*size, -1), 1 if kind == "masked" else 2, -1)
        taken = [chosen[at] == np.arange(count) for at, count in enumerate([3, 2][: len(chosen)])]
        masks["mask"] = np.concatenate(taken, -1) | (random.random((*size, KINDS[kind][1])) < 0.5)
    images = {}
    for name, dtype, shape, _ in IMAGES if kind == "images" else []:
        shape = (*size, *shape)
        drawn = random.uniform(-1, 1, shape) if dtype is np.float32 else random.integers(0, np.iinfo(dtype).max, shape)
        images[f"images.{name}"] = drawn.astype(dtype)
    return masks | images | {
        "numbers": random.normal(0, 1, (*size, NUMBERS)).astype(np.float32),
        "previous_action": previous,
        "episode_start": start,
        "action": actions,
        "log_prob": -np.abs(table[0]),
        "value": table[1],
        "reward": table[2],
        "ended": ended,
        "time_limit": np.zeros(size, bool),
        "disturbed": np.zeros(size, bool),
        "bootstrap": np.zeros(COLUMNS, np.float32),
    }


def page_runs(folder: Path, kind: str) -> None:
    """The program on the page beside a policy ends with its episode."""
    (program,) = re.findall(r"```python\n(.*?)```", (folder / "policy.md").read_text(), re.S)
    space = {"choices": "choices", "masked_choices": "choices", "box": "box"}.get(kind, "discrete")
    images = [(name, np.dtype(dtype).name, shape) for name, dtype, shape, _ in IMAGES if kind == "images"]
    (folder / "mine.py").write_text(MINE.format(space=space, images=images, outputs=KINDS[kind][1]))
    command = [sys.executable, "-c", program + "print(env.steps)"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, "4\n"), done.stderr


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("normalized", [False, True])
@pytest.mark.parametrize("memory", ["none", "gru", "lstm"])
def test_a_policy_of_numbers_is_the_same_everywhere(tmp_path: Path, memory: str, normalized: bool, kind: str) -> None:
    run, weights, batch = tmp_path / "run", weights_of(memory, kind, normalized), batch_of(kind)
    run.mkdir()
    # A process knows a task by its name.
    declared = TASK.read_text().replace('name = "numbers"', f'name = "numbers_{kind}"')
    is_masked = kind.startswith("masked")
    channel = f'\n[[channels]]\nname = "legal"\nrole = "mask"\ndtype = "u8"\nshape = [{KINDS[kind][1]}]\ndoc = ""\n'
    declared = declared.replace(DISCRETE, KINDS[kind][0]) + (channel if is_masked else "")
    is_privileged = kind == "privileged"
    declared = declared.replace(DOOR, DOOR.replace("observation", kind)) if is_privileged else declared
    kinds = {np.float32: "f32", np.uint8: "u8", np.uint16: "u16"}
    for image, dtype, shape, _ in IMAGES if kind == "images" else []:
        declared += f'[[channels]]\nname = "{image}"\nrole = "observation"\ndtype = "{kinds[dtype]}"\n'
        declared += f"shape = {list(shape)}\n" + "range = [-1, 1]\n" * (dtype is np.float32) + 'doc = ""\n'
    (run / "task.toml").write_text(declared)
    told_previous = memory != "none" and kind in TOLD_PREVIOUS
    network = f'goal = "plain"\nmemory = "{memory}"\nmlp = [12, 10]\nhidden = {HIDDEN}\n'
    activation = "relu" if normalized else "tanh"
    network += f"previous_action = {'true' if told_previous else 'false'}\nactivation = \"{activation}\"\n"
    stage = '[[stages]]\nname = "I"\nreward = "r"\nframes = 100\n'
    config = f'task = "numbers_{kind}"\n[auxiliary]\ntask = "none"\n[network]\n{network}{stage}'
    config = config.replace("[network]\n", '[network]\ncarried_goal = "goal_to_object"\n')
    config += f"[normalize]\nobservations = {str(normalized).lower()}\nobservation_clip = {CLIP}\n"
    (run / "config.toml").write_text(config)
    save_file(weights, tmp_path / "start.safetensors")
    # libtorch reads no numbers of 16 bits without a sign.
    signed = {name: array.view(np.int16) if array.dtype == np.uint16 else array for name, array in batch.items()}
    save_file(signed, tmp_path / "batch.safetensors")

    def done(name: str, *words: str) -> None:
        command = [program(name), *words]
        finished = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=240)
        assert finished.returncode == 0, finished.stderr

    done("learner", "import", "--from", "start.safetensors", "--run", "run", "--run-id", "0123456789ab")
    done("orchestrator", "export", "run", "--format", "safetensors", "--out", "policy.safetensors")
    done("orchestrator", "export", "run", "--out", "policy.onnx")
    files = ("--weights", "policy.safetensors", "--batch", "batch.safetensors", "--out", "found.safetensors")
    shapeless = ("--set", f"normalize.observation_clip={CLIP}", "--set", f"network.activation={activation}")
    done("learner", "probe", *files, "--preset", "gym", "--task", "run/task.toml", *shapeless)
    found = load_file(tmp_path / "found.safetensors")

    policy = onnxruntime.InferenceSession(tmp_path / "policy.onnx", providers=["CPUExecutionProvider"])
    places = {"speed": [0, 4], "door": [4, 7], "room": [7, 9]}
    if is_privileged:
        places = {"speed": [0, 4], "room": [4, 6]}
    assert json.loads(policy.get_modelmeta().custom_metadata_map["numbers"]) == places
    page_runs(tmp_path, kind)
    names = {value.name for value in policy.get_inputs()}
    images = {name for name in batch if name.startswith("images.")}
    remembered = {"none": [], "gru": ["belief"], "lstm": ["belief", "cell"]}[memory]
    expected = {"numbers"} | images | set(remembered)
    assert names - {"previous_action"} == expected | ({"action_mask"} if is_masked else set())
    assert ("previous_action" in names) == told_previous
    outputs = {value.name: at for at, value in enumerate(policy.get_outputs())}
    # What a policy is given by.
    tables = ["means", "log_stds"] if kind == "box" else ["log_probs"]
    loaded = stillroom.load(tmp_path / "policy.safetensors").network()
    # Of an image many more numbers add up.
    atol = 1e-5 if images else 2e-6
    assert stillroom.load(run).weights.keys() == weights.keys()
    states = {name: np.zeros((COLUMNS, HIDDEN), np.float32) for name in remembered}
    carried = loaded.begin(COLUMNS)
    # The numbers of the policy come first.
    numbers, privileged = np.split(batch["numbers"], [NUMBERS - PRIVILEGED * is_privileged], -1)
    for step in range(STEPS):
        starts = batch["episode_start"][step]
        states = {name: np.where(starts[:, None], np.float32(0), state) for name, state in states.items()}
        carried = carried * torch.tensor(~starts).unsqueeze(1)
        given = {
            "numbers": numbers[step],
            "previous_action": (batch["previous_action"][step] + 3) % 4,
        } | {name: batch[name][step] for name in images}
        given |= {"action_mask": batch["mask"][step]} if is_masked else {}
        told = given | states
        answer = policy.run(None, {name: told[name] for name in names})
        states = {name: answer[outputs[f"next_{name}"]] for name in states}
        with torch.no_grad():
            if is_privileged:
                assert loaded(given, carried)[1].isnan().all()
                given |= {"privileged": privileged[step]}
            own, own_values, carried = loaded(given, carried)
        np.testing.assert_allclose(carried, np.concatenate([*states.values(), carried[:, :0]], 1), atol=atol)
        for name, theirs in [(table, table) for table in tables] + [("value", "values")] * (not is_privileged):
            np.testing.assert_allclose(answer[outputs[name]], found[theirs][step], atol=atol)
        for ours, theirs in [(own, found[tables[0]][step]), (own_values, found["values"][step])]:
            np.testing.assert_allclose(ours.numpy(), theirs, atol=atol)
        best = {
            "masked": lambda own: own.argmax(1),
            "masked_choices": lambda own: np.stack([own[:, :3].argmax(1), own[:, 3:].argmax(1)], 1),
            "discrete": lambda own: own.argmax(1),
            "privileged": lambda own: own.argmax(1),
            "images": lambda own: own.argmax(1),
            "choices": lambda own: np.stack([own[:, :3].argmax(1), own[:, 3:].argmax(1)], 1),
            "box": lambda own: own.clip([-1, -0.25], [1, 2]),
        }[kind]
        np.testing.assert_array_equal(loaded.best(own).numpy(), np.float32(best(own.numpy())))
