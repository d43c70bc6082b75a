"""Annotated pairs and predictions, as values and as the files others exchange.

* `AnnotatedPair`: the truth of a pair (``segments.json``, or the benchmark's ``segments.pkl``);
* `Prediction`: what a method answered (``changes.json``, or the published
  ``object_masks.pkl``);
* `export`: the published layout and COCO JSON from a finished run.
"""

from scenediff_classic.dataset.annotations import (
    SAMPLE_STEP,
    AnnotatedMask,
    AnnotatedObject,
    AnnotatedPair,
    Track,
    annotation_files,
    read_annotations,
    write_annotations,
)
from scenediff_classic.dataset.export import ExportFormat, export, write_coco, write_object_masks
from scenediff_classic.dataset.predictions import (
    Picture,
    PredictedObject,
    PredictedView,
    Prediction,
    find_prediction,
    read_prediction,
)

__all__ = [
    "SAMPLE_STEP",
    "AnnotatedMask",
    "AnnotatedObject",
    "AnnotatedPair",
    "ExportFormat",
    "Picture",
    "PredictedObject",
    "PredictedView",
    "Prediction",
    "Track",
    "annotation_files",
    "export",
    "find_prediction",
    "read_annotations",
    "read_prediction",
    "write_annotations",
    "write_coco",
    "write_object_masks",
]
