import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.gaussian_splatting.adam import Adam, update
from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.channels import ChannelConfig, fit_channel
from baselines.gaussian_splatting.densify import DensifyConfig, densify, reset_opacities
from baselines.gaussian_splatting.gaussians import Gaussians, Points
from baselines.gaussian_splatting.rasterizer import render
from baselines.gaussian_splatting.train import TrainConfig, Trained, TrainProgress, train
from scenediff_classic.errors import InputError
from scenediff_classic.types import Geometry, SparsePoints
from tests.baselines.gaussian_splatting.scenes import cloud
from tests.geometry.textured_room import room

SHORT = TrainConfig(
    iterations=60, degree=1, degree_every=20, checkpoint_every=7,
    densify=DensifyConfig(start=10, every=10, until=0.8, reset_every=25, most=2500),
)  # fmt: skip


def capture() -> tuple[Geometry, tuple[np.ndarray, ...]]:
    """A small room, with its true depth as if it had been measured."""
    geometry, depths = room(36, 48, 4)
    views = [
        replace(v, depth=d, measured=np.isfinite(d))
        for v, d in zip(geometry.views, depths, strict=True)
    ]
    return replace(geometry, views=tuple(views)), depths


@pytest.fixture(scope="module")
def model() -> tuple[Geometry, tuple[np.ndarray, ...], Trained]:
    geometry, depths = capture()
    config = TrainConfig(iterations=150, degree=1, degree_every=50, densify=None)
    return geometry, depths, train(geometry.views, Points.of(geometry, most=3000), config)


def same(a: Trained, b: Trained) -> bool:
    pairs = zip(vars(a.gaussians).values(), vars(b.gaussians).values(), strict=True)
    return all(torch.equal(x, y) for x, y in pairs) and torch.equal(
        a.exposures.maps, b.exposures.maps
    )


def test_a_short_training_shows_the_room_and_its_depth(
    model: tuple[Geometry, tuple[np.ndarray, ...], Trained],
) -> None:
    geometry, depths, trained = model
    for view, depth in zip(geometry.views, depths, strict=True):
        with torch.no_grad():
            drawn = render(trained.gaussians, PinholeCamera.of(view))
        error = np.mean((drawn.rgb.numpy() - view.image / 255) ** 2)
        assert -10 * math.log10(error) > 24
        assert float(np.nanmedian(np.abs(drawn.depth.numpy() / depth - 1))) < 0.02


def test_a_channel_learns_its_masks_and_leaves_the_geometry(
    model: tuple[Geometry, tuple[np.ndarray, ...], Trained],
) -> None:
    geometry, depths, trained = model
    cameras = [PinholeCamera.of(v) for v in geometry.views]
    masks = [(d < np.median(d)).astype(np.float32) for d in depths]
    masks[0][:, :5] = np.nan
    channel = fit_channel(trained.gaussians, cameras, masks, ChannelConfig(iterations=160))
    for camera, mask in zip(cameras, masks, strict=True):
        known = np.isfinite(mask)
        assert np.mean((channel.render(camera) > 0.5)[known] == (mask > 0.5)[known]) > 0.95
    assert torch.equal(channel.gaussians.means, trained.gaussians.means)
    further = fit_channel(
        trained.gaussians, cameras, masks, ChannelConfig(iterations=1), start=channel
    )
    assert float((further.logits - channel.logits).abs().max()) < 0.1


class _StoppedError(Exception):
    pass


@pytest.mark.parametrize("stop", [8, 31, 59])
def test_a_resumed_training_ends_bit_equal(tmp_path: Path, stop: int) -> None:
    geometry, _ = capture()
    points = Points.of(geometry, most=1200)
    file = tmp_path / "state.pt"
    whole = train(geometry.views, points, SHORT)
    assert len(whole.gaussians) != len(points.xyz)

    def interrupt(report: TrainProgress) -> None:
        if report.iteration == stop:
            raise _StoppedError

    with pytest.raises(_StoppedError):
        train(geometry.views, points, SHORT, checkpoint=file, progress=interrupt)
    seen: list[TrainProgress] = []
    resumed = train(geometry.views, points, SHORT, checkpoint=file, progress=seen.append)
    assert seen[0].iteration == stop - (stop % 7 if stop % 7 else 7) + 1
    assert same(resumed, whole)
    assert seen[-1].remaining_s == 0
    assert "PSNR" in str(seen[-1])
    # a finished training is not done again; one of something else does not continue this one
    assert same(train(geometry.views, points, SHORT, checkpoint=file, progress=seen.append), whole)
    assert seen[-1].iteration == 60
    other = train(geometry.views, points, replace(SHORT, seed=1), checkpoint=file)
    assert not same(other, whole)


def test_a_damaged_checkpoint_is_started_anew(tmp_path: Path) -> None:
    geometry, _ = capture()
    points, config = Points.of(geometry, most=800), replace(SHORT, iterations=9, densify=None)
    file = tmp_path / "state.pt"
    file.write_bytes(b"PK\x03\x04 half a file")
    assert same(
        train(geometry.views, points, config, checkpoint=file),
        train(geometry.views, points, config),
    )


