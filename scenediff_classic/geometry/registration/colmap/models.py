"""Finished models: reading, writing, and a last bundle adjustment."""

from pathlib import Path

import numpy as np
import pycolmap
from jaxtyping import Float64

from scenediff_classic.errors import InputError
from scenediff_classic.geometry.registration.sparse_model import (
    PosedPicture,
    SparseModel,
    project_points,
)
from scenediff_classic.types import Lens, SparsePoints


def adjust(
    folder: Path, output: Path, loss_scale: float, *, lens: bool, centre: bool = False
) -> Path:
    """Bundle adjustment under Cauchy's loss; writes the model to `output` and returns it.

    Parameters
    ----------
    loss_scale : float
        Errors far above this many pixels hardly count.
    lens : bool
        Refine focal length and distortion.
    centre : bool
        Refine the optical centre.
    """
    model = pycolmap.Reconstruction(folder)
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_focal_length = options.refine_extra_params = lens
    options.refine_principal_point = centre
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = loss_scale
    options.ceres.solver_options.num_threads = 1  # as in mapping: sums must not depend on threads
    options.ceres.solver_options.max_num_iterations = 50
    options.ceres.solver_options.function_tolerance = 1e-6
    config = pycolmap.BundleAdjustmentConfig()
    for number in sorted(model.reg_image_ids()):
        config.add_image(number)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    model.update_point_3d_errors()
    output.mkdir(parents=True, exist_ok=True)
    model.write(output)
    return output


def read_model(folder: Path) -> SparseModel:
    """Read a COLMAP model, text or binary.

    Raises
    ------
    InputError
        If the folder holds no readable model, or a camera model with another lens formula.
    """
    try:
        model = pycolmap.Reconstruction(folder)
    except (ValueError, RuntimeError, IndexError) as error:
        raise InputError(f"{folder} does not hold a COLMAP model that can be read.") from error
    images = sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name)
    position = {image.image_id: number for number, image in enumerate(images)}
    pictures = tuple(
        PosedPicture(image.name, lens_of(image.camera, folder), _matrix(image.cam_from_world()))
        for image in images
    )
    found = [np.array([p.xy for p in i.points2D], np.float64).reshape(-1, 2) for i in images]
    xyz, rgb, observations, features = [], [], [], []
    for number in sorted(model.point3D_ids()):
        point = model.point3D(number)
        seen = {position[e.image_id]: e.point2D_idx for e in reversed(point.track.elements)}
        observations += [(len(xyz), picture) for picture in sorted(seen)]
        features += [seen[picture] for picture in sorted(seen)]
        xyz.append(point.xyz)
        rgb.append(point.color)
    points = SparsePoints(
        np.array(xyz, np.float64).reshape(-1, 3),
        np.array(rgb, np.uint8).reshape(-1, 3),
        np.array(observations, np.int64).reshape(-1, 2),
    )
    error = model.compute_mean_reprojection_error() if xyz else float("nan")
    keypoints = [found[o[1]][f] for o, f in zip(observations, features, strict=True)]
    return SparseModel(
        pictures,
        points,
        error,
        np.array(keypoints, np.float64).reshape(-1, 2),
        np.array(features, np.int64),
    )


def write_model(model: SparseModel, folder: Path) -> None:
    """Write a model in COLMAP's binary format; unknown keypoints are the points' projections."""
    output = pycolmap.Reconstruction()
    observed = [
        model.points.observations[model.points.observations[:, 1] == n, 0]
        for n in range(len(model.pictures))
    ]
    for number, picture in enumerate(model.pictures, start=1):
        output.add_camera_with_trivial_rig(camera_of(picture.lens, number))
        if model.keypoints is None:
            keypoints = project_points(model.points.xyz[observed[number - 1]], picture)
        else:
            keypoints = model.keypoints[model.points.observations[:, 1] == number - 1]
        image = pycolmap.Image(picture.name, keypoints, number, number)
        pose = pycolmap.Rigid3d(picture.cam_from_world[:3])
        output.add_image_with_trivial_frame(image, pose)
    tracks = [pycolmap.Track() for _ in model.points.xyz]
    for number, points in enumerate(observed, start=1):
        for keypoint, point in enumerate(points):
            tracks[point].add_element(number, keypoint)
    for track, xyz, rgb in zip(tracks, model.points.xyz, model.points.rgb, strict=True):
        output.add_point3D(xyz, track, rgb)
    folder.mkdir(parents=True, exist_ok=True)
    output.write(folder)


def _matrix(pose: pycolmap.Rigid3d) -> Float64[np.ndarray, "4 4"]:
    return np.vstack([pose.matrix(), [0.0, 0.0, 0.0, 1.0]])


def camera_of(lens: Lens, number: int) -> pycolmap.Camera:
    """COLMAP's camera of any lens."""
    k = lens.intrinsics
    return pycolmap.Camera(
        camera_id=number,
        model="OPENCV",
        width=lens.width,
        height=lens.height,
        params=[k[0, 0], k[1, 1], k[0, 2], k[1, 2], *lens.distortion],
    )


def lens_of(camera: pycolmap.Camera, folder: Path) -> Lens:
    """OpenCV's (k1, k2, p1, p2) of COLMAP's perspective camera models."""
    extra = np.asarray(camera.params)[list(camera.extra_params_idxs())]
    known = camera.model_name in {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"}
    if not known and not (camera.model_name == "FULL_OPENCV" and not np.any(extra[4:])):
        raise InputError(
            f"{folder} uses the camera model {camera.model_name}, which is not supported: "
            "undistort the pictures first (colmap image_undistorter)."
        )
    distortion = np.zeros(4)
    distortion[: min(len(extra), 4)] = extra[:4]
    return Lens(camera.width, camera.height, np.array(camera.calibration_matrix()), distortion)
