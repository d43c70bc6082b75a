"""Area lights and ambient light: which rays to trace, and how much each may bring."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt32

from data_tools.synthetic_pairs import noise
from data_tools.synthetic_pairs.tracer import dot, unit

Rgb = tuple[float, float, float]

AMBIENT_REACH = 0.7
"""Metres within which a surface darkens its surroundings."""


@dataclass(frozen=True)
class AreaLight:
    """A rectangle that shines to the side of ``edge_u x edge_v``."""

    origin: tuple[float, float, float]
    edge_u: tuple[float, float, float]
    edge_v: tuple[float, float, float]
    colour: Rgb
    """Strength: irradiance at one metre straight ahead."""


@dataclass(frozen=True)
class Lighting:
    """Everything that lights a capture."""

    lights: tuple[AreaLight, ...]
    sky: Rgb
    """Ambient light on surfaces that face up."""
    ground: Rgb
    """Ambient light on surfaces that face down."""
    outdoors: float
    """Brightness of the view through the window."""


def light_rays(
    light: AreaLight,
    origin: Float32[np.ndarray, "n 3"],
    normal: Float32[np.ndarray, "n 3"],
    index: UInt32[np.ndarray, "n"],
    seed: int,
    sample: int,
    samples: int,
) -> tuple[Float32[np.ndarray, "n 3"], Float32[np.ndarray, "n"]]:
    """Way to a random point on the light, and the irradiance that it brings if it is free.

    The `samples` calls for a point fall into as many different stripes of the light.
    """
    u = (sample + noise.uniform(index, seed + 2 * sample)) / np.float32(samples)
    v = noise.uniform(index, seed + 2 * sample + 1)
    edge_u, edge_v = np.asarray(light.edge_u, np.float32), np.asarray(light.edge_v, np.float32)
    target = np.asarray(light.origin, np.float32) + u[:, None] * edge_u + v[:, None] * edge_v
    front = np.cross(edge_u, edge_v)
    front /= np.linalg.norm(front)
    way = target - origin
    square = np.maximum(dot(way, way), np.float32(1e-4))
    # Both cosines carry one length of `way`; with the inverse square law that makes its 4th power.
    incoming = np.maximum(dot(way, normal), 0)
    leaving = np.maximum(-dot(way, np.broadcast_to(front, way.shape)), 0)
    return way, incoming * leaving / (square * square)


def ambient_rays(
    normal: Float32[np.ndarray, "n 3"],
    index: UInt32[np.ndarray, "n"],
    seed: int,
    sample: int,
    samples: int,
) -> Float32[np.ndarray, "n 3"]:
    """A way into the half space above each point, denser towards the normal (cosine law)."""
    turn = np.float32(2 * np.pi) * (sample + noise.uniform(index, seed + 2 * sample)) / samples
    square = noise.uniform(index, seed + 2 * sample + 1)
    # A point on the unit sphere added to the normal is cosine-distributed about it.
    z = 1 - 2 * square
    ring = np.sqrt(np.maximum(1 - z * z, 0))
    ball = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1).astype(np.float32)
    way = normal + ball
    return unit(way) * np.float32(AMBIENT_REACH)
