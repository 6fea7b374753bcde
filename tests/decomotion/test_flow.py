"""Flow between two frames: its unit is a pixel of its own raster, whoever estimates it."""

from __future__ import annotations

import re
import struct
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from decomotion.config import load
from decomotion.data.flow import build_flow
from decomotion.data.flow import dis as dis_module
from decomotion.data.flow.config import DisFlowConfig, FlowConfig, RaftFlowConfig
from decomotion.data.flow.dis import DisFlow
from decomotion.data.flow.folder import FolderFlow
from decomotion.data.flow.interface import enlarged, resized, to_raster
from decomotion.data.flow.raft import RaftFlow, from_princeton, load_raft
from decomotion.errors import ConfigError, SupervisionError

SHIFT = (3, -2)


def shifted_texture(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Two frames; what is at (x, y) in the first is at (x, y) + SHIFT in the second."""
    noise = cv2.GaussianBlur(np.random.default_rng(0).random((height + 10, width + 10, 3)), (0, 0), 2)
    texture = (255 * (noise - noise.min()) / np.ptp(noise)).astype(np.uint8)
    dx, dy = SHIFT
    return texture[5 : 5 + height, 5 : 5 + width], texture[5 - dy : 5 - dy + height, 5 - dx : 5 - dx + width]


def dis(**changes: int) -> DisFlowConfig:
    config = load("cpu").data.flow
    assert isinstance(config, DisFlowConfig)
    return config.model_copy(update=changes)


def raft(weights: Path | None, kind: str = "raft-small", **changes: float) -> RaftFlowConfig:
    config = load("cpu", flow=kind).data.flow
    assert isinstance(config, RaftFlowConfig)
    return config.model_copy(update={"weights": None if weights is None else str(weights), "iterations": 12, **changes})


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("gap", "part"), [(3, 1), (7, 1), (8, 2), (9, 2)])
def test_frames_far_apart_are_compared_at_half_the_size(gap: int, part: int, way: int, monkeypatch: pytest.MonkeyPatch):
    """Of 90 x 60 pixels, enlarged to 160 at most; the field has the frames' raster and finds what moved."""
    estimate, compared = DisFlow(dis(max_side=160)), []
    monkeypatch.setattr(dis_module, "resized", lambda frame, size: compared.append(size) or resized(frame, size))
    field = estimate(*shifted_texture(60, 90), pair=(20, 20 + way * gap))
    assert compared == [(160 // part, round(60 * 160 / 90 / part))] * 2
    assert estimate.effort(gap) == 1 / part**2
    assert field.shape == (60, 90, 2)
    np.testing.assert_allclose(np.median(field, axis=(0, 1)), SHIFT, atol=0.1)


@pytest.fixture
def raft_small(shared: Path) -> Path:
    file = shared / "weights" / "raft-small.pth"
    if not file.is_file():
        pytest.skip(f"no weights at {file}")
    return file


@pytest.fixture
def jump() -> tuple[np.ndarray, np.ndarray]:
    """A small patch that jumps 80 pixels across a plain ground."""
    patch = np.random.default_rng(0).integers(0, 256, (16, 16, 3), dtype=np.uint8)
    first, second = np.full((2, 128, 128, 3), 128, np.uint8)
    first[56:72, 10:26], second[56:72, 90:106] = patch, patch
    return first, second


JUMP_START = np.zeros((128, 128, 2), np.float32)
JUMP_START[52:76, 6:30, 0] = 78
IN_PATCH = (slice(60, 68), slice(14, 22))


def test_dis_finds_from_a_start_what_it_loses_from_zero(jump: tuple[np.ndarray, np.ndarray]):
    estimate = DisFlow(dis())
    found = estimate(*jump, start=JUMP_START)[IN_PATCH]
    np.testing.assert_allclose(found, np.tile([80.0, 0.0], (8, 8, 1)), atol=0.5)
    assert np.abs(estimate(*jump)[IN_PATCH] - [80, 0]).max() > 40


def test_a_start_is_forgotten(jump: tuple[np.ndarray, np.ndarray]):
    estimate = DisFlow(dis())
    plain, guided = estimate(*jump), estimate(*jump, start=JUMP_START)
    np.testing.assert_array_equal(estimate(*jump), plain)
    np.testing.assert_array_equal(estimate(*jump, start=JUMP_START), guided)


class TestRasters:
    def test_each_axis_has_its_own_factor(self):
        """A constant field of 10 x 6 pixels brought to 5 x 4: half as wide, two thirds as high."""
        field = np.tile(np.array([4.0, 3.0], np.float32), (6, 10, 1))
        smaller = to_raster(field, (5, 4))
        assert smaller.shape == (4, 5, 2)
        np.testing.assert_allclose(smaller, np.tile(np.array([2.0, 2.0]), (4, 5, 1)), atol=1e-6)

    @pytest.mark.parametrize("size", [(6, 3), (2, 9), (2, 3)])
    def test_what_shrinks_on_any_axis_is_averaged(self, size: tuple[int, int]):
        """Of 9 x 6 pixels every third row and column has a flow of 9, down or to the right; in the mean it is 3."""
        field = np.zeros((9, 6, 2), np.float32)
        field[2::3, :, 1] = field[:, 2::3, 0] = 9
        found = to_raster(field, size)
        assert found.shape == (size[1], size[0], 2)
        if size[0] == 2:
            np.testing.assert_allclose(found[..., 0], 3 / 3, atol=1e-6)
        if size[1] == 3:
            np.testing.assert_allclose(found[..., 1], 3 / 3, atol=1e-6)

    def test_the_limits_of_an_enlargement(self):
        assert enlarged(100, 200, 2.0, 1000) == (400, 200)
        assert enlarged(100, 200, 2.0, 300) == (300, 150)
        assert enlarged(50, 60, 1.0, 1000, min_side=128) == (154, 128)


class TestDis:
    @pytest.mark.parametrize(("height", "width"), [(64, 96), (75, 50)])
    def test_a_shift_is_found(self, height: int, width: int):
        field = DisFlow(dis())(*shifted_texture(height, width))
        assert field.shape == (height, width, 2)
        assert field.dtype == np.float32
        # what DIS reaches on a clean texture
        np.testing.assert_allclose(np.median(field, axis=(0, 1)), SHIFT, atol=0.05)

    @pytest.mark.parametrize(("height", "width"), [(64, 96), (96, 64), (50, 99), (33, 99)])
    def test_a_coarser_raster_has_larger_pixels(self, height: int, width: int):
        field = DisFlow(dis(field_side=48))(*shifted_texture(height, width))
        shrink = np.array([field.shape[1] / width, field.shape[0] / height])
        assert max(field.shape) == 48
        np.testing.assert_allclose(np.median(field, axis=(0, 1)), SHIFT * shrink, atol=0.02)

    @pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 30), (3, 2), (8, 1600)])
    def test_frames_may_be_thin(self, height: int, width: int):
        frame = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
        estimate = DisFlow(dis())
        field = estimate(frame, frame)
        again = estimate(frame, frame, start=field)
        assert field.shape == again.shape
        assert np.abs(field).max() < 1  # and finite

    def test_frames_that_shrink_do_not_alias(self):
        """Fine texture at 96 of 320 pixels; every third or fourth pixel alone gives errors above half a pixel."""
        noise = cv2.GaussianBlur(np.random.default_rng(0).random((260, 340, 3)), (0, 0), 1)
        texture = (255 * (noise - noise.min()) / np.ptp(noise)).astype(np.uint8)
        (dx, dy), (height, width) = SHIFT, (240, 320)
        first, second = texture[5 : 5 + height, 5 : 5 + width], texture[5 - dy :, 5 - dx :][:height, :width]
        field = DisFlow(dis(max_side=96))(first, second)
        assert np.median(np.linalg.norm(field - SHIFT, axis=-1)) < 0.3


