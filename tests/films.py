"""Small videos made on the fly, whose frames carry their own number in black and white blocks."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import numpy as np
from av.video.stream import VideoStream

CLOCK = 1000  # time stamps of the videos below are in milliseconds


def numbered(number: int, height: int = 48, width: int = 64) -> np.ndarray:
    """A picture that shows `number` as ten bits along its top, over a colour ramp."""
    picture = np.zeros((height, width, 3), np.uint8)
    picture[..., 0] = np.linspace(30, 220, width)[None]
    picture[..., 1] = np.linspace(220, 30, height)[:, None]
    picture[..., 2] = 90
    block = width // 10
    for bit in range(10):
        picture[: height // 3, bit * block : (bit + 1) * block] = 255 * (number >> bit & 1)
    return picture


def number_in(picture: np.ndarray) -> int:
    """The number that `numbered` wrote, whatever the compression."""
    height, width = picture.shape[:2]
    centres = (np.arange(10) * (width // 10) + width // 20).astype(int)
    bits = picture[height // 6, centres].mean(axis=-1) > 127
    return int((bits << np.arange(10)).sum())


def write_film(
    path: Path,
    times_ms: Sequence[int],
    pictures: Sequence[np.ndarray] | None = None,
    *,
    codec: str = "mpeg4",
    matrix: Sequence[int] | None = None,
    codec_options: dict[str, str] | None = None,
    container_options: dict[str, str] | None = None,
) -> Path:
    """Encode one picture per presentation time; without `pictures`, their numbers."""
    pictures = pictures or [numbered(i) for i in range(len(times_ms))]
    with av.open(str(path), "w", container_options=container_options or {}) as container:
        stream = cast(VideoStream, container.add_stream(codec, rate=25, options=codec_options))
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.bit_rate = 2_000_000
        stream.codec_context.time_base = stream.time_base = Fraction(1, CLOCK)
        if matrix is not None:
            stream.set_display_matrix(matrix)
        for time, picture in zip(times_ms, pictures, strict=True):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = time, Fraction(1, CLOCK)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def write_sound(path: Path) -> Path:
    """A tenth of a second of silence, and no picture track."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=8000, layout="mono")
        silence = np.zeros((1, 800), np.float32)
        frame = av.AudioFrame.from_ndarray(silence, format="fltp", layout="mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path
