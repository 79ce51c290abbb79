"""The same network under AllenAct's names, and what `import` must make of such weights."""

import json
import math
import pathlib

import torch
from plain_network import Backbone, Cpca, depth_mm, goal_m, set_weights, tensor
from safetensors.torch import save_file
from torch import nn
from torch.nn import functional as F

HERE = pathlib.Path(__file__).parent


class AllenActBackbone(nn.Module):
    """The backbone under the paths of AllenAct's GroupNorm ResNet18."""

    def __init__(self):
        super().__init__()
        ours = Backbone()
        for name in ["conv1", "layer1", "layer2", "layer3", "layer4"]:
            setattr(self, name, getattr(ours, name))

    def forward(self, x):
        x = F.max_pool2d(self.conv1(x), 3, 2, 1)
        return self.layer4(self.layer3(self.layer2(self.layer1(x))))


class AllenActResnet(nn.Module):
    def __init__(self):
        super().__init__()
        self.backbone = AllenActBackbone()
        self.compression = nn.Sequential(nn.Conv2d(256, 128, 3, 1, 1, bias=False), nn.GroupNorm(1, 128), nn.ReLU())
        self.head = nn.Sequential(nn.Flatten(), nn.Linear(2048, 512), nn.ReLU())

    def forward(self, depth):
        return self.head(self.compression(self.backbone(F.avg_pool2d(depth, 2))))


class AllenActCnn(nn.Module):
    def __init__(self):
        super().__init__()
        self.depth_cnn = nn.Sequential()
        for name, module in [
            ("conv_0", nn.Conv2d(1, 32, 8, 4)),
            ("relu_0", nn.ReLU()),
            ("conv_1", nn.Conv2d(32, 64, 4, 2)),
            ("relu_1", nn.ReLU()),
            ("conv_2", nn.Conv2d(64, 32, 3)),
            ("flatten", nn.Flatten()),
            ("fc", nn.Linear(32 * 24 * 24, 512)),
            ("out_relu", nn.ReLU()),
        ]:
            self.depth_cnn.add_module(name, module)

    def forward(self, depth):
        return self.depth_cnn(depth)


def inner(name: str, module: nn.Module) -> nn.Module:
    """A module that holds another under a name."""
    outer = nn.Module()
    outer.add_module(name, module)
    return outer


class AllenAct(nn.Module):
    """`ArmPointNavBaselineActorCritic`: of the disturbance-free project, or (`original`) AllenAct's own."""

    def __init__(self, original: bool, hidden: int, actions: int):
        super().__init__()
        self.original, self.actions = original, actions
        goal = nn.Sequential(nn.Sequential(nn.Linear(3, 100), nn.LeakyReLU()), nn.Sequential(nn.Linear(100, 32)))
        if original:
            self.visual_encoder = AllenActCnn()
            self.relative_dist_embedding = goal
            self.state_encoder = inner("rnn", nn.GRU(544, hidden))
        else:
            self.visual_encoder = AllenActResnet()
            self.goal_embedder = goal
            self.prev_action_embedder = inner("fc", nn.Embedding(actions, 16))
            self.state_encoders = inner("single_belief", inner("rnn", nn.GRU(560, hidden)))
            disturb = nn.ModuleList([nn.Linear(hidden, 128), nn.ReLU(), nn.Linear(128, actions)])
            cpca = Cpca(hidden, actions)
            cpca.action_embedder = inner("fc", nn.Embedding(actions + 1, 16))
            self.aux_models = nn.ModuleDict(
                {
                    "Disturb_Pred": inner("classifier", disturb),
                    "InvDyn": inner("decoder", nn.Linear(2 * 544 + hidden, actions)),
                    "CPCA_16": cpca,
                }
            )
        self.actor = inner("linear", nn.Linear(hidden, actions))
        self.critic = inner("fc", nn.Linear(hidden, 1))
        set_weights(self)

    def forward(self, depth_mm, goal_m, previous_action, belief):
        """Millimetres [B, 224, 224], metres [B, 3], actions [B], [B, hidden]."""
        depth = (depth_mm.float()[:, None] / 1000.0 - 0.5) / 0.25
        seen = self.visual_encoder(depth)
        if self.original:
            goal = self.relative_dist_embedding(goal_m.abs())
            _, belief = self.state_encoder.rnn(torch.cat([goal, seen], 1)[None], belief[None])
        else:
            x, y, z = goal_m.unbind(1)
            polar = [
                goal_m.norm(dim=1),
                torch.atan2(z, torch.hypot(x, y)) / (math.pi / 2),
                torch.atan2(y, x) / math.pi,
            ]
            goal = self.goal_embedder(torch.stack(polar, 1))
            before = self.prev_action_embedder.fc(previous_action)
            embedded = torch.cat([seen, goal, before], 1)
            _, belief = self.state_encoders.single_belief.rnn(embedded[None], belief[None])
        return F.log_softmax(self.actor.linear(belief[0]), -1), self.critic.fc(belief[0])[:, 0], belief[0]

    def risk(self, belief):
        for module in self.aux_models["Disturb_Pred"].classifier:
            belief = module(belief)
        return belief


def import_fixture() -> None:
    """Two steps of two columns; the second column's episode begins at each, after a Done."""
    out = {}
    for name, original, hidden, actions in [("disturb_free", False, 40, 21), ("original", True, 24, 13)]:
        network = AllenAct(original, hidden, actions)
        belief = tensor("import.belief", 2, hidden)
        log_probs, values = [], []
        for t in range(2):
            belief = belief * torch.tensor([[1.0], [0.0]])
            previous = torch.tensor([3 + t, actions - 1])
            depth, goal = ([make(t, n) for n in range(2)] for make in (depth_mm, goal_m))
            log_prob, value, belief = network(torch.stack(depth), torch.stack(goal), previous, belief)
            log_probs.append(log_prob.detach())
            values.append(value.detach())
        out |= {f"{name}.log_probs": torch.stack(log_probs), f"{name}.values": torch.stack(values)}
        if not original:
            out[f"{name}.risk"] = network.risk(belief).detach()
        # Names and shapes: with `noise`, all of the state dict.
        shapes = [f'"{key}": {json.dumps(value.shape)}' for key, value in network.state_dict().items()]
        (HERE / f"import_{name}.json").write_text("{\n" + ",\n".join(shapes) + "\n}\n")
    save_file(out, HERE / "import.safetensors")
