"""The frozen form says what the trained model's own modules say, whatever the kind of model; tables say it nearly."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from decomo_export import baking, lookup
from decomo_export.baking import LEVELS, Bake, BakedSurfaces
from decomo_export.graph import QueryGraph
from decomo_export.lookup import CellGrid, LookupTable, Raster, spare_memory
from decomotion.compositing import composite, composite_weights, thickened
from decomotion.model.fusion import DecoMotion
from decomotion.model.readout import OBJECT_SHARE, answer, surface_of
from decomotion.model.volume import Volume
from tiny_fit import randomised, tiny_model

FRAMES, HEIGHT, WIDTH = 5, 24, 32
KINDS = {
    "cpu": ("cpu", ()),
    "paper": ("paper", ()),
    "omnimotion": ("omnimotion", ()),
    "static": ("cpu", ("model.volumes=static",)),
    "affine": ("cpu", ("model.static.couplings=0", "model.dynamic.couplings=0")),
}


@pytest.fixture(params=KINDS)
def model(request: pytest.FixtureRequest) -> DecoMotion:
    preset, overrides = KINDS[request.param]
    start = torch.eye(3, 4).repeat(FRAMES, 1, 1)
    start[:, 0, 3] = torch.linspace(-0.3, 0.3, FRAMES)
    start[:, 0, 1] = torch.linspace(-0.1, 0.2, FRAMES)
    return randomised(tiny_model(preset, start=start, overrides=overrides), 0.1).eval()


def random_queries(count: int) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    place = torch.rand(count, 2, generator=generator) * torch.tensor([WIDTH, HEIGHT]) - 0.5
    return torch.cat([torch.randint(FRAMES, (count, 1), generator=generator), place], dim=1)


@torch.no_grad()
def test_the_same_answers_as_the_definition(model: DecoMotion):
    queries, frames = random_queries(40), torch.tensor([3, 0, 4, 4])
    tracks, occlusion, rgb, rgb_static, rgb_dynamic, confidence, depth, opacity = QueryGraph(model, "none")(
        queries, frames
    )
    frame, xy = queries[:, 0].long(), queries[:, 1:]
    conditioning = model.condition(torch.arange(FRAMES))
    expected = answer(model, conditioning, xy, frame, frames)
    torch.testing.assert_close(tracks, expected.xy, rtol=0, atol=1e-3)  # float32
    torch.testing.assert_close(occlusion, expected.occlusion, rtol=0, atol=1e-3)
    rays = model.cast(xy[:, None], conditioning, frame)
    fused_colour = thickened(rays.fused_colour(), rays.opacity[..., None])[:, 0]
    torch.testing.assert_close(rgb, fused_colour, rtol=0, atol=1e-3)
    torch.testing.assert_close(confidence, rays.static_confidence[:, 0], rtol=0, atol=1e-4)
    alone = [composite_weights(matter.density)[:, 0] for matter in (rays.static, rays.dynamic)]
    torch.testing.assert_close(opacity, alone[0].sum(-1), rtol=0, atol=1e-4)
    for weights, matter, given in zip(alone, (rays.static, rays.dynamic), (rgb_static, rgb_dynamic), strict=True):
        expected = composite(weights, matter.colour[:, 0]) / weights.sum(-1, keepdim=True).clamp_min(1e-3)
        torch.testing.assert_close(given, expected, rtol=0, atol=1e-3)
    fused = (rays.fused_static + rays.fused_dynamic)[:, 0]
    mean_depth = composite(fused, rays.depths[:, 0, :, None])[:, 0] / fused.sum(-1)
    torch.testing.assert_close(depth, mean_depth, rtol=0, atol=1e-4)


@torch.no_grad()
@pytest.mark.parametrize("density", [0.0, -200.0], ids=["matter", "nothing"])
def test_a_reader_of_the_file_tells_who_owns_a_pixel(model: DecoMotion, density: float):
    """From the static confidence and the share alone, as `Tracker.on_object`; and rays that meet nothing."""
    for volume in (model.static, model.dynamic):
        if isinstance(volume, Volume):
            volume.surface = None  # which would give the rays matter in the middle
            volume.head.bias[3] += density
    graph, queries = QueryGraph(model, "none"), random_queries(400)
    confidence = graph(queries, torch.tensor([0]))[5].numpy()
    frame, xy = queries[:, 0].long(), queries[:, 1:]
    static = graph.model.cast(xy.T, frame).is_static()
    np.testing.assert_array_equal(confidence >= 1 - OBJECT_SHARE, static)
    rays = model.cast(xy[:, None], model.condition(torch.arange(FRAMES)), frame)
    np.testing.assert_allclose(rays.static_confidence[:, 0], confidence, atol=1e-4)
    if density:
        np.testing.assert_array_equal(confidence, 1)


@torch.no_grad()
@pytest.mark.parametrize("canonical", [False, True])
@pytest.mark.parametrize("side", [32, 16, 11])
def test_at_its_samples_a_table_is_what_was_rendered(
    model: DecoMotion, canonical: bool, side: int, monkeypatch: pytest.MonkeyPatch
):
    """On the clip's own raster, half of it, and one that does not divide it: 32x24 becomes 11x8."""
    monkeypatch.setattr(baking, "SIDE", side)
    surfaces = BakedSurfaces(model, canonical=canonical)
    width, height = side, round(side * HEIGHT / WIDTH)
    assert surfaces.codes.shape[:2] == (height, width)
    frame = torch.tensor([0, 2, 4])
    samples = torch.tensor([[3.0, width - 1.0, 0.0], [5.0, height - 1.0, 0.0]])
    size, raster = torch.tensor([[WIDTH], [HEIGHT]]), torch.tensor([[width], [height]])
    xy = (samples + 0.5) * size / raster - 0.5  # a raster covers the frame from edge to edge
    given = surfaces(xy, frame)
    found = torch.empty(3, 3)
    for part in QueryGraph(model, "none").model.parts(given.is_static):
        asked = part.of(given.values), part.of(xy), frame.index_select(0, part.asked)
        found[:, part.place] = surfaces.canonical(part, *asked)[:, :-1]
    expected = surface_of(model, xy.T[:, None], model.condition(torch.arange(FRAMES)), frame)
    assert torch.equal(given.is_static, expected.is_static[:, 0])
    step = 0.01  # the maps stretch a step of depth, 2 / 2**15, and canonical steps of a few 1e-5
    torch.testing.assert_close(found, expected.canonical[:, 0].T, rtol=0, atol=step)


