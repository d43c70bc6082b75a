"""Videos: frames chosen by presentation time, decoded strictly from front to back.

Seeking is never used: it lands on wrong frames in files with a variable frame rate.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar, cast

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.sidedata.sidedata import SideData
from av.sidedata.sidedata import Type as SideDataType
from av.stream import Disposition
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from scenediff_classic.errors import InputError
from scenediff_classic.pictures import Picture, Turn, check_size, shrink

# fmt: off
VIDEO_SUFFIXES = frozenset((
    ".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".3gp", ".mts", ".m2ts",
    ".ts", ".wmv",
))
# fmt: on

T = TypeVar("T")

_RESTART_S = 1.0  # time stamps that jump back by more than this belong to a joined recording
_TIME_SLACK = 1e-6  # time stamps are rounded to the container's clock


@dataclass(frozen=True)
class Sampling:
    """Which frames of a video to take: those nearest to ``start_s + k / fps``."""

    fps: float = 1.0
    start_s: float = 0.0
    """Seconds after the first frame."""
    end_s: float | None = None
    """Frames from here on are left out; None = up to the end."""

    def __post_init__(self) -> None:
        """Refuse rates and ranges that select nothing."""
        if not (math.isfinite(self.fps) and self.fps > 0):
            raise InputError(f"The frame rate must be a number above 0, not {self.fps:g}.")
        if not (math.isfinite(self.start_s) and self.start_s >= 0):
            raise InputError(f"A range must start at 0 s or later, not at {self.start_s:g} s.")
        if self.end_s is not None and not self.end_s > self.start_s:
            raise InputError(
                f"A range must end after its start, unlike {self.start_s:g} s to {self.end_s:g} s."
            )

    @property
    def whole(self) -> bool:
        """Whether the range is the whole video."""
        return self.start_s == 0 and self.end_s is None


def nearest_in_time(
    timed: Iterator[tuple[float, T]], sampling: Sampling
) -> Iterator[tuple[float, T]]:
    """Of items in order of time, those nearest to each sampling time; each at most once.

    Sampling times after the last item have none, and of two equally near items the earlier one
    is taken. At most one item is held back, whatever the rate.

    Parameters
    ----------
    timed : iterator of (time in seconds, item)
        Times strictly increase.
    """
    held: tuple[float, T] | None = None  # the item before, unless it was already taken
    before = -math.inf
    due = 0  # number of the next sampling time
    for time, item in timed:
        if time < sampling.start_s - _TIME_SLACK:
            continue
        if sampling.end_s is not None and time >= sampling.end_s - _TIME_SLACK:
            return
        last = math.floor((time - sampling.start_s) * sampling.fps + _TIME_SLACK)
        taken = False
        if last >= due:  # sampling times due..last lie between the item before and this one
            first_s = sampling.start_s + due / sampling.fps
            last_s = sampling.start_s + last / sampling.fps
            if held and first_s - before <= time - first_s:
                yield held
            if taken := last_s - before > time - last_s:
                yield time, item
            due = last + 1
        held = None if taken else (time, item)
        before = time


def read_clip(
    path: Path,
    sampling: Sampling,
    max_long_side: int,
    warn: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> Iterator[Picture]:
    """Upright frames of a video, one by one, reduced to `max_long_side`.

    Damaged parts and an early end are passed over with a warning, as long as some frames decode.

    Raises
    ------
    InputError
        If the file is no video, has no picture track, or no frame of the range can be decoded.
    """
    with _opened(path) as (container, stream):
        step = float(1 / stream.average_rate) if stream.average_rate else 1 / 30
        clock = _Clock(step)
        declared = _declared_seconds(container, stream)
        expected = _expected_count(declared, sampling)
        damage: list[str] = []
        count = 0
        timed = clock.timed(_decoded(container, stream, damage))
        for time, frame in nearest_in_time(timed, sampling):
            yield _picture(path, count, time, frame, max_long_side)
            count += 1
            progress(count, max(count, expected) if expected else 0)
        if count == 0:
            raise _nothing_found(path, clock.last, sampling)
        _warn_of_faults(path, stream, damage, clock.last + step, declared, sampling, warn)


@dataclass
class _Clock:
    """Turns raw time stamps into strictly increasing seconds since the first frame."""

    step: float
    last: float = -math.inf
    offset: float | None = None

    def timed(self, frames: Iterator[VideoFrame]) -> Iterator[tuple[float, VideoFrame]]:
        for frame in frames:
            time = self._time(frame)
            if time > self.last:
                self.last = time
                yield time, frame

    def _time(self, frame: VideoFrame) -> float:
        following = self.last + self.step if math.isfinite(self.last) else 0.0
        if frame.pts is None or not frame.time_base:
            return following
        raw = float(frame.pts * frame.time_base)
        if self.offset is None or raw + self.offset < self.last - _RESTART_S:
            self.offset = following - raw
        return raw + self.offset


@contextmanager
def _opened(path: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    """The container and its picture track; every failure to open becomes one sentence."""
    try:
        file = path.open("rb")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from error
    with file:
        if not file.read(1):
            raise InputError(f"{path} is empty (0 bytes).")
        file.seek(0)
        try:  # an open file, not a name: no playlist or odd name can make FFmpeg open anything else
            container = av.open(
                file, "r", metadata_errors="ignore", options={"protocol_whitelist": "file"}
            )
        except (FFmpegError, OSError, ValueError) as error:
            raise InputError(
                f"{path} is neither a picture nor a video, or it is damaged or cut short."
            ) from error
        with container:
            cover = Disposition.attached_pic
            tracks = [s for s in container.streams.video if not s.disposition & cover]
            if not tracks:
                raise InputError(f"{path} has no picture track: it is a sound file, or damaged.")
            if tracks[0].codec_context is None:
                raise InputError(f"{path} uses a video format that cannot be decoded here.")
            tracks[0].thread_type = "AUTO"
            yield container, tracks[0]


def _decoded(
    container: InputContainer, stream: VideoStream, damage: list[str]
) -> Iterator[VideoFrame]:
    """All sound frames in presentation order; appends to `damage` what had to be passed over."""
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets)
        except StopIteration:
            return
        # The container itself is broken, and nothing follows. (OSError: it points to a place
        # outside the file; IndexError: PyAV's at the end, if more tracks turned up on the way.)
        except (FFmpegError, OSError, IndexError) as error:
            damage.append(str(error))
            packet = None
        try:
            if packet is not None and packet.is_corrupt:
                damage.append("incomplete packet")
                continue
            frames = stream.decode(packet)
        except FFmpegError as error:
            damage.append(str(error))
            frames = []
        for frame in frames:
            if frame.is_corrupt:
                damage.append("incomplete frame")
            else:
                yield frame
        if packet is None:
            return


def _picture(path: Path, index: int, time: float, frame: VideoFrame, max_long_side: int) -> Picture:
    check_size(frame.width, frame.height, what=f"A frame of {path}")
    turn = _display_turn(frame)
    width, height = turn.size(frame.width, frame.height)
    image = turn.apply(shrink(frame.to_ndarray(format="rgb24"), max_long_side))
    return Picture(f"{path.stem}#{index}", image, width, height, time_s=time)


def _display_turn(frame: VideoFrame) -> Turn:
    """The turn that the container asks players for, to the nearest multiple of 90 degrees.

    The display matrix [a b u; c d v; x y w] maps stored (x, y) to (a x + c y, b x + d y); it also
    holds mirror images, of which PyAV's `frame.rotation` knows nothing.
    """
    for item in cast(Iterable[SideData], frame.side_data):
        if item.type == SideDataType.DISPLAYMATRIX:
            a, b, _, c, d = (int(v) for v in np.frombuffer(bytes(item), np.int32)[:5])
            if abs(b) + abs(c) > abs(a) + abs(d):
                return Turn(transpose=True, mirror_x=c < 0, mirror_y=b < 0)
            return Turn(mirror_x=a < 0, mirror_y=d < 0)
    return Turn()


def _declared_seconds(container: InputContainer, stream: VideoStream) -> float | None:
    """How long the video says it is; files are often wrong about it."""
    if stream.duration and stream.time_base:
        return float(stream.duration * stream.time_base)
    return container.duration / av.time_base if container.duration else None


def _expected_count(declared: float | None, sampling: Sampling) -> int:
    """About how many frames will be sampled; 0 = unknown."""
    end = min((t for t in (declared, sampling.end_s) if t is not None), default=0.0)
    return max(math.ceil((end - sampling.start_s) * sampling.fps), 0)


def _nothing_found(path: Path, last: float, sampling: Sampling) -> InputError:
    if not math.isfinite(last):
        return InputError(f"No frame of {path} can be decoded: the file is damaged or cut short.")
    end = f" to {sampling.end_s:g} s" if sampling.end_s is not None else ""
    return InputError(
        f"{path} has no frame in the range from {sampling.start_s:g} s{end}: "
        f"the frames decoded reach up to {last:.2f} s."
    )


def _warn_of_faults(
    path: Path,
    stream: VideoStream,
    damage: list[str],
    reached: float,
    declared: float | None,
    sampling: Sampling,
    warn: Callable[[str], None],
) -> None:
    if damage:
        warn(f"{path}: {len(damage)} damaged part(s) were passed over.")
    if sampling.end_s is None and declared and reached < declared - max(0.5, 0.02 * declared):
        warn(
            f"{path} ends at {reached:.1f} s, although its header says {declared:.1f} s: "
            "the file seems to be cut short."
        )
    if (stream.sample_aspect_ratio or 1) != 1:
        warn(f"{path} has pixels that are not square, which makes camera estimates less exact.")
