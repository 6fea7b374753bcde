"""Video files by PyAV: the best video stream, its frames as a player shows them, and when each is shown.

What decodes of a damaged file is read; a warning says what it has lost.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from decomotion.errors import ClipError
from decomotion.lost_frames import Loss, Met, lost_frames

if TYPE_CHECKING:
    from av import Packet, VideoFrame
    from av.container import InputContainer
    from av.video.stream import VideoStream

log = logging.getLogger(__name__)

Image = npt.NDArray[np.uint8]

FALLBACK_RATE = 24.0
"""Frames a second of a file that says nothing of it."""
ROUNDING = 1e-3
"""Seconds by which a container may round the time of a frame: Matroska has whole milliseconds."""


@dataclass(frozen=True)
class VideoFile:
    """What was read of a video file."""

    frames: list[Image]
    """RGB [H, W, 3], from `begin` up to but without `end`."""
    times: npt.NDArray[np.float64]
    """Seconds of each, from 0."""
    pixel_aspect: float
    """Width of a pixel over its height."""
    count: int
    """How many frames there are before `end`."""


def read_video(path: Path, begin: int, end: int | None) -> VideoFile:
    """Reads the frames from `begin` up to but without `end`; None: all.

    Of several video streams it is that which the container holds to be the best, and none that is a picture. Raises
    `ClipError` where there is none, nothing decodes, or frames are of several sizes.
    """
    import av
    from av.error import FFmpegError

    url = f"file:{path.absolute()}"  # without it, a colon in a name would end that of a protocol
    video = None
    try:
        with av.open(url) as container:
            streams = _streams(container)
        for index in streams:
            with av.open(url) as container:
                video = _read(path, container, index, begin, end)
            if video.count > 1:
                break
    except FFmpegError as error:
        raise ClipError(
            f"{path} does not decode as a video ({error.strerror}); give a video file or a folder of frames"
        ) from error
    if video is None:
        raise ClipError(f"{path} has no video stream; give a video file or a folder of frames")
    if not video.count:
        raise ClipError(f"{path} has a video stream without frames; give another file")
    if len({frame.shape for frame in video.frames}) > 1:
        raise ClipError(f"{path} changes its frame size on the way; bring all frames to one size")
    return video


def _streams(container: InputContainer) -> list[int]:
    """The video streams, by which to try first: the best as ffmpeg holds, then the largest.

    More than one is tried where the first is a picture: a cover, or a preview.
    """
    best = container.streams.best("video")
    known = [stream for stream in container.streams.video if stream.codec_context is not None]
    return [
        stream.index for stream in sorted(known, key=lambda stream: (stream != best, -stream.width * stream.height))
    ]


def _read(path: Path, container: InputContainer, index: int, begin: int, end: int | None) -> VideoFile:
    stream = next(stream for stream in container.streams.video if stream.index == index)
    met = Met()
    frames, turned = [], False
    for number, frame in enumerate(islice(_decoded(container, stream, met), end)):
        if number >= begin:
            upright, turned = _upright(frame)
            frames.append(upright)
    times = _times(path.name, container, stream, met)
    aspect = float(stream.sample_aspect_ratio or 1)
    return VideoFile(frames, times[begin:] - times[begin:][:1], 1 / aspect if turned else aspect, len(times))


def _decoded(container: InputContainer, stream: VideoStream, met: Met) -> Iterator[VideoFrame]:
    """The frames that decode; `met` tells of them and of the others. Raises PyAV's error where none does."""
    from av.error import FFmpegError

    failure = None
    try:
        for packet in container.demux(stream):
            if packet.size:
                met.decode_times.append(None if packet.dts is None else float(packet.dts * packet.time_base))
            try:
                decoded = packet.decode()
            except FFmpegError as error:
                failure = failure or error
                met.losses.append(Loss(len(met.times), _seconds(packet)))
                continue
            for frame in decoded:
                if frame.is_corrupt:
                    met.losses.append(Loss(len(met.times), frame.time))
                else:
                    met.times.append(frame.time)
                    met.keys.append(frame.key_frame)
                    yield frame
    except FFmpegError as error:  # the file ends here: for ffmpeg too
        failure = failure or error
    if failure is not None and not met.times:
        raise failure
    met.unread = _unread(container, stream, met)


