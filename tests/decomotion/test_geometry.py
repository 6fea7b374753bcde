"""Pixels and normalised coordinates."""

from __future__ import annotations

import jaxtyping
import pytest
import torch

from decomotion.geometry import ImagePlane

PLANES = [ImagePlane(48, 85), ImagePlane(85, 48), ImagePlane(32, 32), ImagePlane(1, 2)]
BATCHES = [(), (7,), (2, 3)]


@pytest.mark.parametrize("plane", PLANES)
@pytest.mark.parametrize("batch", BATCHES)
def test_there_and_back(plane: ImagePlane, batch: tuple[int, ...]):
    xy = 100 * torch.rand(*batch, 2, generator=torch.Generator().manual_seed(0))
    # float32 at 100 pixels
    torch.testing.assert_close(plane.to_pixels(plane.normalise(xy)), xy, rtol=0, atol=1e-4)


@pytest.mark.parametrize("plane", PLANES)
def test_the_image_s_edges_along_its_longer_side_are_plus_and_minus_one(plane: ImagePlane):
    corners = torch.tensor([[-0.5, -0.5], [plane.width - 0.5, plane.height - 0.5]])
    longer = int(plane.height > plane.width)
    assert plane.normalise(corners)[:, longer].tolist() == [-1, 1]


@pytest.mark.parametrize("plane", PLANES)
def test_the_centre_is_the_origin(plane: ImagePlane):
    assert plane.normalise(torch.tensor(plane.centre)).tolist() == [0, 0]


def test_by_hand():
    plane = ImagePlane(height=3, width=5)  # pixel columns 0 to 4, rows 0 to 2; a unit is 2.5 pixels
    xy = torch.tensor([[2.0, 1.0], [4.5, 1.0], [2.0, -0.5]])
    torch.testing.assert_close(plane.normalise(xy), torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, -0.6]]))


def test_both_axes_have_one_scale():
    """A turn by 90 degrees in pixels is one in normalised coordinates."""
    plane = ImagePlane(48, 85)
    right, down = plane.normalise(torch.tensor(plane.centre) + torch.tensor([[7.0, 0.0], [0.0, 7.0]]))
    assert right[0] == down[1] > 0


def test_shapes_are_checked_here():
    """`--jaxtyping-packages` in pyproject.toml is at work: a wrong shape is an error in tests."""
    with pytest.raises(jaxtyping.TypeCheckError):
        ImagePlane(3, 5).normalise(torch.zeros(4, 3))
