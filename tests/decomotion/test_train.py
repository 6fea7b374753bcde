"""The fit: it learns, it stops when it should, and it goes on as if it had not stopped."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from copy import deepcopy
from itertools import count
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import yaml

from decomotion import checkpoint, quality, train
from decomotion.config import Config, load, parse
from decomotion.console import interrupt_flag
from decomotion.data.batch import Batch, Sampler
from decomotion.data.pool import Pool
from decomotion.data.prepare import prepare
from decomotion.device import choose_device
from decomotion.errors import CheckpointError, ConfigError, TrainingError
from decomotion.losses import LOSSES, Loss
from decomotion.model.fusion import DecoMotion
from decomotion.record import Record
from decomotion.run import Run
from decomotion.schedule import Budget, learning_rate_factor, longest_gap, value_at
from decomotion.train import fit, start_maps
from interruption import Killed, ctrl_c, interruption, killed
from tiny_fit import FRAMES, TINY_PRESETS, offsets, sliding_square

CLIP = sliding_square()


def tiny_config(preset: str = "cpu", *overrides: str) -> Config:
    return load(preset, overrides=(*TINY_PRESETS[preset], *overrides))


def model_of(run: Path) -> DecoMotion:
    return checkpoint.load(run / checkpoint.FILE_NAME).model


def flow_error(model: DecoMotion, pool: Pool) -> float:
    """Mean distance in pixels of the fused position from the confident targets of one fixed batch."""
    batch = Sampler(pool, load("cpu").optim).draw(FRAMES - 1, torch.Generator().manual_seed(1))
    with torch.no_grad():
        prediction = model.predict(batch.xy, batch.frame, batch.target_frame, offsets(model, batch.xy, 2))
    distance = (prediction.fused_xy - batch.target_xy).norm(dim=-1)
    return distance[batch.confidence > 0.5].mean().item()


class TestLearning:
    def test_the_error_falls(self, tiny_run: Path, tmp_path: Path):
        pool = prepare(CLIP, tiny_config().data, progress=False)
        start = fit(CLIP, tmp_path / "start", config=tiny_config(), steps=1, progress=False)
        before, after = flow_error(model_of(start), pool), flow_error(model_of(tiny_run), pool)
        assert after < 0.95 * before

    def test_the_error_falls_from_identity_maps_too(self, tmp_path: Path):
        identity = tiny_config(
            "cpu", "model.static.start=identity", "model.dynamic.start=identity", "optim.lr_transform=0.02"
        )
        pool = prepare(CLIP, identity.data, progress=False)
        runs = [fit(CLIP, tmp_path / str(n), config=identity, steps=n, progress=False) for n in (1, 40)]
        before, after = (flow_error(model_of(run), pool) for run in runs)
        assert after < 0.7 * before

    def test_what_a_run_leaves(self, tiny_run: Path):
        assert {file.name for file in tiny_run.iterdir()} == {
            "checkpoint.pt",
            "config.yaml",
            "quality.json",
            "run.json",
            "tensorboard",
            "previews",
        }
        assert (tiny_run / "previews" / "000020.png").is_file()
        assert list((tiny_run / "tensorboard").glob("events.*"))
        assert parse(yaml.safe_load((tiny_run / "config.yaml").read_text()), "config.yaml") == tiny_config()

    def test_its_losses_are_logged_by_name(self, tiny_run: Path):
        from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

        events = EventAccumulator(str(tiny_run / "tensorboard")).Reload()
        held_out = {f"held_out/{kind}" for kind in ("all", "dynamic", "gap_1", "gap_2_to_4", "gap_5_to_7")}
        assert set(events.Tags()["scalars"]) - {"held_out/static"} == {f"loss/{name}" for name in LOSSES} | held_out
        assert [event.step for event in events.Scalars("loss/flow_fused")] == list(range(1, 21))

    def test_the_paper_s_preset(self, tmp_path: Path):
        config = tiny_config("paper")
        run = fit(CLIP, tmp_path / "run", config=config, steps=2, progress=False)
        loaded = checkpoint.load(run / checkpoint.FILE_NAME)
        assert loaded.training["step"] == 2
        assert loaded.config == config

    def test_without_masks(self, tmp_path: Path):
        from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

        config = tiny_config("cpu", "data.masks=none", "log.scalars_every=1")
        run = fit(CLIP, tmp_path / "run", config=config, steps=2, progress=False)
        events = EventAccumulator(str(run / "tensorboard")).Reload()
        values = {name: [event.value for event in events.Scalars(f"loss/{name}")] for name in LOSSES}
        assert values["flow_static"] == values["flow_dynamic"] == values["segmentation"] == [0, 0]
        assert min(values["flow_fused"]) > 0

    def test_the_seed_decides(self, tmp_path: Path):
        runs = [
            fit(CLIP, tmp_path / str(index), config=tiny_config(), steps=2, seed=seed, progress=False)
            for index, seed in enumerate((1, 1, 2))
        ]
        first, same, other = (model_of(run).state_dict() for run in runs)
        assert all(torch.equal(first[name], same[name]) for name in first)
        assert not torch.equal(first["static.head.weight"], other["static.head.weight"])

    @pytest.mark.parametrize("seeds", [(0, 1), (0, 7), (1, 2**31 - 1)])
    def test_the_seed_decides_all_that_is_drawn(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seeds: tuple[int, int]
    ):
        """Pairs, points and depths of every step, and the points that are prepared; not the first weights alone."""
        whole, drawn = Run._parts, []

        def parts(run: Run, batch: Batch, offset: torch.Tensor) -> Iterator[tuple[Batch, torch.Tensor]]:
            drawn.append((batch, offset, run.pool.points))
            return whole(run, batch, offset)

        monkeypatch.setattr(Run, "_parts", parts)
        for number, seed in enumerate((*seeds, seeds[0])):
            fit(CLIP, tmp_path / str(number), config=tiny_config(), steps=3, seed=seed, progress=False)
        first, other, again = drawn[:3], drawn[3:6], drawn[6:]
        assert len(again) == 3
        for (batch, depths, points), (elses, its_depths, its_points) in zip(first, other, strict=True):
            assert not torch.equal(batch.frame * FRAMES + batch.target_frame, elses.frame * FRAMES + elses.target_frame)
            assert (batch.point != elses.point).float().mean() > 0.9
            assert not torch.equal(depths, its_depths)
            assert (points != its_points).mean() > 0.9
        for (batch, depths, points), (same, its_depths, its_points) in zip(first, again, strict=True):
            assert all(torch.equal(value, vars(same)[name]) for name, value in vars(batch).items())
            assert torch.equal(depths, its_depths)
            assert (points == its_points).all()
        assert not torch.equal(first[0][0].point, first[1][0].point)  # nor do two steps draw alike

    def test_an_unknown_loss_stops_before_any_work(self, tmp_path: Path):
        config = tiny_config()
        with pytest.raises(ConfigError, match=r"loss\.flow"):
            fit(CLIP, tmp_path / "run", config=config.model_copy(update={"loss": {"flow": 1.0}}), progress=False)
        assert not (tmp_path / "run").exists()

    @pytest.mark.parametrize(
        ("loss", "when"),
        [
            ({"flow_fused": 0.0}, "0%"),
            ({"flow_fused": {"value": 1.0, "to": 0.0, "begin": 0.1, "end": 0.4}, "distortion": 0.0}, "40%"),
            ({"flow_static": 1.0}, "0%"),
        ],
    )
    def test_without_any_weight_it_stops_too(self, tmp_path: Path, loss: dict[str, object], when: str):
        settings = tiny_config("omnimotion").model_dump(mode="json") | {"loss": loss}
        with pytest.raises(ConfigError, match=f"no loss has a weight above 0 at {when} of the run"):
            fit(CLIP, tmp_path / "run", config=parse(settings, "mine"), progress=False)
        assert not (tmp_path / "run").exists()


def assert_equal_bits(first: Path, second: Path) -> None:
    one, two = (torch.load(run / checkpoint.FILE_NAME, weights_only=True) for run in (first, second))
    assert one["model"].keys() == two["model"].keys()
    different = [name for name in one["model"] if not torch.equal(one["model"][name], two["model"][name])]
    assert different == []
    assert torch.equal(one["training"]["errors"], two["training"]["errors"])
    assert one["training"]["step"] == two["training"]["step"]
    for state, other in zip(
        one["training"]["optimiser"]["state"].values(), two["training"]["optimiser"]["state"].values(), strict=True
    ):
        assert all(torch.equal(state[key], other[key]) for key in state)


class TestQuality:
    def test_it_is_kept_in_the_run(self, tiny_run: Path):
        kept = checkpoint.load(tiny_run / checkpoint.FILE_NAME).quality
        assert kept is not None
        assert kept == quality.parse((tiny_run / quality.FILE_NAME).read_text())
        assert kept.steps == 20
        assert kept.all.links > 100

    def test_a_longer_fit_has_better_figures(self, tiny_run: Path, tmp_path: Path):
        short = fit(CLIP, tmp_path / "run", config=tiny_config(), steps=1, progress=False)
        before, after = (quality.parse((run / quality.FILE_NAME).read_text()) for run in (short, tiny_run))
        assert after.all.median < before.all.median

    def test_a_resumed_fit_holds_out_the_same_links(self, tmp_path: Path):
        config = tiny_config("cpu", *TestResume.SETTINGS)
        straight = fit(CLIP, tmp_path / "straight", config=config, steps=4, seed=5, progress=False)
        with interruption(2, ctrl_c), pytest.raises(KeyboardInterrupt):
            fit(CLIP, tmp_path / "run", config=config, steps=4, seed=5, progress=False, stopping=interrupt_flag)
        assert checkpoint.load(tmp_path / "run" / checkpoint.FILE_NAME).quality is None
        broken = fit(CLIP, tmp_path / "run", resume=True, progress=False)
        assert (straight / quality.FILE_NAME).read_text() == (broken / quality.FILE_NAME).read_text()

    def test_of_a_run_that_goes_on_it_is_not_that_of_its_former_end(self, tmp_path: Path):
        run = fit(CLIP, tmp_path / "run", config=tiny_config(), steps=2, progress=False)
        with interruption(3, ctrl_c), pytest.raises(KeyboardInterrupt):
            fit(CLIP, run, resume=True, steps=9, progress=False, stopping=interrupt_flag)
        assert not (run / quality.FILE_NAME).exists()
        assert checkpoint.load(run / checkpoint.FILE_NAME).quality is None

    def test_what_is_thinned_is_kept_too(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ):
        """Also where the fit is stopped."""
        line = "flow at gaps 1 of 1, 2, 4: budget"
        monkeypatch.setattr("decomotion.data.prepare.keys.what_is_thinned", lambda *_: line)
        run = fit(CLIP, tmp_path / "run", config=tiny_config(), steps=1, progress=False)
        loaded = checkpoint.load(run / checkpoint.FILE_NAME)
        assert loaded.quality is not None
        assert loaded.thinned == loaded.quality.thinned == line
        assert f"its links are thinned ({line})" in caplog.text
        assert "Fit the clip anew with a longer --prepare-budget and --steps 3000" in caplog.text
        with interruption(1, ctrl_c), pytest.raises(KeyboardInterrupt):
            fit(CLIP, run, resume=True, steps=9, progress=False, stopping=interrupt_flag)
        assert checkpoint.load(run / checkpoint.FILE_NAME).thinned == line


class TestResume:
    """Six steps without a break, and six with one after the third, end in the same bits."""

    SETTINGS = ("optim.hard_mining=0.5", "optim.count_maps=true", "optim.micro_batch=2")

    @pytest.fixture(params=["cpu", "paper"])
    def config(self, request: pytest.FixtureRequest) -> Config:
        return tiny_config(request.param, *self.SETTINGS)

    @pytest.fixture
    def straight(self, config: Config, tmp_path: Path) -> Path:
        return fit(CLIP, tmp_path / "straight", config=config, steps=6, progress=False)

    def test_after_ctrl_c(self, config: Config, straight: Path, tmp_path: Path):
        former = signal.getsignal(signal.SIGINT)
        with interruption(2, ctrl_c), pytest.raises(KeyboardInterrupt):
            fit(CLIP, tmp_path / "broken", config=config, steps=6, progress=False, stopping=interrupt_flag)
        assert signal.getsignal(signal.SIGINT) is former
        assert checkpoint.load(tmp_path / "broken" / checkpoint.FILE_NAME).training["step"] == 3
        # neither the seed, the configuration nor the number of steps is said again
        torch.rand(7)
        assert_equal_bits(straight, fit(CLIP, tmp_path / "broken", resume=True, progress=False))

    def test_after_a_kill(self, config: Config, straight: Path, tmp_path: Path):
        always = config.model_copy(update={"log": config.log.model_copy(update={"checkpoint_seconds": 1e-9})})
        with interruption(4, killed), pytest.raises(Killed):
            fit(CLIP, tmp_path / "broken", config=always, steps=6, progress=False)
        assert checkpoint.load(tmp_path / "broken" / checkpoint.FILE_NAME).training["step"] == 4
        assert_equal_bits(straight, fit(CLIP, tmp_path / "broken", resume=True, progress=False))

    def test_killed_before_the_first_step_of_a_new_run_in_an_old_folder(
        self, config: Config, straight: Path, tmp_path: Path
    ):
        fit(CLIP, tmp_path / "broken", config=config, steps=2, seed=5, progress=False)
        with interruption(0, killed), pytest.raises(Killed):
            fit(CLIP, tmp_path / "broken", config=config, steps=6, progress=False)
        assert_equal_bits(straight, fit(CLIP, tmp_path / "broken", resume=True, progress=False))


def test_a_second_ctrl_c_interrupts_at_once():
    former = signal.signal(signal.SIGINT, signal.default_int_handler)  # where tests run in the background, none is set
    try:
        with interrupt_flag() as interrupted:
            ctrl_c()
            assert interrupted.is_set()
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, former)


def test_a_fit_in_a_thread_of_its_own(tmp_path: Path):
    """There, Python lets nobody handle signals."""
    fitting = Thread(
        target=fit, args=(CLIP, tmp_path / "run"), kwargs={"config": tiny_config(), "steps": 2, "progress": False}
    )
    fitting.start()
    fitting.join(120)
    assert checkpoint.load(tmp_path / "run" / checkpoint.FILE_NAME).training["step"] == 2


def test_a_finished_run_resumed_stays_and_a_longer_one_goes_on(tmp_path: Path):
    run = fit(CLIP, tmp_path / "run", config=tiny_config(), steps=2, progress=False)
    before = model_of(run).state_dict()
    fit(CLIP, run, resume=True, progress=False)
    assert all(torch.equal(value, before[name]) for name, value in model_of(run).state_dict().items())
    fit(CLIP, run, resume=True, steps=3, progress=False)
    assert checkpoint.load(run / checkpoint.FILE_NAME).training["step"] == 3


def test_a_longer_budget_outlasts_a_kill_before_the_next_checkpoint(tmp_path: Path):
    run = fit(CLIP, tmp_path / "run", config=tiny_config(), steps=2, progress=False)
    with interruption(2, killed), pytest.raises(Killed):
        fit(CLIP, run, resume=True, steps=4, progress=False)
    fit(CLIP, run, resume=True, progress=False)
    training = checkpoint.load(run / checkpoint.FILE_NAME).training
    assert (training["step"], training["budget"]) == (4, {"steps": 4, "seconds": None})


def test_a_short_time_leaves_preparation_a_share_of_it(tmp_path: Path):
    config = tiny_config("cpu", "data.flow.intervals=geometric", "data.prepare_budget=180")
    run = fit(CLIP, tmp_path / "run", config=config, time_budget=1.0, rebuild_cache=True, progress=False)
    assert checkpoint.load(run / checkpoint.FILE_NAME).config.data.prepare_budget == 0.75
    assert yaml.safe_load((run / "config.yaml").read_text())["data"]["prepare_budget"] == 0.75


def test_another_clip_on_resume(tiny_run: Path):
    with pytest.raises(CheckpointError, match=r"was fitted to another clip \(sliding, 8 frames of 40x28\)"):
        fit(sliding_square(5), tiny_run, resume=True, progress=False)


def test_another_number_of_tracks_on_resume(tmp_path: Path):
    file = tmp_path / "tracks.npz"

    def write(count: int) -> None:
        np.savez(file, tracks=np.full((count, FRAMES, 2), 9.0), occluded=np.zeros((count, FRAMES), bool))

    write(2)
    run = fit(CLIP, tmp_path / "run", config=tiny_config("cpu", f"data.tracks={file}"), steps=1, progress=False)
    write(3)
    with pytest.raises(CheckpointError, match=r"was fitted to 262 points a frame but .* now has 263: its tracks"):
        fit(CLIP, run, resume=True, steps=2, progress=False)


def test_nothing_to_resume(tmp_path: Path):
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt does not exist; train first"):
        fit(CLIP, tmp_path / "run", resume=True, progress=False)
    assert not (tmp_path / "run").exists()


class TestBudget:
    @pytest.fixture
    def clock(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Every look at it takes a tenth of a second."""
        ticks = count()
        watch = SimpleNamespace(monotonic=lambda: next(ticks) / 10)
        for module in ("decomotion.run", "decomotion.train"):
            monkeypatch.setattr(f"{module}.time", watch)

    @pytest.mark.usefixtures("clock")
    def test_of_time(self, tmp_path: Path):
        """What an interrupted run has used up, a resumed one does not get again."""
        config = tiny_config()
        straight = fit(CLIP, tmp_path / "straight", config=config, time_budget=3.0, progress=False)
        with interruption(5, ctrl_c), pytest.raises(KeyboardInterrupt):
            fit(CLIP, tmp_path / "broken", config=config, time_budget=3.0, progress=False, stopping=interrupt_flag)
        broken = fit(CLIP, tmp_path / "broken", resume=True, progress=False)
        one, other = (checkpoint.load(run / checkpoint.FILE_NAME).training for run in (straight, broken))
        assert 3.0 <= min(one["elapsed"], other["elapsed"]) <= max(one["elapsed"], other["elapsed"]) < 3.5
        assert one["step"] > 6
        assert abs(one["step"] - other["step"]) < 5  # stopping takes a few looks at the clock

    @pytest.mark.usefixtures("clock")
    def test_that_leaves_few_steps_is_said_with_what_to_do(self, tmp_path: Path, caplog: pytest.LogCaptureFixture):
        run = fit(CLIP, tmp_path / "run", config=tiny_config(), time_budget=1e-3, progress=False)
        steps = checkpoint.load(run / checkpoint.FILE_NAME).training["step"]
        assert 1 < steps < 20
        [said] = [record.getMessage() for record in caplog.records if "starved" in record.getMessage()]
        assert said.startswith(f"the fit is starved: it took {steps} steps, which is few")
        assert said.endswith(f"Go on with decomo-train on the same clip with --resume --out {run} --time-budget 1m")


