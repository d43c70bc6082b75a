"""3DGS-CD, with the numbers of iterations that its command takes if none are given."""

from dataclasses import replace

from baselines.methods.learned_files import learned_files
from baselines.registry import Method
from baselines.threedgs_cd.detector import ThreedgsCdConfig, detect_with_3dgs_cd
from scenediff_classic.pipeline import DetectConfig


def configured(base: DetectConfig, seed: int) -> ThreedgsCdConfig:
    """Geometry as every method has it; the method asks for no regions."""
    plain = ThreedgsCdConfig()
    models = replace(plain.models, train=replace(plain.models.train, seed=seed))
    return replace(plain, geometry=base.geometry, models=models)


METHOD = Method(
    configured,
    detect_with_3dgs_cd,
    lambda config: learned_files(
        config.search.differences.features, config.search.differences.segmenter
    ),
)
