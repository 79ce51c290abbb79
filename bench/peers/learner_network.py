"""The learner's network and loss in plain PyTorch: docs/method.md, as anyone would write it.

It is not `stillroom.network`: there is no package `stillroom` where the learner is measured, and here the encoder may
be bfloat16 and all of it must fit into a CUDA graph.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

#: Actions of the policy.
ACTIONS = 21
#: Side of a raw depth frame, and of the pooled one that the network sees.
RAW_SIDE, POOL = 224, 2
SIDE = RAW_SIDE // POOL
#: Millimetres to the network's input.
SCALE, OFFSET = 1 / 250, -2.0
#: Constants of the loss.
CLIP, VALUE_COEFFICIENT, ENTROPY_COEFFICIENT, AUXILIARY_WEIGHT, FOCAL_GAMMA = 0.1, 0.5, 0.01, 0.1, 2.0


class Block(nn.Module):
    """Two convolutions and a way around them."""

    def __init__(self, inputs: int, planes: int, stride: int) -> None:
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
            self.downsample = nn.Sequential(nn.Conv2d(inputs, planes, 1, stride, bias=False), nn.GroupNorm(16, planes))

    def forward(self, x: Tensor) -> Tensor:
        """Maps to maps."""
        return F.relu(self.convs(x) + (x if self.downsample is None else self.downsample(x)))


def resnet() -> nn.Sequential:
    """The paper's encoder: ResNet18 with group normalisation, half as wide."""
    stages = [(32, 32, 1), (32, 64, 2), (64, 128, 2), (128, 256, 2)]
    return nn.Sequential(
        nn.Conv2d(1, 32, 7, 2, 3, bias=False),
        nn.GroupNorm(16, 32),
        nn.ReLU(),
        nn.MaxPool2d(3, 2, 1),
        *(block for stage in stages for block in (Block(*stage), Block(stage[1], stage[1], 1))),
        nn.Conv2d(256, 128, 3, 1, 1, bias=False),
        nn.GroupNorm(1, 128),
        nn.ReLU(),
        nn.Flatten(),
        nn.Linear(2048, 512),
        nn.ReLU(),
    )


def cnn() -> nn.Sequential:
    """The small encoder."""
    convolutions = [nn.Conv2d(1, 32, 8, 4), nn.ReLU(), nn.Conv2d(32, 64, 4, 2), nn.ReLU(), nn.Conv2d(64, 32, 3)]
    with torch.no_grad():
        flat = nn.Sequential(*convolutions)(torch.zeros(1, 1, SIDE, SIDE)).numel()
    return nn.Sequential(*convolutions, nn.Flatten(), nn.Linear(flat, 512), nn.ReLU())


ENCODERS = {"resnet": resnet, "cnn": cnn}


@dataclass(frozen=True)
class Batch:
    """A rollout of T steps and N environments on the device; frames are kept pooled, as ours are."""

    frames: Tensor  # f32 [T·N, SIDE, SIDE], millimetres
    goal: Tensor  # f32 [T·N, 3]
    previous_action: Tensor  # i64 [T·N]
    action: Tensor  # i64 [T·N]
    log_prob: Tensor  # f32 [T·N], so are the next three
    value: Tensor
    advantage: Tensor
    target: Tensor
    disturbed: Tensor  # f32 [T·N]
    belief: Tensor  # f32 [N, hidden]

    @staticmethod
    def of(steps: int, environments: int, hidden: int, device: torch.device) -> Batch:
        """Made-up numbers of the right kind."""
        rows = steps * environments

        def noise() -> Tensor:
            return torch.randn(rows, device=device)

        return Batch(
            frames=torch.rand(rows, SIDE, SIDE, device=device) * 4000 + 300,
            goal=torch.rand(rows, 3, device=device),
            previous_action=torch.randint(ACTIONS + 1, (rows,), device=device),
            action=torch.randint(ACTIONS, (rows,), device=device),
            log_prob=noise() * 0.01 - 3.0,
            value=noise() * 0.1,
            advantage=noise(),
            target=noise(),
            disturbed=(torch.rand(rows, device=device) < 0.1).float(),
            belief=torch.zeros(environments, hidden, device=device),
        )


