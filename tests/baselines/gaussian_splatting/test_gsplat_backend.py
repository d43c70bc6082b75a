"""The code around `gsplat`, with a stand-in that draws densely on the CPU."""

import sys
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from baselines.gaussian_splatting import gsplat_backend
from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import Gaussians
from baselines.gaussian_splatting.rasterizer import render
from baselines.gaussian_splatting.rasterizer_reference import render_densely
from scenediff_classic.errors import InputError
from tests.baselines.gaussian_splatting.scenes import CAMERA, cloud


def rasterization(
    means: torch.Tensor, quats: torch.Tensor, scales: torch.Tensor, opacities: torch.Tensor,
    colors: torch.Tensor, viewmats: torch.Tensor, Ks: torch.Tensor, width: int, height: int,
    near_plane: float = 0.01, eps2d: float = 0.3, packed: bool = True, render_mode: str = "RGB",
) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:  # fmt: skip
    """What `gsplat.rasterization` answers to these arguments."""
    assert (packed, render_mode, eps2d) == (False, "RGB+D", 0.3)
    camera = PinholeCamera(Ks[0].numpy(), viewmats[0].numpy(), height, width, near_plane)
    plain = Gaussians(
        means, scales.log(), quats, torch.logit(opacities), means.new_zeros(len(means), 1, 3)
    )
    centres = means.new_zeros((1, len(means), 2), requires_grad=True)
    out = render_densely(plain, camera, extra=colors, screen_shift=centres[0])
    drawn = torch.cat([out.extra, out.depth_sum[..., None]], -1)[None]
    radii = out.visible[None, :, None].repeat(1, 1, 2).int()
    return drawn, out.alpha[None, ..., None], {"means2d": centres, "radii": radii}


def test_it_draws_what_the_cpu_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in = SimpleNamespace(rasterization=rasterization)
    monkeypatch.setitem(vars(sys)["modules"], "gsplat", stand_in)
    results = []
    for on_gsplat in (True, False):
        gaussians = cloud(30).map(lambda t: t.requires_grad_())
        shift = torch.zeros(30, 2, dtype=torch.float64, requires_grad=True)
        extra = torch.linspace(0, 1, 60, dtype=torch.float64).reshape(30, 2)
        if on_gsplat:
            planes, visible = gsplat_backend.draw(gaussians, extra, shift, CAMERA, 2)
        else:
            out = render(gaussians, CAMERA, extra=extra, degree=2, screen_shift=shift)
            parts = (out.rgb, out.depth_sum[..., None], out.extra, out.alpha[..., None])
            planes, visible = torch.cat(parts, -1).permute(2, 0, 1), out.visible
        (
            planes * torch.linspace(-1, 1, planes[0].numel()).reshape(planes[0].shape)
        ).sum().backward()
        grads = [t.grad for t in (*vars(gaussians).values(), shift)]
        results.append([planes, *grads])
        assert bool(visible.any())
    for a, b in zip(*results, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-8, atol=1e-8)


def test_without_it_cuda_is_refused_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(vars(sys)["modules"], "gsplat", None)
    with pytest.raises(InputError, match="pip install gsplat"):
        gsplat_backend.draw(cloud(4), torch.zeros(4, 0), torch.zeros(4, 2), CAMERA, 0)
