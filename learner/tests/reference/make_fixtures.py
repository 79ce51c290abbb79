"""Reference values for learner/tests/reference/: the same method, written a second time in plain PyTorch.

    pip install torch==2.11.0 numpy==2.4.6 safetensors==0.8.0
    python3 make_fixtures.py            # writes *.safetensors beside this file
    python3 make_fixtures.py DIR        # and into DIR what `learner probe` takes, and must find (docs/probe.md)

Nothing here is shared with the Rust code but the formula `noise`, from which both sides make weights and inputs, so
that the files hold results only. Beliefs are stepped one at a time, advantages are explicit sums, the optimiser and
the gradient clipping are PyTorch's own.
"""

import math
import pathlib
import sys

import numpy as np
import torch
from allenact_names import import_fixture
from plain_network import Network, depth_mm, goal_m, noise, probes, tensor
from safetensors.torch import save_file
from torch import nn
from torch.nn import functional as F

HERE = pathlib.Path(__file__).parent


def network_fixture(name: str, **settings) -> None:
    """Three steps of three columns, with an episode's start at step 0, one at 1 and one at 2."""
    network = Network(**settings)
    hidden, actions = settings["hidden"], settings["actions"]
    belief = tensor("belief", 3, hidden)
    starts = [[False, False, True], [False, True, False], [True, False, False]]
    loss, log_probs, values = 0.0, [], []
    for t in range(3):
        previous = torch.tensor([(5 * t + 3 * n) % (actions + 1) for n in range(3)])
        log_prob, value, belief = network.step(
            torch.stack([depth_mm(t, n) for n in range(3)]),
            torch.stack([goal_m(t, n) for n in range(3)]),
            previous,
            torch.tensor(starts[t]),
            belief,
        )
        risk = network.auxiliary["disturb"](belief)
        loss = loss + (log_prob * tensor(f"pull.policy.{t}", 3, actions)).sum()
        loss = loss + (value * tensor(f"pull.value.{t}", 3)).sum()
        loss = loss + (risk * tensor(f"pull.disturb.{t}", 3, actions)).sum()
        log_probs.append(log_prob.detach())
        values.append(value.detach())
    network.zero_grad()
    loss.backward()
    gradients = [(name, weight.grad) for name, weight in network.named_parameters()]
    save_file(
        {
            "log_probs": torch.stack(log_probs),
            "values": torch.stack(values),
            "beliefs": belief.detach(),
            "gradients": probes(sorted(gradients)),
        },
        HERE / f"network_{name}.safetensors",
    )


# The algorithm ------------------------------------------------------------------------------------------------------


def advantages(rewards, values, after, ended, truncated, gamma, lam):
    """A_t as the explicit sum of (γλ)^k δ_{t+k} up to the episode's end; all [T], `after` the value after the last."""
    steps = len(rewards)
    following = values[1:] + [after]
    deltas = []
    for t in range(steps):
        nxt = following[t]
        if ended[t]:
            nxt = values[t] if truncated[t] else 0.0
        deltas.append(rewards[t] + gamma * nxt - values[t])
    result = []
    for t in range(steps):
        total, k = 0.0, t
        while True:
            total += (gamma * lam) ** (k - t) * deltas[k]
            if ended[k] or k == steps - 1:
                break
            k += 1
        result.append(total)
    return result


def gae_fixture() -> None:
    """12 steps of 5 columns, the last two of which have 11."""
    steps, columns, held = 12, 5, 2
    rewards = noise("gae.reward", steps * columns).reshape(steps, columns)
    values = 2.0 * noise("gae.value", steps * columns).reshape(steps, columns)
    after = noise("gae.after", columns)
    ended = noise("gae.ended", steps * columns).reshape(steps, columns) > 0.6
    limit = ended & (noise("gae.limit", steps * columns).reshape(steps, columns) > 0.0)
    assert limit.any() and (ended & ~limit).any()
    f32 = lambda array: array.astype(np.float32).astype(np.float64)
    rewards, values, after = f32(rewards), f32(values), f32(after)
    out = {}
    for name, bootstrap in [("terminal", False), ("truncated", True)]:
        table = np.zeros((steps, columns))
        for n in range(columns):
            length = steps - (n >= columns - held)
            table[:length, n] = advantages(
                list(rewards[:length, n]),
                list(values[:length, n]),
                values[steps - 1, n] if length < steps else after[n],
                list(ended[:length, n]),
                list(limit[:length, n] & bootstrap),
                0.99,
                0.95,
            )
        valid = np.ones((steps, columns), dtype=bool)
        valid[steps - 1, columns - held :] = False
        normal = torch.tensor(table[valid])
        normal = (normal - normal.mean()) / (normal.std() + 1e-5)
        normalized = np.zeros((steps, columns))
        normalized[valid] = normal.numpy()
        out[f"{name}.advantages"] = torch.tensor(table)
        out[f"{name}.normalized"] = torch.tensor(normalized)
        out[f"{name}.returns"] = torch.tensor(np.where(valid, table + values, 0.0))
    save_file(out, HERE / "gae.safetensors")


