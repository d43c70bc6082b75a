"""MV3DCD, with the numbers of iterations that its command takes if none are given."""

from dataclasses import replace

from baselines.methods.learned_files import learned_files
from baselines.mv3dcd.detector import Mv3dcdConfig, detect_with_mv3dcd
from baselines.registry import Method
from scenediff_classic.pipeline import DetectConfig


def configured(base: DetectConfig, seed: int) -> Mv3dcdConfig:
    """Geometry and regions as every method has them."""
    plain = Mv3dcdConfig()
    return replace(
        plain,
        geometry=base.geometry,
        regions=base.regions,
        models=replace(plain.models, train=replace(plain.models.train, seed=seed)),
        fusion=replace(plain.fusion, seed=seed),
    )


METHOD = Method(
    configured,
    detect_with_mv3dcd,
    lambda config: learned_files(config.cues.features, config.regions),
)
