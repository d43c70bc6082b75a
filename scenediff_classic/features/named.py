"""Every feature back-end by its name, with the constants that belong to it.

`similarity` and `merge` of each come from
``python -m tests.benchmarks.features PAIR... --views 3`` on the 12 rendered pairs of the val split,
except for the default, ``gradient-colour``: its constants were chosen with the whole method on the
same pairs (the command gives 0.951 and 1.256).
"""

from typing import Literal

from scenediff_classic.features.binary_patterns import BinaryPatternFeatures
from scenediff_classic.features.colours import ColourFeatures
from scenediff_classic.features.combined import CombinedFeatures
from scenediff_classic.features.gradients import GradientFeatures
from scenediff_classic.features.sift import SiftFeatures
from scenediff_classic.protocols import FeatureExtractor

FeatureName = Literal[
    "gradient-colour",
    "gradient-surface-colour",
    "sift-surface-colour",
    "colours",
    "gradients",
    "sift",
    "binary-patterns",
]

_SURFACE_COLOURS = ColourFeatures(depth_step=0.1)

FEATURES: dict[FeatureName, FeatureExtractor] = {
    "gradient-colour": CombinedFeatures(
        (GradientFeatures(), ColourFeatures()), (0.5, 0.5), similarity=0.93, merge=1.4
    ),
    "gradient-surface-colour": CombinedFeatures(
        (GradientFeatures(), _SURFACE_COLOURS), (0.3, 0.7), similarity=0.967, merge=1.194
    ),
    "sift-surface-colour": CombinedFeatures(
        (SiftFeatures(), _SURFACE_COLOURS), (0.3, 0.7), similarity=0.962, merge=1.189
    ),
    "colours": ColourFeatures(),
    "gradients": GradientFeatures(),
    "sift": SiftFeatures(),
    "binary-patterns": BinaryPatternFeatures(),
}