def test_between_two_owners_only_one_is_averaged():
    """Two columns of pixels: left static at depth 0.5, right dynamic at depth 1.5."""
    surfaces = BakedSurfaces(tiny_model("cpu"), canonical=False)
    depth = torch.full((FRAMES, 1, HEIGHT, WIDTH), 1.5)
    depth[..., : WIDTH // 2] = 0.5
    is_static = depth[:, 0] < 1
    surfaces._encode(depth.flatten(2), is_static.flatten(1))
    assert surfaces.codes.dtype == torch.int16
    assert ((surfaces.codes[..., 0].permute(2, 0, 1) >= 0) == is_static).all()
    assert surfaces.codes.to(torch.int64).abs().min() > LEVELS // 8
    x = torch.tensor([3.25, 15.2, 15.8, 20.0])
    given = surfaces(torch.stack([x, torch.full((4,), 7.5)]), torch.zeros(4, dtype=torch.int64))
    owner = given.is_static
    found = given.values[0] * surfaces.step[owner.long(), 0, 0] + surfaces.lowest[owner.long(), 0, 0]
    torch.testing.assert_close(found, torch.tensor([0.5, 0.5, 1.5, 1.5]), rtol=0, atol=1e-4)
    assert owner.tolist() == [True, True, False, False]


@pytest.mark.parametrize("folded", [False, True])
def test_cell_grid_is_grid_sample(folded: bool):
    random = torch.Generator().manual_seed(0)
    grids = torch.randn(3, 2, 4, 6, generator=random)
    reach = torch.tensor([1.5, 0.7])
    xy = (torch.rand(2, 50, generator=random) * 2.4 - 1.2) * reach[:, None]  # some beyond the border
    frame = torch.randint(3, (50,), generator=random)
    grid = CellGrid(grids, reach)
    if folded:
        grid.leave_folded()
    given = grid(xy * grid.scale[:, None].float() + grid.offset[:, None].float(), frame)
    for column in range(50):
        where = (xy[:, column] / reach)[None, None, None]
        expected = torch.nn.functional.grid_sample(
            grids[frame[column]][None], where, mode="bilinear", padding_mode="border", align_corners=True
        )
        torch.testing.assert_close(given[:, column], expected[0, :, 0, 0])


@torch.no_grad()
@pytest.mark.parametrize("bake", ["none", "depth", "full"])
def test_tables_that_are_left_as_they_are_say_the_same(model: DecoMotion, bake: Bake, monkeypatch: pytest.MonkeyPatch):
    graph, queries, frames = QueryGraph(model, bake), random_queries(40), torch.tensor([3, 0, 4, 4])
    queries[:4, 1:] = torch.tensor([[-0.5, -0.5], [WIDTH - 0.5, HEIGHT - 0.5], [WIDTH - 0.5, -0.5], [0.0, HEIGHT - 1]])
    unfolding = graph(queries, frames)
    monkeypatch.setattr(lookup, "MOST_UNFOLDED", 0)
    spare_memory(graph)
    assert not any(table.unfolds for table in graph.modules() if isinstance(table, LookupTable))
    for given, expected in zip(graph(queries, frames), unfolding, strict=True):
        torch.testing.assert_close(given, expected, rtol=0, atol=1e-4)  # float32, in another order


def test_surfaces_that_are_left_as_they_are_are_the_same():
    surfaces = BakedSurfaces(randomised(tiny_model("cpu"), 0.1).eval(), canonical=True)
    asked = random_queries(200)
    xy, frame = asked[:, 1:].T, asked[:, 0].long()
    expected = surfaces(xy, frame)
    surfaces.leave_folded()
    assert torch.equal(surfaces(xy, frame).values, expected.values)
    assert torch.equal(surfaces(xy, frame).is_static, expected.is_static)


def test_large_tables_are_left_as_they_are(monkeypatch: pytest.MonkeyPatch):
    """All of a model or none: what they take together counts."""
    tables = [CellGrid(torch.randn(3, 2, 4, 6), torch.ones(2)), CellGrid(torch.randn(2, 1, 7, 5), torch.ones(2))]
    size = 4 * (3 * 2 * 4 * 6 + 2 * 7 * 5)
    for most, unfolds in ((size, True), (size - 1, False)):
        monkeypatch.setattr(lookup, "MOST_UNFOLDED", most)
        spare_memory(torch.nn.ModuleList(tables))
        assert [table.unfolds for table in tables] == [unfolds] * 2
    assert tables[0].grids.shape == (3 * 4 * 6, 2)


@torch.no_grad()
@pytest.mark.parametrize("bake", ["none", "depth", "full"])
def test_a_query_s_own_frame_is_exact(model: DecoMotion, bake: Bake):
    queries = random_queries(20)
    tracks, occlusion, *_ = QueryGraph(model, bake)(queries, torch.arange(FRAMES))
    rows, home = np.arange(20), queries[:, 0].long()
    assert torch.equal(tracks[rows, home], queries[:, 1:])
    assert (occlusion[rows, home] == 0).all()


def test_cells_of_a_large_table_are_counted_in_double_precision(monkeypatch: pytest.MonkeyPatch):
    """Their numbers pass what float32 holds; here the limit is lowered so that both ways can be compared."""
    place = torch.tensor([[0.3, 30.9, 40.0, -1.0], [0.0, 22.5, 7.2, 3.9]])
    frame = torch.tensor([0, 4, 2, 1])
    single = Raster(FRAMES, HEIGHT, WIDTH)
    monkeypatch.setattr(lookup, "EXACT", 1)
    double = Raster(FRAMES, HEIGHT, WIDTH)
    assert (single.stride.dtype, double.stride.dtype) == (torch.float32, torch.float64)
    for one, other in zip(single(place, frame), double(place, frame), strict=True):
        assert torch.equal(one, other)


def test_cells_by_hand():
    """Two frames of 3 rows and 5 columns of samples: 2 x 4 cells, numbered row by row, each frame by frame."""
    place = torch.tensor([[1.25, 0.0, 4.0, -3.0, 9.0], [1.5, 0.0, 2.0, 0.75, -1.0]])
    number, within = Raster(2, 3, 5)(place, torch.tensor([1, 0, 0, 1, 0]))
    assert number.tolist() == [2 * (4 + 1) + 1, 0, 2 * (4 + 3), 1, 2 * 3]
    expected = torch.tensor([[0.25, 0.0, 1.0, 0.0, 1.0], [0.5, 0.0, 1.0, 0.75, 0.0]])
    torch.testing.assert_close(within, expected)
    alone, _ = Raster(1, 3, 5)(place, None)
    assert alone.tolist() == [5, 0, 7, 0, 3]


@pytest.mark.parametrize("preset", ["cpu", "paper"])
def test_memory_of_a_ray_is_that_of_its_samples_and_of_one_where_surfaces_are_baked(preset: str):
    """Float32 of so many samples, times 64 channels or the widest layer, times arrays in use."""
    models = {
        samples: tiny_model(preset, height=HEIGHT, width=WIDTH, overrides=(f"model.samples={samples}",)).eval()
        for samples in (3, 12)
    }
    rendered = {samples: QueryGraph(model, "none") for samples, model in models.items()}
    baked = QueryGraph(models[12], "depth")
    assert rendered[12].bytes_per_ray == 4 * rendered[3].bytes_per_ray
    assert rendered[12].bytes_per_rendered_ray == rendered[12].bytes_per_ray == baked.bytes_per_rendered_ray
    assert baked.bytes_per_ray == rendered[12].bytes_per_ray / 12
