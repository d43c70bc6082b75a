"""Register rendered pairs, and compare cameras with the truth and with the confidence reported.

``python -m data_tools.benchmarks.rendered_registration PAIRS...`` takes folders of rendered pairs
(``python -m data_tools.synthetic_pairs``, with ``--rigid-motion`` for scenes in which most things
move as one) and says for each pair how much of the pictures shows moved things, how far the
cameras are off, and whether the run said that the alignment is ambiguous.
"""

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from scipy.stats import rankdata

from data_tools.benchmarks.registration import compare_cameras, read_true_cameras
from scenediff_classic.errors import InputError, SceneDiffError
from scenediff_classic.geometry.registration.structure_from_motion import StructureFromMotion
from scenediff_classic.video import read_capture


@dataclass(frozen=True)
class Registered:
    """One pair: what the run said of itself, and what is true."""

    name: str
    moved: float
    """Share of all pixels that show a thing with another place in the other capture."""
    confidence: np.ndarray
    rotation_deg: np.ndarray
    centre: np.ndarray
    """Errors by frame, as shares of the path's extent."""
    bridge: int
    ambiguous: bool


@dataclass(frozen=True)
class RenderedRegistration:
    """Register rendered pairs and compare with the truth."""

    pairs: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of rendered pairs."""
    every: int = 1
    """Use every n-th frame only: fewer frames hang together less well."""
    seed: int = 0

    def __call__(self) -> Table:
        """One row a pair, and how confidence ranks the frames of all pairs."""
        folders = [p.parent for root in self.pairs for p in sorted(root.glob("*/metadata.json"))]
        if not folders:
            raise InputError("There are no rendered pairs in these folders: make some first.")
        table = Table(title="Registration of rendered pairs: median over frames (worst)")
        table.add_column("pair")
        for column in ("moved", "seen by both", "confidence", "rotation", "centre"):
            table.add_column(column, justify="right")
        table.add_column("said")
        rows = []
        for folder in folders:
            try:
                row = self._register(folder)
            except SceneDiffError as error:
                table.add_row(f"{folder.parent.name}/{folder.name}", *[""] * 5, str(error))
                continue
            rows.append(row)
            table.add_row(
                row.name,
                f"{row.moved:.0%}",
                str(row.bridge),
                f"{np.median(row.confidence):.2f} ({row.confidence.min():.2f})",
                f"{np.median(row.rotation_deg):.2f} ({row.rotation_deg.max():.2f}) degrees",
                f"{np.median(row.centre):.2%} ({row.centre.max():.2%})",
                "ambiguous" if row.ambiguous else "",
            )
        if rows:
            table.caption = (
                "Rank correlation of confidence and centre error over all frames: "
                f"{confidence_rank(rows):.2f}"
            )
        return table

    def _register(self, folder: Path) -> Registered:
        before = read_capture(folder / "before", "before")
        after = read_capture(folder / "after", "after")
        true = read_true_cameras(folder / "truth_geometry.npz", before, after)
        thin = [replace(c, frames=c.frames[:: self.every]) for c in (before, after)]
        with tempfile.TemporaryDirectory(prefix="registration-") as scratch:
            geometry = StructureFromMotion(seed=self.seed)(thin[0], thin[1], Path(scratch))
        errors = compare_cameras(
            np.stack([view.cam_from_world for view in geometry.views]),
            np.stack([true[view.key] for view in geometry.views]),
        )
        return Registered(
            f"{folder.parent.name}/{folder.name}",
            moved_share(folder / "truth_instances.npz"),
            np.array([v.placement.confidence for v in geometry.views if v.placement]),
            errors.rotation_deg,
            errors.centre / errors.extent,
            geometry.bridge or 0,
            any("ambiguous" in warning for warning in geometry.warnings),
        )


def moved_share(instances: Path) -> float:
    """Share of all pixels that show a moved thing."""
    with np.load(instances, allow_pickle=False) as stored:
        moved = stored["id"][stored["kind"] == "moved"]
        return float(np.isin(stored["instances"], moved).mean())


def confidence_rank(rows: list[Registered]) -> float:
    """Spearman's rank correlation of confidence and centre error: -1 = confidence tells all."""
    confidence = np.concatenate([row.confidence for row in rows])
    centre = np.concatenate([row.centre for row in rows])
    return float(np.corrcoef(rankdata(confidence), rankdata(centre))[0, 1])


if __name__ == "__main__":
    try:
        Console().print(tyro.cli(RenderedRegistration)())
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
