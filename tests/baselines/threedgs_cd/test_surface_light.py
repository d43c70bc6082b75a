"""Light is taken out of what is compared; changed things stay."""

from dataclasses import replace

import numpy as np

from baselines.splat_change.models import Render
from baselines.threedgs_cd.surface_light import SurfaceLightConfig, large_planes, relit
from scenediff_classic.types import Lens, View

HEIGHT, WIDTH = 90, 120
FLAT = np.full((HEIGHT, WIDTH), 2.0, np.float32)


def captured(image: np.ndarray) -> View:
    K = np.array([[100.0, 0, WIDTH / 2], [0, 100, HEIGHT / 2], [0, 0, 1]])
    nowhere = np.zeros((HEIGHT, WIDTH), bool)
    return View(
        "after", 0, "0.png", image, K, np.eye(4), FLAT, FLAT, ~nowhere, nowhere,
        Lens(WIDTH, HEIGHT, K, np.zeros(4)),
    )  # fmt: skip


def wall() -> np.ndarray:
    """Boards in two greys."""
    stripes = np.where(np.arange(WIDTH) // 4 % 2, 120, 150)
    return np.broadcast_to(stripes[None, :, None], (HEIGHT, WIDTH, 3)).astype(np.uint8)


def lit(image: np.ndarray) -> np.ndarray:
    """Under a warm lamp at the left."""
    fall = np.linspace(1.5, 0.7, WIDTH)[None, :, None] * [1.1, 1.0, 0.8]
    return np.clip(image * fall, 0, 255).astype(np.uint8)


def test_a_lamp_is_no_difference_and_a_new_thing_is_one() -> None:
    picture = lit(wall())
    thing = np.s_[30:50, 50:70]
    picture[thing] = (60, 40, 170)
    shown = Render(wall(), FLAT, np.ones((HEIGHT, WIDTH), np.float32))
    before = np.abs(shown.image.astype(int) - picture).mean(axis=-1)
    after = np.abs(
        relit(captured(picture), shown, SurfaceLightConfig()).image - picture.astype(int)
    )
    after = after.mean(axis=-1)
    away = np.ones((HEIGHT, WIDTH), bool)
    away[20:60, 40:80] = False
    assert np.median(before[away]) > 20
    assert np.median(after[away]) < 5
    assert np.median(after[thing]) > 40


def test_what_is_unknown_or_no_plane_keeps_its_colours() -> None:
    image = wall()
    rough = (2 + np.random.default_rng(0).uniform(0, 1, FLAT.shape)).astype(np.float32)
    alpha = np.ones((HEIGHT, WIDTH), np.float32)
    same = relit(captured(image), Render(image, rough, alpha), SurfaceLightConfig()).image
    assert np.abs(same.astype(int) - image).max() <= 1
    nothing = Render(np.zeros_like(image), np.full_like(FLAT, np.nan), 0 * alpha)
    assert not relit(captured(lit(image)), nothing, SurfaceLightConfig()).image.any()


def test_planes_are_apart_and_large() -> None:
    config = SurfaceLightConfig()
    x, y = np.meshgrid(np.linspace(-1, 1, WIDTH), np.linspace(-1, 1, HEIGHT))
    floor = y > 0.2
    points = np.stack([x, y, np.where(floor, 3 - y, 3.0)], axis=-1)
    points[..., 2][:8, :8] = 1.0  # too small to be a surface
    known = np.ones(floor.shape, bool)
    known[:, :10] = False
    first, second = large_planes(points, known, config)
    assert not (first & second).any()
    assert not (first | second)[:, :9].any()
    for plane, truth in ((first, ~floor & known), (second, floor & known)):
        assert (plane & truth).sum() > 0.97 * truth.sum()
    assert large_planes(points, np.zeros_like(known), config) == []
    line = np.stack([x, 0 * x, 0 * x], axis=-1)
    assert large_planes(line, known, replace(config, tries=5)) == []
