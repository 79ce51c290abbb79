"""CartPole, served by a program of your own.

stillroom up --env-command "python python/examples/cart_pole.py" --run runs/cart-pole
"""

from __future__ import annotations

import gymnasium

import stillroom


def make_env(render_mode: str | None = None) -> gymnasium.Env:
    """Called once for each environment of an actor; with a `render_mode` where films are made."""
    return gymnasium.make("CartPole-v1", render_mode=render_mode)


if __name__ == "__main__":
    stillroom.serve(make_env, name="cart_pole")
