"""From two inputs on disk to a finished output folder: what `scenediff-classic detect` does.

Every detector, ours and the baselines, writes the same folder through `run_detection`.
"""

import resource
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from scenediff_classic.errors import OutputError, SceneDiffError
from scenediff_classic.geometry.fusion import fuse, write_ply
from scenediff_classic.geometry.store import save_geometry
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.report.overlays import write_overlays
from scenediff_classic.report.page import write_report
from scenediff_classic.result.run import RunInfo, json_ready, write_run
from scenediff_classic.result.score_maps import write_scores
from scenediff_classic.result.writing import write_result
from scenediff_classic.run_folder import Run, open_run
from scenediff_classic.types import Capture, ChangeResult, Evidence, Video
from scenediff_classic.video import fingerprint, read_capture
from scenediff_classic.workspace import write_atomic

_PACKAGES = (
    "scenediff-classic", "numpy", "scipy", "numba", "torch", "pycolmap", "open3d", "scikit-image",
    "kornia", "opencv-contrib-python-headless", "av",
)  # fmt: skip


@dataclass(frozen=True)
class CaptureOptions:
    """Where a capture is and which part of it to use."""

    path: Path
    fps: float = 1.0
    start_s: float = 0.0
    end_s: float | None = None
    ignore_dir: Path | None = None

    def read(self, video: Video, progress: Progress) -> Capture:
        """The capture's sampled frames."""
        return read_capture(
            self.path, video, fps=self.fps, start_s=self.start_s, end_s=self.end_s,
            ignore_dir=self.ignore_dir, progress=progress,
        )  # fmt: skip

    @property
    def fingerprint(self) -> str:
        """Content hash of all files that decide what is read."""
        masks = fingerprint(self.ignore_dir) if self.ignore_dir else ""
        return f"{fingerprint(self.path)}{masks}@{self.fps}:{self.start_s}-{self.end_s}"


Detect = Callable[[Capture, Capture, Path, Progress], tuple[ChangeResult, Evidence]]
"""``detect(before, after, workspace, progress)``; keeps finished stages in the workspace."""


def run_detection(
    before: CaptureOptions,
    after: CaptureOptions,
    out: Path,
    detect: Detect,
    config: Any,
    *,
    seed: int = 0,
    overwrite: bool = False,
    uses: tuple[Path, ...] = (),
    command: tuple[str, ...] = (),
    progress: Progress = silent,
) -> ChangeResult | None:
    """Detect changes and write the output folder (see docs/output.md).

    Parameters
    ----------
    config
        Everything that decides the result beside the inputs; recorded, and compared when an
        unfinished run is found: a killed run with equal inputs and options is continued.
    uses
        Further files and folders that decide the result, such as known geometry: what they hold
        counts, not only their names.

    Returns
    -------
    The result, or None if `out` held this very result already.

    Raises
    ------
    SceneDiffError
        With a sentence for the user; `out` is then as it was.
    """
    settings = json_ready(config)
    identity = {
        "before": before.fingerprint,
        "after": after.fingerprint,
        "uses": [_tree_fingerprint(path) for path in uses],
        "config": settings,
        "version": version("scenediff-classic"),
    }
    with open_run(out, identity, overwrite) as run:
        if run.already_done:
            return None
        try:
            return _produce(run, before, after, detect, settings, seed, command, progress)
        except OutputError:
            raise  # a full disk, say: the next call continues from the finished stages
        except SceneDiffError:
            # the same call would fail the same way again: nothing is worth keeping
            shutil.rmtree(run.scratch, ignore_errors=True)
            raise


def _tree_fingerprint(path: Path) -> str:
    """Content hash of a file, or of a folder with all below it."""
    below = sorted(p for p in path.rglob("*") if p.is_dir()) if path.is_dir() else []
    prints = (f"{p.relative_to(path)}\0{fingerprint(p)}\0" for p in (path, *below))
    return sha256("".join(prints).encode(errors="surrogateescape")).hexdigest()


def _produce(
    run: Run, before: CaptureOptions, after: CaptureOptions, detect: Detect, settings: Any,
    seed: int, command: tuple[str, ...], progress: Progress,
) -> ChangeResult:  # fmt: skip
    captures = before.read("before", progress), after.read("after", progress)
    run.scratch.mkdir(parents=True, exist_ok=True)
    result, evidence = detect(*captures, run.scratch, progress)
    info = RunInfo(
        command=command,
        config=settings,
        versions=versions(),
        seed=seed,
        stage_seconds=evidence.stage_seconds,
        peak_memory_bytes=_peak_memory(),
        git_commit=git_commit(),
        fingerprint=run.fingerprint,
    )
    progress("write", 0, 4)
    save_geometry(evidence.geometry, run.folder / "geometry")
    write_ply(run.folder / "geometry" / "points.ply", fuse(evidence.geometry))
    write_scores(evidence.geometry.views, evidence.scores, run.folder / "scores")
    progress("write", 1, 4)
    write_overlays(result, *captures, run.folder / "overlays")
    progress("write", 2, 4)
    write_report(result, evidence, *captures, info, run.folder / "report.html")
    progress("write", 3, 4)
    for name, text in evidence.files.items():
        write_atomic(run.folder / name, text)
    write_result(result, run.folder / "changes.json")
    write_run(info, run.folder / "run.json")
    run.finish()
    progress("write", 4, 4)
    return result


def versions() -> Mapping[str, str]:
    found = {"python": sys.version.split()[0], **{name: version(name) for name in _PACKAGES}}
    with suppress(PackageNotFoundError):
        found["transformers"] = version("transformers")  # an extra
    return found


def _peak_memory() -> int:
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def git_commit() -> str | None:
    """Commit of the checkout that this very file belongs to, if it is one."""
    folder = Path(__file__).resolve().parent
    if not (folder.parent / ".git").exists():
        return None
    try:
        found = subprocess.run(
            ["git", "-C", str(folder), "rev-parse", "HEAD"],
            capture_output=True, text=True, timeout=10, check=False,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip() or None
