"""The CYWS networks."""

from baselines.cyws.detector import CywsConfig, detect_with_cyws
from baselines.cyws.presets import Dimension
from baselines.registry import Method
from scenediff_classic.pipeline import DetectConfig


def _method(model: Dimension) -> Method:
    def configured(base: DetectConfig, seed: int) -> CywsConfig:
        return CywsConfig(model, geometry=base.geometry, regions=base.regions)

    return Method(configured, detect_with_cyws, lambda config: (config.file,))


METHOD_2D = _method("2d")
METHOD_3D = _method("3d")
