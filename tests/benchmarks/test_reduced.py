"""A model of a small copy, asked in pixels of the clip."""

from pathlib import Path

import numpy as np

from harness.reduced import ReducedTracker
from tiny_model import write_tiny_model


def test_places_by_hand(tmp_path: Path):
    path = write_tiny_model(tmp_path / "model.onnx", num_frames=6, height=40, width=48, clip_name="slide")
    tracker = ReducedTracker(path, 96, 120)  # twice as wide, three times as high
    tracks = tracker.track([(0, 6.5, 13.0), (0, 95.5, 119.5)], [0, 5])
    assert (tracks.size, tracker.facts.width, tracker.facts.height) == ((120, 96), 96, 120)
    np.testing.assert_allclose(tracks.xy[0], [(6.5, 13), (21.5, 5.5)], atol=1e-4)  # 1.5 and -0.5 a frame in the copy
    assert tracker.on_object([(0, 6.5, 13.0), (0, 95.5, 119.5)]).shape == (2,)
