"""Which pictures to match: all pairs while that is cheap, else neighbours and look-alikes."""

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float32

from scenediff_classic.geometry.registration.colmap.database import Database

EXHAUSTIVE = 30
"""Up to this many pictures, every pair is matched."""
NEIGHBOURS = (1, 2, 4, 8)
"""Steps along a capture that are matched in any case."""
SIMILAR = 6
"""Look-alikes of each picture that are matched, in each of the two captures."""
WORDS = 32
SAMPLE = 400
"""Descriptors of each picture that make its signature."""


def matching_pairs(
    captures: Sequence[Sequence[str]], database: Database, seed: int
) -> list[tuple[str, str]]:
    """Pairs of picture names to match, in a fixed order.

    Parameters
    ----------
    captures : sequence of sequences of str
        Picture names of each capture, in temporal order.
    database : Database
        Holds the features; read only when there are too many pictures for all pairs.
    """
    names = [name for capture in captures for name in capture]
    if len(names) <= EXHAUSTIVE:
        return list(itertools.combinations(names, 2))
    rng = np.random.default_rng(seed)
    sample = [d[rng.permutation(len(d))[:SAMPLE]] for d in database.descriptors(names)]
    signatures = _signatures([d.astype(np.float32) for d in sample], seed)
    chosen = similar_pairs(signatures, [len(capture) for capture in captures])
    return [(names[a], names[b]) for a, b in chosen]


def similar_pairs(
    signatures: Float[np.ndarray, "n d"], sizes: Sequence[int]
) -> list[tuple[int, int]]:
    """Temporal neighbours within, and most similar pictures within and across captures.

    Grows linearly with the number of pictures.
    """
    similarity = signatures @ signatures.T
    np.fill_diagonal(similarity, -np.inf)
    ends = np.cumsum(sizes)
    pairs: set[tuple[int, int]] = set()
    for start, end in zip(ends - np.array(sizes), ends, strict=True):
        for step in NEIGHBOURS:
            pairs |= {(a, a + step) for a in range(start, end - step)}
        best = np.argsort(-similarity[:, start:end], axis=1, kind="stable")[:, :SIMILAR] + start
        for picture, others in enumerate(best):
            pairs |= {(min(picture, o), max(picture, o)) for o in others.tolist() if o != picture}
    return sorted(pairs)


def _signatures(
    descriptors: Sequence[Float32[np.ndarray, "_ 128"]], seed: int
) -> Float32[np.ndarray, "n d"]:
    """One unit vector a picture: residuals to common visual words, summed up (VLAD).

    H. Jegou et al., "Aggregating local descriptors into a compact image representation", 2010.
    """
    rng = np.random.default_rng(seed)
    words = _visual_words(np.concatenate(descriptors), rng)
    out = np.zeros((len(descriptors), len(words), words.shape[1]))
    for vector, found in zip(out, descriptors, strict=True):
        nearest = _nearest(found, words)
        np.add.at(vector, nearest, found - words[nearest])
    out /= np.maximum(np.linalg.norm(out, axis=2, keepdims=True), 1e-12)
    out = out.reshape(len(descriptors), -1)
    return (out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)).astype(np.float32)


def _visual_words(
    descriptors: Float32[np.ndarray, "n d"], rng: np.random.Generator
) -> Float32[np.ndarray, "words d"]:
    """A few rounds of k-means: rough words are enough to rank pictures."""
    subset = descriptors[rng.permutation(len(descriptors))[:20000]]
    words = subset[:WORDS].copy()
    for _ in range(8):
        nearest = _nearest(subset, words)
        for number in np.unique(nearest):
            words[number] = subset[nearest == number].mean(axis=0)
    return words


def _nearest(points: Float[np.ndarray, "n d"], words: Float[np.ndarray, "m d"]) -> np.ndarray:
    return np.argmin((words**2).sum(axis=1) - 2 * points @ words.T, axis=1)
