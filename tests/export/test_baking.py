"""Tables are rendered by as many threads as torch has, each on frames of its own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode

from decomo_export import baking
from decomo_export.baking import BakedSurfaces
from decomo_export.frame import FrameModel
from decomo_export.frozen_rays import Hit
from decomotion.model.fusion import DecoMotion, PairConditioning
from tiny_fit import randomised, tiny_model


@pytest.fixture
def model() -> DecoMotion:
    return randomised(tiny_model("cpu", frames=7, height=18, width=30), 0.1).eval()


@pytest.fixture
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("canonical", [False, True])
def test_the_same_table_by_any_number_of_threads_and_rays(
    canonical: bool, model: DecoMotion, monkeypatch: pytest.MonkeyPatch
):
    both = BakedSurfaces(model, canonical=canonical)
    torch.set_num_threads(1)
    monkeypatch.setitem(baking.RAYS_AT_ONCE, "cpu", 53)
    alone = BakedSurfaces(model, canonical=canonical)
    apart = (both.codes.to(torch.int32) - alone.codes).abs()
    assert apart.max() <= 1  # products of other sizes, summed in another order
    assert torch.equal(both.codes >= 0, alone.codes >= 0)


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("fails", [False, True])
def test_operators_run_in_one_thread_meanwhile(fails: bool, model: DecoMotion, monkeypatch: pytest.MonkeyPatch):
    """Threads that share an operator wait for the slowest: on a busy machine that took several times the work."""
    hit, threads = FrameModel.hit, []

    def observed(self: FrameModel, xy: torch.Tensor) -> object:
        threads.append(torch.get_num_threads())
        if fails and len(threads) > 2:
            raise MemoryError
        return hit(self, xy)

    monkeypatch.setattr(FrameModel, "hit", observed)
    if fails:
        with pytest.raises(MemoryError):
            BakedSurfaces(model, canonical=False)
    else:
        BakedSurfaces(model, canonical=False)
    assert set(threads) == {1}
    assert torch.get_num_threads() == 2


def test_a_depth_beyond_the_range_is_its_end_and_stays_with_its_owner(
    model: DecoMotion, monkeypatch: pytest.MonkeyPatch
):
    """A code that does not fit into 16 bits would wrap around, to the other volume."""
    depths = torch.linspace(-0.1, 2.1, 18 * 30)
    is_static = torch.arange(18 * 30) % 2 == 0
    monkeypatch.setattr(FrameModel, "hit", lambda self, xy: Hit(depths[None], is_static))
    codes = BakedSurfaces(model, canonical=False).codes[:, :, 3, 0].flatten()
    assert torch.equal(codes >= 0, is_static)
    assert codes[is_static][[0, -1]].tolist() == [0, 32767]
    assert codes[~is_static][[0, -1]].tolist() == [-1, -32768]
    assert codes[~is_static].diff().max() <= 0


@pytest.mark.parametrize(("preset", "overrides"), [("cpu", ()), ("paper", ()), ("cpu", ("model.volumes=static",))])
def test_a_frame_is_seen_on_the_device_of_its_model(preset: str, overrides: tuple[str, ...]):
    """All on a GPU that is none: a tensor left on the CPU is an error there too."""
    model = tiny_model(preset, frames=3, height=18, width=30, overrides=overrides).eval()
    with FakeTensorMode(allow_non_fake_inputs=True), torch.no_grad():
        for module in model.modules():
            for named in (module._parameters, module._buffers):
                named.update({name: None if held is None else held.to("cuda") for name, held in named.items()})
        conditioning = model.condition(torch.arange(3, device="cuda"))
        row = torch.tensor([1], device="cuda")
        seen = FrameModel(model, PairConditioning(*(volume.take(row) for volume in conditioning)))
        xy = torch.empty(2, 11, device="cuda")
        hit = seen.hit(xy)
        assert (hit.values.device.type, hit.is_static.device.type) == ("cuda", "cuda")
