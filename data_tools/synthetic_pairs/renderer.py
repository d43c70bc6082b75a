"""Ray-traced pictures with exact depth and instance ids, on the processor.

All shading is NumPy; colours are linear light.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt16

from data_tools.synthetic_pairs.atlas import Atlas
from data_tools.synthetic_pairs.lighting import Lighting, ambient_rays, light_rays
from data_tools.synthetic_pairs.models import Model
from data_tools.synthetic_pairs.tracer import Camera, Hits, Tracer, dot, same_surface, unit

SUBPIXELS = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
"""A rotated grid: four rays for a pixel that shows an edge."""
NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))
"""(rows, columns) to the pixels beside one."""


@dataclass(frozen=True)
class Rendering:
    """A picture before it meets a sensor, and its truth."""

    radiance: Float32[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"]
    """z-depth at the pixel centre; NaN where a ray leaves the scene."""
    instances: UInt16[np.ndarray, "h w"]
    """Id of the thing at the pixel centre; 0 = none."""


class Renderer:
    """Renders one arrangement of models under one lighting.

    Parameters
    ----------
    things : sequence of (id, Model)
        The models in place; 0 is the id of what counts as no object.
    """

    def __init__(self, things: Sequence[tuple[int, Model]], lighting: Lighting) -> None:
        self.tracer = Tracer(things)
        self.lighting = lighting
        materials = self.tracer.materials
        self.atlas = Atlas([material.levels for material in materials])
        self.gloss = np.array([m.gloss for m in materials], np.float32)
        self.glow = np.array([m.glow for m in materials], np.float32) * lighting.outdoors

    def render(self, camera: Camera, seed: int, samples: int = 2) -> Rendering:
        """The picture that the camera sees.

        Parameters
        ----------
        seed : int
            Decides where the lights are sampled.
        samples : int
            Shadow rays for each light and pixel, before smoothing over neighbours.
        """
        shape = (camera.height, camera.width)
        pixel = 1.0 / float(camera.intrinsics[0, 0])
        hits = self.tracer.cast(camera.rays())
        index = np.arange(len(hits.depth), dtype=np.uint32)
        links = _links(hits, shape)
        light = _smooth_within(self._light(hits, index, seed, samples).reshape(*shape, 6), links)
        light = light.reshape(-1, 6)
        picture = self._reflect(hits, light, pixel)

        edges = np.flatnonzero(~np.logical_and.reduce(list(links.values())).reshape(-1))
        total = np.zeros((len(edges), 3), np.float32)
        row, column = np.divmod(edges, camera.width)
        for k, (right, down) in enumerate(SUBPIXELS):
            rays = camera.rays_at(column + 0.5 + right, row + 0.5 + down)
            sub = self.tracer.cast(rays)
            lit = self._borrow(sub, edges, hits, light, shape, seed + 17 * (k + 1))
            # Very bright parts would keep their jagged outline: compress before averaging.
            total += np.minimum(self._reflect(sub, lit, pixel), np.float32(4.0))
        picture[edges] = total / np.float32(len(SUBPIXELS))
        depth = np.where(hits.seen, hits.depth, np.nan).astype(np.float32)
        return Rendering(
            picture.reshape(*shape, 3), depth.reshape(shape), hits.instance.reshape(shape)
        )

    def _borrow(
        self,
        sub: Hits,
        pixels: np.ndarray,
        centres: Hits,
        light: np.ndarray,
        shape: tuple[int, int],
        seed: int,
    ) -> np.ndarray:
        """Light for rays inside edge pixels: from a near pixel of the same surface, else traced."""
        lit = np.full((len(pixels), 6), np.nan, np.float32)
        every = np.arange(len(pixels))
        row, column = np.divmod(pixels, shape[1])
        for down, right in ((0, 0), *NEIGHBOURS):
            near = np.clip(row + down, 0, shape[0] - 1) * shape[1]
            near += np.clip(column + right, 0, shape[1] - 1)
            fits = np.isnan(lit[:, 0]) & same_surface(sub, every, centres, near)
            lit[fits] = light[near[fits]]
        rest = np.flatnonzero(np.isnan(lit[:, 0]))
        lit[rest] = self._light(sub.take(rest), pixels[rest].astype(np.uint32), seed, 6)
        return lit

    def _light(self, hits: Hits, index: np.ndarray, seed: int, samples: int) -> np.ndarray:
        """Light that falls on each point (3), and the highlights before the gloss (3)."""
        light = np.zeros((len(index), 6), np.float32)
        origin = hits.position + hits.facing * np.float32(2e-3)
        for number, lamp in enumerate(self.lighting.lights):
            colour = np.asarray(lamp.colour, np.float32) / np.float32(samples)
            for sample in range(samples):
                way, strength = light_rays(
                    lamp, origin, hits.normal, index, seed + 101 * number, sample, samples
                )
                strength *= self.tracer.free(origin, way, strength > 1e-5)
                half = unit(unit(way) + hits.toward)
                angle = np.maximum(dot(half, hits.normal), 0)
                light[:, :3] += strength[:, None] * colour
                light[:, 3:] += (strength * angle**40)[:, None] * colour
        clear = np.zeros(len(index), np.float32)
        for sample in range(samples):
            way = ambient_rays(hits.normal, index, seed + 977, sample, samples)
            clear += self.tracer.free(origin, way, hits.seen) / np.float32(samples)
        upward = 0.5 + 0.5 * hits.normal[:, 2:]
        sky = np.asarray(self.lighting.sky, np.float32)
        ground = np.asarray(self.lighting.ground, np.float32)
        light[:, :3] += clear[:, None] * (ground + (sky - ground) * upward)
        return light

    def _reflect(self, hits: Hits, light: np.ndarray, pixel: float) -> np.ndarray:
        slant = np.maximum(dot(hits.facing, hits.toward), 0.05)
        footprint = hits.depth * np.float32(pixel) * hits.density / np.sqrt(slant)
        footprint = np.where(hits.seen, footprint, 1).astype(np.float32)
        albedo = self.atlas.look_up(hits.material, hits.uv, footprint)
        gloss, glow = self.gloss[hits.material, None], self.glow[hits.material, None]
        radiance = albedo * (light[:, :3] + glow) + gloss * light[:, 3:]
        return np.where(hits.seen[:, None], radiance, 0)


def _links(hits: Hits, shape: tuple[int, int]) -> dict[tuple[int, int], np.ndarray]:
    """For each neighbour (rows, columns): where it continues the pixel's surface."""
    pixels = np.arange(shape[0] * shape[1]).reshape(shape)
    links = {}
    for down, right in ((0, 1), (1, 0)):
        first = pixels[: shape[0] - down, : shape[1] - right]
        second = pixels[down:, right:]
        same = same_surface(hits, first.reshape(-1), hits, second.reshape(-1))
        # Beyond the border nothing is known, so nothing continues there.
        forth, back = np.zeros(shape, bool), np.zeros(shape, bool)
        forth[: shape[0] - down, : shape[1] - right] = same.reshape(first.shape)
        back[down:, right:] = same.reshape(first.shape)
        links[down, right], links[-down, -right] = forth, back
    return links


def _smooth_within(
    values: np.ndarray, links: dict[tuple[int, int], np.ndarray], rounds: int = 5
) -> np.ndarray:
    """Average with the neighbours on the same surface: takes the grain out of soft shadows."""
    weight = np.ones(values.shape[:2], np.float32)
    for same in links.values():
        weight += same
    for _ in range(rounds):
        total = values.copy()
        for (down, right), same in links.items():
            total += np.roll(values, (-down, -right), (0, 1)) * same[..., None]
        values = total / weight[..., None]
    return values