class Network(nn.Module):
    """Encoder, embeddings, GRU, heads. The encoder may compute in bfloat16, as ours does; all else is float32."""

    def __init__(self, encoder: str, hidden: int, *, bf16: bool) -> None:
        super().__init__()
        self.bf16, self.hidden = bf16, hidden
        self.encoder = ENCODERS[encoder]()
        self.goal_embedder = nn.Sequential(nn.Linear(3, 100), nn.LeakyReLU(0.01), nn.Linear(100, 32))
        self.previous_action_embedder = nn.Embedding(ACTIONS + 1, 16)
        self.belief = nn.GRU(560, hidden)
        self.actor = nn.Linear(hidden, ACTIONS)
        self.critic = nn.Linear(hidden, 1)
        self.disturb = nn.Sequential(nn.Linear(hidden, 128), nn.ReLU(), nn.Linear(128, ACTIONS))

    def embed(self, kept: Tensor, goal: Tensor, previous_action: Tensor) -> Tensor:
        """Pooled millimetres [rows, SIDE, SIDE], [rows, 3], [rows] to [rows, 560]."""
        device = kept.device.type
        with torch.autocast(device, torch.bfloat16) if self.bf16 else contextlib.nullcontext():
            visual = self.encoder((kept * SCALE + OFFSET).unsqueeze(1))
        # As a product: the gradient of a look-up sorts, which a CUDA graph may not hold.
        actions = torch.arange(ACTIONS + 1, device=kept.device)
        chosen = (previous_action.unsqueeze(1) == actions).float() @ self.previous_action_embedder.weight
        return torch.cat([visual.float(), self.goal_embedder(goal), chosen], 1)

    @staticmethod
    def observed(rows: int) -> list[Tensor]:
        """Made-up inputs of a step, but for the belief."""
        return [
            torch.randint(300, 4300, (rows, RAW_SIDE, RAW_SIDE), dtype=torch.int16),
            torch.rand(rows, 3),
            torch.randint(ACTIONS + 1, (rows,)),
            torch.ones(rows, 1),
            torch.rand(rows, ACTIONS),
        ]

    def batch(self, steps: int, environments: int, device: torch.device) -> Batch:
        """Made-up numbers of the right kind."""
        return Batch.of(steps, environments, self.hidden, device)

    def act(
        self, raw: Tensor, goal: Tensor, previous_action: Tensor, carried: Tensor, noise: Tensor, belief: Tensor
    ) -> tuple[Tensor, Tensor]:
        """One step: 16-bit frames [rows, RAW_SIDE, RAW_SIDE] to [rows, 3] of action, log-probability and value."""
        kept = F.avg_pool2d(raw.float().unsqueeze(1), POOL).squeeze(1)
        embedded = self.embed(kept, goal, previous_action)
        gru = self.belief
        belief = torch.gru_cell(
            embedded, belief * carried, gru.weight_ih_l0, gru.weight_hh_l0, gru.bias_ih_l0, gru.bias_hh_l0
        )
        log_probs = F.log_softmax(self.actor(belief), -1)
        action = (log_probs + noise).argmax(1, keepdim=True)
        return torch.cat([action.float(), log_probs.gather(1, action), self.critic(belief)], 1), belief

    def loss(self, batch: Batch) -> Tensor:
        """PPO's loss and the auxiliary task's over a batch. No episode begins in it: the GRU is one call of cuDNN."""
        embedded = self.embed(batch.frames, batch.goal, batch.previous_action)
        beliefs, _ = self.belief(embedded.view(-1, len(batch.belief), embedded.shape[1]), batch.belief.unsqueeze(0))
        beliefs = beliefs.flatten(0, 1)
        log_probs = F.log_softmax(self.actor(beliefs), -1)
        values = self.critic(beliefs).squeeze(1)
        logits = self.disturb(beliefs).gather(1, batch.action.unsqueeze(1)).squeeze(1)
        cross = F.binary_cross_entropy_with_logits(logits, batch.disturbed, reduction="none")
        focal = ((1 - (-cross).exp()) ** FOCAL_GAMMA * cross).mean()
        return ppo_loss(log_probs, values, batch) + AUXILIARY_WEIGHT * focal


