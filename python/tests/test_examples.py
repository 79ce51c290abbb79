"""Examples run, where what they need is installed: `.venv/bin/python -m pip install stable-baselines3 torch ...`."""

from __future__ import annotations

import subprocess
import sys

import pytest

from conftest import REPOSITORY

EXAMPLES = REPOSITORY / "python/examples"


@pytest.mark.parametrize(
    ("example", "needs", "says"),
    [
        ("behaviour_cloning.py --episodes 6 --epochs 4", "torch", "of its actions"),
        ("ppo.py --steps 1024", "torch", "return of the last 20"),
        ("ppo_sb3.py --steps 1024", "stable_baselines3", "one episode, return"),
    ],
)
def test_an_example_runs(example: str, needs: str, says: str) -> None:
    pytest.importorskip(needs)
    program, *arguments = example.split()
    command = [sys.executable, EXAMPLES / program, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0 and says in done.stdout, done.stdout + done.stderr


def test_the_notebook_runs() -> None:
    pytest.importorskip("ipykernel")
    pytest.importorskip("matplotlib")
    client = pytest.importorskip("nbclient")
    import nbformat

    notebook = nbformat.read(EXAMPLES / "kitchens.ipynb", 4)
    client.NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    pictures = [output for cell in notebook.cells for output in cell.get("outputs", []) if "data" in output]
    assert sum("image/png" in output["data"] for output in pictures) >= 3


@pytest.mark.parametrize(
    "example",
    [
        "cart_pole.py",
        "corridor.py:make_env",
        "t_maze.py:make_env",
        "pendulum.py:make_env",
        "atari.py:make_env",
    ],
)
def test_an_environment_describes_itself(example: str) -> None:
    if example.startswith("atari"):
        pytest.importorskip("ale_py")
        pytest.importorskip("cv2")
    program = [EXAMPLES / example] if example.endswith(".py") else ["-m", "stillroom", "serve", EXAMPLES / example]
    done = subprocess.run([sys.executable, *program, "--describe"], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and '"observation"' in done.stdout, done.stderr