class TestRaft:
    @pytest.mark.parametrize(("height", "width"), [(64, 96), (131, 203)])
    def test_a_shift_is_found(self, raft_small: Path, height: int, width: int):
        """Frames smaller than RAFT can take, and frames whose sides are no multiples of 8."""
        estimate = build_flow(raft(raft_small))
        field = estimate(*shifted_texture(height, width), (0, 1))
        assert field.shape == (height, width, 2)
        assert field.dtype == np.float32
        # RAFT-small on blurred noise, which it was not trained on
        np.testing.assert_allclose(np.median(field, axis=(0, 1)), SHIFT, atol=0.2)

    def test_as_torchvision_does_it(self, raft_small: Path):
        """On a frame that needs neither padding nor resizing, the field is torchvision's own, bit for bit."""
        from torchvision.models.optical_flow import Raft_Small_Weights

        first, second = shifted_texture(128, 136)
        model = load_raft("raft-small", str(raft_small))
        images = [torch.from_numpy(frame.copy()).permute(2, 0, 1)[None] for frame in (first, second)]
        with torch.no_grad():
            expected = model(*Raft_Small_Weights.DEFAULT.transforms()(*images), num_flow_updates=12)[-1]
        field = build_flow(raft(raft_small))(first, second, (0, 1))
        np.testing.assert_allclose(field, expected[0].permute(1, 2, 0).numpy(), atol=1e-3)

    def test_both_forms_of_the_weights(self, raft_small: Path, tmp_path: Path):
        from_the_original = load_raft("raft-small", str(raft_small))
        torch.save(from_the_original.state_dict(), tmp_path / "torchvision.pth")
        again = load_raft("raft-small", str(tmp_path / "torchvision.pth"))
        for one, other in zip(from_the_original.state_dict().values(), again.state_dict().values(), strict=True):
            assert torch.equal(one, other)

    def test_the_large_checkpoint_s_names(self):
        """The original's names of RAFT-large, put together from torchvision's by hand-written rules, lead back."""
        from torchvision.models.optical_flow import raft_large

        torch.manual_seed(0)
        state = raft_large(weights=None).state_dict()
        original = {f"module.{_original_name(key)}": value for key, value in state.items()}
        for key in [key for key in original if ".downsample.1." in key and "cnet" in key]:
            original[key.replace("downsample.1", "norm3")] = original[key]  # registered twice in the original
        stripped = {key.removeprefix("module."): original[key] for key in sorted(original)}  # norm3 in the middle
        assert from_princeton(stripped).keys() == state.keys()

    @pytest.mark.parametrize("content", ["text", "list", "other weights", "whole model"])
    def test_other_files_are_refused(self, content: str, tmp_path: Path):
        file = tmp_path / "weights.pth"
        if content == "text":
            file.write_text("no weights")
        elif content == "whole model":
            torch.save(torch.nn.Linear(2, 2), file)  # pickled code: not even opened
        else:
            torch.save([torch.zeros(2)] if content == "list" else {"weight": torch.zeros(2)}, file)
        with pytest.raises(SupervisionError, match="--flow-weights"):
            load_raft("raft-small", str(file))

    def test_no_file(self, tmp_path: Path):
        with pytest.raises(SupervisionError, match="does not exist"):
            build_flow(raft(tmp_path / "nowhere.pth"))

    @pytest.mark.parametrize("kind", ["raft-small", "raft-large"])
    def test_no_torchvision(self, kind: str, monkeypatch: pytest.MonkeyPatch):
        for module in [name for name in sys.modules if name.split(".")[0] == "torchvision"]:
            monkeypatch.delitem(sys.modules, module)
        monkeypatch.setitem(sys.modules, "torchvision", None)
        with pytest.raises(
            SupervisionError,
            match=rf"^flow {kind} needs torchvision, .* pip install 'decomotion\[raft\]', or take --flow dis$",
        ):
            build_flow(raft(None, kind))

    def test_no_internet(self, monkeypatch: pytest.MonkeyPatch):
        def unreachable(*_: object, **__: object) -> dict[str, Tensor]:
            raise OSError("no route")

        monkeypatch.setattr("torchvision.models._api.load_state_dict_from_url", unreachable)
        with pytest.raises(
            SupervisionError, match=r"cannot be downloaded .* give a file with --flow-weights, or take --flow dis"
        ):
            build_flow(raft(None, "raft-large"))


