"""Who may import whom: runtime and scoring know nothing of torch, and no arrow points back to where it came from."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from graphlib import TopologicalSorter
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {
    "decomotion": ROOT / "decomotion",
    "decomo_export": ROOT / "export" / "decomo_export",
    "decomo_runtime": ROOT / "runtime" / "decomo_runtime",
    "decomo_eval": ROOT / "eval" / "decomo_eval",
}
GROUND_FLOOR = [
    "decomotion.arrays",
    "decomotion.__version__",
    "decomotion.clip",
    "decomotion.commands",
    "decomotion.console",
    "decomotion.entry",
    "decomotion.errors",
    "decomotion.extras",
    "decomotion.files",
    "decomotion.frame_files",
    "decomotion.frames",
    "decomotion.images",
    "decomotion.jobs",
    "decomotion.memory",
    "decomotion.outputs",
    "decomotion.presets",
    "decomotion.pseudo_depth",
    "decomotion.quality",
    "decomotion.source",
    "decomotion.tables",
    "decomotion.times",
    "decomotion.tracker_files",
    "decomotion.units",
    "decomotion.version",
    "decomotion.windows",
]
"""What every package may use of the trainer's: small modules without torch."""

MAY_IMPORT = {
    "decomotion": ["decomotion"],
    "decomo_export": ["decomo_export", "decomotion", "decomo_runtime"],
    "decomo_runtime": ["decomo_runtime", *GROUND_FLOOR],
    "decomo_eval": ["decomo_eval", "decomo_runtime", *GROUND_FLOOR],
}
SUPERVISION = [
    "decomotion.config",
    "decomotion.data.config",
    "decomotion.data.flow",
    "decomotion.data.links.intervals",
    "decomotion.data.links.linking",
    "decomotion.data.sampling",
]
FETCHED = {
    "decomo_eval.baselines": [*SUPERVISION, "decomotion.device.choose_device"],
    "decomo_eval.bench.cli": ["decomotion.options"],
    "decomo_eval.bench.run": ["decomotion.config"],
}
"""What flow baselines and benchmarks fetch of the trainer's, when one is made and not before."""
OF_AN_EXTRA = {
    "decomotion.jobs.cluster": "ray",
    "decomo_eval.report.charts": "report",
    "decomotion.batch.page": "report",
    "decomo_eval.report.published": "report",
    "decomo_eval.report.writer": "report",
    "decomotion.data.flow.raft": "raft",
    "decomotion.data.features.dino": "dino",
    "decomo_runtime.flow.exr": "exr",
}
"""Modules that fetch what one extra installs, when it is asked for and not before."""
SHARED_BY_THE_PROCESS = (
    r"signal\.signal|basicConfig|setLevel|seterr|setNumThreads|setRNGSeed|random\.seed|environ\[[^]]*\] ="
    r"|environ\.update|environ\.setdefault|putenv|chdir|umask|simplefilter|setdefaulttimeout|rcParams\["
)
RESTORES = ["decomotion.jobs.cluster"]
"""Modules that change some of it for a while: their tests see it restored."""
SELDOM_ASKED_FOR = ["ray", "jinja2", "matplotlib", "yaml", "OpenEXR"]
"""What those extras install."""
TORCH_FREE = ["decomo_runtime", "decomo_eval"]
TRAINING_ONLY = [
    "torch",
    "torchvision",
    "timm",
    "kornia",
    "onnx",
    "onnxscript",
    "safetensors",
    "tensorboard",
    "jaxtyping",
]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
COMMANDS = PROJECT["scripts"]


def imported_names(source: str, module: str, is_package: bool) -> Iterator[str]:
    """Full names of all that `source` imports, wherever in the file: `from a.b import c` gives `a.b.c`."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = module.split(".") if is_package else module.split(".")[:-1]
            base = parents[: len(parents) + 1 - node.level] if node.level else []
            origin = ".".join([*base, *([node.module] if node.module else [])])
            yield from (f"{origin}.{alias.name}" for alias in node.names)


def modules_of(package: str) -> Iterator[tuple[str, Path]]:
    folder = PACKAGES[package]
    for file in sorted(folder.rglob("*.py")):
        parts = file.relative_to(folder.parent).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), file


def distribution_name(requirement: str) -> str:
    """`PyYAML>=6` is `pyyaml`."""
    return re.split(r"[^\w.-]", requirement)[0].lower().replace("_", "-")


def run_python(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=120)


def test_imported_names_reads_every_form():
    source = "import a.b, c\nfrom d.e import f as g\nfrom . import h\nfrom ..i import j\ndef k():\n    from l import m"
    assert set(imported_names(source, "top.mid.leaf", False)) == {"a.b", "c", "d.e.f", "top.mid.h", "top.i.j", "l.m"}
    assert set(imported_names("from .h import i", "top.mid", True)) == {"top.mid.h.i"}


@pytest.mark.parametrize("package", PACKAGES)
def test_import_direction(package: str):
    allowed = [f"{prefix}." for prefix in MAY_IMPORT[package]]
    forbidden = [
        f"{file.relative_to(ROOT)} imports {name}"
        for module, file in modules_of(package)
        for name in imported_names(file.read_text(), module, file.name == "__init__.py")
        if name.split(".")[0] in PACKAGES
        and not f"{name}.".startswith((*allowed, *(f"{prefix}." for prefix in FETCHED.get(module, []))))
    ]
    assert not forbidden, f"{package} may import {MAY_IMPORT[package]} of ours"


@pytest.mark.parametrize("package", PACKAGES)
def test_no_two_modules_import_each_other(package: str):
    """Nor a ring of them, not even within functions or for their types."""
    modules = dict(modules_of(package))
    imports = {
        module: {
            next((known for known in (name, name.rpartition(".")[0]) if known in modules), module)
            for name in imported_names(file.read_text(), module, file.name == "__init__.py")
        }
        - {module}
        for module, file in modules.items()
    }
    TopologicalSorter(imports).prepare()  # a CycleError names them


def test_what_is_exported_has_names_of_its_own():
    """A class of the exporter that had the name of one of the trainer's would be taken for it."""
    names = {
        package: {
            node.name
            for _, file in modules_of(package)
            for node in ast.parse(file.read_text()).body
            if isinstance(node, ast.ClassDef)
        }
        for package in ("decomotion", "decomo_export")
    }
    assert not names["decomotion"] & names["decomo_export"]


