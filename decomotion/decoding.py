"""Decoding a video stream by PyAV: its frames in order, and as a player shows them."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from decomotion.frames import Image
from decomotion.lost_frames import Loss, Met

if TYPE_CHECKING:
    from av import Packet, VideoFrame
    from av.container import InputContainer
    from av.video.stream import VideoStream

MARKED = 4
"""Every so many rows of a picture make up its mark."""
AVI = "avi"
"""A container without times: each frame has a place, which may be empty, and stays to be shown."""
UNKNOWN_KINDS = 16
"""Kinds of data beside a frame that FFmpeg may know and PyAV not yet."""


def stream_at(container: InputContainer, index: int) -> VideoStream:
    """The video stream of that index in the file."""
    return next(stream for stream in container.streams.video if stream.index == index)


def decoded(container: InputContainer, stream: VideoStream, met: Met) -> Iterator[VideoFrame]:
    """The frames that decode, from where the container is; `met` tells of them and of the others.

    Raises PyAV's error where none does.
    """
    from av.error import FFmpegError

    failure, shown = None, partial(_seconds, in_order=container.format.name == AVI)
    try:
        for packet in container.demux(stream):
            if packet.size:
                met.decode_times.append(None if packet.dts is None else float(packet.dts * packet.time_base))
            try:
                frames = packet.decode()
            except FFmpegError as error:
                failure = failure or error
                met.losses.append(Loss(len(met.times), shown(packet)))
                continue
            for frame in frames:
                if frame.is_corrupt:
                    met.losses.append(Loss(len(met.times), shown(frame)))
                else:
                    met.times.append(shown(frame))
                    met.keys.append(frame.key_frame)
                    yield frame
    except FFmpegError as error:  # the file ends here: for ffmpeg too
        failure = failure or error
    if failure is not None and not met.times:
        raise failure
    met.ended = True


def _seconds(of: Packet | VideoFrame, in_order: bool) -> float | None:
    """When it is shown; of a file that has but an order to decode in, when it is decoded."""
    time = of.dts if in_order else of.pts
    return None if time is None or of.time_base is None else float(time * of.time_base)


def mark(frame: VideoFrame) -> int:
    """A checksum of some rows of the picture as it is coded: frames that decode otherwise have another."""
    if frame.planes[0].line_size < 0:  # from the lowest row up, as in old AVIs, which leads out of PyAV's buffer
        frame = frame.reformat(format="gray")
    plane, form = frame.planes[0], frame.format
    if form.is_planar:
        columns = plane.width * -(-form.components[0].bits // 8)
    else:  # some have several pixels in a byte; what is behind a row differs each time
        columns = -(-plane.width * form.padded_bits_per_pixel // 8)
    content = np.frombuffer(memoryview(plane), np.uint8)
    rows = content[: plane.height * plane.line_size].reshape(plane.height, plane.line_size)
    colours = bytes(frame.planes[1]) if form.has_palette else b""  # which are not with every key frame
    return zlib.crc32(rows[::MARKED, :columns].tobytes() + colours)


def _with_known_data(frame: VideoFrame) -> VideoFrame:
    """The frame without the data beside it of kinds that FFmpeg knows and PyAV does not."""
    from av.filter import Graph
    from av.sidedata.sidedata import Type

    last_known = max(kind.value for kind in Type)
    graph = Graph()
    begin = graph.add_buffer(
        width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base or Fraction(1)
    )
    removing = [graph.add("sidedata", f"mode=delete:type={last_known + 1 + kind}") for kind in range(UNKNOWN_KINDS)]
    graph.link_nodes(begin, *removing, graph.add("buffersink")).configure()
    graph.vpush(frame)
    return graph.vpull()


@dataclass(frozen=True)
class Display:
    """How stored pictures are to be shown: where the stored x and y axes point to."""

    x: tuple[int, int] = (1, 0)
    y: tuple[int, int] = (0, 1)

    @staticmethod
    def of(frame: VideoFrame) -> Display:
        """By the display matrix beside a frame. Asked of every frame, PyAV would keep many in memory: of the first."""
        try:
            matrix = frame.side_data.get("DISPLAYMATRIX")
        except ValueError:  # data of a kind that PyAV has no name for, as EXIF, hides all
            matrix = _with_known_data(frame).side_data.get("DISPLAYMATRIX")
        if matrix is None:
            return Display()
        (x_of_x, y_of_x, _), (x_of_y, y_of_y, _), _ = np.frombuffer(matrix, np.int32).reshape(3, 3).tolist()
        return Display((x_of_x, y_of_x), (x_of_y, y_of_y))

    @property
    def is_turned(self) -> bool:
        """Whether height and width change places."""
        return abs(self.y[0]) > abs(self.x[0])

    def upright(self, image: Image) -> Image:
        """A stored picture [H, W, ...] as a player shows it.

        Phones store portrait video lying down, some front cameras mirrored.
        """
        (x_of_x, y_of_x), (x_of_y, y_of_y) = self.x, self.y
        if self.is_turned:
            image, x_of_x, y_of_y = image.swapaxes(0, 1), x_of_y, y_of_x
        return image[:: -1 if y_of_y < 0 else 1, :: -1 if x_of_x < 0 else 1]
