"""Reference values for learner/tests/reference/numbers.rs: CleanRL's ppo.py and ppo_continuous_action.py in double
precision, without autograd.

    pip install numpy==2.4.6 safetensors==0.8.0
    python3 make_cleanrl.py             # writes cleanrl.safetensors beside this file

Formulas and constants are those of `ppo.py` in vwxyzjn/cleanrl: two networks of tanh layers, the loop over t for
advantages, the clipped losses; Gaussians are those of `ppo_continuous_action.py`, and several choices are a product of
categoricals. Masks are those of MaskableCategorical in sb3-contrib (common/maskable/distributions.py). The case `normalized` is given what Gymnasium's NormalizeObservation and NormalizeReward make of its numbers and
rewards, clipped as in `ppo_continuous_action.py`, and truncated episodes are bootstrapped as in `collect_rollouts` of
Stable-Baselines3. The case `lstm` is `ppo_atari_lstm.py` behind such layers, with its states zeroed where an episode
begins (torch.nn.LSTM's equations; Hochreiter & Schmidhuber 1997); in `privileged` the critic is given numbers that the
actor is not (Pinto et al. 2018). The backward pass is written out by hand. Nothing is shared with the Rust code but the
formula `noise`, from which both sides make weights and inputs, so that the file holds results only.
"""

import pathlib

import numpy as np
from safetensors.numpy import save_file

HERE = pathlib.Path(__file__).parent
STEPS, COLUMNS, INPUTS, WIDTHS = 16, 4, 6, [64, 64]
HIDDEN, PRIVILEGED = 16, 3
GAMMA, LAMBDA, VALUE, ENTROPY = 0.99, 0.95, 0.5, 0.01


def exact(name: str, *shape: int) -> np.ndarray:
    """`noise` of the tests: numbers in [-1, 1)."""
    seed = 0x811C9DC5
    for byte in name.encode():
        seed = (seed ^ byte) * 0x01000193 % 2**32
    x = (np.arange(np.prod(shape), dtype=np.uint64) * 0x9E3779B9 + seed) % 2**32
    x ^= x >> 16
    x = x * 0x85EBCA6B % 2**32
    x ^= x >> 13
    x = x * 0xC2B2AE35 % 2**32
    x ^= x >> 16
    return (x / 2147483648.0 - 1.0).reshape(shape)


def rounded(values: np.ndarray) -> np.ndarray:
    """To what 32 bits hold."""
    return values.astype(np.float32).astype(np.float64)


def noise(name: str, *shape: int) -> np.ndarray:
    """`noise_f32` of the tests."""
    return rounded(exact(name, *shape))


def weight(name: str, *shape: int) -> np.ndarray:
    """`weight_values` of the tests: scaled in double, and only then rounded to what 32 bits hold."""
    return rounded(exact(name, *shape) * (np.sqrt(3.0 / shape[1]) if len(shape) > 1 else 0.1))