@pytest.mark.parametrize("package", TORCH_FREE)
def test_runtime_and_eval_name_no_training_library_even_in_a_function(package: str):
    forbidden = [
        f"{file.relative_to(ROOT)} imports {name}"
        for module, file in modules_of(package)
        for name in imported_names(file.read_text(), module, file.name == "__init__.py")
        if name.split(".")[0] in TRAINING_ONLY
    ]
    assert not forbidden


@pytest.mark.parametrize("package", PACKAGES)
def test_every_library_used_is_declared(package: str):
    """In the base install for runtime, eval and the ground floor; an extra for the rest."""
    base, extras = PROJECT["dependencies"], PROJECT["optional-dependencies"]
    extra = extras["train"]
    distributions_of = packages_distributions()
    for module, file in modules_of(package):
        torch_free = package in TORCH_FREE or f"{module}.".startswith(tuple(f"{name}." for name in GROUND_FLOOR))
        own = extras[OF_AN_EXTRA[module]] if module in OF_AN_EXTRA else []
        requirements = [*base, *own] if torch_free else [*base, *extra, *own]
        declared = {distribution_name(requirement) for requirement in requirements}
        libraries = {name.split(".")[0] for name in imported_names(file.read_text(), module, False)}
        for library in libraries - set(PACKAGES) - set(sys.stdlib_module_names):
            owners = {distribution_name(owner) for owner in distributions_of.get(library, [library])}
            assert owners & declared, (
                f"{file.relative_to(ROOT)} imports {library}, which pyproject.toml does not declare"
            )


@pytest.mark.parametrize("package", TORCH_FREE)
def test_only_commands_change_what_the_whole_process_shares(package: str):
    """Threads of libraries, their chance, logging, signals, the environment: these are the caller's."""
    found = [
        f"{file.relative_to(ROOT)}: {call}"
        for module, file in modules_of(package)
        if not module.endswith("cli") and module not in RESTORES
        for call in re.findall(SHARED_BY_THE_PROCESS, file.read_text())
    ]
    assert not found


def test_runtime_and_eval_import_without_the_extras():
    without_torch = [name for package in TORCH_FREE for name, _ in modules_of(package)]
    modules = [name for name in [*GROUND_FLOOR, *without_torch] if "__" not in name]
    assert {"decomotion.clip", "decomo_runtime.cli", "decomo_eval.cli", "decomo_eval.sample.cli"} <= set(modules)
    hide_then_import = """
import importlib, sys

hidden, modules = (argument.split(",") for argument in sys.argv[1:])

class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in hidden:
            raise ImportError(f"{name} is hidden: it belongs to an extra")

sys.meta_path.insert(0, Hidden())
for module in modules:
    importlib.import_module(module)
"""
    hidden = [*TRAINING_ONLY, *SELDOM_ASKED_FOR]
    result = run_python(hide_then_import, ",".join(hidden), ",".join(modules))
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    ("command", "argv"),
    [*((command, ["--help"]) for command in COMMANDS), ("decomo-eval", ["tapvid", "--help"])],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_help_is_instant(command: str, argv: list[str]):
    """Instant: not by the clock, which a busy machine bends, but because nothing heavy is imported."""
    module, function = COMMANDS[command].split(":")
    help_then_heavy_modules = """
import importlib, sys

module, function, heavy, *argv = sys.argv[1:]
code = getattr(importlib.import_module(module), function)(argv)
print("imported:", [name for name in heavy.split(",") if name in sys.modules])
sys.exit(code)
"""
    heavy = [*TRAINING_ONLY, *SELDOM_ASKED_FOR]
    result = run_python(help_then_heavy_modules, module, function, ",".join(heavy), *argv)
    assert result.returncode == 0, result.stderr
    help_text, _, imported = result.stdout.rpartition("imported: ")
    assert help_text.startswith("Usage: ")
    assert imported.strip() == "[]"
