"""Films of episodes that are simulated again: what `render()` draws, as animated PNG, stills, or by ffmpeg as MP4."""

from __future__ import annotations

import struct
import subprocess
import traceback
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from stillroom.description import Refused
from stillroom.fault import told

# How much longer the last picture is shown, seconds.
LAST_S = 2.0


class Camera(gymnasium.Wrapper):
    """Keeps a picture of every state that an episode comes through."""

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        if env.render_mode != "rgb_array":
            raise Refused(
                f"the environment's render_mode is {env.render_mode!r}, and films need 'rgb_array': give the function"
                " that makes it a parameter `render_mode`"
            )
        self.pictures: list[NDArray[np.uint8]] = []
        self.problem: str | None = None

    def __getattr__(self, name: str) -> Any:
        # Such as `get_state`.
        return getattr(self.env, name)

    def reset(self, **arguments: Any) -> Any:
        """Begins another film."""
        returned = super().reset(**arguments)
        self.pictures = []
        self._keep()
        return returned

    def step(self, action: Any) -> Any:
        """A step, and its picture."""
        returned = super().step(action)
        self._keep()
        return returned

    def _keep(self) -> None:
        if self.problem:
            return
        step = len(self.pictures)
        try:
            picture = np.asarray(self.env.render())
        except Exception as error:
            # What is not installed is said in a sentence.
            if not isinstance(error, ImportError | gymnasium.error.DependencyNotInstalled):
                traceback.print_exc()
            self.problem = f"step {step}: its render() raised {told(error)}"
            return
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
            returned = f"{picture.dtype} {picture.shape}"
            self.problem = f"step {step}: its render() returned {returned}, not uint8 of height, width and 3"
            return
        self.pictures.append(picture.copy())


def write(images: dict[str, Any], name: str, pictures: Sequence[NDArray[np.uint8]], fps: float) -> int:
    """Writes a film in the format that a replay asks for. Returns the number of its pictures."""
    folder, form = Path(images["folder"]), images["format"]
    last = [pictures[-1]] * round(LAST_S * fps)
    if form == "png":
        (folder / name).mkdir(parents=True, exist_ok=True)
        for step, picture in enumerate(pictures):
            (folder / name / f"step-{step:03}.png").write_bytes(_animation([picture], fps))
    elif form == "apng":
        (folder / f"{name}.png").write_bytes(_animation(pictures, fps))
    else:
        ffmpeg, (height, width, _) = form["mp4"], pictures[0].shape
        # Colours are of two by two pixels.
        even = "pad=ceil(iw/2)*2:ceil(ih/2)*2"
        command = [ffmpeg["program"], "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        command += ["-s", f"{width}x{height}", "-r", str(fps), "-i", "-", "-c:v", ffmpeg["encoder"], "-vf", even]
        command += ["-pix_fmt", "yuv420p", "-movflags", "+faststart", str(folder / f"{name}.mp4")]
        bytes_of_all = b"".join(picture.tobytes() for picture in [*pictures, *last])
        done = subprocess.run(command, input=bytes_of_all, capture_output=True, check=False)
        if done.returncode:
            raise Refused(f"ffmpeg ended with {done.returncode}: {done.stderr.decode(errors='replace').strip()}")
    return len(pictures)


def _animation(pictures: Sequence[NDArray[np.uint8]], fps: float) -> bytes:
    """A PNG, animated if there are several pictures."""
    height, width, _ = pictures[0].shape
    parts = [b"\x89PNG\r\n\x1a\n", _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))]
    if len(pictures) > 1:
        parts.append(_chunk(b"acTL", struct.pack(">II", len(pictures), 0)))
    number = 0
    for at, picture in enumerate(pictures):
        rows = np.zeros((height, 1 + 3 * width), np.uint8)
        rows[:, 1:] = picture.reshape(height, -1)
        packed = zlib.compress(rows.tobytes(), 6)
        if len(pictures) > 1:
            shown_ms = 1000 / fps + (1000 * LAST_S if at + 1 == len(pictures) else 0)
            control = struct.pack(">IIIIIHHBB", number, width, height, 0, 0, round(shown_ms), 1000, 0, 0)
            parts.append(_chunk(b"fcTL", control))
            number += 1
        if at == 0:
            parts.append(_chunk(b"IDAT", packed))
        else:
            parts.append(_chunk(b"fdAT", struct.pack(">I", number) + packed))
            number += 1
    return b"".join([*parts, _chunk(b"IEND", b"")])


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
