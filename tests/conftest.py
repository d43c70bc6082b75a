"""Shape annotations are enforced while testing, and the real captures are found."""

import importlib
import os
from pathlib import Path

import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

import tests.typechecking  # noqa: F401  (the hook finds it by name)

settings.register_profile("steady", deadline=None, derandomize=True)  # no timed asserts, no luck
settings.load_profile("steady")

_core = Path(__file__).resolve().parents[1] / "scenediff_classic"
_checked = ["types", "cameras", "colour", "masks", "video", "clips", "photos", "pictures"]
_checked += ["workspace", "run_folder"]
_compiled = ("kernels", "kernels_reference", "smoothing", "windows")
_compiled += ("sweep_kernels", "sweep_kernels_reference")
for _folder in ("change", "features", "geometry", "regions"):
    # numba reads the source of its kernels, so those (and their twins) stay out of the hook
    for _path in sorted((_core / _folder).rglob("*.py")):
        if _path.stem not in ("__init__", *_compiled):
            _checked.append(".".join(_path.relative_to(_core).with_suffix("").parts))
install_import_hook(
    [f"scenediff_classic.{name}" for name in _checked], "tests.typechecking.checked"
)
# before pytest says what to do in a crash, so that its traceback ends a crashed run
importlib.import_module("scenediff_classic.geometry.registration.colmap")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of the real captures; the test is skipped where it is absent."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("SCENEDIFF_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"real captures are not here: {folder} (set SCENEDIFF_DATA)")
    return folder
