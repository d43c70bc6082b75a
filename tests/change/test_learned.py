"""The whole method with learned features and regions, random as their weights are here."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

pytest.importorskip("transformers")

import scenediff_classic
from scenediff_classic.features.dino import DinoFeatures
from scenediff_classic.masks import decode
from scenediff_classic.regions.sam import SamRegions
from scenediff_classic.result.run import json_ready
from scenediff_classic.result.writing import write_result
from scenediff_classic.types import Geometry
from tests.change.running import detect
from tests.learned_models import BrightChannels, answered_by, dino, sam
from tests.plane_scene import BOOK, BOOK_ELSEWHERE, VASE, scene


@pytest.fixture(scope="module")
def changed() -> Geometry:
    return scene([VASE, BOOK], [BOOK_ELSEWHERE])


@pytest.fixture(scope="module")
def features(tmp_path_factory: pytest.TempPathFactory) -> DinoFeatures:
    return DinoFeatures(str(dino("dinov3_vit", tmp_path_factory.mktemp("dino"))), long_cells=12)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return sam("sam2", tmp_path_factory.mktemp("sam"))


@pytest.fixture(scope="module")
def regions(folder: Path) -> SamRegions:
    return SamRegions(str(folder), points_per_side=2, min_score=-100.0, min_stability=0.0)


def test_learned_features_find_what_geometry_shows(
    changed: Geometry, features: DinoFeatures
) -> None:
    result, _ = detect(changed, features=features)
    assert {o.kind for o in result.objects} & {"removed", "moved"}


def test_learned_regions_mark_what_was_removed(
    changed: Geometry, features: DinoFeatures, folder: Path, tmp_path: Path
) -> None:
    # of all there is, only the vase is bright in the third channel: the rest is no region
    options = SamRegions(str(folder), points_per_side=2, min_score=0.2, min_stability=0.5)
    result, _ = detect(changed, features=features, regions=answered_by(BrightChannels(), options))
    assert [(o.kind, len(o.views)) for o in result.objects] == [("removed", 3)]
    truth = {
        v.key: np.abs(v.depth - VASE.z + v.cam_from_world[2, 3] * -1) < 1e-4 for v in changed.views
    }
    for seen in result.objects[0].views:
        mask, wanted = decode(seen.mask), truth[seen.video, seen.frame]
        assert (mask & wanted).sum() / (mask | wanted).sum() > 0.7


def test_regions_of_a_real_model_give_a_valid_result(
    changed: Geometry, features: DinoFeatures, regions: SamRegions, tmp_path: Path
) -> None:
    result, evidence = detect(changed, features=features, regions=regions)
    assert any(np.isfinite(m.total).any() for m in evidence.scores)
    write_result(result, tmp_path / "changes.json")
    schema = Path(scenediff_classic.__file__).with_name("changes.schema.json")
    jsonschema.validate(
        json.loads((tmp_path / "changes.json").read_text()), json.loads(schema.read_text())
    )


def test_without_any_region_nothing_is_reported(
    changed: Geometry, features: DinoFeatures, regions: SamRegions
) -> None:
    result, _ = detect(changed, features=features, regions=replace(regions, min_score=1e9))
    assert result.objects == ()


def test_options_are_recorded_and_a_loaded_model_is_not(
    features: DinoFeatures, regions: SamRegions
) -> None:
    assert features.source  # whatever the object keeps beside its options
    assert json_ready(features)["long_cells"] == 12
    assert set(json_ready(regions)) == {"type", *SamRegions.__dataclass_fields__}
    json.dumps(json_ready(regions))