def ppo_terms(log_probs, values, actions, old_log_probs, old_values, advantage, returns, clip):
    new = torch.distributions.Categorical(logits=log_probs)
    ratio = torch.exp(new.log_prob(actions) - old_log_probs)
    policy = -torch.min(ratio * advantage, torch.clamp(ratio, 1 - clip, 1 + clip) * advantage).mean()
    clipped = old_values + torch.clamp(values - old_values, -clip, clip)
    value = 0.5 * torch.max((values - returns) ** 2, (clipped - returns) ** 2).mean()
    kl = (ratio - 1 - ratio.log()).mean()
    return policy, value, new.entropy().mean(), ((ratio - 1).abs() > clip).float().mean(), kl


def goal_fixture() -> None:
    """Goal sensors in all eight octants and on every axis, in double precision."""
    signs = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=np.float64)
    sizes = np.abs(noise("goal.sizes", 4 * 27 * 3).reshape(4, 27, 3)) * 3.0 + 0.01
    goals = (signs * sizes).reshape(-1, 3).astype(np.float32)
    x, y, z = goals.astype(np.float64).T
    rho = np.linalg.norm(goals.astype(np.float64), axis=1)
    # The reference's names for AI2-THOR's axes: azimuth in the (right, up) plane, elevation towards ahead.
    elevation = np.where(rho > 0, np.arcsin(np.clip(z / np.where(rho > 0, rho, 1.0), -1, 1)), 0.0)
    azimuth = np.angle(x + 1j * y)
    polar = np.stack([rho, elevation / (np.pi / 2), azimuth / np.pi], 1)
    out = {"goals": goals, "polar": polar, "cartesian": np.abs(goals)}
    save_file({name: torch.tensor(value) for name, value in out.items()}, HERE / "goal.safetensors")


def lagrangian_fixture() -> None:
    """The multiplier over 12 rollouts of 8 steps and 3 columns; episodes go on over rollouts, and in one none ends."""
    rollouts, steps, columns, gamma, rate = 12, 8, 3, 0.99, 2.0
    shape = (rollouts, steps, columns)
    progress = (noise("lagrangian.progress", math.prod(shape)) * 0.02).astype(np.float32).astype(np.float64)
    progress = progress.reshape(shape)
    ended = noise("lagrangian.ended", math.prod(shape)).reshape(shape) > 0.75
    ended[3] = False
    multiplier, trace = 0.01, []
    increments = [[] for _ in range(columns)]
    for rollout in range(rollouts):
        costs = []
        for t in range(steps):
            for n in range(columns):
                increments[n].append(-progress[rollout, t, n])
                if ended[rollout, t, n]:
                    costs.append(np.array(increments[n]) @ gamma ** np.arange(len(increments[n])))
                    increments[n] = []
        if costs:
            multiplier = max(0.0, multiplier + rate * np.mean(costs))
        trace.append(multiplier)
    assert 0.0 in trace and trace[2] == trace[3] and len(set(trace)) > 8
    save_file({"trace": torch.tensor(trace, dtype=torch.float64)}, HERE / "lagrangian.safetensors")


