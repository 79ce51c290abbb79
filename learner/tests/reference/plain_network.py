"""The network in plain PyTorch, and the formula `noise` from which this side and the Rust tests make weights and inputs."""

import math

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

torch.set_num_threads(1)


def noise(name: str, count: int) -> np.ndarray:
    """`count` numbers in [-1, 1) that are a function of the name: murmur3's finaliser over a counter."""
    seed = 0x811C9DC5
    for byte in name.encode():
        seed = ((seed ^ byte) * 0x01000193) & 0xFFFFFFFF
    x = (np.arange(count, dtype=np.uint64) * 0x9E3779B9 + seed) & 0xFFFFFFFF
    x ^= x >> 16
    x = (x * 0x85EBCA6B) & 0xFFFFFFFF
    x ^= x >> 13
    x = (x * 0xC2B2AE35) & 0xFFFFFFFF
    x ^= x >> 16
    return x.astype(np.float64) / 2**31 - 1.0


def tensor(name: str, *shape: int) -> torch.Tensor:
    return torch.tensor(noise(name, math.prod(shape)).reshape(shape), dtype=torch.float32)


def set_weights(module: nn.Module) -> None:
    for name, weight in module.named_parameters():
        value = torch.tensor(noise(name, weight.numel()).reshape(weight.shape))
        if weight.dim() > 1:
            value = value * math.sqrt(3.0 / (weight.numel() / weight.shape[0]))
        else:
            value = 0.1 * value + (1.0 if is_norm_scale(module, name) else 0.0)
        weight.data.copy_(value.float())


def is_norm_scale(module: nn.Module, name: str) -> bool:
    return name.endswith(".weight") and isinstance(module.get_submodule(name.rpartition(".")[0]), nn.GroupNorm)


def probes(named: list[tuple[str, torch.Tensor]]) -> torch.Tensor:
    """One row a tensor: its norm, and its product with a noise vector."""
    rows = []
    for name, value in named:
        value = value.detach().double().reshape(-1)
        rows.append([value.norm().item(), float(value.numpy() @ noise("probe." + name, value.numel()))])
    return torch.tensor(rows, dtype=torch.float64)


# The network --------------------------------------------------------------------------------------------------------


class Block(nn.Module):
    def __init__(self, inputs: int, planes: int, stride: int):
        super().__init__()
        self.convs = nn.Sequential(
            nn.Conv2d(inputs, planes, 3, stride, 1, bias=False),
            nn.GroupNorm(16, planes),
            nn.ReLU(),
            nn.Conv2d(planes, planes, 3, 1, 1, bias=False),
            nn.GroupNorm(16, planes),
        )
        self.downsample = None
        if stride != 1 or inputs != planes:
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, planes, 1, stride, bias=False), nn.GroupNorm(16, planes)
            )

    def forward(self, x):
        return F.relu(self.convs(x) + (x if self.downsample is None else self.downsample(x)))


class Backbone(nn.Module):
    def __init__(self):
        super().__init__()
        self.conv1 = nn.Sequential(nn.Conv2d(1, 32, 7, 2, 3, bias=False), nn.GroupNorm(16, 32), nn.ReLU())
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        self.layer1 = nn.Sequential(Block(32, 32, 1), Block(32, 32, 1))
        self.layer2 = nn.Sequential(Block(32, 64, 2), Block(64, 64, 1))
        self.layer3 = nn.Sequential(Block(64, 128, 2), Block(128, 128, 1))
        self.layer4 = nn.Sequential(Block(128, 256, 2), Block(256, 256, 1))

    def forward(self, x):
        return self.layer4(self.layer3(self.layer2(self.layer1(self.maxpool(self.conv1(x))))))


class Resnet(nn.Module):
    def __init__(self, side: int):
        super().__init__()
        self.backbone = Backbone()
        self.compression = nn.Sequential(nn.Conv2d(256, 128, 3, 1, 1, bias=False), nn.GroupNorm(1, 128), nn.ReLU())
        with torch.no_grad():
            flat = self.compression(self.backbone(torch.zeros(1, 1, side, side))).numel()
        self.fc = nn.Sequential(nn.Flatten(), nn.Linear(flat, 512), nn.ReLU())

    def forward(self, x):
        return self.fc(self.compression(self.backbone(x)))


