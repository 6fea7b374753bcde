"""What happens in a shot that is no cut: flashes, fades, repeated frames, shake, …, made into a clip's frames.

An incident takes frames [T, H, W, 3] uint8 RGB, the frame at which it happens and a source of chance, and returns
frames of the same size; of some the number changes.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

Frames = npt.NDArray[np.uint8]
Incident = Callable[[Frames, int, np.random.Generator], Frames]


def _clipped(values: npt.ArrayLike) -> Frames:
    return np.clip(values, 0, 255).astype(np.uint8)


def _dimmed(frames: Frames, gain_of: Callable[[npt.NDArray[np.intp]], npt.ArrayLike]) -> Frames:
    """Each frame times its gain."""
    gain = np.asarray(gain_of(np.arange(len(frames))), np.float32)
    return np.stack([_clipped(frame * each) for frame, each in zip(frames, gain, strict=True)])


def _changed(frames: Frames, where: slice, change: Callable[[Frames], npt.NDArray[np.floating]]) -> Frames:
    """Some of the frames, one by one, as `change` makes them."""
    return np.stack(
        [*frames[: where.start], *(_clipped(change(frame)) for frame in frames[where]), *frames[where.stop :]]
    )


def flash(num_frames: int, added: float) -> Incident:
    return lambda frames, at, _: _changed(frames, slice(at, at + num_frames), lambda frame: frame + added)


def flash_on_a_part(frames: Frames, at: int, _: np.random.Generator) -> Frames:
    """Half of the frame, with a soft edge."""
    ramp = np.clip(np.linspace(-2, 3, frames.shape[2], dtype=np.float32), 0, 1)[:, None]
    return _changed(frames, slice(at, at + 2), lambda frame: frame + 200 * ramp)


def of_one_colour(num_frames: int, level: float) -> Incident:
    return lambda frames, at, _: _changed(frames, slice(at, at + num_frames), lambda frame: 0.0 * frame + level)


def switched(gain: float | tuple[float, float, float]) -> Incident:
    """For good; the gain, or one for each channel."""
    factor = np.asarray(gain, np.float32)
    return lambda frames, at, _: _changed(frames, slice(at, len(frames)), lambda frame: frame * factor)


def grey_from_here(frames: Frames, at: int, _: np.random.Generator) -> Frames:
    return _changed(
        frames, slice(at, len(frames)), lambda frame: frame.mean(2, keepdims=True, dtype=np.float32).repeat(3, 2)
    )


def flicker(frames: Frames, _: int, chance: np.random.Generator) -> Frames:
    return _dimmed(frames, lambda number: chance.uniform(0.5, 1.4, len(number)))


def strobe(frames: Frames, at: int, _: np.random.Generator) -> Frames:
    """Every other of twelve frames is all but dark."""
    return _dimmed(frames, lambda number: np.where((number >= at) & (number < at + 12) & (number % 2 == 0), 0.1, 1))


def exposure_drift(frames: Frames, _: int, __: np.random.Generator) -> Frames:
    return _dimmed(frames, lambda number: np.linspace(1.2, 0.3, len(number)))


def fade_out(num_frames: int) -> Incident:
    """To black at the clip's last frame."""
    return lambda frames, _, __: _dimmed(frames, lambda number: np.clip((len(number) - 1 - number) / num_frames, 0, 1))


def fade_in(num_frames: int) -> Incident:
    return lambda frames, _, __: _dimmed(frames, lambda number: np.clip(number / num_frames, 0, 1))


def dip_to_black(frames: Frames, at: int, _: np.random.Generator) -> Frames:
    return _dimmed(frames, lambda number: np.clip(np.abs(number - at) / 6, 0, 1))


def doubled(frames: Frames, _: int, __: np.random.Generator) -> Frames:
    return frames.repeat(2, axis=0)


