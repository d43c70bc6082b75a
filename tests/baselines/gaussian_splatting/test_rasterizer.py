import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import Gaussians
from baselines.gaussian_splatting.rasterizer import Rendering, accumulate, render
from baselines.gaussian_splatting.rasterizer_reference import render_densely
from tests.baselines.gaussian_splatting.scenes import CAMERA, cloud

NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "sh", "extra", "screen_shift")


def drawn(
    draw: Callable[..., Rendering], gaussians: Gaussians, extras: int, degree: int
) -> tuple[list[torch.Tensor], dict[str, torch.Tensor]]:
    """All pictures, and the gradients of a random weighting of them."""
    random = torch.Generator().manual_seed(5)
    dtype = gaussians.means.dtype
    leaves = gaussians.map(lambda t: t.clone().requires_grad_())
    extra = torch.randn(len(gaussians), extras, generator=random).to(dtype).requires_grad_()
    shift = torch.zeros(len(gaussians), 2, dtype=dtype, requires_grad=True)
    out = draw(leaves, CAMERA, extra=extra, degree=degree, screen_shift=shift)
    pictures = [out.rgb, out.depth_sum, out.alpha, out.extra]
    loss = sum((p * torch.randn(p.shape, generator=random).to(dtype)).sum() for p in pictures)
    leaf = [*(getattr(leaves, name) for name in NAMES[:5]), extra, shift]
    grads = torch.autograd.grad(torch.as_tensor(loss), leaf, allow_unused=True)
    found = zip(NAMES, grads, leaf, strict=True)
    return pictures, {n: torch.zeros_like(x) if g is None else g for n, g, x in found}


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-11), (torch.float32, 5e-6)])
@pytest.mark.parametrize(("extras", "degree"), [(0, 0), (1, 1), (3, 2), (2, 3)])
def test_pictures_and_every_gradient_match_the_dense_twin(
    dtype: torch.dtype, tolerance: float, extras: int, degree: int
) -> None:
    gaussians = cloud(60, dtype, seed=degree)
    pictures, grads = drawn(render, gaussians, extras, degree)
    expected, expected_grads = drawn(render_densely, gaussians, extras, degree)
    for picture, twin in zip(pictures, expected, strict=True):
        assert picture.dtype == dtype
        torch.testing.assert_close(picture, twin, rtol=tolerance, atol=tolerance)
    for name in NAMES:
        scale = float(expected_grads[name].abs().max()) if expected_grads[name].numel() else 1.0
        error = (grads[name] - expected_grads[name]).abs()
        assert error.numel() == 0 or float(error.max()) <= tolerance * max(scale, 1.0), name
        # something to compare, except for what there is not
        assert scale > 0 or not expected_grads[name].numel()


def test_gradients_are_those_of_finite_differences() -> None:
    camera = dataclasses.replace(CAMERA, height=12, width=18, intrinsics=np.diag([15.0, 15, 1]))
    camera.intrinsics[:2, 2] = 9, 6
    start = cloud(4, seed=3, degree=1, log_scale=-0.7)
    extra = torch.tensor([[0.3], [-0.2], [0.9], [0.1]], dtype=torch.float64)

    def pictures(*parts: torch.Tensor) -> torch.Tensor:
        out = render(Gaussians(*parts[:5]), camera, extra=parts[5], screen_shift=parts[6])
        # a smooth weighting: single pixels jump where a Gaussian's cut-off passes them
        everything = torch.cat(
            [out.rgb, out.depth_sum[..., None], out.alpha[..., None], out.extra], 2
        )
        return everything[3:9, 5:13].sum((0, 1))

    opaque = dataclasses.replace(start, opacity_logits=start.opacity_logits.abs() + 1)
    inputs = [*vars(opaque).values(), extra, torch.zeros(4, 2, dtype=torch.float64)]
    inputs = [t.detach().clone().requires_grad_() for t in inputs]
    assert torch.autograd.gradcheck(pictures, inputs, eps=1e-7, atol=1e-4, rtol=1e-4)


def test_result_does_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    gaussians = cloud(9000, torch.float32, log_scale=-3)
    results = []
    for count in (1, 3):
        monkeypatch.setenv("NUMBA_NUM_THREADS", str(count))
        pictures, grads = drawn(render, gaussians, 1, 1)
        results.append([*pictures, *grads.values()])
    for a, b in zip(*results, strict=True):
        assert torch.equal(a, b)


def test_nothing_in_sight_is_black_and_has_no_gradient() -> None:
    gaussians = cloud(20)
    behind = dataclasses.replace(gaussians, means=gaussians.means * torch.tensor([1, 1, -1.0]))
    pictures, grads = drawn(render, behind, 1, 1)
    assert all(bool((p == 0).all()) for p in pictures)
    assert all(bool((g == 0).all()) for g in grads.values())
    assert bool(torch.isnan(render(behind, CAMERA).depth).all())
    assert not bool(render(behind, CAMERA).visible.any())