@pytest.fixture
def plain_raft(monkeypatch: pytest.MonkeyPatch) -> list[Tensor]:
    """In the place of RAFT's network one whose flow at a pixel is that pixel's place; it notes the images it sees."""
    seen: list[Tensor] = []

    class Places(torch.nn.Module):
        def forward(self, first: Tensor, second: Tensor, num_flow_updates: int) -> list[Tensor]:
            seen.extend((first, second))
            y, x = torch.meshgrid(*(torch.arange(float(side)) for side in first.shape[-2:]), indexing="ij")
            return [torch.zeros(1, 2, *first.shape[-2:]), torch.stack([x, y])[None]]

    monkeypatch.setattr("decomotion.data.flow.raft.load_raft", lambda *_: Places())
    return seen


def test_raft_s_images_are_padded_evenly_and_cut_out_again(plain_raft: list[Tensor]):
    """131 x 203 pixels lack 5 of a multiple of 8 on either axis: 2 on one side, 3 on the other."""
    frame = np.full((131, 203, 3), 255, np.uint8)
    frame[0] = frame[:, 0] = 0
    field = RaftFlow(raft(None, upsample=1.0, max_side=512))(frame, frame)
    first, second = plain_raft
    assert first.shape == second.shape == (1, 3, 136, 208)
    assert (first.min().item(), first.max().item()) == (-1, 1)
    assert (first[..., :3, :] == -1).all()  # the border, repeated
    assert (first[..., 3:, 3:] == 1).all()
    y, x = np.mgrid[:131, :203]
    np.testing.assert_array_equal(field, np.stack([x + 2, y + 2], axis=-1))