def pulled_down(frames: Frames, _: int, __: np.random.Generator) -> Frames:
    """24 frames a second played at 30: every fourth twice."""
    return frames[np.arange(len(frames) * 5 // 4) * 4 // 5]


def blended_down(frames: Frames, _: int, __: np.random.Generator) -> Frames:
    """24 frames a second played at 30: each the mean of its neighbours by time."""
    times = np.arange((len(frames) - 1) * 5 // 4) * 0.8
    return np.stack(
        [
            cv2.addWeighted(frames[int(time)], 1 - time % 1, frames[int(time) + 1], time % 1, 0).astype(np.uint8)
            for time in times
        ]
    )


def stall(frames: Frames, at: int, _: np.random.Generator) -> Frames:
    """One frame in the place of five, then on."""
    number = np.arange(len(frames))
    return frames[np.where((number > at) & (number < at + 5), at, number)]


def dropped(num_frames: int) -> Incident:
    return lambda frames, at, _: np.delete(frames, slice(at, at + num_frames), axis=0)


def passing_object(frames: Frames, at: int, chance: np.random.Generator) -> Frames:
    """Something close before the lens crosses within five frames; in the middle one it fills the view."""
    height, width = frames.shape[1:3]
    patches = chance.uniform(20, 90, (6, 9, 3)).astype(np.float32)
    surface = cv2.resize(patches, (int(1.3 * width), height), interpolation=cv2.INTER_CUBIC)
    result = frames.copy()
    for number, share in zip(range(at, min(at + 5, len(frames))), (-0.8, -0.5, 0.1, 0.6, 0.9), strict=False):
        left, right = max(0, int((share - 0.15) * width)), min(width, int((share + 1.15) * width))
        result[number, :, left:right] = _clipped(surface[:, : right - left])
    return result


def _seen_from(frames: Frames, shifts: npt.NDArray[np.floating], room: float) -> Frames:
    """The frames through a smaller window, brought back to their size; `shifts` (x, y) in [0, 1] of the `room` left."""
    height, width = frames.shape[1:3]
    inner = (int(width * (1 - room)), int(height * (1 - room)))
    corners = np.round(shifts * (width - inner[0], height - inner[1])).astype(int)
    return np.stack(
        [
            cv2.resize(frame[y : y + inner[1], x : x + inner[0]], (width, height), interpolation=cv2.INTER_LINEAR)
            for frame, (x, y) in zip(frames, corners, strict=True)
        ]
    ).astype(np.uint8)


def shake(frames: Frames, _: int, chance: np.random.Generator) -> Frames:
    """Up to an eighth of the view from frame to frame, either way."""
    return _seen_from(frames, chance.uniform(0, 1, (len(frames), 2)), 0.12)


def whip_pan(frames: Frames, at: int, _: np.random.Generator) -> Frames:
    """Across half of the view within three frames, each smeared along the way."""
    way = np.clip((np.arange(len(frames)) - at + 1) / 4, 0, 1)
    seen = _seen_from(frames, np.stack([way, np.full(len(frames), 0.5)], -1), 1 / 3)
    return _changed(seen, slice(at, at + 3), lambda frame: cv2.blur(frame, (max(3, frame.shape[1] // 8), 1)) * 1.0)


def out_of_focus(frames: Frames, at: int, _: np.random.Generator) -> Frames:
    sigma = frames.shape[2] / 30
    return _changed(frames, slice(at, at + 3), lambda frame: cv2.GaussianBlur(frame, (0, 0), sigma) * 1.0)


def compressed(frames: Frames, _: int, __: np.random.Generator) -> Frames:
    """JPEG at quality 5."""
    coded = (cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 5])[1] for frame in frames)
    return np.stack([np.asarray(cv2.imdecode(each, cv2.IMREAD_COLOR), np.uint8) for each in coded])


def noise(frames: Frames, _: int, chance: np.random.Generator) -> Frames:
    """Of a dark room: a standard deviation of 25 levels."""
    return np.stack([_clipped(frame + chance.normal(0, 25, frame.shape)) for frame in frames])


def text(frames: Frames, at: int, _: np.random.Generator) -> Frames:
    """A title over the middle and a bar over the lowest quarter appear and stay."""
    height, width = frames.shape[1:3]
    result = frames.copy()
    result[at:, height * 3 // 4 :] = 30
    for frame in result[at:]:
        place, size = (width // 20, height // 2), width / 180
        cv2.putText(frame, "A TITLE", place, cv2.FONT_HERSHEY_SIMPLEX, size, (250, 240, 60), max(2, width // 60))
    return result


def damaged(frames: Frames, at: int, chance: np.random.Generator) -> Frames:
    """A decoder's: two frames' lower half is of blocks from anywhere."""
    result, side = frames.copy(), 16
    height, width = frames.shape[1:3]
    for number in range(at, at + 2):
        for y in range(height // 2, height - side, side):
            for x in range(0, width - side, side):
                row, column = chance.integers(height - side), chance.integers(width - side)
                result[number, y : y + side, x : x + side] = frames[at, row : row + side, column : column + side]
    return result


def closer(frames: Frames, at: int, _: np.random.Generator) -> Frames:
    """The zoom jumps by a quarter."""
    nearer = _seen_from(frames[at:], np.full((len(frames) - at, 2), 0.5), 0.2)
    return np.concatenate([frames[:at], nearer])


INCIDENTS: dict[str, Incident] = {
    "nothing": lambda frames, _, __: frames,
    "flash of one frame": flash(1, 100),
    "flash of two frames": flash(2, 100),
    "flash, all but white": flash(2, 180),
    "white frame": of_one_colour(1, 255),
    "black frame": of_one_colour(1, 0),
    "four black frames": of_one_colour(4, 0),
    "flash on a part": flash_on_a_part,
    "light halved": switched(0.5),
    "light doubled": switched(2.0),
    "white balance switched": switched((1.3, 1.0, 0.6)),
    "colour to grey": grey_from_here,
    "flicker": flicker,
    "strobe": strobe,
    "exposure drifts": exposure_drift,
    "fade-out, 6 frames": fade_out(6),
    "fade-out, 12 frames": fade_out(12),
    "fade-out, 24 frames": fade_out(24),
    "fade-in, 6 frames": fade_in(6),
    "fade-in, 12 frames": fade_in(12),
    "fade-in, 24 frames": fade_in(24),
    "dip to black": dip_to_black,
    "every frame twice": doubled,
    "24 to 30, repeated": pulled_down,
    "24 to 30, blended": blended_down,
    "stall of 5 frames": stall,
    "3 frames dropped": dropped(3),
    "5 frames dropped": dropped(5),
    "object passes before the lens": passing_object,
    "camera shake": shake,
    "whip pan": whip_pan,
    "out of focus": out_of_focus,
    "JPEG at quality 5": compressed,
    "noise": noise,
    "title appears": text,
    "decoder's blocks": damaged,
    "zoom jumps": closer,
}
"""By what the table calls them."""
