"""Dense features and their reduction: where the image is, of unit norm, from weights that only hold weights."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from kornia.feature import DenseSIFTDescriptor

from decomotion.clip import Clip
from decomotion.config import load
from decomotion.data.config import DataConfig
from decomotion.data.features import FeatureExtractor, build_features
from decomotion.data.features.aliked import AlikedFeatures
from decomotion.data.features.densesift import DenseSift
from decomotion.data.features.interface import FEATURE_SIDE, MOST_CHANNELS, resized
from decomotion.data.features.reduction import Reduction, fit_reduction
from decomotion.data.features.stage import build_feature_arrays, read_reduction
from decomotion.errors import ConfigError, SupervisionError


def random(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=shape).astype(np.float32)


def reduce_features(features: np.ndarray, size: int) -> np.ndarray:
    return fit_reduction(features, size)(features)


def cosines(vectors: np.ndarray) -> np.ndarray:
    unit = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit @ unit.T


def config(kind: str, weights: Path | None = None, size: int = 0) -> DataConfig:
    chosen = (f"data.features={kind}", f"data.feature_size={size}")
    return load("cpu", overrides=chosen if weights is None else (*chosen, f"data.feature_weights={weights}")).data


def extractor(kind: str, weights: Path | None = None) -> FeatureExtractor:
    built = build_features(config(kind, weights))
    assert built is not None
    return built


class TestReduction:
    @pytest.mark.parametrize(("size", "channels"), [(0, 12), (3, 3), (12, 12), (40, 12)])
    def test_vectors_of_unit_norm_and_of_that_size(self, size: int, channels: int):
        reduced = reduce_features(random(2, 5, 6, 12), size)
        assert reduced.shape == (2, 5, 6, channels)
        assert reduced.dtype == np.float32
        np.testing.assert_allclose(np.linalg.norm(reduced, axis=-1), 1, rtol=1e-5)

    def test_zero_leaves_the_directions(self):
        features = random(30, 12)
        np.testing.assert_allclose(cosines(reduce_features(features, 0)), cosines(features), atol=1e-5)

    def test_what_varies_in_few_directions_loses_nothing(self):
        """Features in a plane of 12 dimensions: their angles about the mean survive the reduction to 2."""
        features = random(60, 2) @ random(2, 12) + 5
        expected = cosines(features - features.mean(axis=0))
        np.testing.assert_allclose(cosines(reduce_features(features, 2)), expected, atol=1e-3)

    def test_a_blank_feature_stays_blank(self):
        assert not reduce_features(np.zeros((2, 8), np.float32), 0).any()


class TestDenseSift:
    @pytest.mark.parametrize(("height", "width"), [(33, 47), (40, 2 * FEATURE_SIDE)])
    def test_shape_and_norm(self, height: int, width: int):
        frame = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
        described = DenseSift()(frame)
        shrink = min(1, FEATURE_SIDE / width)
        assert described.shape == (round(height * shrink), round(width * shrink), 128)
        np.testing.assert_allclose(np.linalg.norm(described, axis=-1), 1, atol=1e-3)

    def test_is_kornia_s(self):
        """Which is centred between pixels, so that its mean over four of them is compared; its channels begin with the
        orientation."""
        noise = np.random.default_rng(0).integers(0, 256, (12, 18, 3), dtype=np.uint8)
        frame = cv2.resize(noise, (90, 60), interpolation=cv2.INTER_CUBIC)
        grey = torch.from_numpy(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)).float()[None, None] / 255
        between = torch.nn.functional.avg_pool2d(DenseSIFTDescriptor(padding=6)(grey), 2, stride=1)
        true = torch.nn.functional.normalize(between, dim=1)[0].permute(1, 2, 0).reshape(60, 90, 8, 16)
        by_cell = true.transpose(2, 3).reshape(60, 90, 128).detach().numpy()
        cosine = (DenseSift()(np.asarray(frame, np.uint8)) * by_cell).sum(axis=-1)
        assert cosine[8:-8, 8:-8].min() > 0.98
        assert np.median(cosine) > 0.995

    @pytest.mark.parametrize("spot", [(20, 12), (44, 30), (33, 24)])
    @pytest.mark.parametrize("enlarged", [1, 4])
    def test_lies_where_the_image_does(self, spot: tuple[int, int], enlarged: int):
        centre = centre_of_what_sees(DenseSift(), spot, enlarged)
        np.testing.assert_allclose(centre, (np.array(spot) + 0.5) * enlarged - 0.5, atol=0.5)


def centre_of_what_sees(
    describe: FeatureExtractor, spot: tuple[int, int], enlarged: int, share: float = 0.3
) -> np.ndarray:
    """(x, y), in pixels of the frame, of the descriptors that a dot in a blank frame of 64 x 48 changes."""
    small = np.zeros((48, 64, 3), np.uint8)
    blank = np.kron(small, np.ones((enlarged, enlarged, 1), np.uint8))
    small[spot[1], spot[0]] = 255
    frame = np.kron(small, np.ones((enlarged, enlarged, 1), np.uint8))
    change = np.abs(describe(frame) - describe(blank)).max(axis=-1)
    y, x = np.argwhere(change > share * change.max()).mean(axis=0)
    scale = np.array([frame.shape[1] / change.shape[1], frame.shape[0] / change.shape[0]])
    return (np.array([x, y]) + 0.5) * scale - 0.5


class TestAliked:
    @pytest.mark.parametrize(("name", "channels"), [("n16", 128), ("t16", 64)])
    def test_published_weights(self, shared: Path, name: str, channels: int):
        weights = shared / "weights" / f"aliked-{name}.pth"
        if not weights.is_file():
            pytest.skip(f"no weights at {weights}")
        describe = extractor("aliked", weights)
        assert describe.channels == channels <= MOST_CHANNELS["aliked"]
        frame = np.random.default_rng(0).integers(0, 256, (48, 70, 3), dtype=np.uint8)
        described = describe(frame)
        assert described.shape == (48, 70, channels)
        np.testing.assert_allclose(np.linalg.norm(described, axis=-1), 1, atol=1e-3)
        # where the change is largest: deeper levels see it from afar, on coarser rasters
        np.testing.assert_allclose(centre_of_what_sees(describe, (33, 20), 1, 0.9), (33, 20), atol=2)

    def test_other_weights_are_refused(self, tmp_path: Path):
        torch.save({"weight": torch.zeros(2)}, tmp_path / "other.pth")
        with pytest.raises(SupervisionError, match="does not hold ALIKED of a size that kornia knows"):
            extractor("aliked", tmp_path / "other.pth")
        torch.save(torch.nn.Linear(2, 2), tmp_path / "model.pth")
        with pytest.raises(SupervisionError, match="is not a file of weights"):
            extractor("aliked", tmp_path / "model.pth")

    def test_no_internet(self, monkeypatch: pytest.MonkeyPatch):
        def unreachable(*_: object, **__: object) -> None:
            raise OSError("no route")

        monkeypatch.setattr("kornia.feature.aliked.aliked.load_state_dict_from_url", unreachable)
        with pytest.raises(SupervisionError, match=r"ALIKED cannot be downloaded.*--feature-weights.*densesift"):
            AlikedFeatures()


class TestDino:
    @pytest.fixture
    def weights(self, tmp_path: Path) -> Path:
        """Of a ViT-S with patches of 16, random, under the names of DINO's own files."""
        timm = pytest.importorskip("timm")
        torch.manual_seed(0)
        model = timm.create_model("vit_small_patch16_224", num_classes=0, depth=2)
        file = tmp_path / "dino.pth"
        torch.save({f"module.backbone.{key}": value for key, value in model.state_dict().items()}, file)
        return file

    def test_a_file_tells_the_network(self, weights: Path, monkeypatch: pytest.MonkeyPatch):
        import timm

        create = timm.create_model
        monkeypatch.setattr(timm, "create_model", lambda name, **options: create(name, depth=2, **options))
        describe = extractor("dino", weights)
        assert describe.channels == 384
        frame = np.random.default_rng(0).integers(0, 256, (60, 100, 3), dtype=np.uint8)
        described = describe(frame)
        assert described.shape == (4, 6, 384)  # 64 x 96 pixels in patches of 16
        np.testing.assert_allclose(np.linalg.norm(described, axis=-1), 1, atol=1e-3)

    def test_patches_of_imagenet_s_colours(self, monkeypatch: pytest.MonkeyPatch):
        """White in units of ImageNet's spread; 512 pixels at most, and the class's token left out."""
        from decomotion.data.features import dino

        seen = []

        class Tokens(torch.nn.Module):
            embed_dim = 2
            patch_embed = SimpleNamespace(patch_size=(8, 8))

            def forward_features(self, image: torch.Tensor) -> torch.Tensor:
                seen.append(image)
                count = image.shape[-2] * image.shape[-1] // 64
                return torch.stack([torch.arange(count + 1.0), torch.full((count + 1,), 3.0)], dim=-1)[None]

        monkeypatch.setattr(dino, "_from_file", lambda _: Tokens())
        described = dino.DinoFeatures("any")(np.full((300, 600, 3), 255, np.uint8))
        assert seen[0].shape == (1, 3, 256, 512)
        np.testing.assert_allclose(seen[0][0, :, 7, 9], [2.2489, 2.4286, 2.6400], atol=1e-4)
        assert described.shape == (32, 64, 2)
        np.testing.assert_allclose(described[0, 0], np.array([1, 3]) / 10**0.5, rtol=1e-5)  # the second token
        np.testing.assert_allclose(described[1, 2], np.array([67, 3]) / 4498**0.5, rtol=1e-5)

    @pytest.mark.parametrize(("channels", "name"), [(384, "vit_small_patch16_224"), (768, "vit_base_patch16_224")])
    def test_a_file_s_channels_tell_the_network(
        self, channels: int, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        import timm

        from decomotion.data.features import dino

        asked = []

        def create(name: str, **options: object) -> torch.nn.Module:
            asked.append((name, options["patch_size"]))
            return torch.nn.Linear(2, 2, bias=False)

        monkeypatch.setattr(timm, "create_model", create)
        torch.save({"patch_embed.proj.weight": torch.zeros(channels, 3, 14, 14)}, tmp_path / "dino.pth")
        with pytest.raises(SupervisionError, match=f"does not fit DINO's ViT-{'SB'[channels // 768]}"):
            dino._from_file(str(tmp_path / "dino.pth"))
        assert asked == [(name, 14)]

    def test_weights_at_hand_need_no_network(self, monkeypatch: pytest.MonkeyPatch):
        from decomotion.data.features import dino

        monkeypatch.setattr(dino, "try_to_load_from_cache", lambda *_: "/somewhere/model.safetensors")
        monkeypatch.setattr(dino, "urlopen", None)
        dino._check_reachable()

    def test_of_another_depth(self, weights: Path):
        with pytest.raises(SupervisionError, match="does not fit DINO's ViT-S"):
            extractor("dino", weights)

    def test_of_something_else(self, tmp_path: Path):
        torch.save({"weight": torch.zeros(2)}, tmp_path / "other.pth")
        with pytest.raises(SupervisionError, match="does not hold DINO's ViT-S or ViT-B"):
            extractor("dino", tmp_path / "other.pth")

    def test_no_internet(self, monkeypatch: pytest.MonkeyPatch):
        def unreachable(*_: object, **__: object) -> None:
            raise OSError("no route")

        monkeypatch.setattr("decomotion.data.features.dino.urlopen", unreachable)
        monkeypatch.setattr("decomotion.data.features.dino.try_to_load_from_cache", lambda *_: None)
        with pytest.raises(SupervisionError, match=r"DINO cannot be downloaded.*--feature-weights.*densesift"):
            extractor("dino")

    def test_no_timm(self, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setitem(sys.modules, "timm", None)
        monkeypatch.delitem(sys.modules, "decomotion.data.features.dino", raising=False)
        with pytest.raises(SupervisionError, match=r"^features dino need timm, .* 'decomotion\[dino\]', or take"):
            extractor("dino")


def test_weights_for_features_without_any():
    with pytest.raises(ConfigError, match="feature_weights go with features aliked or dino, not densesift"):
        config("densesift", Path("weights.pth"))


@pytest.mark.parametrize(
    ("height", "width", "multiple", "expected"), [(60, 100, 16, (64, 96)), (300, 600, 1, (256, 512)), (3, 4, 8, (8, 8))]
)
def test_resized(height: int, width: int, multiple: int, expected: tuple[int, int]):
    assert resized(np.zeros((height, width, 3), np.uint8), 512, multiple).shape[:2] == expected


class TestStage:
    class Plain:
        """Descriptors that tell the colour and the place."""

        channels = 5
        calls = 0

        def __call__(self, frame: np.ndarray) -> np.ndarray:
            self.calls += 1
            y, x = np.mgrid[: frame.shape[0], : frame.shape[1]].astype(np.float32)
            return np.concatenate([frame / 255, x[..., None], y[..., None]], axis=-1).astype(np.float32)

    def clip(self) -> Clip:
        return Clip("noise", np.random.default_rng(0).integers(0, 256, (3, 8, 9, 3), dtype=np.uint8), 24.0)

    def test_read_at_the_points_and_reduced(self, tmp_path: Path):
        points = np.random.default_rng(0).uniform(0, 7, (3, 20, 2)).astype(np.float32)
        facts = build_feature_arrays(self.clip(), points, self.Plain(), 0, False, tmp_path)
        feature = np.load(tmp_path / "feature.npy")
        assert facts == {"channels": 5}
        assert feature.dtype == np.float16
        direction = feature[..., 3:] / np.linalg.norm(feature[..., 3:].astype(np.float32), axis=-1, keepdims=True)
        expected = points / np.linalg.norm(points, axis=-1, keepdims=True)
        np.testing.assert_allclose(direction, expected, atol=0.01)  # float16
        assert read_reduction(tmp_path).vectors is None

    def test_without_features_there_are_no_channels(self, tmp_path: Path):
        assert build_feature_arrays(self.clip(), np.zeros((3, 20, 2), np.float32), None, 0, False, tmp_path) == {
            "channels": 0
        }
        assert np.load(tmp_path / "feature.npy").shape == (3, 20, 0)

    def test_a_sample_of_all_frames_decides_the_directions(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        """Sixty points, fifteen at most: every fourth of each frame."""
        from decomotion.data.features import stage

        seen = []

        def fit(sample: np.ndarray, size: int) -> Reduction:
            seen.append(sample[:, 3].tolist())
            return fit_reduction(sample, size)

        monkeypatch.setattr(stage, "SAMPLE", 15)
        monkeypatch.setattr(stage, "fit_reduction", fit)
        points = np.zeros((3, 20, 2), np.float32)
        points[..., 0] = np.arange(20) / 4 + np.arange(3)[:, None]
        facts = build_feature_arrays(self.clip(), points, self.Plain(), 3, False, tmp_path)
        assert seen == [[frame + step for frame in range(3) for step in range(5)]]
        assert facts == {"channels": 3}

    def test_a_stopped_run_s_frames_are_found_again(self, tmp_path: Path):
        points = np.zeros((3, 20, 2), np.float32)
        (tmp_path / "described").mkdir()
        np.save(tmp_path / "described" / "0.npy", np.ones((20, 5), np.float16))
        (tmp_path / "described" / "1.npy").write_bytes(b"half")
        describe = self.Plain()
        build_feature_arrays(self.clip(), points, describe, 2, False, tmp_path)
        assert describe.calls == 2
        assert np.load(tmp_path / "feature.npy").shape == (3, 20, 2)
        vectors = read_reduction(tmp_path).vectors
        assert vectors is not None
        assert vectors.shape == (5, 2)
        assert not (tmp_path / "described").exists()

    @pytest.mark.parametrize("size", [0, 2])
    def test_a_run_stopped_while_it_reduces_goes_on_there(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int
    ):
        points = np.random.default_rng(0).uniform(0, 7, (3, 20, 2)).astype(np.float32)
        for name in ("whole", "stopped"):
            (tmp_path / name).mkdir()
        build_feature_arrays(self.clip(), points, self.Plain(), size, False, tmp_path / "whole")
        reduce, reduced = Reduction.__call__, []

        def stopped(self: Reduction, features: np.ndarray) -> np.ndarray:
            reduced.append(len(features))
            if len(reduced) == 2:
                raise KeyboardInterrupt
            return reduce(self, features)

        describe = self.Plain()
        with monkeypatch.context() as patch:
            patch.setattr(Reduction, "__call__", stopped)
            with pytest.raises(KeyboardInterrupt):
                build_feature_arrays(self.clip(), points, describe, size, False, tmp_path / "stopped")
        assert {file.name for file in (tmp_path / "stopped/described").iterdir()} == {"1.npy", "2.npy"}
        build_feature_arrays(self.clip(), points, describe, size, False, tmp_path / "stopped")
        assert describe.calls == 3
        np.testing.assert_array_equal(
            np.load(tmp_path / "stopped/feature.npy"), np.load(tmp_path / "whole/feature.npy")
        )
