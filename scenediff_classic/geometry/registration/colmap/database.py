"""Features, matches and mapping: what COLMAP keeps in a database file."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from jaxtyping import Float64, UInt8

from scenediff_classic.errors import InputError
from scenediff_classic.geometry.registration.colmap import VERSION
from scenediff_classic.geometry.registration.sparse_model import (
    EpipolarPair,
    FeatureRecipe,
    MapperRecipe,
    PairMatch,
    Picture,
)

MANY = 30
"""Above so many pictures, mapping adjusts all cameras less often and less finely, since each
picture then changes little and a last adjustment follows. Measured on 80 + 80 rendered pictures:
13 instead of 26 s, the same error after the last adjustment."""

ALIKED_WEIGHTS, LIGHTGLUE_WEIGHTS = "aliked-n16rot.onnx", "aliked-lightglue.onnx"


def check_learned(weights: Path) -> None:
    """Make sure that learned features can be used without reaching for the network.

    COLMAP's own defaults are addresses from which it would download: only local files are passed.

    Raises
    ------
    InputError
        If a file is missing, or this build of pycolmap cannot run it.
    """
    for name in (ALIKED_WEIGHTS, LIGHTGLUE_WEIGHTS):
        if not (weights / name).is_file():
            raise InputError(f"{weights / name} is missing: learned features need it.")
    if not hasattr(pycolmap.FeatureExtractionOptions(), "aliked"):
        raise InputError(
            f"The installed pycolmap {VERSION} was built without ONNX, which learned features "
            "need: use SIFT instead."
        )


@dataclass(frozen=True)
class Database:
    """A COLMAP database file and the pictures it is about."""

    path: Path
    images: Path
    pictures: tuple[Picture, ...]
    seed: int = 0

    def create(self) -> None:
        """Write cameras and pictures under fixed ids, so that threads cannot reorder them."""
        with pycolmap.Database.open(self.path) as database:
            for picture in {p.camera: p for p in reversed(self.pictures)}.values():
                self._write_camera(database, picture)
            for number, picture in enumerate(self.pictures, start=1):
                image = pycolmap.Image(
                    name=picture.name, camera_id=picture.camera + 1, image_id=number
                )
                database.write_image(image, use_image_id=True)
                frame = pycolmap.Frame(frame_id=number, rig_id=picture.camera + 1)
                frame.add_data_id(image.data_id)
                database.write_frame(frame, use_frame_id=True)

    @staticmethod
    def _write_camera(database: pycolmap.Database, picture: Picture) -> None:
        focal = picture.focal or 1.2 * max(picture.width, picture.height)  # COLMAP's own guess
        camera = pycolmap.Camera.create_from_model_id(
            picture.camera + 1,
            pycolmap.CameraModelId.SIMPLE_RADIAL,
            focal,
            picture.width,
            picture.height,
        )
        camera.has_prior_focal_length = picture.focal is not None
        database.write_camera(camera, use_camera_id=True)
        rig = pycolmap.Rig(rig_id=camera.camera_id)
        rig.add_ref_sensor(camera.sensor_id)
        database.write_rig(rig, use_rig_id=True)

    def extract(self, names: Sequence[str], masks: Path, recipe: FeatureRecipe) -> None:
        """Find features of the named pictures, outside the black of ``masks/<name>.png``."""
        reader = pycolmap.ImageReaderOptions()
        if masks.is_dir():
            reader.mask_path = masks
        options = pycolmap.FeatureExtractionOptions()
        options.max_image_size = recipe.max_side
        options.sift.peak_threshold = recipe.peak_threshold
        options.sift.estimate_affine_shape = recipe.affine
        options.sift.domain_size_pooling = recipe.affine
        if recipe.weights is not None:
            options.type = pycolmap.FeatureExtractorType.ALIKED_N16ROT
            model = str((recipe.weights / ALIKED_WEIGHTS).resolve())
            options.mergedict({"aliked": {"n16rot_model_path": model, "n32_model_path": model}})
        pycolmap.extract_features(
            self.path,
            self.images,
            list(names),
            reader_options=reader,
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )

    def match(self, pairs: Sequence[tuple[str, str]], recipe: FeatureRecipe) -> None:
        """Match the given pairs of pictures and verify them geometrically."""
        listing = self.path.with_suffix(".pairs.txt")
        listing.write_text("".join(f"{first} {second}\n" for first, second in pairs))
        options = pycolmap.FeatureMatchingOptions()
        options.guided_matching = recipe.guided
        options.sift.max_ratio = recipe.ratio
        if recipe.weights is not None:
            options.type = pycolmap.FeatureMatcherType.ALIKED_LIGHTGLUE
            model = str((recipe.weights / LIGHTGLUE_WEIGHTS).resolve())
            paths = {"lightglue_model_path": model, "bruteforce_model_path": model}
            options.mergedict({"aliked": paths})
        pairing = pycolmap.ImportedPairingOptions()
        pairing.match_list_path = listing
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = self.seed  # each pair starts anew: threads do not matter
        # Two captures from one tripod differ by a shift of the whole border, like a watermark.
        verification.detect_watermark = False
        pycolmap.match_image_pairs(
            self.path, options, pairing, verification, device=pycolmap.Device.cpu
        )
        listing.unlink()

    def feature_counts(self) -> dict[str, int]:
        """Number of features by picture name."""
        with pycolmap.Database.open(self.path) as database:
            return {
                picture.name: database.num_keypoints_for_image(number)
                for number, picture in enumerate(self.pictures, start=1)
            }

    def descriptors(self, names: Sequence[str]) -> Iterator[UInt8[np.ndarray, "_ 128"]]:
        """SIFT descriptors of the named pictures, one after the other."""
        numbers = {picture.name: number for number, picture in enumerate(self.pictures, start=1)}
        with pycolmap.Database.open(self.path) as database:
            for name in names:
                yield np.asarray(database.read_descriptors(numbers[name]).data)

    def verified_pairs(self) -> tuple[PairMatch, ...]:
        """All pairs that passed the geometric verification."""
        with pycolmap.Database.open(self.path) as database:
            ids, geometries = database.read_two_view_geometries()
            keypoints = {
                number: database.read_keypoints(number)[:, :2]
                if database.exists_keypoints(number)
                else np.zeros((0, 2))
                for number in range(1, len(self.pictures) + 1)
            }
        found = []
        for pair, geometry in zip(ids, geometries, strict=True):
            matches = np.asarray(geometry.inlier_matches)
            if len(matches) == 0:
                continue
            first, second = pycolmap.pair_id_to_image_pair(pair)
            found.append(
                PairMatch.measure(
                    self.pictures[first - 1].name,
                    self.pictures[second - 1].name,
                    keypoints[first][matches[:, 0]] / self._side(first),
                    keypoints[second][matches[:, 1]] / self._side(second),
                )
            )
        return tuple(found)

    def epipolar_pairs(self) -> tuple[EpipolarPair, ...]:
        """Verified pairs that have parallax, with their fundamental matrices."""
        moving = pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED
        found = []
        with pycolmap.Database.open(self.path) as database:
            for pair, geometry in zip(*database.read_two_view_geometries(), strict=True):
                if geometry.config != int(moving) or geometry.F is None:
                    continue
                one, two = pycolmap.pair_id_to_image_pair(pair)
                matches = np.asarray(geometry.inlier_matches)
                frame_one, frame_two = self._frame_of(one), self._frame_of(two)
                fundamental = frame_two.T @ geometry.F @ frame_one
                first = database.read_keypoints(one)[matches[:, 0], :2].astype(np.float64)
                second = database.read_keypoints(two)[matches[:, 1], :2].astype(np.float64)
                found.append(
                    EpipolarPair(
                        (self.pictures[one - 1].camera, self.pictures[two - 1].camera),
                        (first - frame_one[:2, 2]) / frame_one[0, 0],
                        (second - frame_two[:2, 2]) / frame_two[0, 0],
                        fundamental / np.linalg.norm(fundamental),
                        1 / min(self._side(one), self._side(two)),
                    )
                )
        return tuple(found)

    def _frame_of(self, number: int) -> Float64[np.ndarray, "3 3"]:
        """From shares of the longer side, counted from the middle, to pixels."""
        picture, side = self.pictures[number - 1], self._side(number)
        return np.array([[side, 0, picture.width / 2], [0, side, picture.height / 2], [0, 0, 1.0]])

    def set_focal(self, ratios: Mapping[int, float]) -> None:
        """Where mapping starts from, by camera: multiples of the longer side."""
        with pycolmap.Database.open(self.path) as database:
            for number, ratio in ratios.items():
                camera = database.read_camera(number + 1)
                camera.focal_length = ratio * max(camera.width, camera.height)
                database.update_camera(camera)

    def _side(self, number: int) -> int:
        picture = self.pictures[number - 1]
        return max(picture.width, picture.height)

    def reconstruct(
        self,
        folder: Path,
        recipe: MapperRecipe,
        registered: Callable[[int], None],
        names: Sequence[str] = (),
    ) -> tuple[Path, ...]:
        """Compute cameras and points; the folders of the resulting models, largest first.

        Parameters
        ----------
        registered : callable
            Called with the number of pictures placed so far in the current model.
        names : sequence of str
            The pictures to use (incremental mapping only); all of them if left out.
        """
        folder.mkdir(parents=True, exist_ok=True)
        if recipe.method == "global":
            models = pycolmap.global_mapping(
                self.path, self.images, folder, self._global_options(recipe)
            )
        else:
            counter = itertools.count(2)
            options = self._incremental_options(recipe)
            options.image_names = list(names)
            models = pycolmap.incremental_mapping(
                self.path,
                self.images,
                folder,
                options,
                next_image_callback=lambda: registered(next(counter)),
            )
        for number, model in models.items():
            model.extract_colors_for_all_images(self.images)
            (folder / str(number)).mkdir(exist_ok=True)
            model.write(folder / str(number))
        ranked = sorted(models, key=lambda number: (-models[number].num_reg_images(), number))
        return tuple(folder / str(number) for number in ranked)

    def _incremental_options(self, recipe: MapperRecipe) -> pycolmap.IncrementalPipelineOptions:
        options = pycolmap.IncrementalPipelineOptions()
        options.random_seed = self.seed
        options.num_threads = 1  # parallel sums in the solver would differ from run to run
        options.min_model_size = 2
        options.max_num_models = 4
        options.mapper.init_min_num_inliers = recipe.init_inliers
        options.mapper.init_min_tri_angle = recipe.init_angle
        options.mapper.abs_pose_min_num_inliers = recipe.pose_inliers
        options.triangulation.ignore_two_view_tracks = not recipe.two_view_points
        options.ba_refine_focal_length = recipe.refine_lens
        options.ba_refine_extra_params = recipe.refine_lens
        if len(self.pictures) > MANY:
            options.ba_global_frames_ratio = options.ba_global_points_ratio = 1.3
            options.ba_global_function_tolerance = options.ba_local_function_tolerance = 1e-5
            options.ba_global_max_refinements, options.ba_local_max_refinements = 2, 1
        return options

    def _global_options(self, recipe: MapperRecipe) -> pycolmap.GlobalPipelineOptions:
        options = pycolmap.GlobalPipelineOptions()
        options.random_seed = self.seed
        options.num_threads = 1
        options.mapper.random_seed = self.seed
        options.mapper.bundle_adjustment.refine_focal_length = recipe.refine_lens
        options.mapper.bundle_adjustment.refine_extra_params = recipe.refine_lens
        return options
