"""The learner's network in PyTorch: encoder, embeddings or layers, GRU or LSTM, heads (docs/method.md, Network).

Names of modules and weights are those of checkpoints. Everything is float32; `learner probe` on a CPU agrees with it to
rounding. `learner/tests/reference/plain_network.py` is the same network for the reference values of the Rust tests, and
stays a copy of its own: one that both used could be wrong in both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

RAW_SIDE = 224
# Millimetres to the network's input: (metres - 0.5) / 0.25.
SCALE, OFFSET = 1 / 250, -2.0
# In place of the logit of an option that a mask forbids.
FORBIDDEN_LOGIT = -1e8


class Block(nn.Module):
    """Two 3 x 3 convolutions and a way around them."""

    def __init__(self, inputs: int, planes: int, stride: int) -> None:
        super().__init__()
        self.convs = nn.Sequential(
            nn.Conv2d(inputs, planes, 3, stride, 1, bias=False),
            nn.GroupNorm(16, planes),
            nn.ReLU(),
            nn.Conv2d(planes, planes, 3, 1, 1, bias=False),
            nn.GroupNorm(16, planes),
        )
        self.downsample: nn.Module | None = None
        if stride != 1 or inputs != planes:
            self.downsample = nn.Sequential(nn.Conv2d(inputs, planes, 1, stride, bias=False), nn.GroupNorm(16, planes))

    def forward(self, x: Tensor) -> Tensor:
        """[rows, inputs, h, w] to [rows, planes, h / stride, w / stride]."""
        return F.relu(self.convs(x) + (x if self.downsample is None else self.downsample(x)))


class Backbone(nn.Module):
    """ResNet18 with group normalisation, half as wide."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Sequential(nn.Conv2d(1, 32, 7, 2, 3, bias=False), nn.GroupNorm(16, 32), nn.ReLU())
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        self.layer1 = nn.Sequential(Block(32, 32, 1), Block(32, 32, 1))
        self.layer2 = nn.Sequential(Block(32, 64, 2), Block(64, 64, 1))
        self.layer3 = nn.Sequential(Block(64, 128, 2), Block(128, 128, 1))
        self.layer4 = nn.Sequential(Block(128, 256, 2), Block(256, 256, 1))

    def forward(self, x: Tensor) -> Tensor:
        """[rows, 1, side, side] to [rows, 256, side / 32, side / 32]."""
        return self.layer4(self.layer3(self.layer2(self.layer1(self.maxpool(self.conv1(x))))))


class Resnet(nn.Module):
    """The paper's encoder."""

    def __init__(self, side: int) -> None:
        super().__init__()
        self.backbone = Backbone()
        self.compression = nn.Sequential(nn.Conv2d(256, 128, 3, 1, 1, bias=False), nn.GroupNorm(1, 128), nn.ReLU())
        # The stem's convolution and pooling and three stages halve the side, rounding up.
        for _ in range(5):
            side = (side + 1) // 2
        self.fc = nn.Sequential(nn.Flatten(), nn.Linear(128 * side * side, 512), nn.ReLU())

    def forward(self, x: Tensor) -> Tensor:
        """[rows, 1, side, side] to [rows, 512]."""
        return self.fc(self.compression(self.backbone(x)))


class Cnn(nn.Module):
    """The small encoder."""

    def __init__(self, side: int) -> None:
        super().__init__()
        for size, stride in [(8, 4), (4, 2), (3, 1)]:
            side = (side - size) // stride + 1
        self.cnn = nn.Sequential(
            nn.Conv2d(1, 32, 8, 4),
            nn.ReLU(),
            nn.Conv2d(32, 64, 4, 2),
            nn.ReLU(),
            nn.Conv2d(64, 32, 3),
            nn.Flatten(),
            nn.Linear(32 * side * side, 512),
            nn.ReLU(),
        )

    def forward(self, x: Tensor) -> Tensor:
        """[rows, 1, side, side] to [rows, 512]."""
        return self.cnn(x)


