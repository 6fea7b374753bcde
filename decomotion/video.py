"""Video files by PyAV: the best video stream, its frames as a player shows them, and when each is shown.

What decodes of a damaged file is read; a warning says what it has lost.
"""

from __future__ import annotations

import logging
import re
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from decomotion.decoding import AVI, decoded, stream_at
from decomotion.errors import ClipError
from decomotion.frames import Frames
from decomotion.greys import GreyFile
from decomotion.lost_frames import Met, lost_frames
from decomotion.source_file import SourceFile
from decomotion.survey import Survey
from decomotion.video_frames import FrameIndex, VideoFrames, in_grey

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.stream import VideoStream

log = logging.getLogger(__name__)

FALLBACK_RATE = 24.0
"""Frames a second of a file that says nothing of it."""
FATAL_PIXELS = frozenset({"yaf32le", "yaf32be"})
"""Grey and alpha in floats: FFmpeg ends the process at their conversion, while of others it tells that it has none."""
ROUNDING = 1e-3
"""Seconds by which a container may round the time of a frame: Matroska has whole milliseconds."""


@dataclass(frozen=True)
class VideoFile:
    """What an opened video file holds."""

    frames: Frames
    """RGB [T, H, W, 3], from `begin` up to but without `end`, decoded when asked for."""
    times: npt.NDArray[np.float64]
    """Seconds of each, from 0."""
    pixel_aspect: float
    """Width of a pixel over its height."""
    count: int
    """How many frames there are before `end`."""


def open_video(path: Path, begin: int, end: int | None) -> VideoFile:
    """Opens the frames from `begin` up to but without `end`; None: all. They are decoded once, and none is kept.

    With `end`, they are not where the cache knows the file as far as that (`decomotion.survey`).

    Of several video streams it is that which the container holds to be the best, and none that is a picture. Raises
    `ClipError` where there is none, nothing decodes, or frames are of several sizes.
    """
    import av
    from av.error import FFmpegError

    video, file = None, SourceFile(path)
    try:
        with av.open(file.url) as container:
            streams = _streams(container)
        for index in streams:
            with av.open(file.url) as container:
                video = _opened(file, container, index, begin, end)
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


def _opened(file: SourceFile, container: InputContainer, index: int, begin: int, end: int | None) -> VideoFile:
    stream, greys = stream_at(container, index), None
    survey = None if end is None else Survey.kept(file, index, end)
    if survey is not None:
        own = np.array(survey.met.times, np.float64)
    else:
        survey, greys = _surveyed(file, container, stream, begin, end)
        own = _own_times(container, stream, survey.met)
        if own is not None and len(own):
            survey.keep(file, index)
    met = survey.met
    met.unread = _unread(container, stream, met) if met.ended else 0
    times = _times(file.shown.name, stream, met, own)
    frames = VideoFrames(file, index, _index(survey, begin, own is not None, greys))
    aspect = float(stream.sample_aspect_ratio or 1)
    aspect = 1 / aspect if survey.display.is_turned else aspect
    return VideoFile(Frames(frames), times[begin:] - times[begin:][:1], aspect, len(times))


def _surveyed(
    file: SourceFile, container: InputContainer, stream: VideoStream, begin: int, end: int | None
) -> tuple[Survey, GreyFile | None]:
    """Decodes the file up to `end`; small pictures are of the frames from `begin` on, None where there is no room.

    Raises `ClipError` where those are of several sizes, or pixels are not to be converted.
    """
    from av.video.reformatter import VideoReformatter

    survey, converter, greys = Survey(), VideoReformatter(), None
    with suppress(OSError):  # no room for temporary files: whoever wants small pictures makes them
        greys = GreyFile()
    for number, frame in enumerate(islice(decoded(container, stream, survey.met), end)):
        if frame.format.name in FATAL_PIXELS:
            raise ClipError(
                f"{file.shown} has pixels ({frame.format.name}) that FFmpeg cannot convert; save it without alpha"
            )
        survey.add(frame)
        if number < begin:
            continue
        if survey.sizes[number] != survey.sizes[begin]:
            raise ClipError(f"{file.shown} changes its frame size on the way; bring all frames to one size")
        if greys is not None:
            small = in_grey(frame, converter, survey.display)  # pixels that cannot be converted are no full disk
            try:
                greys.add(small)
            except OSError:
                greys = None
    return survey, greys


def _index(survey: Survey, begin: int, times_tell: bool, greys: GreyFile | None) -> FrameIndex:
    """What the frames from `begin` on are found again by."""
    pts = [each for each in survey.pts if each is not None] if times_tell else None
    entries = [number for number, key in enumerate(survey.met.keys) if key and pts is not None]
    height, width = survey.sizes[-1] if survey.sizes else (0, 0)
    size = (width, height) if survey.display.is_turned else (height, width)
    shape = (max(0, len(survey.marks) - begin), *size, 3)
    return FrameIndex(shape, begin, survey.display, survey.marks, pts, entries, greys)


def _unread(container: InputContainer, stream: VideoStream, met: Met) -> int:
    """How many frames the file announces beyond its last."""
    announced = stream.frames if stream.average_rate == stream.guessed_rate or "mov" in container.format.name else 0
    if announced:
        return max(0, announced - _reached(container, stream, met))
    times = [time for time in met.times if time is not None]
    duration = re.fullmatch(r"(\d+):(\d+):(\d+\.?\d*)", stream.metadata.get("DURATION", ""))  # Matroska's
    if duration is None or len(times) < 2:
        return 0
    missing = 3600 * int(duration[1]) + 60 * int(duration[2]) + float(duration[3]) - times[-1]
    steps = np.diff(times)
    return round(missing / np.median(steps)) - 1 if missing > 1.5 * steps.max() else 0


def _reached(container: InputContainer, stream: VideoStream, met: Met) -> int:
    """How many of the announced frames were read; those of AVI that were left out on purpose count too."""
    last = met.decode_times[-1] if met.decode_times else None
    places = 0 if container.format.name != AVI or last is None else round(last * float(stream.average_rate or 0)) + 1
    return max(len(met.decode_times), places)


def _own_times(container: InputContainer, stream: VideoStream, met: Met) -> npt.NDArray[np.float64] | None:
    """Seconds of the frames as the file has them, strictly increasing; None where it does not say them."""
    times = np.array(met.times, np.float64)  # None becomes nan
    told = container.format.name != AVI or not stream.codec_context.has_b_frames  # AVI has but an order to decode in
    return times if told and not np.isnan(times).any() and (np.diff(times) > 0).all() else None


def _times(name: str, stream: VideoStream, met: Met, own: npt.NDArray[np.float64] | None) -> npt.NDArray[np.float64]:
    """Seconds of the frames from 0: their own, else even ones. Says what is lost or assumed."""
    if own is not None and len(own):
        times = _on_grid(own - own[0], float(stream.guessed_rate or FALLBACK_RATE))
        lost = lost_frames(name, met, times)
    else:
        rate = _stated_rate(stream, met)
        times = np.arange(len(met.times)) / rate
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
