"""Checkpoints, and with torch the network. `learner probe` is asked what the learner's own network gives."""

from __future__ import annotations

import hashlib
import json
import math
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

import stillroom
from conftest import REPOSITORY, random_action
from stillroom.checkpoint import CheckpointError


def weights_of(encoder: str, pool: int, hidden: int, actions: int) -> dict[str, np.ndarray]:
    """Random weights of a policy, by the names and shapes of checkpoints."""
    shapes: dict[str, tuple[int, ...]] = {}
    side = 224 // pool

    def block(path: str, inputs: int, planes: int) -> None:
        shapes.update(
            {f"{path}.convs.0.weight": (planes, inputs, 3, 3), f"{path}.convs.3.weight": (planes, planes, 3, 3)}
        )
        shapes.update({f"{path}.convs.{i}.{kind}": (planes,) for i in (1, 4) for kind in ("weight", "bias")})
        if inputs != planes:
            shapes.update({f"{path}.downsample.0.weight": (planes, inputs, 1, 1)})
            shapes.update({f"{path}.downsample.1.{kind}": (planes,) for kind in ("weight", "bias")})

    if encoder == "resnet":
        shapes["visual_encoder.backbone.conv1.0.weight"] = (32, 1, 7, 7)
        shapes.update({f"visual_encoder.backbone.conv1.1.{kind}": (32,) for kind in ("weight", "bias")})
        inputs = 32
        for stage in range(4):
            for index in range(2):
                block(f"visual_encoder.backbone.layer{stage + 1}.{index}", inputs, 32 << stage)
                inputs = 32 << stage
        shapes["visual_encoder.compression.0.weight"] = (128, 256, 3, 3)
        shapes.update({f"visual_encoder.compression.1.{kind}": (128,) for kind in ("weight", "bias")})
        last = "visual_encoder.fc.1"
        features = 128 * math.ceil(side / 32) ** 2
    else:
        for index, (outputs, inputs, size, stride) in enumerate([(32, 1, 8, 4), (64, 32, 4, 2), (32, 64, 3, 1)]):
            shapes[f"visual_encoder.cnn.{2 * index}.weight"] = (outputs, inputs, size, size)
            shapes[f"visual_encoder.cnn.{2 * index}.bias"] = (outputs,)
            side = (side - size) // stride + 1
        last, features = "visual_encoder.cnn.6", 32 * side * side
    shapes.update({f"{last}.weight": (512, features), f"{last}.bias": (512,)})
    shapes.update({"goal_embedder.0.weight": (100, 3), "goal_embedder.0.bias": (100,)})
    shapes.update({"goal_embedder.2.weight": (32, 100), "goal_embedder.2.bias": (32,)})
    shapes["previous_action_embedder.weight"] = (actions + 1, 16)
    shapes.update({"belief.weight_ih_l0": (3 * hidden, 560), "belief.weight_hh_l0": (3 * hidden, hidden)})
    shapes.update({"belief.bias_ih_l0": (3 * hidden,), "belief.bias_hh_l0": (3 * hidden,)})
    shapes.update({"actor.weight": (actions, hidden), "actor.bias": (actions,)})
    shapes.update({"critic.weight": (1, hidden), "critic.bias": (1,)})
    random = np.random.default_rng(7)
    weights = {}
    for name, shape in shapes.items():
        scale = np.sqrt(1.0 / np.prod(shape[1:])) if len(shape) > 1 else 0.1
        weights[name] = (random.standard_normal(shape) * scale).astype(np.float32)
    return weights


def run_folder(root: Path, rollouts: list[int]) -> None:
    (root / "checkpoints").mkdir()
    for rollout in rollouts:
        name = root / "checkpoints" / f"rollout-{rollout:08}"
        tensors = {
            "model.actor.weight": np.full((2, 3), rollout, np.float32),
            "optimizer.first": np.zeros(3, np.float32),
        }
        save_file(tensors, name.with_suffix(".safetensors"))
        digest = hashlib.sha256(name.with_suffix(".safetensors").read_bytes()).hexdigest()
        config = '[network]\ngoal = "cartesian"\n[episode]\nmax_steps = 77\naction_space = "small"\n'
        manifest = {"tensors": f"{name.name}.safetensors", "tensors_sha256": digest, "frames": 1000 * rollout}
        name.with_suffix(".json").write_text(
            json.dumps({**manifest, "config": config, "carried_goal": "goal_to_object"})
        )


def test_the_newest_whole_checkpoint_of_a_run_is_read(tmp_path: Path) -> None:
    run_folder(tmp_path, [3, 12, 100])
    newest = stillroom.load(tmp_path)
    assert (newest.frames, newest.goal, newest.path.name) == (100_000, "cartesian", "rollout-00000100.safetensors")
    assert list(newest.weights) == ["actor.weight"] and newest.weights["actor.weight"][0, 0] == 100
    assert newest.environment() == {"carried_goal": "goal_to_object", "max_steps": 77, "action_space": "small"}
    env = stillroom.ArmPointNav(1, **newest.environment())
    assert env.action_space.n == 13
    assert stillroom.load(tmp_path, rollout=3).frames == 3000
    assert stillroom.load(tmp_path / "checkpoints/rollout-00000012.safetensors").frames == 12_000
    # A torn one is followed by the one before it, and refused where it is asked for.
    torn = tmp_path / "checkpoints/rollout-00000100.safetensors"
    torn.write_bytes(torn.read_bytes()[:-1] + b"\x01")
    assert stillroom.load(tmp_path).frames == 12_000
    with pytest.raises(CheckpointError, match="SHA-256"):
        stillroom.load(torn)
    newest.save(tmp_path / "weights.safetensors")
    alone = stillroom.load(tmp_path / "weights.safetensors")
    assert np.array_equal(alone.weights["actor.weight"], newest.weights["actor.weight"]) and alone.frames is None