def test_raft_s_frames_have_128_pixels_a_side_at_least(plain_raft: list[Tensor]):
    frame = np.zeros((64, 40, 3), np.uint8)
    assert RaftFlow(raft(None, upsample=1.0, max_side=512))(frame, frame).shape == (64, 40, 2)
    assert plain_raft[0].shape == (1, 3, 208, 128)  # 40 x 64 enlarged 3.2 times


@pytest.mark.parametrize("intervals", ["[2,4]", "[1,0]", "[-1,1]"])
def test_gaps_that_do_not_reach_every_frame_are_refused(intervals: str):
    with pytest.raises(ConfigError, match="gaps must be positive and one of them 1"):
        load("cpu", overrides=(f"data.flow.intervals={intervals}",))


def _original_name(key: str) -> str:
    for pattern, replacement in (
        (r"^feature_encoder", "fnet"),
        (r"^context_encoder", "cnet"),
        (r"^(.net)\.convnormrelu\.0", r"\1.conv1"),
        (r"^(.net)\.convnormrelu\.1", r"\1.norm1"),
        (r"^(.net)\.conv\.", r"\1.conv2."),
        (r"\.convnormrelu(\d)\.0", r".conv\1"),
        (r"\.convnormrelu(\d)\.1", r".norm\1"),
        (r"motion_encoder\.conv\.0", "encoder.conv"),
        (r"motion_encoder\.convcorr(\d)\.0", r"encoder.convc\1"),
        (r"motion_encoder\.convflow(\d)\.0", r"encoder.convf\1"),
        (r"recurrent_block\.convgru(\d)\.conv(.)", r"gru.conv\2\1"),
        (r"^mask_predictor\.convrelu\.0", "update_block.mask.0"),
        (r"^mask_predictor\.conv", "update_block.mask.2"),
    ):
        key = re.sub(pattern, replacement, key)
    return key