# Two rollouts and their updates are read from top to bottom, in the order in which they run.
def run_fixture() -> None:
    """The whole algorithm: two rollouts of four columns, acting, then two epochs on each, compared as a whole."""
    columns, steps, actions, epochs, clip = 4, 6, 13, 2, 0.1
    # A_large indices of A_small, in its order.
    small = list(range(8)) + [16, 17, 18, 19, 20]
    network = Network(encoder="cnn", pool=4, polar=True, previous_action=True, hidden=32, actions=actions)
    with torch.no_grad():
        network.actor.weight *= 0.2
    optimizer = torch.optim.Adam(network.parameters())
    belief = torch.zeros(columns, 32)
    previous = [0] * columns
    out = {}
    for rollout, (progress, last) in enumerate([(0.0, 3), (0.5, 4)]):
        at_start, rows, chosen, old_log_probs, old_values = belief, [], [], [], []
        ended, reward, limit, disturbed = [], [], [], []
        for t in range(steps):
            now = rollout * steps + t
            # An episode starts at the beginning of the run and after each end.
            start = torch.tensor([p == 0 for p in previous])
            row = (
                torch.stack([depth_mm(now, n) for n in range(columns)]),
                torch.stack([goal_m(now, n) for n in range(columns)]),
                torch.tensor(previous),
                start,
            )
            with torch.no_grad():
                log_probs, values, after = network.step(*row, belief)
            uniform = (noise(f"gumbel.{now}", columns * actions).reshape(columns, actions) + 1.0) / 2.0
            gumbel = torch.tensor(-np.log(-np.log(np.clip(uniform, 1e-6, 1 - 1e-6))), dtype=torch.float32)
            action = (log_probs + gumbel).argmax(-1)
            acts = torch.tensor([t < steps - 1 or n < last for n in range(columns)])
            belief = torch.where(acts[:, None], after, belief)
            rows.append(row)
            chosen.append(action)
            old_log_probs.append(log_probs[torch.arange(columns), action])
            old_values.append(values)
            ended.append([bool(e) for e in noise(f"ended.{now}", columns) > 0.5])
            limit.append([e and bool(l) for e, l in zip(ended[-1], noise(f"limit.{now}", columns) > 0.0)])
            reward.append(list(tensor(f"reward.{now}", columns).double().numpy() * 3.0))
            disturbed.append([float(d) for d in noise(f"disturbed.{now}", columns) > 0.4])
            previous = [
                (0 if ended[-1][n] else int(action[n]) + 1) if acts[n] else previous[n] for n in range(columns)
            ]
        now = (rollout + 1) * steps
        # What is seen after the last action; a column that held sees the same again.
        final = torch.stack([depth_mm(now, n) if n < last else depth_mm(now - 1, n) for n in range(columns)])
        final_goal = torch.stack([goal_m(now, n) if n < last else goal_m(now - 1, n) for n in range(columns)])
        with torch.no_grad():
            _, after_values, _ = network.step(
                final, final_goal, torch.tensor(previous), torch.tensor([p == 0 for p in previous]), belief
            )

        keep = torch.tensor([[t < steps - 1 or n < last for n in range(columns)] for t in range(steps)])
        advantage = torch.zeros(steps, columns)
        for n in range(columns):
            length = int(keep[:, n].sum())
            result = advantages(
                [reward[t][n] for t in range(length)],
                [float(old_values[t][n]) for t in range(length)],
                float(after_values[n]),
                [ended[t][n] for t in range(length)],
                [False] * length,
                0.99,
                0.95,
            )
            advantage[:length, n] = torch.tensor(result)
        old_value = torch.stack(old_values)
        returns = advantage + old_value
        # A row is asked about disturbance when its successor is a frame of the rollout and of the same episode.
        asked = keep.clone()
        asked[-1] = False
        for t in range(steps - 1):
            for n in range(columns):
                asked[t, n] &= bool(keep[t + 1, n]) and not bool(rows[t + 1][3][n])
        for group in optimizer.param_groups:
            group["lr"] = 1e-3 * (1 - progress * 2 / 3)

        figures = []
        for _ in range(epochs):
            b, log_probs, values, risks = at_start, [], [], []
            for t in range(steps):
                log_prob, value, b = network.step(*rows[t], b)
                log_probs.append(log_prob)
                values.append(value)
                risks.append(network.auxiliary["disturb"](b)[torch.arange(columns), chosen[t]])
            policy, value, entropy, fraction, kl = ppo_terms(
                torch.stack(log_probs)[keep],
                torch.stack(values)[keep],
                torch.stack(chosen)[keep],
                torch.stack(old_log_probs)[keep],
                old_value[keep],
                advantage[keep],
                returns[keep],
                clip,
            )
            p = torch.sigmoid(torch.stack(risks)[asked])
            label = torch.tensor(disturbed)[asked] > 0.5
            p_true = torch.where(label, p, 1 - p)
            focal = (-((1 - p_true) ** 2) * p_true.log()).mean()
            optimizer.zero_grad()
            (policy + 0.5 * value - 0.01 * entropy + 0.1 * focal).backward()
            norm = nn.utils.clip_grad_norm_(network.parameters(), 0.5)
            optimizer.step()
            figures.append(torch.stack([policy, value, entropy, focal, fraction, kl, norm]).detach())
        out[f"{rollout}.actions"] = torch.tensor([[small[a] for a in row] for row in torch.stack(chosen).tolist()])
        out[f"{rollout}.log_probs"] = torch.stack(old_log_probs)
        out[f"{rollout}.values"] = old_value
        out[f"{rollout}.figures"] = torch.stack(figures).mean(0)
        out[f"{rollout}.weights"] = probes(sorted((name, w) for name, w in network.named_parameters()))
    save_file(out, HERE / "run.safetensors")


