"""Environments of your own in a run: the interpreter that serves them is the actor's process.

`stillroom up --env gymnasium:CartPole-v1` starts `python -m stillroom serve gymnasium:CartPole-v1` for each actor. A
program of your own does the same with `stillroom.serve(make_env)`, and is started by `stillroom up --env-command`.
"""

from __future__ import annotations

import argparse
import faulthandler
import functools
import importlib
import importlib.util
import inspect
import json
import os
import re
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn, TextIO

import gymnasium

from stillroom import fault
from stillroom._stillroom import BUILD, Actor, Replay, hold_lifeline
from stillroom.columns import Among, Vector, check_sizes, halves, takes_size
from stillroom.description import Described, Refused, describe
from stillroom.determinism import prove, try_out
from stillroom.film import Camera, write
from stillroom.masks import add_mask
from stillroom.pools import PoolEnv
from stillroom.trial import Report, Tried, no_report

MakeEnv = Callable[..., gymnasium.Env | gymnasium.vector.VectorEnv]


def serve(make_env: MakeEnv, *, name: str | None = None) -> NoReturn:
    """Serves environments to the orchestrator that has started this program. It returns only by `SystemExit`.

    Args:
        make_env: makes an environment; it is called once for each. Or it makes a gymnasium.vector.VectorEnv, and is
            called for each half of an actor's environments, with their number if it has an argument `num_envs`.
        name: of the task: lower-case letters, digits and underscores; otherwise it is that of `make_env`.
    """
    arguments = _parser().parse_args()
    streams = _stand_apart(arguments.lifeline)
    _run(arguments, lambda: (make_env, name or getattr(make_env, "__name__", "task")), streams)


def main(argv: Sequence[str]) -> NoReturn:
    """`python -m stillroom serve SPEC`."""
    parser = _parser()
    parser.prog = "python -m stillroom serve"
    parser.add_argument("env", help="gymnasium:ID, envpool:ID, package.module:function or file.py:function")
    parser.add_argument("--kwargs", type=json.loads, default={}, help="keyword arguments for it, as JSON")
    parser.add_argument("--path", help="a folder to import modules from")
    arguments = parser.parse_args(argv)
    streams = _stand_apart(arguments.lifeline)
    _run(arguments, lambda: find(arguments.env, arguments.kwargs, arguments.path), streams)


def find(spec: str, kwargs: dict[str, Any], path: str | None) -> tuple[MakeEnv, str]:
    """What makes the environments that `spec` names, and the name of their task."""
    place, _, name = spec.partition(":")
    if not name:
        raise Refused(
            f"`{spec}` names no environment: give gymnasium:ID, envpool:ID, package.module:function or"
            " ./file.py:function"
        )
    if place == "gymnasium":

        def registered(render_mode: str | None = None) -> gymnasium.Env:
            return gymnasium.make(name, disable_env_checker=True, **({"render_mode": render_mode} | kwargs))

        return registered, name.rpartition("/")[2]
    if place == "envpool":
        return lambda: PoolEnv(name, **kwargs), name.rpartition("/")[2]
    if path is not None:
        sys.path.insert(0, path)
    try:
        module = _module(place)
    except ModuleNotFoundError as error:
        raise Refused(f"there is no Python module `{error.name}`, which `{spec}` needs") from error
    except FileNotFoundError as error:
        raise Refused(f"there is no file {place}") from error
    make = getattr(module, name, None)
    if not callable(make):
        raise Refused(f"`{place}` has no function `{name}`")
    _check_keywords(make, name, kwargs)
    plain = name in ("make", "make_env")
    return functools.partial(make, **kwargs), Path(place).stem.rpartition(".")[2] if plain else name


def _check_keywords(make: MakeEnv, name: str, kwargs: dict[str, Any]) -> None:
    """Refuses keyword arguments that a function does not take."""
    try:
        parameters = inspect.signature(make).parameters.values()
    except (TypeError, ValueError):
        # One of C may have none that can be read.
        return
    named = [one.name for one in parameters if one.kind in (one.POSITIONAL_OR_KEYWORD, one.KEYWORD_ONLY)]
    unknown = [key for key in kwargs if key not in named]
    if unknown and not any(one.kind is one.VAR_KEYWORD for one in parameters):
        raise Refused(f"{name}() has no parameter {unknown[0]!r}; it has {', '.join(named) or 'none'}")


