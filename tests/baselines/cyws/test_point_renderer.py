"""Points drawn into another picture: as a slow twin in NumPy does it, and differentiable."""

import numpy as np
import pytest
import torch

from baselines.cyws.point_renderer import splat

Array = np.ndarray


def twin(
    xy: Array, depth: Array, features: Array, height: int, width: int, radius: float, most: int
) -> tuple[Array, Array]:
    """Pixel by pixel, disc by disc."""
    out, seen = np.zeros((features.shape[0], height, width)), np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            over = []
            for k, ((x, y), d) in enumerate(zip(xy, depth, strict=True)):
                if not (np.isfinite([x, y, d]).all() and d > 0):
                    continue
                square = (column + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2
                if square < radius**2:
                    over.append((d, k, 1 - square / radius**2))
            free = 1.0
            for _, k, alpha in sorted(over)[:most]:
                out[:, row, column] += free * alpha * features[:, k]
                seen[row, column] += free * alpha
                free *= 1 - alpha
    return out, seen


@pytest.mark.parametrize(("radius", "most"), [(1.5, 8), (1.5, 2), (0.5, 8), (2.3, 4)])
def test_like_the_slow_twin(radius: float, most: int) -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-2, 9, (2, 120, 2))
    depth = rng.uniform(0.5, 3, (2, 120)).round(1)  # some are equal
    xy[0, 3], depth[0, 5], depth[1, 7], depth[1, 8] = np.nan, np.nan, -1.0, np.inf
    features = rng.normal(size=(2, 3, 120))
    drawn = splat(torch.from_numpy(xy), torch.from_numpy(depth), 6, 7, radius, most)
    picture = drawn.draw(torch.from_numpy(features)).numpy()
    for k in range(2):
        want, seen = twin(xy[k], depth[k], features[k], 6, 7, radius, most)
        np.testing.assert_allclose(picture[k], want, atol=1e-12)
        np.testing.assert_allclose(drawn.visibility[k, 0].numpy(), seen, atol=1e-12)


def test_the_nearest_disc_hides_the_others() -> None:
    xy = torch.tensor([[[0.5, 0.5], [0.5, 0.5]]])
    drawn = splat(xy, torch.tensor([[2.0, 1.0]]), 1, 1)
    assert drawn.draw(torch.tensor([[[5.0, 7.0]]])).item() == 7.0


def test_nothing_to_draw_is_an_empty_picture() -> None:
    drawn = splat(torch.full((1, 4, 2), 50.0), torch.ones(1, 4), 3, 3)
    assert drawn.visibility.sum() == 0
    assert drawn.draw(torch.ones(1, 2, 4)).abs().sum() == 0


def test_gradients_of_features_and_places() -> None:
    rng = np.random.default_rng(1)
    xy = torch.from_numpy(rng.uniform(0, 4, (1, 10, 2))).requires_grad_()
    features = torch.from_numpy(rng.normal(size=(1, 2, 10))).requires_grad_()
    depth = torch.from_numpy(rng.uniform(1, 2, (1, 10)))

    def draw(places: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
        return splat(places, depth, 4, 4).draw(values)

    assert torch.autograd.gradcheck(draw, (xy, features))


def test_one_of_a_batch_is_as_alone() -> None:
    rng = np.random.default_rng(2)
    xy = torch.from_numpy(rng.uniform(0, 5, (3, 40, 2)))
    depth = torch.from_numpy(rng.uniform(1, 2, (3, 40)))
    features = torch.from_numpy(rng.normal(size=(3, 2, 40)))
    together = splat(xy, depth, 5, 5).draw(features)
    alone = splat(xy[1:2], depth[1:2], 5, 5).draw(features[1:2])
    assert torch.equal(together[1:2], alone)