# The other auxiliary tasks -------------------------------------------------------------------------------------------


def contrast(cpca, embeddings, beliefs, action, questions, elsewhere) -> torch.Tensor:
    """CPC|A's loss over questions (t, n, offset): tensors [T, N, ...]; `elsewhere` maps a cell to the one shown for it."""
    verdicts = []
    for t, n, offset in questions:
        taken = cpca.action_embedder(action[t : t + offset, n])
        _, context = cpca.context_model(taken[:, None], beliefs[t, n][None, None])
        for (seen_t, seen_n), label in [((t + offset, n), 1.0), (elsewhere[t + offset, n], 0.0)]:
            logit = cpca.classifier(torch.cat([embeddings[seen_t, seen_n], context[0, 0]]))
            verdicts.append(F.binary_cross_entropy_with_logits(logit, torch.full_like(logit, label)))
    # Two verdicts a question, summed.
    return 2.0 * torch.stack(verdicts).mean()


def guess(decoder, embeddings, beliefs, action, questions, last) -> torch.Tensor:
    """Inverse dynamics' loss over questions (t, n, 1); `last` maps a cell to the last step of its episode's part."""
    guesses = []
    for t, n, _ in questions:
        known = torch.cat([embeddings[t, n], embeddings[t + 1, n], beliefs[last[t, n], n]])
        guesses.append(F.cross_entropy(decoder(known)[None], action[t, n][None]))
    return torch.stack(guesses).mean()


# A batch from a file ---------------------------------------------------------------------------------------------------

PROBES = {
    "disturb": dict(encoder="cnn", pool=4, polar=True, previous_action=True, hidden=32, actions=13),
    "cpca16": dict(encoder="cnn", pool=4, polar=False, previous_action=False, hidden=24, actions=21),
    "inverse_dynamics": dict(encoder="resnet", pool=2, polar=True, previous_action=True, hidden=48, actions=21),
}


def probe_batch(task: str, actions: int, hidden: int) -> dict[str, torch.Tensor]:
    """`learner probe`'s input: 7 steps of 4 columns, the last two of which have 6."""
    steps, columns = 7, 4
    cells = [(t, n) for t in range(steps) for n in range(columns)]
    table = lambda name, scale=1.0: tensor(f"probe.{name}", steps, columns) * scale
    ended = table("ended") > 0.6
    # An episode starts after an end, and in one column at the very first step.
    start = torch.cat([torch.tensor([[False, True, False, False]]), ended[:-1]])
    action = torch.tensor([(3 * t + 5 * n + t * n) % actions for t, n in cells]).reshape(steps, columns)
    previous = torch.where(start, 0, torch.tensor([1 + (7 * t + n) % actions for t, n in cells]).reshape(steps, columns))
    recorded = torch.ones(steps, columns, dtype=torch.bool)
    recorded[-1, 2:] = False
    batch = {
        "frames": torch.stack([depth_mm(t, n) for t, n in cells]).to(torch.int16).reshape(steps, columns, 224, 224),
        "goal_m": torch.stack([goal_m(t, n) for t, n in cells]).reshape(steps, columns, 3),
        "previous_action": previous,
        "episode_start": start,
        "action": action,
        "log_prob": -math.log(actions) + table("log_prob", 0.5),
        "value": table("value"),
        "reward": table("reward", 3.0),
        "ended": ended,
        "time_limit": ended & (table("limit") > 0.0),
        "disturbed": table("disturbed") > 0.3,
        "bootstrap": tensor("probe.bootstrap", columns),
        "beliefs": tensor("probe.beliefs", columns, hidden),
        "recorded": recorded,
    }
    if task == "cpca16":
        valid = int(recorded.sum())
        batch["negatives"] = torch.tensor([(11 * cell + 5) % valid for cell in range(len(cells))]).reshape(steps, columns)
    return batch


