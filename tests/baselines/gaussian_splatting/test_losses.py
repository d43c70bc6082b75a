import numpy as np
import pytest
import torch

from baselines.gaussian_splatting import losses
from baselines.gaussian_splatting.exposure import applied, fit_exposure
from baselines.gaussian_splatting.losses import Target, photometric_loss, psnr, ssim


def pictures(dtype: torch.dtype = torch.float64) -> tuple[torch.Tensor, torch.Tensor]:
    random = np.random.default_rng(0)
    a, b = random.uniform(size=(2, 3, 17, 21))
    return torch.tensor(a, dtype=dtype), torch.tensor(0.7 * a + 0.3 * b, dtype=dtype)


def test_ssim_is_the_published_formula() -> None:
    x, y = pictures()
    place = np.arange(11) - 5
    window = np.exp(-(place**2) / (2 * 1.5**2))
    window = torch.tensor(np.outer(window, window) / window.sum() ** 2)[None, None]

    def mean(p: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(p[:, None], window, padding=5)[:, 0]

    m, n = mean(x), mean(y)
    xx, yy, xy = mean(x * x) - m * m, mean(y * y) - n * n, mean(x * y) - m * n
    expected = (2 * m * n + 0.01**2) * (2 * xy + 0.03**2)
    expected /= (m * m + n * n + 0.01**2) * (xx + yy + 0.03**2)
    assert float(ssim(x, Target.of(y))) == pytest.approx(float(expected.mean()), abs=1e-9)


def test_gradient_of_ssim_is_that_of_finite_differences() -> None:
    x, y = pictures()
    target = Target.of(y[:2, :7, :9])
    start = x[:2, :7, :9].clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda p: ssim(p, target), [start], eps=1e-6, atol=1e-7)


def test_the_formula_for_cuda_is_that_of_the_cpu() -> None:
    blurred = [torch.rand(2, 5, 6, generator=torch.Generator().manual_seed(k)) for k in range(5)]
    for a, b in zip(losses._terms_on_cpu(*blurred), losses._terms_on_cuda(*blurred), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)


def test_the_same_picture_costs_nothing_and_ignored_pixels_neither() -> None:
    x, y = pictures(torch.float32)
    assert float(photometric_loss(x, Target.of(x))) == pytest.approx(0, abs=1e-6)
    ignore = np.zeros((17, 21), bool)
    ignore[3:8] = True
    changed = torch.where(torch.from_numpy(ignore), x, y).requires_grad_()
    loss = photometric_loss(changed, Target.of(y, ignore))
    loss.backward()
    assert float(loss.detach()) == pytest.approx(0, abs=1e-6)
    assert changed.grad is not None
    assert bool((changed.grad[:, 3:8] == 0).all())


def test_psnr() -> None:
    assert psnr(0.01) == pytest.approx(20)
    assert psnr(0) == float("inf")


def test_exposure_is_found_although_something_changed() -> None:
    random = np.random.default_rng(1)
    rendered = random.uniform(size=(30, 40, 3))
    truth = np.c_[np.diag([0.8, 0.9, 1.1]), [0.05, 0.0, -0.04]]
    captured = rendered @ truth[:, :3].T + truth[:, 3] + random.normal(0, 0.005, rendered.shape)
    captured[:8, :20] = 0.9  # a changed object
    known = np.ones((30, 40), bool)
    known[20:, 30:] = False
    captured[20:, 30:] = np.nan
    found = fit_exposure(rendered, captured, known)
    np.testing.assert_allclose(found, truth, atol=0.02)
    planes = torch.tensor(rendered.transpose(2, 0, 1))
    shown = applied(planes, torch.tensor(truth))
    np.testing.assert_allclose(shown[:, 12].numpy().T, rendered[12] @ truth[:, :3].T + truth[:, 3])


def test_exposure_of_nothing_is_no_change() -> None:
    nothing = np.zeros((4, 5), bool)
    empty = np.zeros((4, 5, 3))
    np.testing.assert_allclose(fit_exposure(empty, empty, nothing), np.eye(3, 4))
