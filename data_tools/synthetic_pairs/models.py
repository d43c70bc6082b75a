"""What a scene is made of: surfaces with a look, and things built from them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from data_tools.synthetic_pairs.atlas import pyramid
from data_tools.synthetic_pairs.canvas import Canvas, Colour, Rng, hex_colours, pick
from data_tools.synthetic_pairs.meshes import Mesh
from data_tools.synthetic_pairs.surfaces import Family, Texture


@dataclass(frozen=True, eq=False)
class Material:
    """How a surface looks."""

    texture: Texture
    gloss: float = 0.15
    """Strength of the highlight: 0 = matt, 1 = glazed."""
    glow: float = 0.0
    """Light that the surface gives off by itself, in multiples of its texture."""

    @cached_property
    def levels(self) -> tuple[np.ndarray, ...]:
        """The texture at all its resolutions, in linear light."""
        return pyramid(self.texture)


@dataclass(frozen=True, eq=False)
class Part:
    """A mesh with one material."""

    mesh: Mesh
    material: Material


@dataclass(frozen=True, eq=False)
class Model:
    """A thing that stands on z = 0 at the origin."""

    label: str
    parts: tuple[Part, ...]

    @property
    def radius(self) -> float:
        """Of the upright cylinder about the origin that holds it, in metres."""
        return max(
            float(np.sqrt((p.mesh.points[..., :2].astype(np.float64) ** 2).sum(-1).max()))
            for p in self.parts
        )

    @property
    def height(self) -> float:
        """Highest point, in metres."""
        return max(float(p.mesh.points[..., 2].max()) for p in self.parts)

    def moved(self, x: float, y: float, z: float, yaw: float) -> "Model":
        """Turned by `yaw` (radians) and put down at a place (metres)."""
        parts = tuple(Part(p.mesh.moved((x, y, z), yaw), p.material) for p in self.parts)
        return Model(self.label, parts)

    def scaled(self, factor: float) -> "Model":
        """A smaller or larger copy."""
        parts = tuple(
            Part(p.mesh.stretched(factor, factor, factor), p.material) for p in self.parts
        )
        return Model(self.label, parts)

    def recoloured(self, channels: tuple[int, int, int]) -> "Model":
        """The same thing in other colours: the texture's channels in another order."""
        parts = tuple(
            Part(p.mesh, replace(p.material, texture=p.material.texture[..., channels]))
            for p in self.parts
        )
        return Model(self.label, parts)


METALS = hex_colours("8d9094 b5a16b 3a3d42 c3c7ca")
BRIGHT = hex_colours("c8483c e0913a 5f9e5a 2f7f86 3c64a6 f0e8da 2d3138")


@dataclass(frozen=True)
class Paint:
    """Gives a thing its materials; the families decide the look, the generator the details."""

    rng: Rng
    prints: tuple[Family, ...]
    covers: tuple[Family, ...]
    woods: tuple[Family, ...]
    size: int
    """Side of the textures in pixels (a power of two)."""

    def printed(self, gloss: float = 0.25) -> Material:
        """One of the print families."""
        family = self.prints[int(self.rng.integers(len(self.prints)))]
        return Material(family(self.rng, self.size), gloss)

    def cover(self) -> Material:
        """The front of a book, a package or a picture."""
        family = self.covers[int(self.rng.integers(len(self.covers)))]
        return Material(family(self.rng, self.size), 0.2)

    def wood(self) -> Material:
        """Bare or painted wood."""
        family = self.woods[int(self.rng.integers(len(self.woods)))]
        return Material(family(self.rng, self.size), 0.12)

    def plain(self, colour: Colour, gloss: float = 0.3, glow: float = 0.0) -> Material:
        """One colour with a fine grain."""
        seed = int(self.rng.integers(2**31))
        return Material(Canvas(64, colour).finish(seed, 0.06), gloss, glow)

    def metal(self) -> Material:
        """A brushed metal tone."""
        return self.plain(pick(self.rng, METALS), 0.7)

    def bright(self, gloss: float = 0.4) -> Material:
        """A lively plain colour."""
        return self.plain(pick(self.rng, BRIGHT), gloss)


Builder = Callable[[Rng, Paint], Model]
"""An object family: (generator of the shape, materials) -> a model."""