class Layers:
    """Linear layers, by their names; behind all but an actor's or critic's last a tangent or a rectifier."""

    def __init__(self, path: str, sizes: list[int], *, relu: bool = False) -> None:
        self.path, self.w, self.relu = path, {}, relu
        # One layer has no number.
        self.names = [f"{path}.{2 * i}" for i in range(len(sizes) - 1)] if len(sizes) > 2 else [path]
        for name, inputs, width in zip(self.names, sizes, sizes[1:], strict=False):
            self.w[f"{name}.weight"] = weight(f"{name}.weight", width, inputs)
            self.w[f"{name}.bias"] = weight(f"{name}.bias", width)

    def is_activated(self, index: int) -> bool:
        return self.path == "mlp" or index + 1 < len(self.names)

    def forward(self, x: np.ndarray) -> np.ndarray:
        self.given = [x]
        for index, name in enumerate(self.names):
            y = self.given[-1] @ self.w[f"{name}.weight"].T + self.w[f"{name}.bias"]
            activated = np.maximum(y, 0.0) if self.relu else np.tanh(y)
            self.given.append(activated if self.is_activated(index) else y)
        return self.given[-1]

    def backward(self, dy: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Gradients of the weights and of the input for `dy`, that of the output."""
        found = {}
        for index, name in reversed(list(enumerate(self.names))):
            if self.is_activated(index):
                y = self.given[index + 1]
                dy = dy * ((y > 0.0) if self.relu else (1.0 - y**2))
            found[f"{name}.weight"] = dy.T @ self.given[index]
            found[f"{name}.bias"] = dy.sum(0)
            dy = dy @ self.w[f"{name}.weight"]
        return found, dy


class Lstm:
    """Gates i, f, g, o; before the first step are given states, zeroed where an episode begins."""

    def __init__(self, inputs: int, starts: np.ndarray) -> None:
        shapes = {"weight_ih_l0": (inputs,), "weight_hh_l0": (HIDDEN,), "bias_ih_l0": (), "bias_hh_l0": ()}
        names = {f"belief.{name}": shape for name, shape in shapes.items()}
        self.starts, self.w = starts, {name: weight(name, 4 * HIDDEN, *shape) for name, shape in names.items()}

    def forward(self, x: np.ndarray) -> np.ndarray:
        self.x, self.cache, outputs = x.reshape(STEPS, COLUMNS, -1), [], []
        h, c = np.split(noise("cleanrl.beliefs", COLUMNS, 2 * HIDDEN), 2, 1)
        for t in range(STEPS):
            carried = 1.0 - self.starts[t][:, None]
            h, c = carried * h, carried * c
            gates = self.x[t] @ self.w["belief.weight_ih_l0"].T + self.w["belief.bias_ih_l0"]
            gates = gates + h @ self.w["belief.weight_hh_l0"].T + self.w["belief.bias_hh_l0"]
            i, f, g, o = np.split(gates, 4, 1)
            i, f, o, g = *(1.0 / (1.0 + np.exp(-gate)) for gate in (i, f, o)), np.tanh(g)
            before, c = (h, c), f * c + i * g
            h = o * np.tanh(c)
            self.cache.append((carried, *before, i, f, g, o, c))
            outputs.append(h)
        self.last = np.concatenate([h, c], 1)
        return np.concatenate(outputs)

    def backward(self, dy: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Through time: gradients of the weights and of the input for `dy`, that of all outputs."""
        dy, found, dx = dy.reshape(STEPS, COLUMNS, HIDDEN), {name: 0.0 for name in self.w}, [None] * STEPS
        dh = dc = np.zeros((COLUMNS, HIDDEN))
        for t in reversed(range(STEPS)):
            carried, h, before, i, f, g, o, c = self.cache[t]
            dh = dh + dy[t]
            dc = dc + dh * o * (1.0 - np.tanh(c) ** 2)
            d_gates = [dc * g * i * (1 - i), dc * before * f * (1 - f), dc * i * (1 - g**2)]
            d_gates = np.concatenate([*d_gates, dh * np.tanh(c) * o * (1 - o)], 1)
            found["belief.weight_ih_l0"] += d_gates.T @ self.x[t]
            found["belief.weight_hh_l0"] += d_gates.T @ h
            for name in ("bias_ih_l0", "bias_hh_l0"):
                found[f"belief.{name}"] += d_gates.sum(0)
            dx[t] = d_gates @ self.w["belief.weight_ih_l0"]
            dh, dc = carried * (d_gates @ self.w["belief.weight_hh_l0"]), carried * dc * f
        return found, np.concatenate(dx)


class Categorical:
    """Independent choices: the logits of their options stand side by side."""

    def __init__(self, counts: list[int], *, masked: bool = False) -> None:
        self.counts, self.outputs = counts, sum(counts)
        cells = 3 * np.arange(STEPS)[:, None] + 5 * np.arange(COLUMNS)
        self.actions = np.stack([(cells + at) % count for at, count in enumerate(counts)], -1)
        # What was chosen was allowed.
        taken = np.concatenate([np.eye(count)[self.actions[..., at]] for at, count in enumerate(counts)], -1) > 0
        drawn = noise("cleanrl.mask", STEPS, COLUMNS, self.outputs) > 0.2 if masked else True
        self.masks = np.split((taken | drawn).reshape(-1, self.outputs), np.cumsum(counts)[:-1], 1)

    def judge(self, logits: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
        """What the policy is given by, log-probabilities of the actions, entropies."""
        self.log_probs, self.new, self.entropies = [], 0.0, 0.0
        rows = np.arange(len(logits))
        parts = np.split(logits, np.cumsum(self.counts)[:-1], 1)
        for part, mask, chosen in zip(parts, self.masks, self.chosen(), strict=True):
            part = np.where(mask, part, -1e8)
            log_probs = part - part.max(1, keepdims=True)
            log_probs = log_probs - np.log(np.exp(log_probs).sum(1, keepdims=True))
            self.new = self.new + log_probs[rows, chosen]
            self.entropies = self.entropies - np.where(mask, np.exp(log_probs) * log_probs, 0.0).sum(1)
            self.log_probs.append(log_probs)
        # Of what is not allowed the test compares no number.
        shown = [np.where(mask, table, 0.0) for mask, table in zip(self.masks, self.log_probs, strict=True)]
        return {"log_probs": np.concatenate(shown, 1)}, self.new, self.entropies

    def chosen(self) -> np.ndarray:
        return self.actions.reshape(-1, len(self.counts)).T

    def backward(self, d_logprob: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Gradients by the actor's outputs and by the policy's own weights."""
        found = []
        for log_probs, mask, chosen, count in zip(self.log_probs, self.masks, self.chosen(), self.counts, strict=True):
            probs = np.exp(log_probs)
            d_logits = d_logprob[:, None] * (np.eye(count)[chosen] - probs)
            # dH/dlogits = -p (log p + H).
            entropies = -(probs * log_probs).sum(1, keepdims=True)
            d_logits = d_logits + ENTROPY * probs * (log_probs + entropies) / len(probs)
            found.append(np.where(mask, d_logits, 0.0))
        return np.concatenate(found, 1), {}


class Gaussian:
    """Independent numbers: the actor gives their means, and deviations are weights of their own."""

    def __init__(self, numbers: int) -> None:
        self.outputs = numbers
        self.actions = 2.0 * noise("cleanrl.drawn", STEPS, COLUMNS, numbers)
        self.log_std = rounded(0.1 * exact("log_std", numbers))

    def judge(self, means: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
        """What the policy is given by, log-probabilities of the actions, entropies."""
        std = np.exp(self.log_std)
        self.away = (self.actions.reshape(means.shape) - means) / std
        log_probs = -(self.away**2) / 2 - self.log_std - np.log(np.sqrt(2 * np.pi))
        entropies = np.broadcast_to(0.5 + 0.5 * np.log(2 * np.pi) + self.log_std, means.shape)
        given = {"means": means, "log_stds": np.broadcast_to(self.log_std, means.shape)}
        return given, log_probs.sum(1), entropies.sum(1)

    def backward(self, d_logprob: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Gradients by the actor's outputs and by the policy's own weights."""
        d_means = d_logprob[:, None] * self.away / np.exp(self.log_std)
        return d_means, {"log_std": (d_logprob[:, None] * (self.away**2 - 1)).sum(0) - ENTROPY}


def normalized(values: np.ndarray, mean: np.ndarray | float, var: np.ndarray | float, clip: float) -> np.ndarray:
    """`normalize` of Gymnasium's wrappers, then the clip of CleanRL's."""
    return np.clip((values - mean) / np.sqrt(var + 1e-8), -clip, clip)


def gae(rewards: np.ndarray, values: np.ndarray, ended: np.ndarray, next_value: np.ndarray) -> np.ndarray:
    """Advantages [STEPS, COLUMNS]."""
    # dones[t] of ppo.py is what ended before the observation of t.
    dones = np.concatenate([np.zeros((1, COLUMNS)), ended[:-1]])
    next_done = ended[-1].astype(float)
    advantages = np.zeros_like(rewards)
    lastgaelam = 0.0
    for t in reversed(range(STEPS)):
        if t == STEPS - 1:
            nextnonterminal, nextvalues = 1.0 - next_done, next_value
        else:
            nextnonterminal, nextvalues = 1.0 - dones[t + 1], values[t + 1]
        delta = rewards[t] + GAMMA * nextvalues * nextnonterminal - values[t]
        advantages[t] = lastgaelam = delta + GAMMA * LAMBDA * nextnonterminal * lastgaelam
    return advantages


def case(
    name: str,
    policy: Categorical | Gaussian,
    clip: float,
    *,
    norm_adv: bool = True,
    clip_vloss: bool = True,
    norm: bool = False,
    recurrent: bool = False,
    privileged: int = 0,
    relu: bool = False,
) -> dict[str, np.ndarray]:
    """One minibatch of everything."""
    obs = 2.0 * noise("cleanrl.numbers", STEPS, COLUMNS, INPUTS + privileged)
    # 32-bit arithmetic makes these on both sides.
    half = np.float32(0.25)
    logprobs = (noise("cleanrl.log_prob", STEPS, COLUMNS).astype(np.float32) * half - np.float32(1.25)).astype(float)
    values = noise("cleanrl.value", STEPS, COLUMNS)
    rewards = noise("cleanrl.reward", STEPS, COLUMNS)
    ended = noise("cleanrl.ended", STEPS, COLUMNS) > 0.7
    next_value = noise("cleanrl.bootstrap", COLUMNS)
    if norm:
        mean, var = noise("cleanrl.mean", INPUTS), 1.25 + noise("cleanrl.var", INPUTS)
        obs = normalized(obs, mean, rounded(var), 1.5)
        # Of 500 returns: their squares of deviations are in the checkpoint.
        rewards = normalized(rewards, 0.0, 8.0 / 500.0, 5.0)
        truncated = ended & (noise("cleanrl.limit", STEPS, COLUMNS) > 0.0)
        rewards = rewards + truncated * GAMMA * noise("cleanrl.last_value", STEPS, COLUMNS)

    advantages = gae(rewards, values, ended, next_value)
    returns = advantages + values

    rows = STEPS * COLUMNS
    x = obs.reshape(rows, -1)
    shared, of_memory = [], {}
    if recurrent:
        starts = np.concatenate([np.ones((1, COLUMNS)), ended[:-1]])
        # The first column goes on from the states that it is given.
        starts[0, 0] = 0.0
        shared = [Layers("mlp", [INPUTS, *WIDTHS]), Lstm(WIDTHS[-1], starts)]
        for part in shared:
            x = part.forward(x)
        of_memory = {"beliefs": x.reshape(STEPS, COLUMNS, HIDDEN), "next_beliefs": shared[-1].last}
    sizes = [x.shape[1]] if recurrent else [INPUTS, *WIDTHS]
    actor = Layers("actor", [*sizes, policy.outputs], relu=relu)
    critic = Layers("critic", [sizes[0] + privileged, *sizes[1:], 1], relu=relu)
    given, newlogprob, entropies = policy.judge(actor.forward(x[:, : sizes[0]]))
    logratio = newlogprob - logprobs.reshape(rows)
    ratio = np.exp(logratio)
    approx_kl = ((ratio - 1) - logratio).mean()
    clipfrac = (np.abs(ratio - 1.0) > clip).mean()

    mb_advantages = advantages.reshape(rows)
    if norm_adv:
        # ppo.py adds 1e-8; the reference of this project 1e-5 (docs/method.md).
        mb_advantages = (mb_advantages - mb_advantages.mean()) / (mb_advantages.std(ddof=1) + 1e-5)
    pg_loss1 = -mb_advantages * ratio
    pg_loss2 = -mb_advantages * np.clip(ratio, 1 - clip, 1 + clip)
    pg_loss = np.maximum(pg_loss1, pg_loss2).mean()

    newvalue, old, target = critic.forward(x)[:, 0], values.reshape(rows), returns.reshape(rows)
    v_loss_unclipped = (newvalue - target) ** 2
    v_clipped = old + np.clip(newvalue - old, -clip, clip)
    v_loss_clipped = (v_clipped - target) ** 2
    v_loss = 0.5 * (np.maximum(v_loss_unclipped, v_loss_clipped) if clip_vloss else v_loss_unclipped).mean()
    entropy_loss = entropies.mean()
    loss = pg_loss - ENTROPY * entropy_loss + VALUE * v_loss

    # Of the policy's loss by log-probabilities: where the clipped term is the greater one, it is constant.
    inside = (ratio >= 1 - clip) & (ratio <= 1 + clip)
    d_ratio = np.where((pg_loss1 > pg_loss2) | inside, -mb_advantages, 0.0) / rows
    d_logprob = d_ratio * ratio
    d_outputs, own = policy.backward(d_logprob)
    within = np.abs(newvalue - old) <= clip
    d_unclipped, d_clipped = 2 * (newvalue - target), 2 * (v_clipped - target) * within
    d_value = np.where(v_loss_unclipped > v_loss_clipped, d_unclipped, d_clipped)
    # Where nothing is clipped both are the same.
    d_value = np.where(within | (not clip_vloss), d_unclipped, d_value)
    d_value = 0.5 * VALUE * d_value / rows
    (of_actor, d_actor), (of_critic, d_critic) = actor.backward(d_outputs), critic.backward(d_value[:, None])
    gradients, dx = of_actor | of_critic | own, d_actor + d_critic[:, : sizes[0]]
    for part in reversed(shared):
        of_part, dx = part.backward(dx)
        gradients |= of_part

    found = {
        **{key: table.reshape(STEPS, COLUMNS, -1) for key, table in given.items()},
        **of_memory,
        "values": newvalue.reshape(STEPS, COLUMNS),
        "advantages": mb_advantages.reshape(STEPS, COLUMNS),
        "returns": returns,
        "loss/policy": np.array(pg_loss),
        "loss/value": np.array(v_loss),
        "policy/entropy": np.array(entropy_loss),
        "loss/total": np.array(loss),
        "policy/approximate_kl": np.array(approx_kl),
        "policy/clip_fraction": np.array(clipfrac),
        "optimizer/gradient_norm": np.array(np.sqrt(sum((g**2).sum() for g in gradients.values()))),
        **{f"gradient.{weight}": gradient for weight, gradient in gradients.items()},
    }
    return {f"{name}.{key}": np.ascontiguousarray(value, dtype=np.float32) for key, value in found.items()}


if __name__ == "__main__":
    save_file(
        case("defaults", Categorical([3]), 0.2)
        | case("plain", Categorical([3]), 0.2, norm_adv=False, clip_vloss=False)
        | case("narrow", Categorical([3]), 0.05, norm_adv=False)
        | case("choices", Categorical([3, 2]), 0.2)
        | case("masked", Categorical([3], masked=True), 0.2)
        | case("masked_choices", Categorical([3, 2], masked=True), 0.2)
        | case("numbers", Gaussian(2), 0.2)
        | case("normalized", Categorical([3]), 0.2, norm=True)
        | case("lstm", Categorical([3]), 0.2, recurrent=True)
        | case("privileged", Categorical([3]), 0.2, privileged=PRIVILEGED)
        | case("relu", Categorical([3]), 0.2, relu=True),
        HERE / "cleanrl.safetensors",
    )
