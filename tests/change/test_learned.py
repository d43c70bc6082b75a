"""The whole method with learned features and regions, random as their weights are here."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
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
from tests.learned_models import dino, sam
from tests.plane_scene import BOOK, BOOK_ELSEWHERE, VASE, scene


@pytest.fixture(scope="module")
def changed() -> Geometry:
    return scene([VASE, BOOK], [BOOK_ELSEWHERE])


@pytest.fixture(scope="module")
def features(tmp_path_factory: pytest.TempPathFactory) -> DinoFeatures:
    return DinoFeatures(str(dino("dinov3_vit", tmp_path_factory.mktemp("dino"))), long_cells=12)


@pytest.fixture(scope="module")
def regions(tmp_path_factory: pytest.TempPathFactory) -> SamRegions:
    folder = sam("sam2", tmp_path_factory.mktemp("sam"))
    return SamRegions(str(folder), points_per_side=4, min_score=-100.0, min_stability=0.0)


def test_learned_features_find_what_geometry_shows(
    changed: Geometry, features: DinoFeatures
) -> None:
    result, _ = detect(changed, features=features)
    assert {o.kind for o in result.objects} & {"removed", "moved"}


def test_both_plug_ins_give_a_valid_result(
    changed: Geometry, features: DinoFeatures, regions: SamRegions, tmp_path: Path
) -> None:
    result, evidence = detect(changed, features=features, regions=regions)
    assert result.objects
    for item in result.objects:
        for seen in item.views:
            assert decode(seen.mask).any()
    assert len(evidence.scores) == 6
    write_result(result, tmp_path / "changes.json")
    schema = Path(scenediff_classic.__file__).with_name("changes.schema.json")
    jsonschema.validate(
        json.loads((tmp_path / "changes.json").read_text()), json.loads(schema.read_text())
    )
    assert detect(changed, features=features, regions=regions)[0] == result


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
