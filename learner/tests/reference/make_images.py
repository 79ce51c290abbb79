"""Reference values for learner/tests/reference/images.rs: the network and the losses of CleanRL's ppo_atari.py, in double
precision, with an encoder for each image of learner/tests/support/images.toml.

    pip install numpy==2.4.6 safetensors==0.8.0 torch==2.11.0
    python3 make_images.py              # writes images.safetensors beside this file

Nothing is shared with the Rust code but the formula `noise` of `make_cleanrl.py`, from which both sides make weights and
inputs, so that the file holds results only.
"""

import numpy as np
import torch
from make_cleanrl import COLUMNS, ENTROPY, GAMMA, HERE, LAMBDA, STEPS, VALUE, exact, noise
from safetensors.numpy import save_file
from torch import Tensor, nn

ACTIONS, CLIP = 3, 0.1
SHAPES = {"depth": (41, 36), "heat": (2, 45, 36), "screen": (36, 40, 3)}


def images() -> dict[str, Tensor]:
    """What is observed, [T, N, ...]."""
    values = {
        name: noise(f"images.{name}", STEPS, COLUMNS, *shape).astype(np.float32) for name, shape in SHAPES.items()
    }
    one = np.float32(1)
    screen = ((values["screen"] + one) * np.float32(127)).astype(np.uint8)
    depth = ((values["depth"] + one) * np.float32(32767)).astype(np.uint16)
    return {"depth": torch.tensor(depth.astype(float)), "heat": torch.tensor(values["heat"].astype(float))} | {
        "screen": torch.tensor(screen.astype(float))
    }


def encoder(channels: int, height: int, width: int) -> nn.Module:
    """`network` of ppo_atari.py."""
    convolutions = nn.Sequential(
        nn.Conv2d(channels, 32, 8, stride=4),
        nn.ReLU(),
        nn.Conv2d(32, 64, 4, stride=2),
        nn.ReLU(),
        nn.Conv2d(64, 64, 3, stride=1),
        nn.ReLU(),
        nn.Flatten(),
    )
    features = convolutions(torch.zeros(1, channels, height, width)).shape[1]
    return convolutions.append(nn.Linear(features, 512)).append(nn.ReLU())


class Agent(nn.Module):
    """Encoders, a layer for the numbers, linear heads."""

    def __init__(self) -> None:
        super().__init__()
        sizes = {"depth": (1, 41, 36), "heat": (2, 45, 36), "screen": (3, 36, 40)}
        self.images = nn.ModuleDict({name: encoder(*size) for name, size in sizes.items()})
        self.mlp = nn.Sequential(nn.Linear(4, 8), nn.Tanh())
        self.actor, self.critic = nn.Linear(8 + 3 * 512, ACTIONS), nn.Linear(8 + 3 * 512, 1)

    def forward(self, numbers: Tensor, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Log-probabilities and values of rows."""
        given = {
            "depth": seen["depth"].unsqueeze(1) / 65535.0,
            "heat": seen["heat"],
            "screen": seen["screen"].permute(0, 3, 1, 2) / 255.0,
        }
        hidden = torch.cat([self.mlp(numbers), *(self.images[name](given[name]) for name in given)], 1)
        return self.actor(hidden).log_softmax(1), self.critic(hidden).flatten()


def set_weights(agent: Agent) -> None:
    """`weight_values` of the tests."""
    for name, weight in agent.named_parameters():
        shape = tuple(weight.shape)
        values = exact(name, *shape)
        values = values * np.sqrt(3.0 / np.prod(shape[1:])) if len(shape) > 1 else 0.1 * values
        weight.data = torch.tensor(values.astype(np.float32).astype(float))


def main() -> None:
    """One minibatch of everything, as in ppo_atari.py."""
    agent = Agent().double()
    set_weights(agent)
    log_prob = (
        noise("images.log_prob", STEPS, COLUMNS).astype(np.float32) * np.float32(0.25) - np.float32(1.25)
    ).astype(float)
    values, rewards = noise("images.value", STEPS, COLUMNS), noise("images.reward", STEPS, COLUMNS)
    ended, bootstrap = noise("images.ended", STEPS, COLUMNS) > 0.7, noise("images.bootstrap", COLUMNS)
    actions = torch.tensor((3 * np.arange(STEPS)[:, None] + 5 * np.arange(COLUMNS)) % ACTIONS)

    advantages, lastgaelam = np.zeros_like(rewards), 0.0
    for t in reversed(range(STEPS)):
        nextvalues = bootstrap if t == STEPS - 1 else values[t + 1]
        delta = rewards[t] + GAMMA * nextvalues * ~ended[t] - values[t]
        advantages[t] = lastgaelam = delta + GAMMA * LAMBDA * ~ended[t] * lastgaelam
    returns = torch.tensor(advantages + values).flatten()
    mb_advantages = torch.tensor(advantages).flatten()
    # ppo_atari.py adds 1e-8; the reference of this project 1e-5 (docs/method.md).
    mb_advantages = (mb_advantages - mb_advantages.mean()) / (mb_advantages.std() + 1e-5)

    seen = {name: image.flatten(0, 1) for name, image in images().items()}
    log_probs, newvalue = agent(torch.tensor(2.0 * noise("images.numbers", STEPS, COLUMNS, 4)).flatten(0, 1), seen)
    newlogprob = log_probs.gather(1, actions.flatten().unsqueeze(1)).squeeze(1)
    ratio = (newlogprob - torch.tensor(log_prob).flatten()).exp()
    pg_loss = torch.max(-mb_advantages * ratio, -mb_advantages * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
    old = torch.tensor(values).flatten()
    v_clipped = old + (newvalue - old).clamp(-CLIP, CLIP)
    v_loss = 0.5 * torch.max((newvalue - returns) ** 2, (v_clipped - returns) ** 2).mean()
    entropy = -(log_probs.exp() * log_probs).sum(1).mean()
    loss = pg_loss - ENTROPY * entropy + VALUE * v_loss
    loss.backward()

    probes = []
    for name, weight in sorted(agent.named_parameters()):
        gradient = weight.grad.numpy()
        probes += [np.linalg.norm(gradient), (gradient * exact(f"probe.{name}", *gradient.shape)).sum()]
    found = {
        "log_probs": log_probs.view(STEPS, COLUMNS, ACTIONS),
        "values": newvalue.view(STEPS, COLUMNS),
        "loss/policy": pg_loss,
        "loss/value": v_loss,
        "policy/entropy": entropy,
        "loss/total": loss,
        "gradients": torch.tensor(np.array(probes)),
    }
    save_file({name: value.detach().numpy() for name, value in found.items()}, HERE / "images.safetensors")


if __name__ == "__main__":
    main()
