"""The .onnx file as a contract: names, axes and metadata that the exporter writes and the runtime relies on.

All coordinates are pixels of the clip's own resolution, pixel centres at integers; frames count from 0.

Inputs
    queries             float32 [N, 3]  (t, x, y): the frame and place where each point is seen
    frames              int64   [M]     the frames in which to look for it
Outputs
    tracks              float32 [N, M, 2]  (x, y) of each point in each frame, inside or outside the image
    occlusion           float32 [N, M]     score in [0, 1]; above the metadata's threshold: occluded
    rgb                 float32 [N, 3]     colour of the query's own ray in [0, 1], both volumes fused
    rgb_static          float32 [N, 3]     the static volume alone, as if it were opaque
    rgb_dynamic         float32 [N, 3]     the dynamic volume alone, likewise
    static_confidence   float32 [N]        share of the ray that is static, in [0, 1]; 1 of a ray that meets nothing
    depth               float32 [N]        pseudo-depth of the ray, 0 (near) to `FARTHEST`
    static_opacity      float32 [N]        how opaque the static volume alone is, in [0, 1]; 0: it has a hole there
The first two answer where M > 0; the others where M = 0, and are NaN, not computed, where M > 0. Files of an earlier
version may lack the last, have black in `rgb_static` where the static volume has a hole, and a `static_confidence` of 0
where a ray meets nothing.
"""

from __future__ import annotations

from decomotion.pseudo_depth import FAR

FORMAT_VERSION = 1
"""Raised whenever a runtime of the former version would misread the file."""

OPSET, IR_VERSION = 18, 8
"""Of ONNX 1.13; the oldest onnxruntime that the package declares reads up to opset 21 and IR version 10."""

QUERIES, FRAMES = "queries", "frames"
INPUTS = (QUERIES, FRAMES)

TRACKS, OCCLUSION = "tracks", "occlusion"
RGB, RGB_STATIC, RGB_DYNAMIC = "rgb", "rgb_static", "rgb_dynamic"
STATIC_CONFIDENCE, DEPTH, STATIC_OPACITY = "static_confidence", "depth", "static_opacity"
TRACKING = (TRACKS, OCCLUSION)
"""What is answered where M > 0."""
APPEARANCE = (RGB, RGB_STATIC, RGB_DYNAMIC, STATIC_CONFIDENCE, DEPTH, STATIC_OPACITY)
"""What is answered where M = 0."""
OUTPUTS = (*TRACKING, *APPEARANCE)
REQUIRED_OUTPUTS = OUTPUTS[:-1]
"""Those that files of every version have."""

META_FORMAT_VERSION = "decomotion.format_version"
META_CLIP_NAME = "decomotion.clip_name"
META_NUM_FRAMES = "decomotion.num_frames"
META_HEIGHT = "decomotion.height"
META_WIDTH = "decomotion.width"
META_FPS = "decomotion.fps"
META_TIMES = "decomotion.times"
"""Seconds of each frame from 0, a JSON list; only where the frames are not `fps` a second throughout."""
META_PIXEL_ASPECT = "decomotion.pixel_aspect"
"""Width of the clip's pixels over their height; only where they are not square."""
META_PRESET = "decomotion.preset"
META_OCCLUSION_THRESHOLD = "decomotion.occlusion_threshold"
META_OBJECT_SHARE = "decomotion.object_share"
"""An object owns a point whose `static_confidence` is below 1 less this: it is followed as one of the object."""
META_WRITER_VERSION = "decomotion.version"
META_BYTES_PER_RAY = "decomotion.bytes_per_ray"
"""Working memory that one query takes in one frame."""
META_BYTES_PER_RENDERED_RAY = "decomotion.bytes_per_rendered_ray"
"""Working memory that one query takes where M = 0: its own ray is rendered, whatever is baked."""
META_BAKE = "decomotion.bake"
META_PRECISION = "decomotion.precision"
META_DEVIATION = "decomotion.deviation"
"""`mean p99`, in pixels: how far tracks are from those of the same graph in float32."""

META_FITTED_BY = "decomotion.fitted_by"
"""Version of the code that fitted it, with its commit where that was known; `META_WRITER_VERSION`: that exported it."""
META_STEPS = "decomotion.steps"
"""That the fit took."""
META_BUDGET = "decomotion.budget"
"""What the fit was given: `steps`, and `seconds` or null, in JSON; where there are seconds, steps do not count."""
META_LICENCE = "decomotion.licence"
"""Of the clip, in a line; only where it was told."""

META_QUALITY = "decomotion.quality"
"""How good the fit is, `decomotion.quality.Quality` in JSON; only where it was measured."""

LAYERS = ("fused", "static", "dynamic", "mask", "depth")
"""What can be rendered of a frame (`layers.py`; the page too)."""
FARTHEST = FAR
"""Pseudo-depth at the far end of every ray."""
HOLE = 0.1
"""Static opacity below which the static volume has a hole: its layer becomes transparent there."""
