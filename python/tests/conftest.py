"""What tests share."""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

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


def weights_of(
    encoder: str, pool: int, hidden: int, actions: int, previous_action: bool = True
) -> dict[str, np.ndarray]:
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
    if previous_action:
        shapes["previous_action_embedder.weight"] = (actions + 1, 16)
    inputs = 560 if previous_action else 544
    shapes.update({"belief.weight_ih_l0": (3 * hidden, inputs), "belief.weight_hh_l0": (3 * hidden, hidden)})
    shapes.update({"belief.bias_ih_l0": (3 * hidden,), "belief.bias_hh_l0": (3 * hidden,)})
    shapes.update({"actor.weight": (actions, hidden), "actor.bias": (actions,)})
    shapes.update({"critic.weight": (1, hidden), "critic.bias": (1,)})
    random = np.random.default_rng(7)
    weights = {}
    for name, shape in shapes.items():
        scale = np.sqrt(1.0 / np.prod(shape[1:])) if len(shape) > 1 else 0.1
        weights[name] = (random.standard_normal(shape) * scale).astype(np.float32)
    return weights


def sealed(**fields: object) -> bytes:
    """A manifest with its own checksum, as `proto::checkpoint` writes it."""
    manifest = {
        **{"schema_version": 3, "rollout": 7, "frames": 1000, "exchange": 0, "stage": 0, "stage_end": False},
        **{"adam_steps": 0, "multiplier": "0", "carried_goal": "goal_to_object"},
        **{"tensors": "rollout-00000007.safetensors", "tensors_bytes": 0, "tensors_sha256": ""},
        **{"config_sha256": "", "config": "", "weights": "w"},
        "machine": {"torch": "2.11.0", "device": "cpu", "threads": 2, "instruction_set": "avx2"},
        **fields,
    }
    manifest = {name: value for name, value in manifest.items() if name != "config" or value}
    text = lambda digest: json.dumps(manifest | {"manifest_sha256": digest}, indent=2, ensure_ascii=False)  # noqa: E731
    return text(hashlib.sha256(text("").encode(errors="replace")).hexdigest()).encode(errors="replace")


def checkpoint(folder: Path, rollout: int, tensors: dict[str, np.ndarray], **fields: object) -> Path:
    """Writes a checkpoint of these tensors; returns its manifest."""
    name = folder / f"rollout-{rollout:08}"
    save_file(tensors, name.with_suffix(".safetensors"))
    content = name.with_suffix(".safetensors").read_bytes()
    facts = {"tensors_bytes": len(content), "tensors_sha256": hashlib.sha256(content).hexdigest()}
    manifest = sealed(rollout=rollout, frames=1000 * rollout, tensors=f"{name.name}.safetensors", **facts | fields)
    name.with_suffix(".json").write_bytes(manifest)
    return name.with_suffix(".json")


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


def probed(
    learner: Path, folder: Path, weights: str, batch: dict[str, np.ndarray], goal: str = "polar"
) -> dict[str, np.ndarray]:
    """What the learner's own network gives for a recorded batch: `learner probe`."""
    cells = batch["episode_start"].shape
    others = {name: np.zeros(cells, np.float32) for name in ("log_prob", "value", "reward")}
    others.update({name: np.zeros(cells, np.bool_) for name in ("ended", "time_limit", "disturbed")})
    others.update(action=np.zeros(cells, np.int64), bootstrap=np.zeros(cells[1], np.float32))
    save_file({**batch, **others}, folder / "batch.safetensors")
    command = [learner, "probe", "--weights", weights, "--batch", "batch.safetensors", "--out", "out.safetensors"]
    subprocess.run(
        [*command, "--device", "cpu", "--set", f"network.goal={goal}"], cwd=folder, check=True, capture_output=True
    )
    return load_file(folder / "out.safetensors")


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
