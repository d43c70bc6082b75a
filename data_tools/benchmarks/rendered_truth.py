"""What is where in a rendered pair: the renderer's object numbers, as any view shows them."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int32

from scenediff_classic.cameras import pixel_centres, sample, source_from_view
from scenediff_classic.errors import InputError
from scenediff_classic.geometry.checked import read_npz
from scenediff_classic.types import VIDEOS, Video, View

CHANGED = ("added", "removed", "moved")


@dataclass(frozen=True)
class RenderedTruth:
    """The objects of a pair that ``data_tools.synthetic_pairs`` made; read where it is needed."""

    pair: Path

    @property
    def kinds(self) -> Mapping[int, str]:
        """Object -> fixed (furniture), unchanged, added, removed or moved."""
        return _read(self.pair)[1]

    @property
    def things(self) -> tuple[int, ...]:
        """All objects that are no furniture."""
        return tuple(number for number, kind in self.kinds.items() if kind != "fixed")

    @property
    def changed(self) -> tuple[int, ...]:
        """The objects that were added, removed or moved."""
        return tuple(number for number, kind in self.kinds.items() if kind in CHANGED)

    def instances(self, view: View) -> Int32[np.ndarray, "h w"]:
        """Object at every pixel of a view; 0 = the room, and whatever the input did not show."""
        xy = source_from_view(pixel_centres(*view.shape), view.lens, view.intrinsics)
        seen = sample(self._map(view).astype(np.float32), xy - 1e-6, nearest=True)
        return np.nan_to_num(seen).astype(np.int32)

    def change(self, view: View) -> Bool[np.ndarray, "h w"]:
        """True where the view shows something that changed."""
        return np.isin(self.instances(view), self.changed)

    def _map(self, view: View) -> np.ndarray:
        found = _read(self.pair)[0].get(view.key)
        if found is None:
            raise InputError(f"{self.pair} has no true objects for {view.video} {view.index}.")
        return found


@lru_cache(maxsize=2)
def _read(pair: Path) -> tuple[dict[tuple[Video, int], np.ndarray], dict[int, str]]:
    arrays = read_npz(pair / "truth_instances.npz")
    keys = zip(arrays["video"].tolist(), arrays["index"].tolist(), strict=True)
    maps = {(VIDEOS[v], i): m for (v, i), m in zip(keys, arrays["instances"], strict=True)}
    kinds = zip(arrays["id"].tolist(), arrays["kind"].tolist(), strict=True)
    return maps, dict(kinds)