def _called(make_env: MakeEnv) -> str:
    """The name of a function, also of one with some arguments given."""
    return getattr(getattr(make_env, "func", make_env), "__name__", "make_env")


def _module(place: str) -> Any:
    if not place.endswith(".py"):
        return importlib.import_module(place)
    file = Path(place)
    sys.path.insert(0, str(file.parent))
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[file.stem] = module
    spec.loader.exec_module(module)
    return module


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="Serves environments to a run; the orchestrator starts this.")
    parser.add_argument("--describe", action="store_true", help="print what the environment says of itself, as JSON")
    parser.add_argument("--declared", type=json.loads, default=[], help="channels that the user declares, as JSON")
    parser.add_argument("--build", action="store_true", help="print which build of Stillroom this is")
    parser.add_argument("--replay", action="store_true", help="simulate the recorded episodes on standard input again")
    parser.add_argument("--actor", type=int)
    parser.add_argument("--incarnation", type=int, default=1)
    parser.add_argument("--wire")
    parser.add_argument("--config")
    parser.add_argument("--lifeline", action="store_true")
    return parser


def _stand_apart(lifeline: bool) -> tuple[TextIO, TextIO]:
    """Keeps standard input and output for this module, and returns them.

    From here on what environments print goes to the log, and they read nothing.
    """
    # Descriptors that `os.dup` makes are not inherited by processes that environments start.
    asked, answer = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    if lifeline:
        hold_lifeline()
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    return asked, answer


def _run(
    arguments: argparse.Namespace, found: Callable[[], tuple[MakeEnv, str]], streams: tuple[TextIO, TextIO]
) -> NoReturn:
    asked, answer = streams
    if arguments.build:
        print(BUILD, file=answer, flush=True)
        raise SystemExit(0)
    _say_where(arguments.lifeline, arguments.describe)
    try:
        make_env, name = found()
        if arguments.describe:
            # The orchestrator that holds the lifeline reads what is tried, line by line, before the answer.
            report = _reporting(answer) if arguments.lifeline else no_report
            print(json.dumps(_described(make_env, name, arguments.declared, report)), file=answer, flush=True)
            raise SystemExit(0)
        if arguments.replay:
            _replay(make_env, _task_name(name), asked, answer)
            raise SystemExit(0)
        missing = [name for name in ("actor", "wire", "config") if getattr(arguments, name) is None]
        if missing:
            raise Refused(f"--{missing[0]} is missing: the orchestrator starts this, `stillroom up --env ...`")
        actor = Actor(arguments.actor, arguments.incarnation, arguments.wire, arguments.config)
        # Before the actor joins the run: they may start processes of their own.
        envs, vectors = _made_for_actor(make_env, actor.environments)
        described = describe(envs[0], _task_name(name))
        actor.run(envs, vectors, json.dumps(described.description), described.observed)
    except Refused as refusal:
        print(f"stillroom: error: {refusal}", file=sys.stderr)
        raise SystemExit(2) from None
    except Exception as error:
        traceback.print_exc()
        print(f"stillroom: error: {fault.sentence(error)}", file=sys.stderr)
        raise SystemExit(1) from None
    raise SystemExit(1)


def _say_where(lifeline: bool, describe: bool) -> None:
    """What crashes says where; what hangs, when the orchestrator sends SIGUSR1."""
    faulthandler.enable()
    if lifeline:
        faulthandler.register(signal.SIGUSR1, all_threads=False)
    # The lifeline ignores them, and so would processes that the environment starts and ends.
    for request in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if lifeline and describe else ():
        signal.signal(request, signal.SIG_DFL)


def _reporting(answer: TextIO) -> Report:
    def report(call: str, place: str) -> None:
        print(json.dumps({"call": call, "place": place}), file=answer, flush=True)

    return report