def probe_expected(task: str, network: Network, batch: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Losses and gradients, in double precision; advantages normalised for `disturb` only."""
    network = network.double()
    batch = {name: value.double() if value.is_floating_point() else value for name, value in batch.items()}
    steps, columns = batch["action"].shape
    keep, start, action = batch["recorded"], batch["episode_start"], batch["action"]
    belief, embeddings, beliefs, log_probs, values = batch["beliefs"], [], [], [], []
    for t in range(steps):
        embedded = network.embed(batch["frames"][t], batch["goal_m"][t], batch["previous_action"][t])
        log_prob, value, belief = network.judge(embedded, start[t], belief)
        for into, what in [(embeddings, embedded[:, :544]), (beliefs, belief), (log_probs, log_prob), (values, value)]:
            into.append(what)
    embeddings, beliefs, log_probs, values = map(torch.stack, [embeddings, beliefs, log_probs, values])

    length = [int(keep[:, n].sum()) for n in range(columns)]
    advantage = torch.zeros(steps, columns, dtype=torch.float64)
    for n in range(columns):
        after = batch["bootstrap"][n] if length[n] == steps else batch["value"][steps - 1, n]
        column = lambda name: batch[name][: length[n], n].tolist()
        column = advantages(
            column("reward"), column("value"), float(after), column("ended"), [False] * length[n], 0.99, 0.95
        )
        advantage[: length[n], n] = torch.tensor(column, dtype=torch.float64)
    returns = torch.where(keep, advantage + batch["value"], 0.0)
    if task == "disturb":
        normal = advantage[keep]
        advantage[keep] = (normal - normal.mean()) / (normal.std() + 1e-5)
    terms = ppo_terms(
        log_probs[keep],
        values[keep],
        action[keep],
        batch["log_prob"][keep],
        batch["value"][keep],
        advantage[keep],
        returns[keep],
        0.1,
    )
    policy, value, entropy, fraction, kl = terms
    assert 0.2 < fraction < 1.0

    def same_episode(t: int, later: int, n: int) -> bool:
        return later < length[n] and not bool(start[t + 1 : later + 1, n].any())

    valid = [(t, n) for t in range(steps) for n in range(columns) if keep[t, n]]
    questions = lambda horizon: [
        (t, n, offset) for offset in range(1, horizon + 1) for t, n in valid if same_episode(t, t + offset, n)
    ]
    head = network.auxiliary[task]
    if task == "disturb":
        asked = [(t, n) for t, n, _ in questions(1)]
        logits = torch.stack([head(beliefs[t, n])[action[t, n]] for t, n in asked])
        p = torch.sigmoid(logits)
        p_true = torch.where(torch.stack([batch["disturbed"][t, n] for t, n in asked]), p, 1 - p)
        auxiliary = (-((1 - p_true) ** 2) * p_true.log()).mean()
    elif task == "inverse_dynamics":
        last = {(t, n): max(l for l in range(t, length[n]) if l == t or same_episode(t, l, n)) for t, n in valid}
        auxiliary = guess(head, embeddings, beliefs, action, questions(1), last)
    else:
        elsewhere = {(t, n): divmod(int(batch["negatives"][t, n]), columns) for t, n in valid}
        auxiliary = contrast(head, embeddings, beliefs, action, questions(16), elsewhere)
    total = policy + 0.5 * value - 0.01 * entropy + 0.1 * auxiliary
    names, weights = zip(*sorted(network.named_parameters()))
    gradients = torch.autograd.grad(total, weights)
    norm = torch.stack([gradient.norm() for gradient in gradients]).norm()
    figures = [policy, value, entropy, auxiliary, fraction, kl, total, norm]
    seen = lambda rows: torch.where(keep.reshape(steps, columns, *[1] * (rows.dim() - 2)), rows, 0.0).detach()
    return {
        "figures": torch.stack(figures).detach().double(),
        "log_probs": seen(log_probs),
        "values": seen(values),
        "advantages": advantage,
        "returns": returns,
        "gradients": probes(list(zip(names, gradients))),
    }


def probe_fixture(folder: str | None = None) -> None:
    """What `learner probe` must find. With a folder, its input files too: TASK.weights, TASK.batch, TASK.expected."""
    out = {}
    for task, settings in PROBES.items():
        network = Network(auxiliary=task, **settings)
        weights = {name: weight.detach().clone() for name, weight in network.named_parameters()}
        batch = probe_batch(task, settings["actions"], settings["hidden"])
        expected = probe_expected(task, network, batch)
        out |= {f"{task}.{name}": value for name, value in expected.items()}
        if folder is not None:
            files = {"weights": weights, "batch": batch, "expected": expected}
            for kind, tensors in files.items():
                path = pathlib.Path(folder) / f"{task}.{kind}.safetensors"
                save_file({name: value.contiguous() for name, value in tensors.items()}, path)
    save_file(out, HERE / "probe.safetensors")


if __name__ == "__main__":
    network_fixture("resnet", encoder="resnet", pool=2, polar=True, previous_action=True, hidden=512, actions=21)
    network_fixture("cnn", encoder="cnn", pool=1, polar=False, previous_action=False, hidden=64, actions=13)
    gae_fixture()
    goal_fixture()
    lagrangian_fixture()
    run_fixture()
    import_fixture()
    probe_fixture(sys.argv[1] if len(sys.argv) > 1 else None)
