"""How many frames a clip has does not show in the memory that drawing on it or showing it takes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from clip_files import write_video
from tiny_model import write_tiny_model

HEIGHT, WIDTH = 258, 516
FEW, MANY = 60, 240
FRAME = HEIGHT * WIDTH * 3

RUN = """
import sys
from importlib import import_module
code = import_module(sys.argv[1]).main(sys.argv[2:])
peak = next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM"))
print("peak", 1024 * int(peak))
sys.exit(code)
"""


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """Of two lengths: a texture that drifts."""
    folder = tmp_path_factory.mktemp("videos")
    texture = np.random.default_rng(0).integers(0, 256, (HEIGHT // 6, WIDTH // 6 + MANY, 3), dtype=np.uint8)
    wide = texture.repeat(6, axis=0).repeat(6, axis=1)
    frames = np.lib.stride_tricks.sliding_window_view(wide, WIDTH, axis=1)[:, : 2 * MANY : 2].transpose(1, 0, 3, 2)
    options = {"preset": "ultrafast", "crf": "23"}
    return {count: write_video(folder / f"{count}.mp4", frames[:count], options=options) for count in (FEW, MANY)}


def peak(command: str, *arguments: str | Path) -> int:
    """Bytes of a process of its own, at its largest."""
    if not Path("/proc/self/status").is_file():
        pytest.skip("needs /proc")
    done = subprocess.run(
        [sys.executable, "-c", RUN, command, *arguments], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return int(done.stdout.rsplit("peak ", 1)[1])


def grown(videos: dict[int, Path], folder: Path, command: str, *arguments: str) -> int:
    """Bytes that the longer video takes more than the shorter one; `OUT` in an argument is a folder for each."""
    peaks = []
    for count in (FEW, MANY):
        model = write_tiny_model(folder / f"{count}.onnx", num_frames=count, height=HEIGHT, width=WIDTH)
        named = [each.replace("OUT", str(folder / str(count))) for each in arguments]
        peaks.append(peak(command, model, "--clip", videos[count], *named))
    return peaks[1] - peaks[0]


def test_drawing_tracks(videos: dict[int, Path], tmp_path: Path):
    arguments = ("--grid", "128@0", "--out", "OUT.npz", "--overlay", "OUT.mp4")
    # all frames would be 180 more; what is told of each frame is some hundred bytes
    assert grown(videos, tmp_path, "decomo_runtime.cli", *arguments) < 40 * FRAME


def test_showing_a_clip(videos: dict[int, Path], tmp_path: Path):
    assert grown(videos, tmp_path, "decomo_runtime.view.cli", "--export", "OUT") < 40 * FRAME
