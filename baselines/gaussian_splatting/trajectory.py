"""A flight along a capture's cameras, rendered to a video."""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import torch
from scipy.spatial.transform import Rotation, Slerp

from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import Gaussians
from baselines.gaussian_splatting.rasterizer import render
from scenediff_classic.errors import InputError
from scenediff_classic.workspace import writing


def smooth_path(cameras: Sequence[PinholeCamera], between: int = 15) -> list[PinholeCamera]:
    """Cameras from each to the next: turned evenly, moved evenly.

    Parameters
    ----------
    between : int
        Steps from one given camera to the next.

    Raises
    ------
    InputError
        If there is no camera.
    """
    if not cameras:
        raise InputError("A trajectory needs at least one camera.")
    if len(cameras) == 1:
        return list(cameras)
    poses = np.stack([c.cam_from_world for c in cameras])
    turns = Rotation.from_matrix(poses[:, :3, :3])
    centres = np.stack([-p[:3, :3].T @ p[:3, 3] for p in poses])
    given = np.arange(len(cameras))
    times = np.linspace(0, len(cameras) - 1, (len(cameras) - 1) * between + 1)
    rotations = Slerp(given, turns)(times).as_matrix()
    path = []
    for time, rotation in zip(times, rotations, strict=True):
        centre = [np.interp(time, given, centres[:, k]) for k in range(3)]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
        path.append(replace(cameras[round(time)], cam_from_world=pose))
    return path


def write_trajectory(
    path: Path, gaussians: Gaussians, cameras: Sequence[PinholeCamera], fps: int = 30
) -> None:
    """Render one frame a camera to an MP4 (H.264); all frames have the first camera's size.

    The file appears complete or not at all. Sizes are made even, as the codec needs.

    Raises
    ------
    InputError
        If there is no camera.
    OutputError
        If the file cannot be written.
    """
    if not cameras:
        raise InputError("A trajectory needs at least one camera.")
    height, width = cameras[0].height // 2 * 2, cameras[0].width // 2 * 2
    temporary = path.with_name(f".{path.stem}.tmp.mp4")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with av.open(str(temporary), "w") as container:
                stream = container.add_stream("libx264", rate=fps, options={"crf": "18"})
                stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
                for index, camera in enumerate(cameras):
                    with torch.no_grad():
                        rgb = render(gaussians, camera.resized(height, width)).rgb
                    shown = (rgb.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()
                    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(shown), format="rgb24")
                    frame.pts, frame.time_base = index, Fraction(1, fps)
                    container.mux(stream.encode(frame))
                container.mux(stream.encode())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
