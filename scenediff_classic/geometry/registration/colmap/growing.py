"""Models put together outside COLMAP's mapper: back into the database's terms, and completed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
from jaxtyping import Bool, Float64

from scenediff_classic.geometry.registration.agreement import OwnMatches
from scenediff_classic.geometry.registration.colmap.database import Database
from scenediff_classic.geometry.registration.colmap.models import camera_of, lens_of
from scenediff_classic.geometry.registration.quality import video_of
from scenediff_classic.geometry.registration.sparse_model import FeatureMatches, SparseModel
from scenediff_classic.types import Lens


def feature_matches(database: Database) -> tuple[FeatureMatches, ...]:
    """The verified matches of all pairs, by numbers of features."""
    with pycolmap.Database.open(database.path) as stored:
        pairs, geometries = stored.read_two_view_geometries()
    found = []
    for pair, geometry in zip(pairs, geometries, strict=True):
        matches = np.asarray(geometry.inlier_matches)
        if len(matches):
            first, second = (
                database.pictures[n - 1].name for n in pycolmap.pair_id_to_image_pair(pair)
            )
            found.append(FeatureMatches(first, second, matches.astype(np.int64)))
    return tuple(sorted(found, key=lambda f: (f.first, f.second)))


def own_matches(database: Database) -> OwnMatches:
    """By which models are checked: of pairs within a capture, and found before any guidance."""
    numbers = {picture.name: number for number, picture in enumerate(database.pictures, start=1)}
    verified = (m for m in feature_matches(database) if video_of(m.first) == video_of(m.second))
    one_number = np.array([1 << 32, 1])  # a match as one integer
    pairs = []
    with pycolmap.Database.open(database.path) as stored:
        for pair in verified:
            plain = np.asarray(stored.read_matches(numbers[pair.first], numbers[pair.second]))
            kept = np.isin(pair.features @ one_number, plain.astype(np.int64) @ one_number)
            pairs.append(replace(pair, features=pair.features[kept]))
    return OwnMatches(tuple(pairs), keypoints(database))


def keypoints(database: Database) -> dict[str, Float64[np.ndarray, "n 2"]]:
    """Where the features of each picture are, in pixels."""
    with pycolmap.Database.open(database.path) as stored:
        return {
            picture.name: stored.read_keypoints(number)[:, :2].astype(np.float64)
            if stored.exists_keypoints(number)
            else np.zeros((0, 2))
            for number, picture in enumerate(database.pictures, start=1)
        }


def first_lens(database: Database, name: str) -> Lens:
    """The lens from which mapping starts for a picture."""
    camera = next(p.camera for p in database.pictures if p.name == name)
    with pycolmap.Database.open(database.path) as stored:
        return lens_of(stored.read_camera(camera + 1), database.path)


def write_grown(model: SparseModel, folder: Path, database: Database) -> Path:
    """Write a model under the database's numbers, so that its matches can be used again.

    Pictures that share a camera in the database share the lens of the first of them. Only models
    whose `SparseModel.features` are the database's can be written so.
    """
    assert model.features is not None
    numbers = {picture.name: n for n, picture in enumerate(database.pictures, start=1)}
    found = keypoints(database)
    output = pycolmap.Reconstruction()
    written: set[int] = set()
    for posed in model.pictures:
        number = numbers[posed.name]
        camera = database.pictures[number - 1].camera + 1
        if camera not in written:
            written.add(camera)
            output.add_camera_with_trivial_rig(_plain_camera(posed.lens, camera))
        image = pycolmap.Image(posed.name, found[posed.name], camera, number)
        output.add_image_with_trivial_frame(image, pycolmap.Rigid3d(posed.cam_from_world[:3]))
    tracks = [pycolmap.Track() for _ in model.points.xyz]
    for (point, picture), feature in zip(model.points.observations, model.features, strict=True):
        tracks[point].add_element(numbers[model.pictures[picture].name], int(feature))
    for track, xyz, rgb in zip(tracks, model.points.xyz, model.points.rgb, strict=True):
        output.add_point3D(xyz, track, rgb)
    folder.mkdir(parents=True, exist_ok=True)
    output.write(folder)
    return folder


def complete(folder: Path, output: Path, database: Database) -> Path:
    """Triangulate what the matches allow with the given cameras; cameras stay, points remain."""
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = database.seed
    options.num_threads = 1  # as in mapping: sums must not depend on threads
    output.mkdir(parents=True, exist_ok=True)
    model = pycolmap.triangulate_points(
        pycolmap.Reconstruction(folder),
        database.path,
        database.images,
        output,
        clear_points=False,
        options=options,
    )
    model.extract_colors_for_all_images(database.images)
    model.write(output)
    return output


def find_pose(
    xy: Float64[np.ndarray, "n 2"],
    xyz: Float64[np.ndarray, "n 3"],
    lens: Lens,
    max_error: float,
    seed: int,
    *,
    refine_lens: bool = False,
) -> tuple[Float64[np.ndarray, "4 4"], Lens, Bool[np.ndarray, "n"]] | None:
    """The camera that sees points at given pixels, by RANSAC; None if there is none.

    Parameters
    ----------
    max_error : float
        Pixels by which a point may miss.
    refine_lens : bool
        Refine focal length and distortion.

    Returns
    -------
    cam_from_world : array (4, 4)
    lens : Lens
    inliers : array (n,)
    """
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = max_error
    options.ransac.random_seed = seed
    refinement = pycolmap.AbsolutePoseRefinementOptions()
    refinement.refine_focal_length = refinement.refine_extra_params = refine_lens
    camera = _plain_camera(lens, 1)
    found = pycolmap.estimate_and_refine_absolute_pose(xy, xyz, camera, options, refinement)
    if found is None:
        return None
    pose = np.vstack([found["cam_from_world"].matrix(), [0.0, 0.0, 0.0, 1.0]])
    return pose, lens_of(camera, Path("picture")), np.asarray(found["inlier_mask"], bool)


def _plain_camera(lens: Lens, number: int) -> pycolmap.Camera:
    """The mapper's own model if it describes the lens: more freedom would bend where little is."""
    k = lens.intrinsics
    if k[0, 0] != k[1, 1] or lens.distortion[1:].any():
        return camera_of(lens, number)
    return pycolmap.Camera(
        camera_id=number,
        model="SIMPLE_RADIAL",
        width=lens.width,
        height=lens.height,
        params=[k[0, 0], k[0, 2], k[1, 2], lens.distortion[0]],
    )
