"""Checkpoints, and with torch the network. `learner probe` is asked what the learner's own network gives."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

import stillroom
from conftest import REPOSITORY, checkpoint, probed, record, sealed, weights_of
from stillroom.checkpoint import CheckpointError


def run_folder(root: Path, rollouts: list[int]) -> None:
    (root / "checkpoints").mkdir()
    config = '[network]\ngoal = "cartesian"\n[episode]\nmax_steps = 77\naction_space = "small"\n'
    for rollout in rollouts:
        tensors = {
            "model.actor.weight": np.full((2, 3), rollout, np.float32),
            "optimizer.first": np.zeros(3, np.float32),
        }
        checkpoint(root / "checkpoints", rollout, tensors, config=config)


def test_the_newest_whole_checkpoint_of_a_run_is_read(tmp_path: Path) -> None:
    run_folder(tmp_path, [3, 12, 100])
    newest = stillroom.load(tmp_path)
    assert (newest.frames, newest.goal, newest.path.name) == (100_000, "cartesian", "rollout-00000100.safetensors")
    assert list(newest.weights) == ["actor.weight"] and newest.weights["actor.weight"][0, 0] == 100
    distances = {"start_distance_max_m": 0.0, "goal_distance_max_m": 0.0}
    task = {
        "task": "arm_point_nav",
        "carried_goal": "goal_to_object",
        "max_steps": 77,
        "action_space": "small",
    } | distances
    assert newest.environment() == task
    env = stillroom.ArmPointNav(1, **newest.environment())
    assert env.action_space.n == 13
    assert stillroom.load(tmp_path, rollout=3).frames == 3000
    assert stillroom.load(tmp_path / "checkpoints/rollout-00000012.safetensors").frames == 12_000
    # A torn one is followed by the one before it, and refused where it is asked for.
    torn = tmp_path / "checkpoints/rollout-00000100.safetensors"
    torn.write_bytes(torn.read_bytes()[:-1] + b"\x01")
    with pytest.warns(UserWarning, match=r"00000100.* is damaged.*: rollout-00000012.safetensors is taken"):
        assert stillroom.load(tmp_path).frames == 12_000
    with pytest.raises(CheckpointError, match="SHA-256"):
        stillroom.load(torn)
    newest.save(tmp_path / "weights.safetensors")
    alone = stillroom.load(tmp_path / "weights.safetensors")
    assert np.array_equal(alone.weights["actor.weight"], newest.weights["actor.weight"]) and alone.frames is None
    # The best one, named by a file where there are no links.
    best = tmp_path / "validation/rollout-00000003"
    best.mkdir(parents=True)
    for file in (tmp_path / "checkpoints").glob("rollout-00000003.*"):
        shutil.copy(file, best)
    (tmp_path / "best").write_text("validation/rollout-00000003\n")
    assert stillroom.load(tmp_path / "best").frames == 3000
    (tmp_path / "best").write_text("../validation/rollout-00000003\n")
    with pytest.raises(CheckpointError):
        stillroom.load(tmp_path / "best")


def test_a_policy_file_says_itself_what_it_is(tmp_path: Path) -> None:
    config = '[network]\ngoal = "cartesian"\ncarried_goal = "object_to_goal"\n[episode]\nmax_steps = 77\n'
    ones = np.ones((2, 3), np.float16)
    digest = hashlib.sha256(b"actor.weight" + (12).to_bytes(8, "little") + ones.tobytes()).hexdigest()
    facts = {"config": config, "frames": "4000", "rollout": "12", "run": "0123"}
    facts |= {"weights_sha256": "", "tensors_sha256": digest}
    path = tmp_path / "policy.safetensors"
    save_file({"actor.weight": ones}, path, {"stillroom": json.dumps(facts)})
    policy = stillroom.load(path)
    assert (policy.frames, policy.goal, policy.carried_goal) == (4000, "cartesian", "object_to_goal")
    assert policy.weights["actor.weight"].dtype == np.float32
    assert (policy.environment()["carried_goal"], policy.environment()["max_steps"]) == ("object_to_goal", 77)
    for wrong, problem in [
        ("nonsense", "metadata that cannot be read"),
        ("[]", "metadata that cannot be read"),
        (json.dumps({**facts, "frames": "many"}), "`frames`"),
        (json.dumps({**facts, "config": "="}), "configuration"),
    ]:
        save_file({"actor.weight": ones}, path, {"stillroom": wrong})
        with pytest.raises(CheckpointError, match=problem):
            stillroom.load(path)


def test_a_damaged_policy_file_is_refused(tmp_path: Path) -> None:
    whole = REPOSITORY / "models/fetch.safetensors"
    assert stillroom.load(whole).frames == 45_000_000
    content = bytearray(whole.read_bytes())
    # The lowest bit of a weight: it stays a finite number.
    content[-2] ^= 1
    damaged = tmp_path / "damaged.safetensors"
    damaged.write_bytes(content)
    with pytest.raises(CheckpointError, match="damaged: the SHA-256 of its weights"):
        stillroom.load(damaged)
    assert stillroom.load(damaged, verify=False).frames == 45_000_000


def test_what_holds_no_checkpoint_is_refused(tmp_path: Path) -> None:
    cases: list[tuple[str, bytes | None, str]] = [
        ("", None, "no checkpoint"),
        ("a.safetensors", b"nothing", "no safetensors file"),
        ("a.json", b"[]", "not a manifest"),
        ("b.json", sealed(tensors="../a.safetensors"), "not beside it"),
        ("c.json", sealed(config="[network]\ngoal = 3"), "its configuration"),
        ("d.json", sealed(), "No such file"),
        ("e.json", sealed().replace(b"1000", b"2000"), "its own checksum"),
        ("a.txt", b"", "neither a run folder"),
        ("c.safetensors", None, "c.safetensors is not there"),
    ]
    for name, content, problem in cases:
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(stillroom.CheckpointError, match=problem) as caught:
            stillroom.load(tmp_path / name)
        assert str(tmp_path) in str(caught.value)


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
    expected = probed(learner, tmp_path, "weights.safetensors", batch)

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
