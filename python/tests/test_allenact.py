r"""Weights of AllenAct's own classes: imported, the learner's network gives what AllenAct's gives.

AllenAct is not among the packages of `make test-python`: it brings a torch with CUDA (5 GB in all), and pins packages
that no longer go together. Once, into `.venv/`:

    pip install torch==2.11.0
    pip install --no-deps allenact==0.5.4 gym==0.26.2 gym_notices cloudpickle attrs networkx scipy packaging \
        opencv-python-headless compress_pickle setproctitle Pillow torchvision==0.26.0 tensorboardX protobuf
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stillroom
from conftest import REPOSITORY, probed, record

torch = pytest.importorskip("torch", reason="torch is not installed: this file says how AllenAct is")
pytest.importorskip("allenact", reason="AllenAct is not installed: this file says how")

import gym  # noqa: E402
from allenact.algorithms.onpolicy_sync.policy import LinearActorHead, LinearCriticHead  # noqa: E402
from allenact.base_abstractions.misc import Memory  # noqa: E402
from allenact.embodiedai.models.basic_models import RNNStateEncoder, SimpleCNN  # noqa: E402
from allenact.embodiedai.models.resnet import GroupNormResNetEncoder, gnresnet18  # noqa: E402
from allenact.embodiedai.models.visual_nav_models import VisualNavActorCritic  # noqa: E402
from safetensors.torch import save_file  # noqa: E402
from torch import Tensor, nn  # noqa: E402

STEPS, COLUMNS = 24, 3
DEPTH = gym.spaces.Dict({"depth": gym.spaces.Box(0.0, 10.0, (224, 224, 1), np.float32)})


def goal_embedding() -> nn.Module:
    """The two layers of `input_embedding_net`, which is in AllenAct's projects and not in its package."""
    return nn.Sequential(nn.Sequential(nn.Linear(3, 100), nn.LeakyReLU()), nn.Sequential(nn.Linear(100, 32)))