class TestFolder:
    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        return tmp_path

    def flow(self, folder: Path, **changes: int) -> FolderFlow:
        config = load("cpu", flow=str(folder)).data.flow.model_copy(update=changes)
        estimator = build_flow(config)
        assert isinstance(estimator, FolderFlow)
        return estimator

    @pytest.mark.parametrize("suffix", [".npy", ".flo"])
    @pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
    def test_a_field_of_another_size_covers_the_image(self, folder: Path, suffix: str, dtype: type):
        """A field of 20 x 10 for frames of 40 x 30: a pixel is two of theirs wide, three high."""
        field = np.tile(np.array([4.0, 3.0], dtype), (10, 20, 1))
        if suffix == ".npy":
            np.save(folder / "2_5.npy", field)
        else:
            (folder / "2_5.flo").write_bytes(struct.pack("<fii", 202021.25, 20, 10) + field.astype("<f4").tobytes())
        frame = np.zeros((30, 40, 3), np.uint8)
        read = self.flow(folder)(frame, frame, (2, 5))
        np.testing.assert_allclose(read, np.tile(np.array([8.0, 9.0]), (30, 40, 1)), rtol=1e-5)

    def test_a_damaged_header_is_refused(self, folder: Path):
        np.save(folder / "0_1.npy", np.zeros((4, 4, 2), np.float32))
        content = (folder / "0_1.npy").read_bytes()
        (folder / "0_1.npy").write_bytes(content.replace(b"}", b"("))
        frame = np.zeros((4, 4, 3), np.uint8)
        with pytest.raises(SupervisionError, match="damaged"):
            self.flow(folder)(frame, frame, (0, 1))

    def test_missing_pairs_are_named(self, folder: Path):
        np.save(folder / "0_1.npy", np.zeros((4, 4, 2), np.float32))
        estimator = self.flow(folder)
        estimator.require([(0, 1)])
        with pytest.raises(SupervisionError, match=r"lacks fields 1_0, 1_2; add them"):
            estimator.require([(0, 1), (1, 0), (1, 2)])
        with pytest.raises(SupervisionError, match="lacks fields 0_2, 1_3, 2_4, 3_5, 4_6 and 3 more; add them"):
            estimator.require([(frame, frame + 2) for frame in range(8)])
        with pytest.raises(SupervisionError, match="lacks fields 0_2, 1_3, 2_4, 3_5, 4_6; add them"):
            estimator.require([(frame, frame + 2) for frame in range(5)])

    def test_a_raster_of_one_row_will_do(self, folder: Path):
        np.save(folder / "0_1.npy", np.full((1, 4, 2), 0.5, np.float32))
        frame = np.zeros((6, 8, 3), np.uint8)
        np.testing.assert_allclose(self.flow(folder)(frame, frame, (0, 1)), np.full((6, 8, 2), (1.0, 3.0)))

    @pytest.mark.parametrize(
        ("field", "message"),
        [
            (np.zeros((4, 4)), r"float64 \[4, 4\]; it must be float"),
            (np.zeros((4, 4, 3)), r"must be float \[h, w, 2\]"),
            (np.zeros((4, 4, 2), int), r"must be float \[h, w, 2\]"),
            (np.zeros((0, 4, 2)), r"float64 \[0, 4, 2\]; it must be float"),
            (np.full((4, 4, 2), np.nan), "not finite"),
            (np.array([{}], object), "is damaged"),
        ],
    )
    def test_other_content_is_refused(self, folder: Path, field: np.ndarray, message: str):
        np.save(folder / "0_1.npy", field, allow_pickle=True)
        frame = np.zeros((4, 4, 3), np.uint8)
        with pytest.raises(SupervisionError, match=message):
            self.flow(folder)(frame, frame, (0, 1))

    @pytest.mark.parametrize("content", [b"", b"PIEH", struct.pack("<fii", 202021.25, 20, 10) + b"1234"])
    def test_a_damaged_flo_is_refused(self, folder: Path, content: bytes):
        (folder / "0_1.flo").write_bytes(content)
        frame = np.zeros((4, 4, 3), np.uint8)
        with pytest.raises(SupervisionError, match="damaged"):
            self.flow(folder)(frame, frame, (0, 1))

    def test_no_folder(self, tmp_path: Path):
        with pytest.raises(SupervisionError, match="is no folder; give dis, raft-small, raft-large or one"):
            self.flow(tmp_path / "nowhere")


