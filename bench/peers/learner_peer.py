"""Times of the network in PyTorch: a step of inference, and an epoch of an update."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import torch

from .learner_network import Layers, Network

#: Calls before anything is measured or captured.
WARM_UP = 3
#: The fewest calls that are measured.
FEWEST = 5


@dataclass(frozen=True)
class Variant:
    """A way to run PyTorch."""

    name: str
    bf16: bool = False
    compiled: bool = False
    #: Captured in a CUDA graph and replayed.
    graph: bool = False


def variants(device: torch.device, *, training: bool) -> list[Variant]:
    """Those that make sense on a device."""
    eager = [Variant("eager fp32"), Variant("eager bf16", bf16=True)]
    if device.type == "cpu":
        return [*eager, Variant("compiled fp32", compiled=True)]
    graphed = [] if training else [Variant("bf16, graph", bf16=True, graph=True)]
    # LeanRL's way.
    return [*eager, *graphed, Variant("compiled bf16, graph", bf16=True, compiled=True, graph=True)]


def synchronise(device: torch.device) -> None:
    """Waits until a device has done all."""
    if device.type == "cuda":
        torch.cuda.synchronize()


def capture(step: Callable[[], object]) -> Callable[[], object]:
    """The step as a CUDA graph; it has been warmed up on a stream of its own."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(WARM_UP):
            step()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        step()
    return graph.replay


def timed_s(call: Callable[[], object], device: torch.device, seconds: float) -> float:
    """Median wall time of a call, seconds."""
    times: list[float] = []
    synchronise(device)
    began = time.perf_counter()
    while len(times) < FEWEST or time.perf_counter() - began < seconds:
        started = time.perf_counter()
        call()
        synchronise(device)
        times.append(time.perf_counter() - started)
    return median(times)


#: Makes the network, whose encoder computes in bfloat16 or not.
Make = Callable[[bool], "Network | Layers"]


def make(shape: str, encoder: str, hidden: int, bf16: bool) -> Network | Layers:
    """The network of a shape."""
    return Network(encoder, hidden, bf16=bf16) if shape == "kitchen" else Layers(shape, bf16=bf16)


def inference_s(make: Make, batch: int, variant: Variant, device: torch.device, seconds: float) -> float:
    """A whole step: observations in pinned memory of the host to actions, log-probabilities and values on the host."""
    network = make(variant.bf16).to(device).eval()
    cuda = device.type == "cuda"
    host = [tensor.pin_memory() if cuda else tensor for tensor in network.observed(batch)]
    inputs = [tensor.to(device) for tensor in host]
    belief = torch.zeros(batch, network.hidden, device=device)
    answer = torch.zeros(batch, 3)
    answer = answer.pin_memory() if cuda else answer
    judged = torch.zeros(batch, 3, device=device)
    act = torch.compile(network.act, dynamic=False) if variant.compiled else network.act

    def step() -> None:
        row, after = act(*inputs, belief)
        judged.copy_(row)
        belief.copy_(after)

    def whole(step: Callable[[], object]) -> list[float]:
        for tensor, source in zip(inputs, host, strict=True):
            tensor.copy_(source, non_blocking=True)
        step()
        answer.copy_(judged, non_blocking=True)
        synchronise(device)
        return answer[:, 0].tolist()

    with torch.no_grad():
        run = capture(step) if variant.graph else step
        for _ in range(WARM_UP):
            whole(run)
        return timed_s(lambda: whole(run), device, seconds)


def epoch_s(make: Make, shape: tuple[int, int], variant: Variant, device: torch.device) -> float:
    """An epoch over a rollout of (steps, environments): forward, backward, clip, Adam."""
    network = make(variant.bf16).to(device)
    batch = network.batch(*shape, device)
    cuda = device.type == "cuda"
    adam = torch.optim.Adam(network.parameters(), lr=3e-4, fused=cuda, capturable=variant.graph)
    loss = torch.compile(network.loss, dynamic=False) if variant.compiled else network.loss

    def step() -> None:
        adam.zero_grad(set_to_none=True)
        loss(batch).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 0.5)
        adam.step()

    run = capture(step) if variant.graph else step
    for _ in range(WARM_UP):
        run()
    return timed_s(run, device, 0.5)


def attempt(measure: Callable[[], float]) -> tuple[float | None, str]:
    """The figure, or none and why: too little memory, or what a compiler lacks on this machine."""
    try:
        return measure(), ""
    except torch.OutOfMemoryError:
        return None, "out of memory"
    except Exception as error:
        # One variant less is no reason to lose the others.
        first = next(iter(str(error).strip().splitlines()), "")
        return None, f"{type(error).__name__}: {first}"
    finally:
        torch.compiler.reset()
        if torch.cuda.is_available():
            torch.cuda.empty_cache()
