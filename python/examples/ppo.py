"""Recurrent PPO in one file, over a `stillroom.VectorEnv` and the learner's own network.

    python python/examples/ppo.py --steps 4096

In the style of CleanRL: read it from top to bottom. A policy that does the task needs tens of millions of frames; this
shows the loop.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch
from torch.nn import functional as F

import stillroom
from stillroom.network import Network

ENVIRONMENTS, LENGTH, EPOCHS = 8, 64, 2
GAMMA, LAMBDA, CLIP, ENTROPY, VALUE, LEARNING_RATE = 0.99, 0.95, 0.1, 0.01, 0.5, 3e-4


# Rollout, advantages and update are read from top to bottom, as in CleanRL.
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=4096)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    torch.manual_seed(arguments.seed)
    # In the step after an episode's last one the environment resets and the action is ignored; `valid` leaves it out.
    env = stillroom.VectorEnv(ENVIRONMENTS, kitchens=[1, 3], preset="demo")
    network = Network(encoder="cnn", input_pool=4, hidden=128)
    optimizer = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)

    observations, _ = env.reset(seed=arguments.seed)
    start = torch.ones(ENVIRONMENTS, dtype=torch.bool)
    belief = network.begin(ENVIRONMENTS)
    returns, running, begun = [], np.zeros(ENVIRONMENTS), time.perf_counter()
    for update in range(max(arguments.steps // (ENVIRONMENTS * LENGTH), 1)):
        # Rollout ---------------------------------------------------------------------------------------------------
        first_belief = belief
        seen, starts, actions, log_probs, values, rewards, dones, valid = [], [], [], [], [], [], [], []
        for _ in range(LENGTH):
            with torch.no_grad():
                # Observations are views that the next step overwrites: what the update needs is pooled, hence copied.
                kept = (
                    network.pool(torch.from_numpy(observations["depth"])),
                    network.coordinates(torch.from_numpy(observations["goal"])),
                    (torch.from_numpy(observations["previous_action"]) + 1) % (network.actions + 1),
                )
                log_prob, value, belief = judge(network, network.embed(*kept), belief, start)
                action = torch.distributions.Categorical(logits=log_prob).sample()
            observations, reward, terminated, truncated, infos = env.step(action.numpy())
            seen.append(kept), starts.append(start), actions.append(action), values.append(value)
            log_probs.append(log_prob.gather(1, action[:, None])[:, 0])
            rewards.append(torch.from_numpy(reward).float())
            done = torch.from_numpy(terminated | truncated)
            dones.append(done)
            # An episode starts with the observation of a step that was a reset.
            start = torch.from_numpy(infos["step"] == 0)
            valid.append(~start)
            running += reward
            returns += list(running[done.numpy()])
            running[done.numpy()] = 0.0
        # Advantages ------------------------------------------------------------------------------------------------
        with torch.no_grad():
            kept = (
                network.pool(torch.from_numpy(observations["depth"])),
                network.coordinates(torch.from_numpy(observations["goal"])),
                (torch.from_numpy(observations["previous_action"]) + 1) % (network.actions + 1),
            )
            _, bootstrap, _ = judge(network, network.embed(*kept), belief, start)
        advantages, carry, after = [], torch.zeros(ENVIRONMENTS), bootstrap
        for t in reversed(range(LENGTH)):
            goes_on = (~dones[t]).float()
            delta = rewards[t] + GAMMA * after * goes_on - values[t]
            carry = delta + GAMMA * LAMBDA * goes_on * carry
            advantages.insert(0, carry)
            after = values[t]
        advantage, value_before = torch.stack(advantages), torch.stack(values)
        target = advantage + value_before
        weight = torch.stack(valid).float()
        # Update: through time from the rollout's first belief ---------------------------------------------------------
        for _ in range(EPOCHS):
            # The encoder sees all steps at once, only the belief goes from step to step.
            embedded = network.embed(*(torch.cat(part) for part in zip(*seen, strict=True)))
            belief_now, outputs = first_belief, []
            for t, rows in enumerate(embedded.split(ENVIRONMENTS)):
                log_prob, value, belief_now = judge(network, rows, belief_now, starts[t])
                outputs.append((log_prob, value))
            log_prob, value = (torch.stack(part) for part in zip(*outputs, strict=True))
            chosen = log_prob.gather(2, torch.stack(actions)[:, :, None])[:, :, 0]
            ratio = (chosen - torch.stack(log_probs)).exp()
            gain = torch.minimum(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage)
            entropy = -(log_prob.exp() * log_prob).sum(2)
            losses = -gain + VALUE * F.mse_loss(value, target, reduction="none") - ENTROPY * entropy
            loss = (losses * weight).sum() / weight.sum()
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 0.5)
            optimizer.step()
        frames = (update + 1) * ENVIRONMENTS * LENGTH
        mean = np.mean(returns[-20:]) if returns else float("nan")
        speed = frames / (time.perf_counter() - begun)
        print(f"{frames:7} frames  loss {loss.item():8.4f}  return of the last 20 episodes {mean:6.2f}  {speed:5.0f}/s")


def judge(
    network: Network, embedded: torch.Tensor, belief: torch.Tensor, start: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Log-probabilities, values and beliefs; the belief is zeroed where an episode starts."""
    belief = torch.where(start[:, None], torch.zeros_like(belief), belief)
    seen, belief = network.remember(embedded, belief)
    return F.log_softmax(network.actor(seen), -1), network.critic(seen)[:, 0], belief


if __name__ == "__main__":
    main()