def _seconds(packet: Packet) -> float | None:
    return None if packet.pts is None else float(packet.pts * packet.time_base)


def _unread(container: InputContainer, stream: VideoStream, met: Met) -> int:
    """How many frames the file announces beyond its last."""
    announced = stream.frames if stream.average_rate == stream.guessed_rate or "mov" in container.format.name else 0
    if announced:
        return max(0, announced - len(met.decode_times))
    times = [time for time in met.times if time is not None]
    duration = re.fullmatch(r"(\d+):(\d+):(\d+\.?\d*)", stream.metadata.get("DURATION", ""))  # Matroska's
    if duration is None or len(times) < 2:
        return 0
    missing = 3600 * int(duration[1]) + 60 * int(duration[2]) + float(duration[3]) - times[-1]
    steps = np.diff(times)
    return round(missing / np.median(steps)) - 1 if missing > 1.5 * steps.max() else 0


def _times(name: str, container: InputContainer, stream: VideoStream, met: Met) -> npt.NDArray[np.float64]:
    """Seconds of the frames from 0: their own, else even ones. Says what is lost or assumed."""
    times = np.array(met.times, np.float64)  # None becomes nan
    own = container.format.name != "avi" or not stream.codec_context.has_b_frames  # AVI has but an order to decode in
    if own and len(times) and not np.isnan(times).any() and (np.diff(times) > 0).all():
        times = _on_grid(times - times[0], float(stream.guessed_rate or FALLBACK_RATE))
        lost = lost_frames(name, met, times)
    else:
        rate = _stated_rate(stream, met)
        times = np.arange(len(times)) / rate
        log.warning("%s does not say when its frames are shown: they are taken to be even, %.6g a second", name, rate)
        lost = lost_frames(name, met, None)
    if lost is not None:
        log.warning("%s", lost)
    return times


def _stated_rate(stream: VideoStream, met: Met) -> float:
    """Frames a second where their times are not known: that of decoding, or the container's or the codec's."""
    decoded = np.array(met.decode_times, np.float64)
    if len(decoded) > 1 and not np.isnan(decoded).any() and (np.diff(decoded) > 0).all():
        return float(f"{(len(decoded) - 1) / (decoded[-1] - decoded[0]):.12g}")
    bare = np.isnan(decoded).all()  # a stream without a container, the rate of which ffmpeg doubles
    return float((bare and stream.codec_context.framerate) or stream.guessed_rate or FALLBACK_RATE)


def _on_grid(times: npt.NDArray[np.float64], rate: float) -> npt.NDArray[np.float64]:
    """Times at the rate that the file states where they are those but for the container's rounding."""
    exact = np.round(times * rate) / rate
    return exact if np.abs(times - exact).max() <= min(ROUNDING, 0.1 / rate) else times


def _upright(frame: VideoFrame) -> tuple[Image, bool]:
    """The frame as a player shows it, and whether its sides changed places.

    Phones store portrait video lying down, some front cameras mirrored, with a display matrix beside it.
    """
    image = np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
    matrix = frame.side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return image, False
    (x_of_x, y_of_x, _), (x_of_y, y_of_y, _), _ = np.frombuffer(matrix, np.int32).reshape(3, 3).tolist()
    if turned := abs(x_of_y) > abs(x_of_x):
        image, x_of_x, y_of_y = image.swapaxes(0, 1), x_of_y, y_of_x
    return image[:: -1 if y_of_y < 0 else 1, :: -1 if x_of_x < 0 else 1], turned
