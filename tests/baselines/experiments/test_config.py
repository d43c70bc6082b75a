"""Reading an experiment: examples, refusals, options by dotted names."""

from dataclasses import replace
from pathlib import Path

import pytest

from baselines.experiments.cells import method_config
from baselines.experiments.config import EXAMPLES, MethodSpec, Setting, read_config
from baselines.experiments.overriding import overridden
from baselines.registry import METHODS, load_method
from scenediff_classic.errors import InputError
from scenediff_classic.features.named import FEATURES
from scenediff_classic.pipeline import DetectConfig

WHOLE = """
name = "small"
[[benchmarks]]
kind = "synthetic"
root = "pairs"
[[methods]]
name = "scenediff-classic"
options = { scoring.voxel = 0.01, "moves.max_size_ratio" = 3 }
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "it.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", ["main", "ablation", "sensitivity", "geometry", "runtime"])
def test_examples_make_options_for_every_method(name: str) -> None:
    config = read_config(Path(name))
    assert config.name == name
    for setting in config.settings:
        for spec in config.in_setting(setting):
            made = method_config(spec, setting, DetectConfig(), config.seed)
            plain = load_method(spec.registered).configured(DetectConfig(), config.seed)
            if "=" not in setting.name:  # values of a sweep may be the usual ones
                assert (made != plain) == bool(setting.options or spec.options)
        for path, value in setting.geometry_options.items():
            assert overridden(DetectConfig().geometry, {path: value}, "") != DetectConfig().geometry


def test_all_examples_are_tested() -> None:
    assert {p.stem for p in EXAMPLES.iterdir()} == {
        "main", "ablation", "sensitivity", "geometry", "runtime",
    }  # fmt: skip


def test_main_example_holds_every_method() -> None:
    assert {m.name for m in read_config(Path("main")).methods} == set(METHODS)


def test_options_reach_the_method(tmp_path: Path) -> None:
    config = read_config(written(tmp_path, WHOLE.replace(', "moves.max_size_ratio" = 3', "")))
    made = method_config(config.methods[0], config.settings[0], DetectConfig(), 0)
    plain = DetectConfig()
    assert made == replace(plain, scoring=replace(plain.scoring, voxel=0.01))


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('name = "small"', 'name = "small"\nsede = 3', "it.toml has an unknown key 'sede'"),
        ('name = "small"', 'name = "small"\nseed = "3"', "seed must be a whole number, not '3'"),
        ('name = "small"', "", "it.toml lacks the key 'name'"),
        ('name = "small"', 'name = "small', "not valid TOML"),
        ('root = "pairs"', "root = 3", "benchmarks[1].root must be a path, not 3"),
        ('root = "pairs"', 'root = "pairs"\nlimit = 0', "limit must be at least 1"),
        ("[[methods]]", "[[method]]", "unknown key 'method'"),
        ("[[methods]]", '[[settings]]\npreset="quick"\n[[methods]]', "must be one of fast"),
        ("[[methods]]", '[[settings]]\nname="../x"\n[[methods]]', "cannot be the name of a folder"),
        ("[[methods]]", '[[settings]]\nmethods=["x"]\n[[methods]]', "names the method 'x'"),
        ("[[methods]]", "[[settings]]\n[[settings]]\n[[methods]]", "two settings are called"),
    ],
)  # fmt: skip
def test_mistakes_are_named(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    path = written(tmp_path, WHOLE.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_config(path)
    assert complaint in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"scoring.voxels": 1}, "ScoringConfig has no 'voxels'"),
        ({"scoring.voxel": "1"}, "scoring.voxel must be a number, not '1'"),
        ({"scoring.voxel": True}, "scoring.voxel must be a number, not True"),
        ({"scoring.voxel": float("nan")}, "scoring.voxel must be a finite number"),
        ({"scoring.voxel.x": 1}, "'voxel' has no options of its own"),
        ({"features": "words"}, "features must be one of gradient-colour"),
        ({"geometry.stereo.sources": 3}, "geometry is the same for all methods"),
    ],
)
def test_wrong_options_are_named(options: dict[str, object], complaint: str) -> None:
    spec = MethodSpec("mine", "scenediff-classic", options)
    with pytest.raises(InputError) as caught:
        method_config(spec, Setting(), DetectConfig(), 0)
    assert complaint in str(caught.value)
    assert "The method 'mine'" in str(caught.value)


def test_options_take_names_of_plug_ins_and_parts_that_are_off() -> None:
    made = overridden(DetectConfig(), {"features": "sift", "threshold.fixed": 1}, "")
    assert made.features == FEATURES["sift"]
    assert made.threshold.fixed == 1.0
    splat = load_method("3dgs-cd").configured(DetectConfig(), 5)
    assert splat.models.train.seed == 5
    assert splat.occupancy is None
    assert overridden(splat, {"occupancy": True}, "").occupancy is not None


def test_sweeps_become_settings(tmp_path: Path) -> None:
    sweep = '[[sweeps]]\nmethod="scenediff-classic"\noption="scoring.voxel"\nvalues=[0.5, 1]\n'
    config = read_config(written(tmp_path, WHOLE + sweep))
    assert [s.name for s in config.settings] == ["default", "scoring.voxel=0.5", "scoring.voxel=1"]
    assert config.settings[2].options == {"scenediff-classic": {"scoring.voxel": 1}}
    with pytest.raises(InputError, match="like the setting 'x'"):
        read_config(written(tmp_path, WHOLE + sweep + 'like = "x"\n'))


def test_parts_of_an_experiment() -> None:
    config = read_config(Path("runtime"))
    part = config.selected(["cyws2d", "mv3dcd"], ["a"], 2)
    assert [m.name for m in part.methods] == ["mv3dcd", "cyws2d"]
    assert (part.benchmarks[0].limit, part.benchmarks[0].scenes) == (2, ("a",))
    assert config.selected(limit=5).benchmarks[0].limit == 3
    with pytest.raises(InputError, match="there is no 'cyws'"):
        config.selected(["cyws"])


def test_methods_are_named_or_imported() -> None:
    with pytest.raises(InputError, match="There is no method 'x': take scenediff-classic"):
        load_method("x")
    with pytest.raises(InputError, match="cannot be imported"):
        load_method("no_such_module:METHOD")
    with pytest.raises(InputError, match=r"no baselines\.registry\.Method"):
        load_method("baselines.registry:METHODS")