class Cnn(nn.Module):
    def __init__(self, side: int):
        super().__init__()
        convolutions = [nn.Conv2d(1, 32, 8, 4), nn.ReLU(), nn.Conv2d(32, 64, 4, 2), nn.ReLU(), nn.Conv2d(64, 32, 3)]
        with torch.no_grad():
            flat = nn.Sequential(*convolutions)(torch.zeros(1, 1, side, side)).numel()
        self.cnn = nn.Sequential(*convolutions, nn.Flatten(), nn.Linear(flat, 512), nn.ReLU())

    def forward(self, x):
        return self.cnn(x)


class Cpca(nn.Module):
    def __init__(self, hidden: int, actions: int):
        super().__init__()
        self.action_embedder = nn.Embedding(actions, 16)
        self.context_model = nn.GRU(16, hidden)
        self.classifier = nn.Sequential(nn.Linear(544 + hidden, 32), nn.ReLU(), nn.Linear(32, 1))


def auxiliary_head(task: str, hidden: int, actions: int) -> nn.Module:
    if task == "disturb":
        return nn.Sequential(nn.Linear(hidden, 128), nn.ReLU(), nn.Linear(128, actions))
    return {"inverse_dynamics": nn.Linear(2 * 544 + hidden, actions), "cpca16": Cpca(hidden, actions)}[task]


class Network(nn.Module):
    def __init__(
        self,
        encoder: str,
        pool: int,
        polar: bool,
        previous_action: bool,
        hidden: int,
        actions: int,
        auxiliary: str = "disturb",
    ):
        super().__init__()
        self.pool, self.polar = pool, polar
        self.visual_encoder = {"resnet": Resnet, "cnn": Cnn}[encoder](224 // pool)
        self.goal_embedder = nn.Sequential(nn.Linear(3, 100), nn.LeakyReLU(0.01), nn.Linear(100, 32))
        inputs = 544
        if previous_action:
            self.previous_action_embedder = nn.Embedding(actions + 1, 16)
            inputs += 16
        self.belief = nn.GRU(inputs, hidden)
        self.actor = nn.Linear(hidden, actions)
        self.critic = nn.Linear(hidden, 1)
        self.auxiliary = nn.ModuleDict({auxiliary: auxiliary_head(auxiliary, hidden, actions)})
        set_weights(self)

    def embed(self, depth_mm, goal_m, previous_action):
        """Millimetres [B, 224, 224], metres [B, 3], rows of the action table [B] (0 = none): [B, 544 or 560]."""
        dtype = self.actor.weight.dtype
        depth = F.avg_pool2d(depth_mm.to(dtype)[:, None] / 1000.0, self.pool)
        parts = [self.visual_encoder((depth - 0.5) / 0.25)]
        x, y, z = goal_m.double().unbind(1)
        if self.polar:
            rho = (x**2 + y**2 + z**2).sqrt()
            goal = torch.stack(
                [rho, torch.atan2(z, torch.hypot(x, y)) / (math.pi / 2), torch.atan2(y, x) / math.pi], 1
            )
        else:
            goal = torch.stack([x, y, z], 1).abs()
        # Rounded as on the way into a network of any precision.
        parts.append(self.goal_embedder(goal.float().to(dtype)))
        if hasattr(self, "previous_action_embedder"):
            parts.append(self.previous_action_embedder(previous_action))
        return torch.cat(parts, 1)

    def step(self, depth_mm, goal_m, previous_action, start, belief):
        """[`embed`]'s inputs, bool [B], [B, hidden]."""
        return self.judge(self.embed(depth_mm, goal_m, previous_action), start, belief)

    def judge(self, embedded, start, belief):
        """Log-probabilities, values, beliefs after it."""
        belief = torch.where(start[:, None], torch.zeros_like(belief), belief)
        _, belief = self.belief(embedded[None], belief[None])
        belief = belief[0]
        return F.log_softmax(self.actor(belief), -1), self.critic(belief)[:, 0], belief


def depth_mm(t: int, n: int) -> torch.Tensor:
    """0..4095 mm in tiles of 8 pixels: walls and edges, not white noise."""
    tiles = np.floor((noise(f"frame.{t}.{n}", 28 * 28) + 1.0) * 2048.0).reshape(28, 28)
    return torch.tensor(np.kron(tiles, np.ones((8, 8))) + np.arange(224)[None, :])


def goal_m(t: int, n: int) -> torch.Tensor:
    return tensor(f"goal.{t}.{n}", 3) * 2.0