def ppo_loss(log_probs: Tensor, values: Tensor, batch: Batch | Rows) -> Tensor:
    """PPO's clipped loss of a categorical policy and its value."""
    ratio = (log_probs.gather(1, batch.action.unsqueeze(1)).squeeze(1) - batch.log_prob).exp()
    policy = -torch.minimum(ratio * batch.advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * batch.advantage).mean()
    clipped = batch.value + (values - batch.value).clamp(-CLIP, CLIP)
    value = 0.5 * torch.maximum((values - batch.target) ** 2, (clipped - batch.target) ** 2).mean()
    entropy = -(log_probs.exp() * log_probs).sum(-1).mean()
    return policy + VALUE_COEFFICIENT * value - ENTROPY_COEFFICIENT * entropy


@dataclass(frozen=True)
class Rows:
    """A rollout of a task without memory."""

    observation: Tensor  # [rows, ...] as the environment has it
    action: Tensor  # i64 [rows]
    log_prob: Tensor  # f32 [rows], so are the others
    value: Tensor
    advantage: Tensor
    target: Tensor


class Layers(nn.Module):
    """Networks without memory: CleanRL's of Atari (four frames, DQN's convolutions), or two MLPs of 64 × 64."""

    hidden = 0

    def __init__(self, shape: str, *, bf16: bool) -> None:
        super().__init__()
        self.bf16 = bf16
        self.images = shape == "atari"
        self.size, self.actions = ((4, 84, 84), 4) if self.images else ((4,), 2)
        if self.images:
            convolutions = [nn.Conv2d(4, 32, 8, 4), nn.ReLU(), nn.Conv2d(32, 64, 4, 2), nn.ReLU(), nn.Conv2d(64, 64, 3)]
            self.body = nn.Sequential(*convolutions, nn.ReLU(), nn.Flatten(), nn.Linear(3136, 512), nn.ReLU())
            self.actor, self.critic = nn.Linear(512, self.actions), nn.Linear(512, 1)
        else:
            self.body = nn.Identity()
            self.actor, self.critic = (
                nn.Sequential(nn.Linear(4, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))
                for outputs in (self.actions, 1)
            )

    def observed(self, rows: int) -> list[Tensor]:
        """Made-up inputs of a step."""
        size = (rows, *self.size)
        observation = torch.randint(256, size, dtype=torch.uint8) if self.images else torch.randn(size)
        return [observation, torch.rand(rows, self.actions)]

    def batch(self, steps: int, environments: int, device: torch.device) -> Rows:
        """Made-up numbers of the right kind."""
        rows = steps * environments
        noise = [torch.randn(rows, device=device) for _ in range(4)]
        action = torch.randint(self.actions, (rows,), device=device)
        return Rows(self.observed(rows)[0].to(device), action, noise[0] * 0.01 - 0.7, *noise[1:])

    def heads(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Logarithms of probabilities [rows, actions] and values [rows]."""
        with torch.autocast(observation.device.type, torch.bfloat16) if self.bf16 else contextlib.nullcontext():
            body = self.body(observation.float() / 255 if self.images else observation)
            logits, values = self.actor(body), self.critic(body)
        return F.log_softmax(logits.float(), -1), values.float().squeeze(1)

    def act(self, observation: Tensor, noise: Tensor, belief: Tensor) -> tuple[Tensor, Tensor]:
        """One step: [rows, 3] of action, log-probability and value; and the belief, which is empty."""
        log_probs, values = self.heads(observation)
        action = (log_probs + noise).argmax(1, keepdim=True)
        return torch.cat([action.float(), log_probs.gather(1, action), values.unsqueeze(1)], 1), belief

    def loss(self, batch: Rows) -> Tensor:
        """PPO's loss over a batch."""
        return ppo_loss(*self.heads(batch.observation), batch)