def _described(
    make_env: MakeEnv, name: str, declared: list[dict[str, Any]], report: Report = no_report
) -> dict[str, Any]:
    """What an environment says of itself, which has been tried out."""
    one: Any
    proven: Any

    def made(size: int) -> Any:
        report("", "it is being made")
        return _made(make_env, size)

    def tried(env: Any, described: Described | None = None) -> Any:
        return Tried(env, described, declared, report)

    try:
        env = made(2)
        vector = env if isinstance(env, Vector) else None
        one, proven = (vector.columns[0], Among(vector)) if vector else (env, env)
        described = describe(tried(one), _task_name(name))
        add_mask(described, tried(one))
        try_out(described, tried(proven, described), declared)
        prove(tried(proven, described), lambda: tried(made(1), described))
    except SystemExit as ended:
        raise Refused(fault.exited(ended)) from ended
    report("", "its process ends")
    # Of vectors that have a size, an actor has two.
    more: dict[str, Any] = {"environments": 2 * len(vector)} if vector and not takes_size(make_env) else {}
    return described.description | more | ({"warnings": described.warnings} if described.warnings else {})


def _replay(make_env: MakeEnv, name: str, asked: TextIO, answer: TextIO) -> None:
    """Simulates recorded episodes again, and films them if that is asked for."""
    setup = next(asked)
    images = json.loads(setup)["images"]
    made = _made(make_env, 1, **({"render_mode": "rgb_array"} if images and _takes_mode(make_env) else {}))
    one, vectors = (made.columns[0], [made]) if isinstance(made, Vector) else (made, [])
    if images and vectors:
        raise Refused("the environment is a vector, of which no film is made: --check replays its episodes")
    described = describe(one, name)
    camera = Camera(one) if images else None
    replay = Replay(setup, camera or one, vectors, json.dumps(described.description), described.observed)
    for line in asked:
        verdict = replay.verdict(line)
        if camera is not None:
            told = json.loads(verdict)
            number, episode = told["environment"]["number"], told["episode"]
            if camera.problem:
                raise Refused(f"environment {number}, episode {episode}, {camera.problem}")
            film = f"environment-{number}-episode-{episode:06}"
            told["images"] = write(images, film, camera.pictures, one.metadata.get("render_fps") or 30)
            verdict = json.dumps(told)
        print(verdict, file=answer, flush=True)


def _takes_mode(make_env: MakeEnv) -> bool:
    """Whether `make_env` can be called with a `render_mode`."""
    parameters = inspect.signature(make_env).parameters
    return "render_mode" in parameters or any(one.kind is one.VAR_KEYWORD for one in parameters.values())


def _made_for_actor(make_env: MakeEnv, environments: int) -> tuple[list[Any], list[Vector]]:
    """All environments of an actor, and the vectors whose columns they are."""
    sizes = halves(environments)
    made = [_made(make_env, size) for size in sizes[:1]]
    if isinstance(made[0], Vector):
        vectors = [*made, *(_made(make_env, size) for size in sizes[1:])]
        check_sizes(vectors, environments)
        return [column for vector in vectors for column in vector.columns], vectors
    return made + [_made(make_env, 1) for _ in range(environments - 1)], []


def _made(make_env: MakeEnv, size: int, **more: Any) -> Any:
    """An environment, or a vector of them: of this size, if it takes one."""
    try:
        env = make_env(**more, **({"num_envs": size} if takes_size(make_env) else {}))
    except Exception as error:
        traceback.print_exc()
        raise Refused(f"the environment cannot be made: {fault.told(error)}") from error
    if isinstance(env, gymnasium.vector.VectorEnv):
        return Vector(env)
    if not isinstance(env, gymnasium.Env):
        made = "None" if env is None else fault.a(type(env).__name__)
        raise Refused(f"{_called(make_env)}() returned {made}, which is no gymnasium.Env")
    return env


def _task_name(name: str) -> str:
    """`CartPole-v1` as `cart_pole_v1`."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    words = re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")
    return words[:64] if words[:1].isalpha() else f"task_{words}"[:64]
