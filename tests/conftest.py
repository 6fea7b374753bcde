"""For all tests: where the optional real data lies, and what needs a GPU."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import hypothesis
import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser
    from xdist.remote import Producer
    from xdist.scheduler import LoadScopeScheduling

if "PYTEST_XDIST_WORKER" in os.environ:  # a worker for each core: threads of their own would wait for one another
    os.environ.setdefault("OMP_NUM_THREADS", "1")

SHARED = Path(os.environ.get("DECOMO_SHARED", Path(__file__).parents[2] / "shared"))

FUZZ_EXAMPLES = os.environ.get("DECOMO_FUZZ")
"""Examples of each property for a long search; without it, a hundred that are the same in every run."""

hypothesis.settings.register_profile(
    "ours",
    deadline=None,  # a busy machine is not a failure
    derandomize=FUZZ_EXAMPLES is None,
    max_examples=int(FUZZ_EXAMPLES or 100),
)
hypothesis.settings.load_profile("ours")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real clips and weights; the test is skipped where it is absent."""
    if not (SHARED / "data").is_dir():
        pytest.skip(f"no real data at {SHARED}: set DECOMO_SHARED to the folder that holds it")
    return SHARED


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Prepared supervision goes to a folder of the session: no test depends on what another run left behind."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DECOMO_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="session", autouse=True)
def few_trials() -> Iterator[None]:
    """What preparation will take is estimated by the fewest trials."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("decomotion.data.timing.SECONDS", 0.0)
        yield


@pytest.fixture(scope="session")
def tiny_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sliding square as a folder of frames."""
    from tiny_fit import sliding_square, write_frames

    return write_frames(sliding_square(), tmp_path_factory.mktemp("clips") / "sliding")


@pytest.fixture(scope="session")
def tiny_run(tiny_clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of `decomo-train`, 20 steps on the sliding square."""
    from decomotion.cli import main
    from tiny_fit import TINY_CPU

    out = tmp_path_factory.mktemp("runs") / "sliding"
    settings = [part for override in TINY_CPU for part in ("--set", override)]
    assert main([str(tiny_clip), "--preset", "cpu", "--steps", "20", "--out", str(out), *settings]) == 0
    return out


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    """Debian's Chromium, driven by Playwright; tests that want it are skipped where either is missing."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
    executable = shutil.which("chromium")
    if executable is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    quiet = ("quic", "background-networking", "component-update", "sync", "gpu")
    with playwright.sync_playwright() as driver:
        arguments = ["--no-sandbox", "--no-first-run", *(f"--disable-{part}" for part in quiet)]
        browser = driver.chromium.launch(executable_path=executable, args=arguments)
        yield browser
        browser.close()


HEAD = """
import sys
import ray
about = ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
print(about.address_info["gcs_address"], flush=True)
sys.stdin.read()
"""
HEAD_SECONDS = 3600
"""That the Ray of a session lives at most."""


@pytest.fixture(scope="session")
def ray_head() -> Iterator[tuple[str, dict[str, str]]]:
    """The address of a Ray of two CPUs in a process of its own, and what its clients' environment says."""
    from children import child
    from decomotion.jobs.cluster import ENVIRONMENT

    pytest.importorskip("ray", reason="needs Ray: pip install 'decomotion[ray]'")
    variables = {**ENVIRONMENT, "RAY_AUTH_MODE": "disabled"}
    with child([sys.executable, "-c", HEAD], {**os.environ, **variables}, HEAD_SECONDS) as head:
        assert head.stdout is not None
        if not (address := head.stdout.readline().strip()):
            pytest.skip("Ray did not start within the half minute that it gives itself: the machine is too busy")
        yield address, variables


@pytest.fixture
def ray_address(ray_head: tuple[str, dict[str, str]], monkeypatch: pytest.MonkeyPatch) -> str:
    """Of a Ray of two CPUs."""
    address, variables = ray_head
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    return address


TOGETHER = (
    ("tests/export/",),
    ("tests/decomotion/test_metamorphic.py",),
    ("tests/test_wheel.py",),
    ("tests/eval/test_bench.py", "tests/decomotion/test_batch_run.py::test_on_ray"),
    ("tests/docs/test_tutorials.py", "tests/docs/test_notebooks.py"),
    ("tests/runtime/test_view_clip.py",),
)
"""Tests that share what takes long to make, or fill two cores: each of these stays on one worker."""
WORKERS = 2
"""Of the whole suite; each holds torch, 1.5 GiB. Chosen files or folders are tested without."""


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """The answer to `--numprocesses=auto`."""
    return WORKERS if config.args_source is pytest.Config.ArgsSource.TESTPATHS else 0


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LoadScopeScheduling:
    """Hands out tests one by one, but for those that stay together."""
    from xdist.scheduler import LoadScopeScheduling

    class Together(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return next((places[0] for places in TOGETHER if nodeid.startswith(places)), nodeid)

    return Together(config, log)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skips tests marked `gpu` where there is none."""
    if item.get_closest_marker("gpu"):
        import torch

        if not torch.cuda.is_available():
            pytest.skip("needs a CUDA device")