class Images(nn.ModuleDict):
    """Images of any declaration, each through the convolutions of DQN: by name its channels, and the features that
    convolutions leave."""

    def __init__(self, images: dict[str, tuple[int, int]]) -> None:
        super().__init__(
            {
                name: nn.Sequential(
                    nn.Conv2d(channels, 32, 8, 4),
                    nn.ReLU(),
                    nn.Conv2d(32, 64, 4, 2),
                    nn.ReLU(),
                    nn.Conv2d(64, 64, 3),
                    nn.ReLU(),
                    nn.Flatten(),
                    nn.Linear(features, 512),
                    nn.ReLU(),
                )
                for name, (channels, features) in images.items()
            }
        )

    def see(self, name: str, image: Tensor) -> Tensor:
        """An image as it was observed, [rows, height, width], and channels first or last, to [rows, 512]."""
        most = {torch.uint8: 255.0, torch.uint16: 65535.0}.get(image.dtype)
        image = image.to(torch.float32) if most is None else image.to(torch.float32) / most
        if image.dim() == 3:
            image = image.unsqueeze(1)
        # A side has more pixels than an image has channels.
        elif image.shape[1] != self[name][0].in_channels:
            image = image.permute(0, 3, 1, 2)
        return self[name](image)


def layers(inputs: int, widths: list[int], activation: str) -> list[nn.Module]:
    """Linear layers of these widths, each with an activation behind it."""
    behind = {"tanh": nn.Tanh, "relu": nn.ReLU}[activation]
    return [
        module
        for before, width in zip([inputs, *widths], widths, strict=False)
        for module in (nn.Linear(before, width), behind())
    ]


class Normalizer(nn.Module):
    """Numbers less their mean, divided by their deviation, then clipped. Both are as a run has found them."""

    running_mean: Tensor
    running_var: Tensor

    def __init__(self, numbers: int, clip: float) -> None:
        super().__init__()
        self.clip = clip
        self.register_buffer("running_mean", torch.zeros(numbers))
        self.register_buffer("running_var", torch.ones(numbers))

    def forward(self, x: Tensor, which: slice) -> Tensor:
        mean, var = self.running_mean[which], self.running_var[which]
        return ((x - mean) / (var + 1e-8).sqrt()).clamp(-self.clip, self.clip)