@pytest.mark.parametrize("kind", ["dis", "raft-small"])
def test_what_all_estimators_share_is_kept(kind: str):
    former = load("cpu").data.flow
    changed = load("cpu", overrides=("data.flow.field_side=300",), flow=kind).data.flow
    assert changed.kind == kind
    assert changed.field_side == 300
    common = set(FlowConfig.model_fields) - {"field_side"}
    assert changed.model_dump(include=common) == former.model_dump(include=common)


def test_what_is_compared_is_as_bright_as_it_looks(monkeypatch: pytest.MonkeyPatch):
    """Red, green and blue: by Rec. 601."""
    compared: list[np.ndarray] = []
    monkeypatch.setattr(dis_module, "resized", lambda frame, size: compared.append(frame) or resized(frame, size))
    frame = np.zeros((20, 30, 3), np.uint8)
    frame[:, :10, 0] = frame[:, 10:20, 1] = frame[:, 20:, 2] = 255
    DisFlow(dis(max_side=32))(frame, frame)
    assert compared[0][5, [5, 15, 25]].tolist() == [76, 150, 29]


@pytest.mark.parametrize(
    ("name", "value"),
    [("patch_stride", 7), ("descent_iterations", 1), ("refinement_iterations", 0), ("gradient_weight", 0.5)],
)
def test_every_setting_of_dis_is_heeded(name: str, value: float):
    first, second = shifted_texture(60, 90)
    assert not np.array_equal(DisFlow(dis(**{name: value}))(first, second), DisFlow(dis())(first, second))


def test_what_becomes_narrower_is_averaged_whatever_its_height():
    """Columns in pairs; 20 of them, as many as there are rows."""
    frame = np.zeros((20, 40), np.uint8)
    frame[:, ::2] = 200
    np.testing.assert_array_equal(resized(frame, (20, 10)), np.full((10, 20), 100))
    tall = np.zeros((60, 24), np.uint8)
    tall[:, ::2] = 200
    np.testing.assert_array_equal(resized(tall, (12, 30)), np.full((30, 12), 100))


class Network(torch.nn.Module):
    """In the place of RAFT's: it notes how often its flow is updated, and where it is to be."""

    updates: int
    place = torch.device("cpu")

    def to(self, device: torch.device) -> Network:  # pyright: ignore[reportIncompatibleMethodOverride]
        self.place = device
        return self

    def forward(self, first: Tensor, second: Tensor, num_flow_updates: int) -> list[Tensor]:
        self.updates = num_flow_updates
        return [torch.ones(1, 2, *first.shape[-2:])]


def test_raft_runs_where_it_is_told_as_often_as_it_is_told(monkeypatch: pytest.MonkeyPatch):
    network = Network()
    monkeypatch.setattr("decomotion.data.flow.raft.load_raft", lambda *_: network)
    build_flow(raft(None), "meta")
    assert network.place == torch.device("meta")
    frame = np.zeros((40, 90, 3), np.uint8)
    field = build_flow(raft(None, iterations=5, field_side=45))(frame, frame, (0, 1))
    assert network.updates == 5
    assert field.shape == (20, 45, 2)


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1e300])
def test_fields_of_a_folder_are_finite(tmp_path: Path, value: float):
    """In single precision."""
    field = np.zeros((4, 5, 2))
    field[2, 3, 1] = value
    np.save(tmp_path / "0_1.npy", field)
    config = load("cpu", flow=str(tmp_path)).data.flow
    frame = np.zeros((4, 5, 3), np.uint8)
    with pytest.raises(SupervisionError, match="has values that are not finite numbers"):
        build_flow(config)(frame, frame, (0, 1))


def test_fields_of_a_folder_are_kept_as_coarse_as_others(tmp_path: Path):
    np.save(tmp_path / "0_1.npy", np.tile(np.array([4.0, 3.0], np.float32), (60, 96, 1)))
    config = load("cpu", overrides=("data.flow.field_side=48",), flow=str(tmp_path)).data.flow
    frame = np.zeros((60, 96, 3), np.uint8)
    field = build_flow(config)(frame, frame, (0, 1))
    np.testing.assert_allclose(field, np.tile(np.array([2.0, 1.5]), (30, 48, 1)))
