"""Reference values for learner/tests/reference/numbers.rs: an update of several minibatches, as CleanRL makes it.

    pip install torch==2.11.0 numpy==2.4.6 safetensors==0.8.0
    python3 make_update.py              # writes update.safetensors beside this file

The loop is that of `ppo.py` and `ppo_continuous_action.py` in vwxyzjn/cleanrl, in double precision, with PyTorch's own
distributions, gradients, clipping and Adam: acting, epochs of minibatches. Frames are dealt out as
docs/method.md has it, by Philox4x32-10 (Salmon et al. 2011). Nothing is shared with the Rust code but `noise`.
"""

import torch
from make_cleanrl import COLUMNS, ENTROPY, HERE, INPUTS, STEPS, VALUE, WIDTHS, gae, noise, weight
from safetensors.torch import save_file
from torch import nn
from torch.distributions import Categorical, Independent, Normal

EPOCHS, MINIBATCHES, CLIP, RATE, NORM, SEED = 3, 4, 0.2, 2.5e-3, 1.0, 7
# The purpose "minibatch" of random numbers.
MINIBATCH = 12
torch.set_num_threads(1)
torch.set_default_dtype(torch.float64)


def philox(counter: list[int], key: list[int]) -> int:
    """The first word of a block."""
    for _ in range(10):
        p0, p1 = counter[0] * 0xD2511F53, counter[2] * 0xCD9E8D57
        low = 2**32 - 1
        counter = [p1 >> 32 ^ counter[1] ^ key[0], p1 & low, p0 >> 32 ^ counter[3] ^ key[1], p0 & low]
        key = [key[0] + 0x9E3779B9 & low, key[1] + 0xBB67AE85 & low]
    return counter[0]


assert philox([0] * 4, [0] * 2) == 0x6627E8D5


def dealt(epoch: int) -> list[list[int]]:
    """The minibatches of an epoch, as indices of the flat batch: each has every fourth frame in the order of draws."""
    cells = [(t, n) for t in range(STEPS) for n in range(COLUMNS)]
    draw = lambda t, n: philox([MINIBATCH << 24 | epoch << 16, n, 0, t], [SEED, 0])
    cells.sort(key=lambda cell: draw(*cell))
    return [[t * COLUMNS + n for t, n in cells[first::MINIBATCHES]] for first in range(MINIBATCHES)]


def tensor(name: str, *shape: int) -> torch.Tensor:
    return torch.tensor(noise(f"cleanrl.{name}", *shape))


class Agent(nn.Module):
    def __init__(self, outputs: int, *, gaussian: bool) -> None:
        super().__init__()
        layers = lambda last: nn.Sequential(
            nn.Linear(INPUTS, WIDTHS[0]),
            nn.Tanh(),
            nn.Linear(WIDTHS[0], WIDTHS[1]),
            nn.Tanh(),
            nn.Linear(WIDTHS[1], last),
        )
        self.actor, self.critic = layers(outputs), layers(1)
        self.log_std = nn.Parameter(torch.zeros(outputs)) if gaussian else None
        for name, parameter in self.named_parameters():
            parameter.data = torch.tensor(weight(name, *parameter.shape))

    def policy(self, x: torch.Tensor) -> Categorical | Independent:
        y = self.actor(x)
        return Categorical(logits=y) if self.log_std is None else Independent(Normal(y, self.log_std.exp()), 1)

    def choose(self, x: torch.Tensor, draws: torch.Tensor) -> torch.Tensor:
        """By noise: Gumbel's trick for options, a multiple of the deviation for numbers."""
        policy = self.policy(x)
        if self.log_std is None:
            return (policy.logits + draws).argmax(-1)
        return policy.mean + policy.stddev * draws


def update(outputs: int, *, gaussian: bool, by_minibatch: bool) -> dict[str, torch.Tensor]:
    """A rollout, and an update with it."""
    agent = Agent(outputs, gaussian=gaussian)
    optimizer = torch.optim.Adam(agent.parameters(), lr=RATE, eps=1e-5)
    obs, next_obs = 2.0 * tensor("numbers", STEPS, COLUMNS, INPUTS), 2.0 * tensor("after", COLUMNS, INPUTS)
    rewards = tensor("reward", STEPS, COLUMNS)
    ended = (tensor("ended", STEPS, COLUMNS) > 0.7).double()
    with torch.no_grad():
        actions = agent.choose(obs, 2.0 * tensor("draws", STEPS, COLUMNS, outputs))
        logprobs, values = agent.policy(obs).log_prob(actions), agent.critic(obs)[..., 0]
        known = (rewards, values, ended, agent.critic(next_obs)[:, 0])
        advantages = torch.tensor(gae(*(one.numpy() for one in known)))
        returns = advantages + values

    b_obs, b_actions = obs.flatten(0, 1), actions.flatten(0, 1)
    b_logprobs, b_advantages, b_returns, b_values = (x.flatten() for x in (logprobs, advantages, returns, values))
    if not by_minibatch:
        b_advantages = (b_advantages - b_advantages.mean()) / (b_advantages.std() + 1e-5)
    figures = []
    for epoch in range(EPOCHS):
        for mb_inds in dealt(epoch):
            policy, newvalue = agent.policy(b_obs[mb_inds]), agent.critic(b_obs[mb_inds]).view(-1)
            logratio = policy.log_prob(b_actions[mb_inds]) - b_logprobs[mb_inds]
            ratio = logratio.exp()
            mb_advantages = b_advantages[mb_inds]
            if by_minibatch:
                mb_advantages = (mb_advantages - mb_advantages.mean()) / (mb_advantages.std() + 1e-8)
            pg_loss1 = -mb_advantages * ratio
            pg_loss2 = -mb_advantages * torch.clamp(ratio, 1 - CLIP, 1 + CLIP)
            pg_loss = torch.max(pg_loss1, pg_loss2).mean()
            v_loss_unclipped = (newvalue - b_returns[mb_inds]) ** 2
            v_clipped = b_values[mb_inds] + torch.clamp(newvalue - b_values[mb_inds], -CLIP, CLIP)
            v_loss_clipped = (v_clipped - b_returns[mb_inds]) ** 2
            v_loss = 0.5 * torch.max(v_loss_unclipped, v_loss_clipped).mean()
            entropy_loss = policy.entropy().mean()
            loss = pg_loss - ENTROPY * entropy_loss + v_loss * VALUE
            optimizer.zero_grad()
            loss.backward()
            norm = nn.utils.clip_grad_norm_(agent.parameters(), NORM)
            optimizer.step()
            approx_kl = ((ratio - 1) - logratio).mean()
            clipfrac = ((ratio - 1.0).abs() > CLIP).double().mean()
            figures.append(torch.stack([pg_loss, v_loss, entropy_loss, clipfrac, approx_kl, norm]).detach())
    figures = torch.stack(figures)
    # Ratios and gradients were clipped, and not all of them.
    assert figures[-1, 3] > figures[0, 3] == 0.0 and figures[:, 5].max() > NORM > figures[:, 5].min(), figures
    found = {"actions": actions, "figures": figures.mean(0)}
    found |= {f"weight.{name}": parameter.detach() for name, parameter in agent.named_parameters()}
    return {name: value.float().contiguous() for name, value in found.items()}


if __name__ == "__main__":
    found = {
        f"{name}.{over}.{key}": value
        for name, outputs in (("discrete", 3), ("box", 2))
        for over in ("rollout", "minibatch")
        for key, value in update(outputs, gaussian=name == "box", by_minibatch=over == "minibatch").items()
    }
    save_file(found, HERE / "update.safetensors")