def one(z: float = 2.0, *, opacity: float = 6.0, size: float = 0.5) -> Gaussians:
    """A large grey Gaussian on the camera's axis."""
    parts = ([[0, 0, z]], [[np.log(size)] * 3], [[1.0, 0, 0, 0]], [opacity], [[[0.0] * 3]])
    return Gaussians(*(torch.tensor(p, dtype=torch.float64) for p in parts))


def test_a_gaussian_is_a_gaussian_on_the_picture() -> None:
    alpha = render(one(size=0.1), CAMERA).alpha.numpy()
    row, col = np.unravel_index(alpha.argmax(), alpha.shape)
    assert abs(col + 0.5 - 25) <= 0.5
    assert abs(row + 0.5 - 18) <= 0.5
    variance_x, variance_y = (40 * 0.1 / 2) ** 2 + 0.3, (42 * 0.1 / 2) ** 2 + 0.3
    y, x = np.mgrid[:37, :50] + 0.5
    cross = 40 * 0.0 + 0.5 * 42 * 0.05**2
    inverse = np.linalg.inv([[variance_x + (0.5 * 0.05) ** 2, cross], [cross, variance_y]])
    offset = np.stack([x - 25, y - 18], -1)
    power = -0.5 * np.einsum("hwi,ij,hwj->hw", offset, inverse, offset)
    expected = np.minimum(np.exp(power) / (1 + np.exp(-6)), 0.99)
    np.testing.assert_allclose(alpha, np.where(expected >= 1 / 255, expected, 0), atol=1e-9)


@given(st.floats(1, 5), st.floats(1.2, 3))
def test_the_nearer_one_hides_the_other(near: float, ratio: float) -> None:
    back, front = one(near * ratio, size=5.0), one(near, size=5.0)
    both = Gaussians(
        *(torch.cat(p) for p in zip(vars(back).values(), vars(front).values(), strict=True))
    )
    picture = render(both, CAMERA, extra=torch.tensor([[1.0], [0.0]], dtype=torch.float64))
    centre = picture.extra[18, 25, 0], picture.alpha[18, 25], picture.depth[18, 25]
    assert float(centre[0]) == pytest.approx(0.0099, abs=2e-4)
    assert float(centre[1]) == pytest.approx(0.9999, abs=1e-4)
    assert float(centre[2]) == pytest.approx(near, rel=0.03 * ratio)


def test_the_order_of_the_gaussians_does_not_matter() -> None:
    gaussians = cloud(50)
    order = torch.randperm(50, generator=torch.Generator().manual_seed(1))
    turned = gaussians.map(lambda t: t[order])
    torch.testing.assert_close(render(turned, CAMERA).rgb, render(gaussians, CAMERA).rgb)


def test_accumulated_values_are_means_over_the_weights() -> None:
    gaussians = cloud(40)
    random = np.random.default_rng(0)
    picture = random.uniform(size=(37, 50, 2))
    picture[5:9, 7:30] = np.nan
    known = np.isfinite(picture).all(axis=2)
    means, weights = accumulate(gaussians, [CAMERA], [picture])
    extra = torch.eye(40, dtype=torch.float64)
    each = render_densely(gaussians, CAMERA, extra=extra).extra.numpy() * known[..., None]
    total = each.sum((0, 1))
    np.testing.assert_allclose(weights.numpy(), total, atol=1e-9)
    expected = np.einsum("hwn,hwc->nc", each, np.nan_to_num(picture))
    seen = total > 0
    np.testing.assert_allclose(means.numpy()[seen], expected[seen] / total[seen, None], rtol=1e-8)
    assert np.isnan(means.numpy()[~seen]).all()


def test_accumulating_a_plain_picture_gives_its_value_everywhere() -> None:
    gaussians = cloud(40, torch.float32)
    means, weights = accumulate(gaussians, [CAMERA] * 2, [np.full((37, 50, 1), 0.25)] * 2)
    assert bool((weights > 0).any())
    np.testing.assert_allclose(means[weights > 0].numpy(), 0.25, rtol=1e-5)


def test_a_camera_of_half_the_size_shows_the_same() -> None:
    gaussians = one(size=0.6)
    large = PinholeCamera(np.array([[80.0, 0, 40], [0, 80, 32], [0, 0, 1]]), np.eye(4), 64, 80)
    small = large.resized(32, 40)
    halves = render(gaussians, large).alpha.reshape(32, 2, 40, 2).mean(dim=(1, 3))
    torch.testing.assert_close(render(gaussians, small).alpha, halves, atol=0.01, rtol=0)