class DisturbanceFree(VisualNavActorCritic):
    """The paper's network: AllenAct's class for visual navigation with its ResNet, one belief, two auxiliary tasks."""

    def __init__(self, hidden: int, actions: int) -> None:
        space = gym.spaces.Discrete(actions)
        super().__init__(space, DEPTH, hidden, auxiliary_uuids=["InvDyn", "CPCA_16"])
        self.visual_encoder = GroupNormResNetEncoder(
            DEPTH, None, "depth", 512, baseplanes=32, ngroups=16, make_backbone=gnresnet18
        )
        self.goal_embedder = goal_embedding()
        self.create_state_encoders(
            obs_embed_size=544,
            prev_action_embed_size=16,
            num_rnn_layers=1,
            rnn_type="GRU",
            add_prev_actions=True,
            add_prev_action_null_token=False,
        )
        self.create_actorcritic_head()
        self.create_aux_models(544, 16)

    def forward_encoder(self, observations: dict[str, Tensor]) -> Tensor:
        """Depth as AllenAct's sensor normalises it, polar goals: [steps, columns, ...] to [steps, columns, 544]."""
        return torch.cat([self.visual_encoder(observations), self.goal_embedder(observations["goal"])], -1)

    def outputs(self, observations: dict[str, Tensor], previous: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
        """Log-probabilities and values by AllenAct's own forward pass."""
        memory = Memory().check_append("single_belief", torch.zeros(1, COLUMNS, self._hidden_size), sampler_dim=1)
        output, _ = self(observations, memory, previous, masks)
        return output.distributions.logits.log_softmax(-1), output.values[..., 0]


class Original(nn.Module):
    """AllenAct's first baseline of ManipulaTHOR, of the modules that it is made of; its goals are absolute values."""

    def __init__(self, hidden: int, actions: int) -> None:
        super().__init__()
        self.visual_encoder = SimpleCNN(DEPTH, 512, rgb_uuid=None, depth_uuid="depth")
        self.state_encoder = RNNStateEncoder(544, hidden)
        self.relative_dist_embedding = goal_embedding()
        self.actor, self.critic = LinearActorHead(hidden, actions), LinearCriticHead(hidden)
        self.hidden = hidden

    def outputs(self, observations: dict[str, Tensor], previous: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
        """Log-probabilities and values; the previous action is not looked at."""
        del previous
        seen = [self.relative_dist_embedding(observations["goal"]), self.visual_encoder(observations)]
        belief, _ = self.state_encoder(torch.cat(seen, -1), torch.zeros(1, COLUMNS, self.hidden), masks)
        return self.actor(belief).logits.log_softmax(-1), self.critic(belief)[..., 0]


def polar(goal_m: np.ndarray) -> np.ndarray:
    """Distance, elevation and azimuth, as the disturbance-free project's sensor gives them."""
    x, y, z = np.moveaxis(goal_m.astype(np.float64), -1, 0)
    flat = np.hypot(x, y)
    angles = [np.arctan2(z, flat) / (np.pi / 2), np.arctan2(y, x) / np.pi]
    return np.stack([np.hypot(flat, z), *angles], -1).astype(np.float32)


CASES = {
    "disturbance-free": (DisturbanceFree, 64, "large", polar, ["auxiliary.task=cpca16"]),
    "original": (
        Original,
        48,
        "small",
        np.abs,
        [
            "network.encoder=cnn",
            "network.input_pool=1",
            "network.goal=cartesian",
            "network.previous_action=false",
            "episode.action_space=small",
            "auxiliary.task=none",
        ],
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_weights_of_allenacts_class_give_what_it_gives(kitchens: dict, tmp_path: Path, name: str) -> None:
    programs = {}
    for program in ("orchestrator", "learner"):
        programs[program] = Path(
            os.environ.get(f"STILLROOM_{program.upper()}", REPOSITORY / "target/release" / program)
        )
        if not programs[program].exists():
            pytest.skip(f"{programs[program]} is not there: make build")
    make, hidden, space, coordinates, settings = CASES[name]
    actions = {"large": 21, "small": 13}[space]
    torch.manual_seed(5)
    network: Any = make(hidden, actions).eval()
    # AllenAct begins with heads near zero, with which any belief gives nearly the same.
    nn.init.normal_(network.actor.linear.weight, std=0.3)
    nn.init.normal_(network.critic.fc.weight, std=0.3)
    state = {key: value.detach().clone().contiguous() for key, value in network.state_dict().items()}
    save_file(state, tmp_path / "theirs.safetensors")

    command = [programs["orchestrator"], "import", "theirs.safetensors", "--preset", "paper", "--run", "run"]
    options = [word for setting in [f"network.hidden={hidden}", *settings] for word in ("--set", setting)]
    done = subprocess.run([*command, *options], check=False, cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    imported = stillroom.load(tmp_path / "run")
    assert imported.carried_goal == "goal_to_object"
    if name == "disturbance-free":
        for ours, theirs in [
            ("cpca16.context_model.weight_hh_l0", "CPCA_16.context_model.weight_hh_l0"),
            ("cpca16.classifier.2.weight", "CPCA_16.classifier.2.weight"),
        ]:
            assert np.array_equal(imported.weights[f"auxiliary.{ours}"], state[f"aux_models.{theirs}"].numpy())

    batch = record(STEPS, COLUMNS, space, kitchens[1])
    # An episode begins in mid-rollout, too, so that masks matter.
    batch["episode_start"][STEPS // 2, 1] = True
    batch["previous_action"][STEPS // 2, 1] = 0
    observations = {
        "depth": (torch.from_numpy(batch["frames"]).float()[..., None] / 1000 - 0.5) / 0.25,
        "goal": torch.from_numpy(coordinates(batch["goal_m"])),
    }
    # AllenAct has no row for "none yet": an episode's first step gets the action that ended the one before, Done.
    before = torch.from_numpy(batch["previous_action"])
    before = torch.where(before == 0, actions - 1, before - 1)
    masks = (~torch.from_numpy(batch["episode_start"])).float()[..., None]
    with torch.no_grad():
        log_probs, values = network.outputs(observations, before, masks)

    imported.save(tmp_path / "ours.safetensors")
    goal = "cartesian" if name == "original" else "polar"
    expected = probed(programs["learner"], tmp_path, "ours.safetensors", batch, goal)
    assert np.abs(log_probs.numpy() - expected["log_probs"]).max() < 1e-4
    assert np.abs(values.numpy() - expected["values"]).max() < 1e-4
    assert np.ptp(values.numpy()) > 1e-2, "what is seen matters"