def test_exposure_takes_up_a_change_of_light() -> None:
    geometry, _ = capture()
    darker = replace(geometry.views[0], image=(geometry.views[0].image * 0.8).astype(np.uint8))
    views = [darker, *geometry.views[1:]]
    config = replace(SHORT, iterations=200, densify=None, coarse=())
    trained = train(views, Points.of(geometry, most=2000), config)
    gain = trained.exposures.maps[:, :, :3].diagonal(dim1=1, dim2=2).mean(dim=1)
    assert float(gain[0]) < float(gain[1:].min()) - 0.03
    torch.testing.assert_close(trained.exposures.maps.mean(dim=0), torch.eye(3, 4))


def test_ignored_pixels_have_no_say() -> None:
    geometry, _ = capture()
    points = Points.of(geometry, most=800)
    ignore = np.zeros(geometry.views[0].shape, bool)
    ignore[:20] = True
    config = replace(SHORT, iterations=12, densify=None, coarse=())
    results = []
    for colour in (0, 255):
        image = geometry.views[0].image.copy()
        image[ignore] = colour
        view = replace(geometry.views[0], image=image, ignore=ignore)
        results.append(train([view], points, config))
    assert same(*results)


def test_nothing_to_train_from_is_refused() -> None:
    geometry, _ = capture()
    with pytest.raises(InputError, match="picture"):
        train([], Points.of(geometry), SHORT)
    with pytest.raises(InputError, match="points"):
        train(geometry.views, None, SHORT)
    bare = tuple(replace(v, measured=np.zeros(v.shape, bool)) for v in geometry.views)
    with pytest.raises(InputError, match="neither depth nor points"):
        Points.of(Geometry(bare, SparsePoints.none()))
    with pytest.raises(InputError, match="four points"):
        Gaussians.start(Points(np.zeros((3, 3)), np.zeros((3, 3), np.uint8)))


def test_points_are_the_depth_cloud_or_else_the_sparse_ones() -> None:
    geometry, _ = capture()
    dense = Points.of(geometry, most=500)
    assert dense.dense
    assert 250 < len(dense.xyz) <= 500
    bare = tuple(replace(v, measured=np.zeros(v.shape, bool)) for v in geometry.views)
    sparse = Points.of(replace(geometry, views=bare), views=[1])
    seen = geometry.points.observations
    assert not sparse.dense
    assert len(sparse.xyz) == len(np.unique(seen[seen[:, 1] == 1, 0]))


def test_densify_splits_the_large_doubles_the_small_and_removes_the_useless() -> None:
    start = cloud(6, torch.float32)
    start.log_scales[:] = math.log(0.001)
    start.log_scales[0] = math.log(0.1)  # large and pulled at: split
    start.log_scales[3] = math.log(9.0)  # huge: goes
    start.opacity_logits[:] = 1
    start.opacity_logits[4] = -9  # faint: goes
    pull = torch.tensor([1.0, 1.0, 0, 0, 0, 0])
    state = Adam.start(start).map(lambda t: t + 1)
    config = DensifyConfig()
    out, adam = densify(start, state, pull, 1.0, config, np.random.default_rng(0))
    assert len(out) == 3 + 1 + 2  # 1, 2, 5; 1 again; two parts of 0
    torch.testing.assert_close(out.means[:4], start.means[[1, 2, 5, 1]])
    assert bool(((out.means[4:] - start.means[0]).norm(dim=1) < 0.5).all())
    torch.testing.assert_close(out.log_scales[4:].exp(), torch.full((2, 3), 0.1 / 1.6))
    assert bool((adam.mean.means[:3] == 1).all())
    assert bool((adam.mean.means[3:] == 0).all())
    full, _ = densify(
        start, state, pull * 2, 1.0, replace(config, most=6), np.random.default_rng(0)
    )
    assert len(full) == 4
    reset_opacities(out, adam, config)
    assert float(out.opacities.max()) == pytest.approx(0.01, rel=1e-4)
    assert bool((adam.square.opacity_logits == 0).all())


def test_adam_moves_only_what_is_in_sight_as_pytorch_does() -> None:
    random = torch.Generator().manual_seed(0)
    ours = torch.randn(5, 2, generator=random)
    theirs = ours.clone().requires_grad_()
    other = torch.optim.Adam([theirs], lr=0.02, eps=1e-15)
    mean, square = torch.zeros_like(ours), torch.zeros_like(ours)
    visible = torch.tensor([True, True, False, True, True])
    hidden = ours[2].clone()
    for number in range(1, 4):
        grad = torch.randn(5, 2, generator=random)
        theirs.grad = grad.clone()
        other.step()
        update(ours, grad, mean, square, np.full(2, 0.02), visible, number)
    torch.testing.assert_close(ours[visible], theirs.detach()[visible])
    assert torch.equal(ours[2], hidden)
