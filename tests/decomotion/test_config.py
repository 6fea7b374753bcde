"""The configuration: what loads, and what is named when it does not."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
import yaml

import decomotion
from decomotion.config import load, parse
from decomotion.errors import ConfigError
from decomotion.model.config import GridFieldConfig, MlpConditionerConfig
from decomotion.prepare_cli import command as prepare
from decomotion.presets import AUTO, AUTO_PRESET, PRESETS
from decomotion.schedule import Schedule

every_preset = pytest.mark.parametrize("preset", PRESETS)


@every_preset
def test_presets_load_and_carry_their_names(preset: str):
    assert load(preset).preset == preset


@every_preset
def test_there_and_back_through_plain_values(preset: str):
    config = load(preset)
    written = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    assert parse(yaml.safe_load(written), "config.yaml") == config


def test_a_run_from_before_hidden_points_had_a_share_goes_on_without():
    plain = load("cpu").model_dump(mode="json")
    del plain["optim"]["hidden_share"], plain["loss"]["flow_hidden"]
    assert parse(plain, "config.yaml").optim.hidden_share == 0


def test_omnimotion_is_cpu_but_for_the_decomposition():
    """Whatever else changes in `cpu` changes in both."""
    single, fused = load("omnimotion"), load("cpu")
    assert single.optim == fused.optim.model_copy(update={"hidden_share": 0})
    assert fused.optim.hidden_share > 0
    assert fused.loss["flow_hidden"] != 0  # one without the other is of no use
    assert single.data == fused.data.model_copy(update={"masks": "none", "features": "none"})
    guided = {f"{kind}_{volume}" for kind in ("flow", "photometric") for volume in ("static", "dynamic")}
    off = {*guided, "flow_hidden", "feature", "segmentation"}
    assert single.loss == {name: 0 if name in off else weight for name, weight in fused.loss.items()}
    assert single.model.volumes == "dynamic"
    unchanged = {"volumes": "fused", "dynamic": fused.model.dynamic}
    assert single.model.model_copy(update=unchanged) == fused.model
    assert single.model.dynamic.start == fused.model.static.start == "camera"


def test_paper_is_the_paper():
    """What Sec. 4.1 and the supplement state."""
    config = load("paper")
    assert config.model.samples == 32
    assert (config.model.static.couplings, config.model.dynamic.couplings) == (3, 6)
    for field in (config.model.static.field, config.model.dynamic.field, config.model.feature_field):
        assert (field.kind, field.width) == ("gabor", 512)
        assert getattr(field, "layers", None) == 3
    assert config.model.frame_code.kind == "time"
    assert config.model.frame_code.hidden == 256
    assert (config.optim.steps, config.optim.pairs, config.optim.points) == (100_000, 8, 256)
    assert (config.optim.lr_field, config.optim.lr_transform, config.optim.lr_code) == (3e-4, 1e-4, 1e-3)
    assert config.optim.decay == "step"
    assert config.optim.decay_every * config.optim.steps == 20_000
    started = {name: weight.value if isinstance(weight, Schedule) else weight for name, weight in config.loss.items()}
    assert (started["photometric_dynamic"], started["feature"]) == (1, 10)
    assert (started["photometric_static"], started["segmentation"], started["photometric_fused"]) == (1, 1, 1)
    guided = ("flow_dynamic", "flow_static", "segmentation")
    assert all(isinstance(weight := config.loss[name], Schedule) and weight.to == 0 for name in guided)


def test_overrides():
    config = load(
        "cpu",
        overrides=(
            "optim.steps=7",
            "optim.lr_field=1e-4",  # YAML 1.1 reads this as text
            "data.masks=none",
            "loss.distortion=0",
            "loss.flow_fused={value: 0, to: 1, begin: 0.1, end: 0.2}",
            "data.flow.intervals=[1, 3]",
            "model.static.field.width=5",
            "model.dynamic.conditioner={kind: mlp, frequencies: 1, encoding: 4, hidden: 4, layers: 1}",
            "model.dynamic.surface=null",
        ),
    )
    assert (config.optim.steps, config.optim.lr_field, config.data.masks) == (7, 1e-4, "none")
    assert config.loss["distortion"] == 0
    assert config.loss["flow_fused"] == Schedule(value=0, to=1, begin=0.1, end=0.2)
    assert config.data.flow.intervals == (1, 3)
    assert isinstance(config.model.static.field, GridFieldConfig)
    assert config.model.static.field.width == 5
    assert isinstance(config.model.dynamic.conditioner, MlpConditionerConfig)
    assert config.model.dynamic.surface is None


def test_an_override_leaves_the_rest():
    changed, preset = load("cpu", overrides=("optim.steps=7",)), load("cpu")
    assert changed.model_copy(update={"optim": preset.optim}) == preset


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("optim.stepz=7", "there is no key optim.stepz"),
        ("optimm.steps=7", "there is no key optimm"),
        ("optim.steps.more=7", "there is no key optim.steps.more"),
        ("loss.flow_fussed=1", "there is no key loss.flow_fussed"),
        ("optim.steps", "is not of the form key=value"),
        ("=3", "is not of the form key=value"),
        ("optim..steps=3", "is not of the form key=value"),
        ("optim.steps=[1", "the value is not YAML"),
        ("optim.steps=many", "optim.steps: input should be a valid integer"),
        ("optim.steps=0", "optim.steps: input should be greater than or equal to 1"),
        ("optim.decay=linear", "optim.decay: input should be 'cosine' or 'step'"),
        ("model.static.field.kind=mesh", "model.static.field: "),
        ("model.static.field.cells=3", "there is no key model.static.field.cells"),
        ("data.flow.intervals=[2, 4]", "data.flow.intervals: value error, gaps must be positive and one of them 1"),
        ("data.flow.intervals=[1, 0]", "data.flow.intervals: value error, gaps must be positive and one of them 1"),
        ("model.static.directions=[]", "model.static.directions: tuple should have at least 1 item"),
        ("model.static.directions=[[0, 0, 0]]", "model.static.directions: value error, a direction of zeros leads"),
        ("model.static.conditioner.cells=[]", "cells: tuple should have at least 1 item"),
        ("model.static.conditioner.cells=[2, 0]", "cells.1: input should be greater than or equal to 1"),
        ("model.static.field.image_cells=[]", "image_cells: tuple should have at least 1 item"),
        ("model.static.field.image_cells=[0]", "image_cells.0: input should be greater than or equal to 1"),
        ("loss.distortion=much", "loss.distortion"),
        ("loss.distortion={value: 1, to: 0, begin: 0, end: 2}", "end: input should be less than or equal to 1"),
    ],
)
def test_a_bad_override_is_named(override: str, message: str):
    with pytest.raises(ConfigError) as raised:
        load("cpu", overrides=(override,))
    assert message in str(raised.value)


def write(path: Path, change: str = "", **changes: object) -> Path:
    tree = load("cpu").model_dump(mode="json") | changes
    path.write_text(yaml.safe_dump(tree) + change, encoding="utf-8")
    return path


def test_a_file_in_the_presets_form(tmp_path: Path):
    assert load(file=write(tmp_path / "mine.yaml", preset="mine"), overrides=("optim.steps=9",)).preset == "mine"


def test_a_file_that_extends_a_preset(tmp_path: Path):
    file = tmp_path / "mine.yaml"
    field = "{kind: gabor, width: 8, layers: 2, input_scale: 8.0, alpha: 3.0}"
    file.write_text(f"extends: cpu\npreset: mine\nmodel: {{static: {{couplings: 1, field: {field}}}}}\n")
    config, cpu = load(file=file, overrides=("optim.steps=9",)), load("cpu")
    assert (config.preset, config.model.static.couplings, config.optim.steps) == ("mine", 1, 9)
    assert config.model.static.field.kind == "gabor"
    assert config.model.static.conditioner == cpu.model.static.conditioner
    assert config.model.dynamic == cpu.model.dynamic
    file.write_text("extends: gpu\n")
    with pytest.raises(ConfigError, match="preset 'gpu' is unknown"):
        load(file=file)


def test_unknown_and_missing_keys_of_a_file_are_named(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"mine\.yaml: verbose: extra inputs are not permitted"):
        load(file=write(tmp_path / "mine.yaml", verbose=True))
    with pytest.raises(ConfigError, match=r"mine\.yaml: optim\.steps: field required"):
        load(file=write(tmp_path / "mine.yaml", optim={}))


def test_files_that_are_none(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"mine\.yaml does not exist"):
        load(file=tmp_path / "mine.yaml")
    (tmp_path / "list.yaml").write_text("- 1")
    with pytest.raises(ConfigError, match="does not hold a mapping"):
        load(file=tmp_path / "list.yaml")
    (tmp_path / "broken.yaml").write_text("{")
    with pytest.raises(ConfigError, match="is not YAML"):
        load(file=tmp_path / "broken.yaml")
    (tmp_path / "clip.mp4").write_bytes(b"\x00\x00\x00\x20ftyp\xff\xfe")
    with pytest.raises(ConfigError, match="is not YAML"):
        load(file=tmp_path / "clip.mp4")


def test_an_unknown_preset_is_named():
    with pytest.raises(ConfigError, match="preset 'gpu' is unknown; choose one of cpu, omnimotion, paper"):
        load("gpu")


def test_it_is_frozen():
    with pytest.raises(ValueError, match="frozen"):
        load("cpu").optim.steps = 3  # type: ignore[misc]


def test_each_preset_is_a_file_and_can_be_chosen():
    (option,) = [parameter for parameter in prepare.params if parameter.name == "preset"]
    files = {file.stem for file in (Path(decomotion.__file__).parent / "configs").glob("*.yaml")}
    assert isinstance(option.type, click.Choice)
    assert {*option.type.choices} == {AUTO, *PRESETS} == {AUTO, *files}
    assert AUTO_PRESET in PRESETS