class Network(nn.Module):
    """Observations and a belief to the policy, a value and the next belief.

    Args:
        encoder: "resnet" or "cnn"; None in a task without a frame.
        input_pool: side of the pooling before the encoder.
        goal: what becomes of the numbers beside a frame: "polar", "cartesian", "plain".
        previous_action: whether the network is given the last action.
        hidden: width of the GRU or LSTM; 0 without memory.
        memory: "gru" or "lstm".
        actions: how many there are; of several choices the options of all, of a box its numbers.
        choices: options of each choice, if there are several.
        bounds: least and greatest of each number of a box: means are the policy's, and `log_std` is a weight.
        numbers: how many numbers an observation has, beside its frame if there is one.
        mlp: widths of the layers of a task without a frame.
        activation: what follows on each of them, "tanh" or "relu".
        masked: whether observations have a mask of the options that may be chosen.
        images: channels, and features that convolutions leave, of each image but the frame, in the order of names.
        privileged: how many numbers the critic alone is given.
    """

    def __init__(
        self,
        *,
        encoder: str | None = "resnet",
        input_pool: int = 2,
        goal: str = "polar",
        previous_action: bool = True,
        hidden: int = 512,
        memory: str = "gru",
        actions: int = 21,
        numbers: int = 3,
        mlp: list[int] | None = None,
        activation: str = "tanh",
        choices: list[int] | None = None,
        bounds: list[list[float]] | None = None,
        observation_clip: float | None = None,
        masked: bool = False,
        images: dict[str, tuple[int, int]] | None = None,
        privileged: int = 0,
    ) -> None:
        super().__init__()
        # Of an environment of your own: name, shape, and of whole numbers the least and how many there are.
        self.channels: list[tuple[str, list[int], tuple[int, int] | None]] = []
        self.masked = masked
        self.choices = choices or [actions]
        self.log_std = nn.Parameter(torch.zeros(actions)) if bounds else None
        self.register_buffer("bounds", torch.tensor(bounds) if bounds else None, persistent=False)
        self.input_pool, self.goal, self.hidden, self.actions = input_pool, goal, hidden, actions
        goals = ("polar", "cartesian", "plain")
        if encoder not in ("resnet", "cnn", None) or goal not in goals or input_pool not in (1, 2, 4):
            raise ValueError(
                f'encoder is {encoder!r}, goal {goal!r}, input_pool {input_pool!r}: there are "resnet", "cnn", None;'
                ' "polar", "cartesian", "plain"; 1, 2, 4'
            )
        clip = observation_clip
        self.observation_norm = None if clip is None else Normalizer(numbers + privileged, clip)
        # Layers that actor and critic share, and those that each has of its own.
        shared, own = (mlp or [], []) if hidden or images else ([], mlp or [])
        if encoder is None:
            self.visual_encoder, self.goal_embedder = None, None
            self.mlp = nn.Sequential(*layers(numbers, shared, activation))
            width = [numbers, *shared][-1]
        else:
            own = []
            self.visual_encoder = {"resnet": Resnet, "cnn": Cnn}[encoder](RAW_SIDE // input_pool)
            self.goal_embedder = nn.Sequential(nn.Linear(numbers, 100), nn.LeakyReLU(0.01), nn.Linear(100, 32))
            width = 544
        self.numbers, self.privileged = numbers, privileged
        self.images = Images(images) if images else None
        width += 512 * len(images or {})
        self.previous_action_embedder = nn.Embedding(actions + 1, 16) if previous_action else None
        width += 16 if previous_action else 0
        self.belief = {"gru": nn.GRU, "lstm": nn.LSTM}[memory](width, hidden) if hidden else None
        width = hidden or width

        def head(width: int, outputs: int) -> nn.Module:
            last = nn.Linear([width, *own][-1], outputs)
            return nn.Sequential(*layers(width, own, activation), last) if own else last

        self.actor, self.critic = head(width, actions), head(width + privileged, 1)

    @classmethod
    def of(
        cls,
        weights: dict[str, NDArray[Any]],
        *,
        goal: str = "polar",
        activation: str = "tanh",
        observation_clip: float = 10.0,
        choices: list[int] | None = None,
        bounds: list[list[float]] | None = None,
        masked: bool = False,
        channels: list[dict[str, Any]] | None = None,
    ) -> Network:
        """The network that weights belong to: names and shapes give all but `goal`, `activation`,
        `observation_clip`, `masked`, `channels` (an own environment's) and the actions' form. Heads of auxiliary tasks
        are left out."""

        def widths(path: str) -> list[int]:
            """Outputs of a Sequential's linear layers."""
            found = []
            while f"{path}.{2 * len(found)}.weight" in weights:
                found.append(weights[f"{path}.{2 * len(found)}.weight"].shape[0])
            return found

        encoder = "resnet" if "visual_encoder.fc.1.weight" in weights else "cnn"
        shared, own_layers = widths("mlp"), widths("actor")[:-1]
        last = "visual_encoder.fc.1.weight" if encoder == "resnet" else "visual_encoder.cnn.6.weight"
        images = {
            name.split(".")[1]: (weights[name].shape[1], weights[name.replace(".0.", ".7.")].shape[1])
            for name in sorted(weights)
            if name.startswith("images.") and name.endswith(".0.weight")
        }
        has_frame = any(name.startswith("visual_encoder.") for name in weights)
        if shared or own_layers or (images and not has_frame):
            encoder, last = None, "mlp.0.weight" if shared else "actor.0.weight"
        if images and not (shared or has_frame):
            last = "actor.weight"
        actor = f"actor.{2 * len(own_layers)}.weight" if own_layers else "actor.weight"
        remembers = "belief.weight_hh_l0" in weights or not (own_layers or images or has_frame)
        # The critic's first layer is wider by what it alone is given.
        first = [f"{head}.0.weight" if own_layers else f"{head}.weight" for head in ("actor", "critic")]
        for name in (actor, last, *first, *(["belief.weight_hh_l0"] if remembers else [])):
            if name not in weights or len(weights[name].shape) != 2:
                raise ValueError(f"these are no weights of a policy: {name} is missing or no matrix")
        actions, width = weights[actor].shape
        # Before a network of that size is made.
        if 0 in (actions, width):
            raise ValueError(f"these are no weights of a policy: {actor} is empty")
        memories = {(3 * width, width): "gru", (4 * width, width): "lstm"}
        memory = memories.get(weights["belief.weight_hh_l0"].shape) if remembers else "gru"
        privileged = weights[first[1]].shape[1] - weights[first[0]].shape[1]
        if memory is None or privileged < 0:
            misfit = "belief.weight_hh_l0" if memory is None else first[1]
            raise ValueError(f"these are no weights of a policy: {misfit} does not fit {actor}")
        if len(bounds or []) != (actions if "log_std" in weights else 0) or sum(choices or [actions]) != actions:
            raise ValueError(f"these weights are of other actions: {actor} has {actions} outputs")
        previous_action = "previous_action_embedder.weight" in weights
        seen = last if encoder is None else "goal_embedder.0.weight"
        if seen not in weights or len(weights[seen].shape) != 2:
            raise ValueError(f"these are no weights of a policy: {seen} is missing or no matrix")
        # Layers of the actor's own are given the embedding of the last action, too.
        numbers = weights[seen].shape[1] - (16 if own_layers and previous_action else 0)
        if seen == "actor.weight":
            numbers = 0
        for input_pool in (1, 2, 4):
            network = cls(
                encoder=encoder,
                input_pool=input_pool,
                goal=goal,
                previous_action=previous_action,
                hidden=width if remembers else 0,
                memory=memory,
                actions=actions,
                numbers=numbers,
                mlp=shared or own_layers,
                activation=activation,
                choices=choices,
                bounds=bounds,
                observation_clip=observation_clip if "observation_norm.running_mean" in weights else None,
                masked=masked,
                images=images,
                privileged=privileged,
            )
            own = network.state_dict()
            if own[last].shape == weights[last].shape:
                try:
                    # A copy: arrays of numpy may be read-only.
                    network.load_state_dict({name: torch.tensor(weights[name]) for name in own if name in weights})
                except (RuntimeError, TypeError) as error:
                    raise ValueError(f"these are no weights of a policy: {error}") from error
                network.take_names(channels or [])
                return network.eval()
        raise ValueError(f"no input pooling gives the encoder {weights[last].shape[1]} features")

    def __repr__(self) -> str:
        """What it takes and gives, in a line."""
        parameters = sum(parameter.numel() for parameter in self.parameters())
        memory = f", {type(self.belief).__name__} of {self.hidden}" if self.belief is not None else ""
        return f"<network: {self.expected()} to {self.actions} outputs{memory}, {parameters} parameters>"

    def take_names(self, channels: list[dict[str, Any]]) -> None:
        """Has `forward` take observations by the names of these channels, too, if they are all that it is given."""
        found: list[tuple[str, list[int], tuple[int, int] | None]] = []
        for channel in channels:
            shape, bounds = channel.get("shape", []), channel.get("range")
            if channel["name"] in (self.images or {}):
                continue
            if channel["dtype"] != "f32" and bounds is None:
                return
            whole = None if channel["dtype"] == "f32" else (int(bounds[0]), int(bounds[1] - bounds[0]) + 1)
            found.append((channel["name"], shape, whole))
        width = sum(math.prod(shape) * (whole[1] if whole else 1) for _, shape, whole in found)
        if self.visual_encoder is None and width == self.numbers:
            self.channels = found

    def expected(self) -> str:
        """The keys of observations, with shapes."""
        if self.visual_encoder is not None:
            keys = [f"depth [rows, {RAW_SIDE}, {RAW_SIDE}]", f"goal [rows, {self.numbers}]"]
        elif self.channels:
            keys = [f"{name} {['rows', *shape]}".replace("'", "") for name, shape, _ in self.channels]
        else:
            keys = [f"numbers [rows, {self.numbers}]"] if self.numbers else []
        keys += [f"images.{name} [rows, ...]" for name in self.images or {}]
        keys += ["previous_action [rows]"] if self.previous_action_embedder is not None else []
        keys += [f"action_mask [rows, {self.actions}]"] if self.masked else []
        return ", ".join(keys)

    def by_name(self, observations: Any) -> dict[str, Any]:
        """Observations as `forward` reads them: those of an environment of your own become `numbers` and `images.NAME`.
        A ValueError if something is missing or has another shape."""
        if not isinstance(observations, Mapping):
            raise ValueError(
                f"observations are a {type(observations).__name__}, not a dictionary: it has {self.expected()}"
            )
        given = dict(observations)
        given |= {f"images.{name}": given[name] for name in self.images or {} if name in given}
        if self.channels and "numbers" not in given and all(name in given for name, _, _ in self.channels):
            given["numbers"] = torch.cat([self._numbers(given[name], *channel) for name, *channel in self.channels], 1)
        needed = ["depth", "goal"] if self.visual_encoder is not None else ["numbers"] * bool(self.numbers)
        needed += [f"images.{name}" for name in self.images or {}]
        needed += ["previous_action"] * (self.previous_action_embedder is not None) + ["action_mask"] * self.masked
        vectors = {"goal": (self.numbers,), "numbers": (self.numbers,), "previous_action": ()}
        for name in needed:
            if name not in given or (name in vectors and tuple(given[name].shape[1:]) != vectors[name]):
                found = f"shape {tuple(given[name].shape)}" if name in given else f"keys {', '.join(observations)}"
                raise ValueError(f"observations are {self.expected()}; these have the {found}")
        return given

    def _numbers(self, value: Any, shape: list[int], whole: tuple[int, int] | None) -> Tensor:
        """A channel's numbers as the network is given them: whole ones as one-hot."""
        value = torch.as_tensor(value, device=self.device())
        if list(value.shape[1:]) != shape or not value.dim():
            raise ValueError(f"observations are {self.expected()}; these have the shape {tuple(value.shape)}")
        if whole is not None:
            value = F.one_hot(value.long() - whole[0], whole[1])
        return value.reshape(len(value), -1).to(torch.float32)

    def begin(self, rows: int = 1) -> Tensor:
        """The belief at an episode's start: zeros [rows, hidden]; of an LSTM the cell stands behind it, and it is twice
        as wide."""
        states = 2 if isinstance(self.belief, nn.LSTM) else 1
        return torch.zeros(rows, states * self.hidden, device=self.device())

    def remember(self, embedded: Tensor, belief: Tensor) -> tuple[Tensor, Tensor]:
        """One step of what `embed` gave, with the belief of the step before: what actor and critic see, and the belief
        for the next step."""
        unit = self.belief
        if unit is None:
            return embedded, belief
        weights = (unit.weight_ih_l0, unit.weight_hh_l0, unit.bias_ih_l0, unit.bias_hh_l0)
        if isinstance(unit, nn.LSTM):
            seen, cell = torch.lstm_cell(embedded, belief.chunk(2, 1), *weights)
            return seen, torch.cat([seen, cell], 1)
        belief = torch.gru_cell(embedded, belief, *weights)
        return belief, belief

    def device(self) -> torch.device:
        """Where its weights are."""
        return next(self.parameters()).device

    def pool(self, depth: Tensor) -> Tensor:
        """Depth as environments give it, [rows, 224, 224] in millimetres (integers) or metres (floats), to millimetres
        [rows, side, side] averaged over `input_pool` pixels each way."""
        depth_mm = depth * 1000.0 if depth.is_floating_point() else depth.to(torch.float32)
        return F.avg_pool2d(depth_mm.unsqueeze(1), self.input_pool).squeeze(1)

    def coordinates(self, goal_m: Tensor) -> Tensor:
        """Goal vectors [rows, 3], metres, to what the network is given [rows, 3]; other numbers behind them stay."""
        if self.goal == "plain":
            return goal_m
        goal_m, rest = goal_m[:, :3], goal_m[:, 3:]
        if self.goal == "cartesian":
            return torch.cat([goal_m.abs(), rest], 1)
        x, y, z = goal_m.to(torch.float64).unbind(1)
        distance = (x * x + y * y + z * z).sqrt()
        elevation = torch.atan2(z, (x * x + y * y).sqrt())
        azimuth = torch.atan2(y, x)
        polar = torch.stack([distance, elevation / (math.pi / 2), azimuth / math.pi], 1)
        return torch.cat([polar.to(torch.float32), rest], 1)

    def embed(
        self, depth_mm: Tensor, goal: Tensor, previous_action: Tensor, images: dict[str, Tensor] | None = None
    ) -> Tensor:
        """Pooled millimetres [rows, side, side], goal coordinates [rows, 3] and rows of the action table [rows] (0 is
        none yet, else 1 + action) to [rows, 560]. In a task without a frame the numbers take the goal's place. Images
        by name, as they were observed, add 512 each."""
        if self.observation_norm is not None:
            goal = self.observation_norm(goal, slice(0, self.numbers))
        if self.visual_encoder is None or self.goal_embedder is None:
            parts = [self.mlp(goal)]
        else:
            parts = [self.visual_encoder((depth_mm * SCALE + OFFSET).unsqueeze(1)), self.goal_embedder(goal)]
        if self.images is not None:
            parts += [self.images.see(name, (images or {})[name]) for name in self.images]
        if self.previous_action_embedder is not None:
            parts.append(self.previous_action_embedder(previous_action))
        return torch.cat(parts, 1)

    def forward(self, observations: dict[str, Any], belief: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """One step of `rows` environments.

        Args:
            observations: of an environment of your own its channels by their names; those of a `VectorEnv`, arrays or
                tensors: depth [rows, 224, 224], goal [rows, 3], and previous_action [rows]. In a task without a frame
                numbers [rows, numbers] instead of depth and goal; in a task with masks action_mask [rows, actions],
                true where an option may be chosen. Any other image as `images.NAME`, as it was observed. What the
                critic alone is given as `privileged`, or none of it.
            belief: as `begin` has it; zeros where an episode begins.

        Returns:
            log-probabilities of the actions [rows, actions] (of several choices side by side; of a box means), values
            [rows] (NaN without what the critic alone is given), and beliefs for the next step.
        """

        observations = self.by_name(observations)

        def given(name: str) -> Tensor:
            return torch.as_tensor(observations[name], device=self.device())

        images = {name: given(f"images.{name}") for name in self.images or {}}
        if self.visual_encoder is None:
            # Beside images there may be no numbers.
            count = len(next(iter(images.values()), ()))
            goal = given("numbers") if self.numbers else torch.zeros(count, 0, device=self.device())
            depth_mm = goal.new_zeros(len(goal), 0, 0)
        else:
            goal, depth_mm = self.coordinates(given("goal")), self.pool(given("depth"))
        rows = torch.zeros(len(goal), dtype=torch.long, device=self.device())
        if self.previous_action_embedder is not None:
            # In observations "none yet" is the last number, in the table the first row.
            rows = (given("previous_action").long() + 1) % (self.actions + 1)
        embedded = self.embed(depth_mm, goal, rows, images)
        seen, belief = self.remember(embedded, belief)
        policy = self.actor(seen)
        if self.masked:
            policy = policy.masked_fill(~given("action_mask").bool(), FORBIDDEN_LOGIT)
        if self.log_std is None:
            policy = torch.cat([F.log_softmax(logits, -1) for logits in policy.split(self.choices, 1)], 1)
        if not self.privileged:
            return policy, self.critic(seen).squeeze(1), belief
        if "privileged" not in observations:
            return policy, torch.full((len(seen),), math.nan, device=self.device()), belief
        more = given("privileged")
        if self.observation_norm is not None:
            more = self.observation_norm(more, slice(self.numbers, None))
        return policy, self.critic(torch.cat([seen, more], 1)).squeeze(1), belief

    def best(self, policy: Tensor) -> Tensor:
        """The most probable actions of a policy that `forward` gave: numbers [rows], options [rows, choices], or means
        within the bounds [rows, numbers]."""
        if self.log_std is not None:
            return policy.clamp(self.bounds[:, 0], self.bounds[:, 1])
        options = torch.stack([log_probs.argmax(1) for log_probs in policy.split(self.choices, 1)], 1)
        return options if len(self.choices) > 1 else options.squeeze(1)