def test_what_holds_no_checkpoint_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no checkpoint"):
        stillroom.load(tmp_path)
    (tmp_path / "a.safetensors").write_bytes(b"nothing")
    with pytest.raises(CheckpointError, match="no safetensors file"):
        stillroom.load(tmp_path / "a.safetensors")
    (tmp_path / "a.json").write_text("[]")
    with pytest.raises(CheckpointError, match="no manifest"):
        stillroom.load(tmp_path / "a.json")
    (tmp_path / "b.json").write_text('{"tensors": "../a.safetensors", "tensors_sha256": ""}')
    with pytest.raises(CheckpointError, match="not beside it"):
        stillroom.load(tmp_path / "b.json")
    with pytest.raises(CheckpointError, match="neither a run folder"):
        stillroom.load(tmp_path / "a.txt")


def record(steps: int, columns: int, actions: str, kitchen: stillroom.Kitchen) -> dict[str, np.ndarray]:
    """A batch for `learner probe`: what environments saw under the random policy, episodes ending within it."""
    env = stillroom.VectorEnv(
        columns, kitchens=[kitchen], action_space=actions, max_steps=40, autoreset_mode="SameStep"
    )
    count = len(env.action_names)
    observations, infos = env.reset(seed=3)
    rows: dict[str, list[np.ndarray]] = {"frames": [], "goal_m": [], "previous_action": [], "episode_start": []}
    for step in range(steps):
        rows["frames"].append(observations["depth"].astype(np.int32))
        rows["goal_m"].append(observations["goal"].copy())
        rows["previous_action"].append((observations["previous_action"] + 1) % (count + 1))
        rows["episode_start"].append(infos["step"] == 0)
        chosen = [random_action(1, column, 0, step) % (count - 1) for column in range(columns)]
        observations, _, _, _, infos = env.step(np.array(chosen))
    return {name: np.stack(values) for name, values in rows.items()}


@pytest.mark.parametrize(
    ("encoder", "pool", "hidden", "space", "steps"),
    [("cnn", 4, 64, "large", 250), ("resnet", 2, 128, "small", 250), ("cnn", 2, 32, "small", 10)],
)
def test_the_network_is_the_learners(
    kitchens: dict, tmp_path: Path, encoder: str, pool: int, hidden: int, space: str, steps: int
) -> None:
    torch = pytest.importorskip("torch")
    learner = Path(os.environ.get("STILLROOM_LEARNER", REPOSITORY / "target/release/learner"))
    if not learner.exists():
        pytest.skip(f"{learner} is not there: make build, or STILLROOM_LEARNER=/path/to/learner")
    columns, actions = 4, {"large": 21, "small": 13}[space]
    save_file(weights_of(encoder, pool, hidden, actions), tmp_path / "weights.safetensors")
    batch = record(steps, columns, space, kitchens[1])
    cells = (steps, columns)
    others = {name: np.zeros(cells, np.float32) for name in ("log_prob", "value", "reward")}
    others.update({name: np.zeros(cells, np.bool_) for name in ("ended", "time_limit", "disturbed")})
    others.update(action=np.zeros(cells, np.int64), bootstrap=np.zeros(columns, np.float32))
    save_file({**batch, **others}, tmp_path / "batch.safetensors")
    command = [
        learner,
        "probe",
        "--weights",
        "weights.safetensors",
        "--batch",
        "batch.safetensors",
        "--out",
        "out.safetensors",
    ]
    subprocess.run([*command, "--device", "cpu"], cwd=tmp_path, check=True, capture_output=True)
    expected = load_file(tmp_path / "out.safetensors")

    network = stillroom.load(tmp_path / "weights.safetensors").network()
    belief, log_probs, values = network.begin(columns), [], []
    with torch.no_grad():
        for step in range(steps):
            start = torch.from_numpy(batch["episode_start"][step])
            belief = torch.where(start[:, None], network.begin(columns), belief)
            observations = {
                "depth": batch["frames"][step],
                "goal": batch["goal_m"][step],
                "previous_action": (batch["previous_action"][step] + actions) % (actions + 1),
            }
            log_prob, value, belief = network(observations, belief)
            log_probs.append(log_prob.numpy())
            values.append(value.numpy())
    found = np.stack(log_probs)
    assert batch["episode_start"].sum() > columns or steps < 40, "episodes ended within the batch"
    assert np.abs(found - expected["log_probs"]).max() < 1e-5
    assert np.abs(np.stack(values) - expected["values"]).max() < 1e-4
    assert np.array_equal(found.argmax(2), expected["log_probs"].argmax(2))
    assert len(set(found.argmax(2).ravel())) > 1, "the policy does not always choose the same"