class TestFailure:
    @pytest.mark.parametrize("value", [float("nan"), float("inf")])
    def test_a_loss_that_is_not_a_number(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, value: float):
        sound = LOSSES["photometric_fused"]
        monkeypatch.setitem(LOSSES, "photometric_fused", Loss(lambda p, b: sound(p, b) * self.after_two_calls(value)))
        self.calls = 0
        with pytest.raises(TrainingError, match=r"loss photometric_fused is not a number at step 2; .*batch\.pt"):
            fit(CLIP, tmp_path / "run", config=tiny_config(), steps=6, progress=False)
        batch = torch.load(tmp_path / "run" / "failed_batch.pt", weights_only=True)
        assert batch["xy"].shape == (4, 32, 2)
        assert all(value.isfinite().all() for value in model_of(tmp_path / "run").parameters())

    def test_a_gradient_that_is_not_a_number(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        """The loss is 0, its slope infinite: the weights of the last sound step are what is kept."""
        endless = Loss(lambda p, b: (p.depths.sum() * 0 + 0 * p.static_weights.sum()).sqrt())
        monkeypatch.setitem(LOSSES, "distortion", endless)
        with pytest.raises(TrainingError, match=r"the gradient is not a number at step 0; .*batch\.pt"):
            fit(CLIP, tmp_path / "run", config=tiny_config(), steps=6, progress=False)
        assert all(value.isfinite().all() for value in model_of(tmp_path / "run").parameters())

    def after_two_calls(self, value: float) -> float:
        self.calls += 1
        return value if self.calls > 2 else 1.0


class TestDevice:
    def test_auto(self, monkeypatch: pytest.MonkeyPatch):
        for available, expected in ((True, "cuda"), (False, "cpu")):
            monkeypatch.setattr(torch.cuda, "is_available", lambda available=available: available)
            assert choose_device("auto") == expected

    def test_absent(self, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
        for name in ("cuda", "cuda:1"):
            with pytest.raises(ConfigError, match="torch sees no CUDA device; use --device cpu or auto"):
                choose_device(name)

    def test_unknown(self):
        with pytest.raises(ConfigError, match="--device gpu is not a device that torch knows"):
            choose_device("gpu")

    @pytest.mark.parametrize("name", ["meta", "cuda:9", "mps", "xpu"])
    def test_known_but_of_no_use(self, name: str, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
        with pytest.raises(ConfigError, match=f"--device {name} cannot be computed on here; use auto, cpu or cuda"):
            choose_device(name)

    @pytest.mark.gpu
    def test_a_fit_on_the_gpu(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        whole, used = Run.optimise, []

        def optimise(run: Run, progress: float) -> dict[str, float]:
            used.append(next(run.model.parameters()).device.type)
            return whole(run, progress)

        monkeypatch.setattr(Run, "optimise", optimise)
        run = fit(CLIP, tmp_path / "run", config=tiny_config(), steps=2, device="cuda", progress=False)
        fit(CLIP, run, resume=True, steps=3, device="cuda", progress=False)
        assert used == ["cuda"] * 3
        assert next(model_of(run).parameters()).device.type == "cpu"  # read anywhere


@pytest.fixture
def run(tmp_path: Path) -> Run:
    config = tiny_config("cpu", "optim.smooth_share=0.25")
    pool = prepare(CLIP, config.data, progress=False)
    record = Record(CLIP.digest(), config, 0, Budget(1))
    return train._begun(tmp_path / "run", CLIP, record, pool, torch.device("cpu"))


def test_micro_batches_give_the_gradient_of_the_whole(run: Run):
    """And the same losses: all are means over pairs of equal size."""
    run.losses = dict.fromkeys(LOSSES, 1.0)
    with torch.no_grad():
        for parameter in run.model.parameters():
            parameter += 0.02 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(0))
    before = deepcopy(run.model.state_dict())
    results = []
    for size in (0, 3, 2, 1):  # of 4 pairs; 0: all, and 3 leaves a rest
        run.model.load_state_dict(before)
        run.config = run.config.model_copy(update={"optim": run.config.optim.model_copy(update={"micro_batch": size})})
        totals = run.optimise(0.5)
        results.append((totals, [p.grad.clone() for p in run.model.parameters() if p.grad is not None]))
    (whole, gradient), *parts = results
    for values, part in parts:
        assert values == pytest.approx(whole, rel=1e-4)
        for one, other in zip(gradient, part, strict=True):
            # float32 sums in another order
            torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-4 * float(one.abs().max()) + 1e-8)


def test_a_step_follows_the_schedules(run: Run, monkeypatch: pytest.MonkeyPatch):
    """Learning rates, weights of the losses and the longest gap, as they are at that point of the run."""
    gaps, weighed = [], []
    draw, add = run.sampler.draw, run.gradient.add
    monkeypatch.setattr(run.sampler, "draw", lambda gap, generator: gaps.append(gap) or draw(gap, generator))
    monkeypatch.setattr(run.gradient, "add", lambda *given: weighed.append(given[-1]) or add(*given))
    optim = run.config.optim
    for progress in (0.0, 0.45, 0.9):
        run.optimise(progress)
        assert gaps.pop() == longest_gap(optim, progress, FRAMES)
        weights = {name: value_at(weight, progress) for name, weight in run.config.loss.items()}
        assert weighed.pop() == {name: weight for name, weight in weights.items() if weight > 0}
        for group in run.optimiser.param_groups:
            assert group["lr"] == group["base_lr"] * learning_rate_factor(optim, progress)
    assert longest_gap(optim, 0.0, FRAMES) < longest_gap(optim, 0.45, FRAMES)


def test_every_parameter_has_one_learning_rate(run: Run):
    names = {parameter: name for name, parameter in run.model.named_parameters()}
    rates = {names[p]: group["base_lr"] for group in run.optimiser.param_groups for p in group["params"]}
    assert rates.keys() == set(names.values())
    optim = run.config.optim
    assert rates["frame_code.codes"] == optim.lr_code
    assert rates["static.affine.correction.0.weight"] == optim.lr_transform
    assert rates["dynamic.couplings.1.conditioner.basis.0"] == optim.lr_transform
    assert rates["static.field.network.0.weight"] == rates["feature_head.bias"] == optim.lr_field


def test_a_loss_of_weight_zero_is_not_computed(run: Run, monkeypatch: pytest.MonkeyPatch):
    def fail(*args: object) -> torch.Tensor:
        raise AssertionError("computed")

    monkeypatch.setitem(LOSSES, "distortion", Loss(fail))
    run.losses = {"flow_fused": 1.0, "distortion": 0.0}
    values = run.optimise(0.5)
    assert values["flow_fused"] > 0
    assert values["distortion"] == 0


def test_start_maps(run: Run):
    pool = run.pool
    assert torch.equal(start_maps("identity", pool), torch.eye(3, 4).repeat(FRAMES, 1, 1))
    for kind in ("camera", "object"):
        maps = start_maps(kind, pool)
        np.testing.assert_array_equal(maps[:, :2][..., [0, 1, 3]], getattr(pool, kind))
        assert maps[:, 2].tolist() == [[0, 0, 1, 0]] * FRAMES


def test_defaults_are_the_cpu_preset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(train, "load_config", lambda preset: tiny_config(preset))
    assert fit(CLIP, steps=1, progress=False) == Path("runs/sliding")
