"""Holds the modules of plain_network.py, which the Rust tests are compared with, against AllenAct's own.

    pip install torch==2.11.0 numpy==2.4.6 safetensors==0.8.0
    pip install --no-deps allenact==0.5.4 gym==0.26.2 gym_notices cloudpickle attrs networkx scipy packaging \\
        opencv-python-headless compress_pickle setproctitle Pillow
    python check_allenact.py

AllenAct pins packages that no longer go together, hence --no-deps.
"""

import gym
import numpy as np
import torch
from allenact.embodiedai.models.basic_models import RNNStateEncoder
from allenact.embodiedai.models.resnet import GroupNormResNetEncoder, gnresnet18

import allenact_names
import plain_network


def difference(a: torch.Tensor, b: torch.Tensor) -> float:
    return ((a - b).norm() / b.norm()).item()


def encoder() -> None:
    """Names, shapes, output and gradients of the visual encoder."""
    space = gym.spaces.Dict({"depth": gym.spaces.Box(0.0, 10.0, (224, 224, 1), np.float32)})
    theirs = GroupNormResNetEncoder(space, None, "depth", 512, baseplanes=32, ngroups=16, make_backbone=gnresnet18)
    mine = allenact_names.AllenActResnet()
    plain_network.set_weights(mine)
    theirs.load_state_dict(mine.state_dict(), strict=True)
    depth = torch.stack([plain_network.depth_mm(0, n) for n in range(3)]).float() / 1000.0
    depth = (depth - 0.5) / 0.25
    a, b = mine(depth[:, None]), theirs({"depth": depth[None, ..., None]})[0]
    torch.manual_seed(1)
    towards = torch.randn_like(a)
    (a * towards).sum().backward()
    (b * towards).sum().backward()
    gradients = [difference(p.grad, q.grad) for p, q in zip(mine.parameters(), theirs.parameters(), strict=True)]
    print(f"encoder: output {difference(a, b):.1e}, gradients at most {max(gradients):.1e}")
    assert difference(a, b) < 1e-5 and max(gradients) < 1e-5


def belief() -> None:
    """The GRU over a rollout whose columns begin episodes in mid-rollout: AllenAct's masks, our zeroed states."""
    torch.manual_seed(2)
    steps, columns, inputs, hidden = 12, 5, 560, 64
    theirs = RNNStateEncoder(inputs, hidden)
    x, before = torch.randn(steps, columns, inputs), torch.randn(1, columns, hidden)
    carried = (torch.rand(steps, columns, 1) > 0.25).float()
    expected, _ = theirs(x, before, carried)
    state, beliefs = before, []
    for t in range(steps):
        out, state = theirs.rnn(x[t : t + 1], state * carried[t])
        beliefs.append(out[0])
    print(f"belief: {difference(torch.stack(beliefs), expected):.1e}")
    assert difference(torch.stack(beliefs), expected) < 1e-5


if __name__ == "__main__":
    encoder()
    belief()
